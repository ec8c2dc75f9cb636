"""UCL 2019's layout on synthetic files: units, names, and what is refused."""

import cv2
import numpy as np
import pytest

from endolab import datasets
from endolab.datasets import folders
from endolab.datasets import ucl2019 as ucl
from endolab.model.cameras import Pinhole

CAMERA = Pinhole(256, 256, 128.0, 128.0, 127.5, 127.5)  # 90° wide, for the sake of a number
SERIES = "T1_L2_1_resized"


def write(folder, index=12, series=SERIES, value=51, shape=(256, 256), dtype=np.uint8):
    """A frame at z = 4 cm, with one pixel unknown and one too far."""
    depth = np.full(shape, value, dtype)
    depth[0, 0], depth[0, 1] = 0, 255
    colour = np.full((256, 256, 3), 51, np.uint8)
    colour[..., 2] = 255
    cv2.imwrite(str(folder / f"{series}_Depth_{index:04d}.png"), depth)
    cv2.imwrite(str(folder / f"{series}_FrameBuffer_{index:04d}.png"), colour)


def test_a_frame(tmp_path):
    write(tmp_path)
    sample = ucl.read_ucl2019(tmp_path, SERIES, 12, CAMERA)
    assert sample.frame.name == f"{SERIES}_FrameBuffer_0012.png"
    np.testing.assert_allclose(sample.frame.image[5, 5], (1.0, 0.2, 0.2))
    assert sample.frame.mask.all()
    assert np.isnan(sample.distance[0, :2]).all()
    side = 127.5 / 128  # the lower right corner, off the axis by as much across as down
    assert sample.distance[255, 255] == pytest.approx(40.0 * np.sqrt(1 + 2 * side**2))
    assert sample.calibration.camera == CAMERA
    assert sample.calibration.photometry.gain is None


def test_true_z_knows_the_name(tmp_path):
    write(tmp_path)
    z = datasets.true_z(tmp_path / f"{SERIES}_Depth_0012.png")
    assert z[5, 5] == pytest.approx(40.0)
    assert np.isnan(z[0, :2]).all()


def test_a_folder_of_two_series(tmp_path):
    write(tmp_path)
    write(tmp_path, series="C_T3_L2_3_resized", value=102)
    folder = folders.open_dataset(tmp_path, CAMERA)
    assert folder.layout == "ucl2019"
    assert folder.names == ("C_T3_L2_3_resized_FrameBuffer_0012.png", f"{SERIES}_FrameBuffer_0012.png")
    near = [np.nanmin(sample.distance) for sample in folder]
    np.testing.assert_allclose(near, (80.0, 40.0), rtol=1e-4)
    with pytest.raises(ValueError, match="the camera of UCL 2019 is not published; give one"):
        folders.open_dataset(tmp_path)


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"dtype": np.uint16}, "expected one channel of uint8, found uint16"),
        ({"shape": (256, 256, 3)}, "expected one channel of uint8, found uint8 of shape"),
        ({"shape": (128, 256)}, "expected 256x256 px, found 256x128 px"),
    ],
)
def test_depth_of_another_kind(tmp_path, how, message):
    write(tmp_path, **how)
    with pytest.raises(ValueError, match=message) as caught:
        ucl.read_ucl2019(tmp_path, SERIES, 12, CAMERA)
    assert str(caught.value).startswith(str(tmp_path / f"{SERIES}_Depth_0012.png"))


@pytest.mark.parametrize(("value", "message"), [(0, "found 0 everywhere"), (1, "none beyond 0.78 mm")])
def test_depth_that_is_none(tmp_path, value, message):
    path = tmp_path / "a_Depth_0001.png"
    cv2.imwrite(str(path), np.full((256, 256), value, np.uint8))
    with pytest.raises(ValueError, match=message):
        ucl.read_ucl2019_depth(path)


def test_files_that_do_not_fit(tmp_path):
    write(tmp_path)
    with pytest.raises(FileNotFoundError, match=f"expected a file {SERIES}_FrameBuffer_0013.png"):
        ucl.read_ucl2019(tmp_path, SERIES, 13, CAMERA)
    with pytest.raises(ValueError, match=r"Depth_0012\.png: expected 320x240 px, found 256x256 px"):
        ucl.read_ucl2019(tmp_path, SERIES, 12, datasets.load_calibration("simple").camera)
    cv2.imwrite(str(tmp_path / f"{SERIES}_FrameBuffer_0012.png"), np.zeros((256, 256), np.uint8))
    with pytest.raises(ValueError, match=r"FrameBuffer_0012\.png: expected colours of 256x256 px"):
        ucl.read_ucl2019(tmp_path, SERIES, 12, CAMERA)
    (tmp_path / f"{SERIES}_Depth_0012.png").unlink()
    with pytest.raises(FileNotFoundError, match=f"expected a file {SERIES}_Depth_0012.png"):
        ucl.read_ucl2019(tmp_path, SERIES, 12, CAMERA)
