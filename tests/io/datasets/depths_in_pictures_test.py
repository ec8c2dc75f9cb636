"""Published frames whose camera comes with them: SCARED, Hamlyn and EndoSLAM, on files written here."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import endolab as el
from endolab import datasets

MATRIX = np.array([[45.0, 0.0, 30.5], [0.0, 46.0, 22.0], [0.0, 0.0, 1.0]])
DISTORTION = np.array([[-0.3, 0.08, 1e-3, -5e-4, 0.01]])
SHAPE = 48, 64
RED = np.full((*SHAPE, 3), (10, 20, 250), np.uint8)  # in OpenCV's order


def write(folder, name, stored):
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(folder / name), stored)


def write_scared(folder):
    """A keyframe that shows a tilted plane through OpenCV's camera; two pixels are unknown."""
    pixels = np.stack(np.meshgrid(np.arange(64.0), np.arange(48.0)), -1).reshape(
        -1, 1, 2
    )
    precise = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    flat = cv2.undistortPoints(pixels, MATRIX, DISTORTION, criteria=precise)
    rays = np.concatenate([flat.reshape(*SHAPE, 2), np.ones((*SHAPE, 1))], axis=-1)
    points = rays * (50 / (1 + 0.2 * rays[..., :1]))
    points[0, 0] = np.nan
    points[0, 1] = 0
    write(folder, "Left_Image.png", np.dstack([RED, np.full(SHAPE, 255, np.uint8)]))
    write(folder, "left_depth_map.tiff", points[..., ::-1].astype(np.float32))
    storage = cv2.FileStorage(
        str(folder / "endoscope_calibration.yaml"), cv2.FILE_STORAGE_WRITE
    )
    for name, matrix in {"M1": MATRIX, "D1": DISTORTION, "M2": np.eye(3)}.items():
        storage.write(name, matrix)
    storage.release()
    return np.linalg.norm(points, axis=-1)


def write_hamlyn(folder, columns=4):
    """A frame at z = 40 mm; one pixel is unknown, one at the limit; the last column of the matrix is 0."""
    z = np.full(SHAPE, 40, np.uint16)
    z[0, :2] = 0, 300
    write(folder, "image01/0000000012.jpg", RED)
    write(folder, "depth01/0000000012.png", z)
    np.savetxt(folder / "intrinsics.txt", np.pad(MATRIX, ((0, 0), (0, columns - 3))))


def write_endoslam(folder):
    """A frame at 7 cm, its red, beside other channels; one pixel is unknown."""
    grey = np.full((*SHAPE, 4), (3, 4, 7, 255), np.uint8)
    grey[0, 0, 2] = 0
    write(folder, "Frames/image_0003.png", RED)
    write(folder, "Pixelwise Depths/aov_image_0003.png", grey)
    (folder.parent / "Calibration").mkdir(exist_ok=True)
    text = ", ".join(str(value) for value in MATRIX.ravel())
    (folder.parent / "Calibration/cam.txt").write_text(text)


def slants():
    """Distance over z of each pixel of the matrix's camera."""
    column, row = np.meshgrid(np.arange(64), np.arange(48))
    return np.sqrt(1 + ((column - 30.5) / 45) ** 2 + ((row - 22) / 46) ** 2)


def check(folder, layout, name, write):
    """The frame opens in its folder and in the one around it; return it."""
    place = folder / "sequence"
    place.mkdir()
    write(place)
    opened = el.open_dataset(place)
    assert (opened.layout, opened.names) == (layout, (name,))
    assert el.open_dataset(folder).names == (f"sequence/{name}",)
    sample = opened[0]
    assert sample.frame.mask.all()
    assert sample.calibration.photometry.gain is None
    with pytest.raises(ValueError, match="give none"):
        el.open_dataset(place, el.Pinhole(64, 48, 45.0, 46.0, 30.5, 22.0))
    return sample


def test_a_keyframe_of_scared(tmp_path):
    """Its own points lie on the rays of its own camera; to single precision."""
    sample = check(tmp_path, "scared", "Left_Image.png", write_scared)
    distance = write_scared(tmp_path / "sequence")
    assert np.isnan(sample.distance[0, :2]).all()
    assert_allclose(sample.distance.ravel()[2:], distance.ravel()[2:], rtol=1e-5)
    assert_allclose(sample.frame.image[5, 5] * 255, (250, 20, 10))


def test_a_keyframe_of_scared_whose_files_are_others(tmp_path):
    write_scared(tmp_path)
    text = (tmp_path / "endoscope_calibration.yaml").read_text()
    (tmp_path / "endoscope_calibration.yaml").write_text(text.replace("M1", "M3"))
    with pytest.raises(ValueError, match=r"endoscope_calibration\.yaml: not .* M1"):
        datasets.read_scared(tmp_path)
    write(tmp_path, "left_depth_map.tiff", np.ones(SHAPE, np.float32))
    with pytest.raises(ValueError, match=r"left_depth_map\.tiff: expected X, Y and Z"):
        datasets.read_scared(tmp_path)


def test_a_frame_of_hamlyn(tmp_path):
    sample = check(tmp_path, "hamlyn", "image01/0000000012.jpg", write_hamlyn)
    assert np.isnan(sample.distance[0, :2]).all()
    assert_allclose(sample.distance.ravel()[2:], 40 * slants().ravel()[2:])
    write_hamlyn(tmp_path / "sequence", columns=3)
    same = datasets.read_hamlyn(tmp_path / "sequence", 12)
    assert_array_equal(same.distance, sample.distance)


def test_a_frame_of_endoslam(tmp_path):
    name = "Frames/image_0003.png"
    sample = check(tmp_path, "endoslam", name, write_endoslam)
    assert np.isnan(sample.distance[0, 0])
    assert_allclose(sample.distance.ravel()[1:], 70 * slants().ravel()[1:])


@pytest.mark.parametrize("content", ["1 2 3", "a b c", "1 0 2 0 nan 3 0 0 1", "", None])
def test_a_matrix_that_is_none(tmp_path, content):
    write_hamlyn(tmp_path)
    if content is None:
        (tmp_path / "intrinsics.txt").unlink()
    else:
        (tmp_path / "intrinsics.txt").write_text(content)
    with pytest.raises((ValueError, OSError), match=r"intrinsics\.txt"):
        datasets.read_hamlyn(tmp_path, 12)
