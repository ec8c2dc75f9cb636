"""Calibrations as their own programs write them: the same rays, or one sentence."""

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import endolab as el
from endolab.cli.main import main
from endolab.io.cameras.formats import read_camera

POINTS = np.array([[0.3, -0.2, 1.0], [-0.25, 0.1, 1.0], [0.05, 0.3, 1.0]])
K = np.array([[300.0, 0, 160], [0, 310.0, 120], [0, 0, 1]])
BROWN = (-0.1, 0.02, 0.001, -0.002, 0.01, 0.02, -0.01, 0.005)
FISHEYE = (-0.05, 0.01, -0.002, 0.001)


@pytest.fixture
def write(tmp_path):
    def file(name, content):
        path = tmp_path / name
        text = content if isinstance(content, str) else json.dumps(content)
        path.write_text(text, encoding="utf-8")
        return path

    return file


def by_opencv(k, fisheye=False):
    """Where OpenCV has the points."""
    project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
    pixels, _ = project(POINTS[None], np.zeros(3), np.zeros(3), K, np.array(k))
    return pixels.reshape(-1, 2)


def as_stored(path, k, more):
    storage = cv2.FileStorage(str(path), cv2.FileStorage_WRITE)
    for key, value in more.items():
        storage.write(key, value)
    storage.write("camera_matrix", K)
    storage.write("distortion_coefficients", np.array(k))
    storage.release()
    return path


@pytest.mark.parametrize("suffix", ["yaml", "xml", "json"])
@pytest.mark.parametrize("count", [4, 5, 8])
def test_opencv_writes_it(tmp_path, suffix, count):
    size = {"image_width": 320, "image_height": 240}
    path = as_stored(tmp_path / f"a.{suffix}", BROWN[:count], size)
    camera = read_camera(f"{path}#brown")
    assert_allclose(camera.project(POINTS), by_opencv(BROWN[:count]), atol=1e-9)
    path = as_stored(tmp_path / f"b.{suffix}", FISHEYE, size)
    camera = read_camera(path)
    assert_allclose(camera.project(POINTS), by_opencv(FISHEYE, True), atol=1e-9)
    path = as_stored(tmp_path / f"c.{suffix}", BROWN[:4], size | {"fisheye_model": 0})
    assert isinstance(read_camera(path), el.BrownConrady)


FIVE = list(BROWN[:5])
M = K.tolist()
NINE = K.ravel().tolist()
LENS = "".join(f"k{n}: {k}\n" for n, k in ((1, -0.1), (2, 0.02), (3, 0.01)))
LENS += "p1: 0.001\np2: -0.002\n"
FLAT = "fx: 300.0\nfy: 310.0\ncx: 160.0\ncy: 120.0\n" + LENS
SIZE = {"width": 320, "height": 240}
WIDE = "width: 320\nheight: 240\n"
FORMS = {
    "ROS": f"""image_width: 320
image_height: 240
camera_name: narrow
distortion_model: plumb_bob
camera_matrix: {{rows: 3, cols: 3, data: {NINE}}}
distortion_coefficients: {{rows: 1, cols: 5, data: {FIVE}}}
""",
    "ROS, echoed": f"height: 240\nwidth: 320\nD: {FIVE}\nK: {NINE}\n---\n",
    "legacy": f"Camera_Matrix: {M}\nkc: {FIVE}\nimage_Width: 320\nimage_Height: 240\n",
    "camel": f"cameraMatrix: {M}\ndistortionParameters: [{FIVE}]\nimageSize: [320, 240]\n",
    "snake": f"mtx: {M}\ndistortion_params: [{FIVE}]\ninput_image_size: [320, 240]\n",
    "RealSense": f'{{"ppx": 160, "ppy": 120, "fx": 300, "fy": 310, "coeffs": {FIVE}, '
    '"width": 320, "height": 240}',
    "flat": FLAT + WIDE,
    "own": re.sub("(?m)^", "  ", f"\n{FLAT}{WIDE}").replace("  ", "intrinsics:", 1),
    "left": f'{{"left": {{"K": {M}, "D": {FIVE}}}, "T": [1, 2, 3], '
    '"width": 320, "height": 240}',
    "nerfstudio": "camera_model: OPENCV\nfl_x: 300\nfl_y: 310\nw: 320\nh: 240\ncx: 160.5\n"
    f"cy: 120.5\n{LENS}frames: [{{transform_matrix: {np.eye(4).tolist()}}}]\n",
    "ORB-SLAM2": re.sub(r"(?m)^(?=\w)", "Camera.", FLAT + WIDE)
    + "LEFT.P: !!opencv-matrix\n   data:[1., 0.]\n",
    "ORB-SLAM3": 'Camera.type: "PinHole"\nCamera.width: 320\nCamera.height: 240\n'
    + re.sub(r"(?m)^(?=\w)", "Camera1.", FLAT),
    "legacy encoding": f'time: "f\xe9v."\nimage_size: [320, 240]\nK: {M}\nD: {FIVE}\n',
}


@pytest.mark.parametrize("form", FORMS)
def test_whatever_the_names_are_the_camera_is_one(tmp_path, form):
    path = tmp_path / "mine"
    path.write_text(FORMS[form], encoding="latin-1")
    assert read_camera(path) == el.BrownConrady(320, 240, 300, 310, 160, 120, FIVE)


def test_numpys_and_rows_of_a_matrix(tmp_path, write):
    np.savez(tmp_path / "a.npz", mtx=K, dist=[FIVE], rvecs=np.array([None]))
    found = read_camera(tmp_path / "a.npz", (320, 240))
    assert found == el.BrownConrady(320, 240, 300, 310, 160, 120, FIVE)
    for text in (
        "300 0 160\n0 310 120\n0 0 1\n",
        "300,0,160,0\n0,310,120,0\n0,0,1,0\n",
    ):
        found = read_camera(write("k.txt", text), (320, 240))
        assert found == el.Pinhole(320, 240, 300, 310, 160, 120)


WORDS = st.sampled_from(
    ["lens", "Numbers", "_", "poly", "model", "dist", "k", "c", "x"]
)


@given(st.lists(WORDS, min_size=1, max_size=4), st.sampled_from([4, 5, 8, 12, 14]))
def test_numbers_of_a_lens_are_read_or_named(tmp_path_factory, words, count):
    path = tmp_path_factory.mktemp("law") / "mine.json"
    name = "".join(words)
    given = {"mtx": K.tolist(), name: [0.01] * count} | SIZE
    path.write_text(json.dumps(given))
    try:
        assert read_camera(path).k[:4] == (0.01,) * 4
    except ValueError as error:
        assert name in str(error) or "coefficients" in str(error)  # noqa: PT017


def test_what_else_a_calibration_says_passes(write):
    known = {"mtx": K.tolist(), "R": [1.0] * 9, "P": [1.0] * 12, "flags": 4, **SIZE}
    known |= {"per_view_errors": [0.1] * 12, "rvecs": [[0.1, 0.2, 0.3]] * 5, "rms": 0.3}
    known |= {"board_size": [9, 6], "square_size": 35, "roi": [0, 0, 320, 240]}
    assert read_camera(write("k.json", known)) == el.Pinhole(
        320, 240, 300, 310, 160, 120
    )


def test_a_centre_far_off_is_told_but_not_after_a_crop(write, caplog):
    known = {"K": [[300, 0, 20], [0, 300, 120], [0, 0, 1]], **SIZE}
    cut = el.load_calibration(write("far.json", known)).crop(40, 0, 280, 240)
    assert "principal point" in caplog.text
    caplog.clear()
    path = write("cut.json", cut.to_dict())
    assert el.load_calibration(path) == cut
    assert not caplog.text


# As Kalibr's documentation has it (the file's layout), with two cameras.
KALIBR = """cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.05, 1e-2, -0.002, 0.001]
  distortion_model: equidistant
  intrinsics: [300, 310.0, 160.0, 120.0]
  resolution: [320, 240]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, 0.1]
  camera_model: pinhole
  distortion_coeffs: [-0.1, 0.02, 0.001, -0.002]
  distortion_model: radtan
  intrinsics: [300.0, 310.0, 160.0, 120.0]
  resolution: [320, 240]
"""


def test_kalibr(write):
    path = write("camchain.yaml", KALIBR)
    first = el.load_calibration(path).camera
    assert_allclose(first.project(POINTS), by_opencv(FISHEYE, True), atol=1e-9)
    second = el.load_calibration(f"{path}#cam1").camera
    assert_allclose(second.project(POINTS), by_opencv(BROWN[:4]), atol=1e-9)
    omni = write("omni.yaml", KALIBR.replace("pinhole", "omni", 1))
    assert el.load_calibration(f"{omni}#cam1").camera == second


# Each with where COLMAP 4.2.1 (pycolmap) has the first point, from the first pixel's corner.
COLMAP = {
    "1 SIMPLE_PINHOLE 320 240 300 160 120": (250.0, 60.0),
    "1 PINHOLE 320 240 300 310 160 120": (250.0, 58.0),
    "1 SIMPLE_RADIAL 320 240 300 160 120 -0.1": (248.83, 60.78),
    "1 RADIAL 320 240 300 160 120 -0.1 0.02": (248.86042, 60.75972),
    "1 OPENCV 320 240 300 310 160 120 -0.1 0.02 0.001 -0.002": (248.63842, 58.924544),
    "1 FULL_OPENCV 320 240 300 310 160 120 -0.1 0.02 0.001 -0.002 0.01 0.02 -0.01 0.005": (
        248.423925280,
        59.072307029,
    ),
    "1 SIMPLE_FISHEYE 320 240 200 160 120": (217.585690140, 81.609539907),
    "1 FISHEYE 320 240 200 210 160 120": (217.585690140, 79.690016902),
    "1 SIMPLE_RADIAL_FISHEYE 320 240 200 160 120 -0.05": (217.240900202, 81.839399866),
    "1 RADIAL_FISHEYE 320 240 200 160 120 -0.05 0.01": (217.249157816, 81.833894789),
    "1 OPENCV_FISHEYE 320 240 200 210 160 120 -0.05 0.01 -0.002 0.001": (
        217.248971890,
        79.925719677,
    ),
}


def test_a_name_is_the_endoscopes_whatever_lies_in_the_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("c3vd").mkdir()
    el.write_calibration(el.load_calibration("simple"), "paper")
    for name in ("c3vd", "paper"):
        assert el.load_calibration(name) is el.datasets.CALIBRATIONS[name]
        assert main(["convert", name, "--out", f"{name}.json"]) == 0
    assert el.load_calibration("./paper").camera == el.load_calibration("simple").camera


@pytest.mark.parametrize("line", COLMAP)
def test_colmap(write, line):
    head = "# Camera list\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
    other = "7 PINHOLE 640 480 500 500 320 240\n"
    path = write("cameras.txt", f"{head}{line}\n{other}")
    expected = np.array(COLMAP[line]) - 0.5
    assert_allclose(read_camera(path).project(POINTS[0]), expected, atol=1e-8)
    assert read_camera(f"{path}#7") == el.Pinhole(640, 480, 500, 500, 319.5, 239.5)


def test_c3vd(write):
    known = el.load_calibration("c3vd").camera
    flat = {f"a{power}": value for power, value in enumerate(known.a)}
    flat |= {name: getattr(known, name) for name in ("cx", "cy", "c", "d", "e")}
    size = {"width": known.width, "height": known.height}
    assert read_camera(write("flat.json", size | flat)) == known
    lines = "".join(f"{name}: {value!r}\n" for name, value in flat.items())
    assert read_camera(write("flat.txt", lines), (1350, 1080)) == known


@pytest.mark.parametrize(
    ("kind", "k", "order"),
    [
        ("", (), ()),
        ("_k1_k2", BROWN[:2], (*BROWN[:2], 0.0, 0.0)),
        ("_k1_k2_k3", BROWN[:3], (*BROWN[:2], 0.0, 0.0, BROWN[2])),
        ("_rational6", BROWN[:6], (*BROWN[:2], 0.0, 0.0, *BROWN[2:6])),
        ("_kb4", FISHEYE, FISHEYE),
    ],
)
def test_vicalib(write, kind, k, order):
    numbers = "; ".join(map(str, (300.0, 310.0, 160.0, 120.0, *k)))
    camera = f"""<camera><camera_model type="calibu_fu_fv_u0_v0{kind}">
    <width> 320 </width> <height> 240 </height> <params> [ {numbers} ] </params>
    </camera_model></camera>"""
    path = write("rig.xml", f"<rig>{camera}{camera.replace('310', '290')}</rig>")
    expected = by_opencv(order or (0.0,) * 4, kind == "_kb4")
    assert_allclose(read_camera(path).project(POINTS), expected, atol=1e-9)
    assert read_camera(f"{path}#camera1").fy == 290
