"""Published frames: their layouts on synthetic files, then the frames themselves where they are."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from endolab import datasets


def write(folder, name, stored):
    """Write a picture, colours in OpenCV's order, into a folder that may be new."""
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(folder / name), stored)


def test_published_frames_are_where_they_are_said_to_be_and_nowhere_else(
    tmp_path, monkeypatch
):
    for named, found in ((str(tmp_path), tmp_path), (str(tmp_path / "none"), None)):
        monkeypatch.setenv("ENDOLAB_DATA", named)
        assert datasets.data_folder() == found
    monkeypatch.delenv("ENDOLAB_DATA")
    assert datasets.data_folder() is None


@pytest.mark.parametrize("suffix", ["png", "tiff"])
def test_a_frame_of_c3vd(tmp_path, suffix):
    """A frame of C3VD that shows z = 20 mm but in three pixels, and nothing in the first column."""
    depth = np.full((1080, 1350), round(20 * 655.35), np.uint16)
    depth[:, 0] = 0
    depth[540, 1] = 65535
    depth[543, 679] = 6554
    depth[540, 3] = 65534
    colour = np.zeros((1080, 1350, 3), np.uint8)
    colour[7, 9] = (10, 20, 30)
    write(tmp_path, "0042_color.png", colour)
    write(tmp_path, f"0042_depth.{suffix}", depth)
    (sample,) = datasets.open_dataset(tmp_path)
    assert sample.frame.name == "0042_color.png"
    assert_array_equal(sample.frame.image[7, 9] * 255, (30, 20, 10))
    assert_array_equal(sample.frame.mask, np.arange(1350) > np.zeros((1080, 1)))
    z = sample.distance * sample.calibration.camera.field.cos_alpha
    assert np.isnan(z[540, :2]).all()
    assert z[540, 3] == pytest.approx(65534 / 655.35)
    assert np.nanmedian(z) == pytest.approx(20.0, abs=1e-3)
    assert sample.distance[543, 679] == pytest.approx(10.0, abs=1e-3)  # on the axis


def test_a_frame_of_simcol3d(tmp_path):
    """A frame of SimCol3D at z = 4 cm but in two pixels."""
    depth = np.full((475, 475), 4 / 20 * 255 * 256, np.uint16)
    depth[0, 0] = 0
    depth[237, 237] = 256
    colour = np.full((475, 475, 4), 65280, np.uint16)
    colour[..., 0] = 128 << 8  # blue
    write(tmp_path, "FrameBuffer_0007.png", colour)
    write(tmp_path, "Depth_0007.png", depth)
    (sample,) = datasets.open_dataset(tmp_path)
    assert_allclose(sample.frame.image[100, 100], (1.0, 1.0, 128 / 255), rtol=1e-12)
    assert sample.frame.mask.all()
    assert np.isnan(sample.distance[0, 0])
    assert sample.distance[237, 237] == pytest.approx(200 / 255)
    corner = 40 * np.sqrt(1 + 2 * (237 / 227.60416) ** 2)
    assert sample.distance[0, 474] == pytest.approx(corner, rel=1e-9)


LAID = {  # where three frames of a sequence lie: colour, depth, the camera
    "C3VD": ("{0:04d}_color.png", "{0:04d}_depth.tiff", "c3vd"),
    "C3VD, short": ("{0}_color.png", "{0:04d}_depth.tiff", "c3vd"),
    "C3VDv2": ("rgb/{0:04d}.png", "depth/{0:04d}_depth.tiff", "c3vd_v2"),
    "EndoGSLAM": ("color/{0:04d}_color.png", "depth/{0:04d}_depth.tiff", "c3vd"),
    "EndoGSLAM, raw": (
        "color_raw/{0}_color.png",
        "depth_raw/{0:04d}_depth.tiff",
        "c3vd",
    ),
}


def write_sequence(folder, kind, numbers=(10, 2, 9)):
    """Frames of z = 10 mm and their number, and as red; what else such a folder holds."""
    colours, depths, _ = LAID[kind]
    for number in numbers:
        red = np.full((108, 135, 3), (0, 0, 20 * number), np.uint8)
        z = np.full((108, 135), round((10 + number) * 655.35), np.uint16)
        write(folder, colours.format(number), red)
        write(folder, depths.format(number), z)
    write(folder, "normals/0002_normals.tiff", np.zeros((2, 2), np.uint8))
    if "raw" in kind:  # beside them what it makes: without distortion, of 8 bits
        for name in ("color/2_color.png", "depth/0002_depth.tiff"):
            write(folder, name, np.full((108, 135), 50, np.uint8))


def check_sequence(dataset, numbers):
    for number, sample in zip(numbers, dataset, strict=True):
        assert round(float(sample.frame.image[50, 50, 0]) * 255) == 20 * number
        z = sample.distance * sample.calibration.camera.field.cos_alpha
        assert np.nanmedian(z) == pytest.approx(10 + number, abs=1e-3)


@pytest.mark.parametrize("kind", LAID)
def test_colour_and_depth_are_paired_by_number_wherever_they_lie(tmp_path, kind):
    """In the folder of a sequence, or in one that holds several."""
    colours, depths, camera = LAID[kind]
    write_sequence(tmp_path / "cecum_t1_a", kind)
    write_sequence(tmp_path / "cecum_t2_b", kind, (3,))
    (tmp_path / "3D_models").mkdir()
    dataset = datasets.open_dataset(tmp_path / "cecum_t1_a")
    assert dataset.names == tuple(colours.format(number) for number in (2, 9, 10))
    check_sequence(dataset, (2, 9, 10))
    assert dataset[0].calibration == datasets.load_calibration(camera, 135)
    several = datasets.open_dataset(tmp_path)
    check_sequence(several, (2, 9, 10, 3))
    check_sequence([several[f"cecum_t1_a/{colours.format(2)}"]], (2,))
    (tmp_path / "cecum_t1_a" / depths.format(9)).unlink()
    with pytest.raises(FileNotFoundError, match="0009_depth"):
        dataset[1]


@pytest.mark.parametrize(
    ("name", "index", "stored", "pixel", "z"),
    [
        ("c3vd_trans_t1_a", 0, (36, 27, 25), (100, 700), 14015 / 655.35),
        ("simcol3d", 0, (116, 68, 47), (100, 300), 6912 / 256 / 255 * 200),
    ],
)
def test_known_pixels(data, name, index, stored, pixel, z):
    """Values that another program read."""
    sample = datasets.open_dataset(data / name)[index]
    image = sample.frame.image
    middle = image[image.shape[0] // 2, image.shape[1] // 2]
    assert_allclose(middle * 255, stored, rtol=1e-9)
    ray = sample.calibration.camera.unproject(pixel[::-1])
    assert sample.distance[pixel] == pytest.approx(z / ray[2], rel=1e-9)
