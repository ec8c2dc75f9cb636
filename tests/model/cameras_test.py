"""Cameras against OpenCV, against their own definitions, and there and back again."""

import pickle
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from endolab.io.datasets import load_calibration
from endolab.model.cameras import BrownConrady, KannalaBrandt, Pinhole, Scaramuzza

ENDOSCOPE = load_calibration("paper").camera
WIDE = KannalaBrandt(400, 400, 100.0, 100.0, 199.5, 199.5, (0.01, 0.0, 0.0, 0.0))
PINHOLE = Pinhole(320, 240, 200.0, 210.0, 159.5, 119.5)
C3VD = load_calibration("c3vd").camera
K = (-0.188672, -0.00392734, 0.0305248, -0.0127569)
C3VD_KB = KannalaBrandt(1350, 1080, 767.386, 767.506, 679.054, 543.647, K)
BROWN = BrownConrady(
    640, 480, 420.0, 425.0, 310.0, 245.0, (-0.33, 0.12, 1e-3, -8e-4, -0.01)
)
RATIONAL_K = (0.9, 0.3, 1e-3, -5e-4, 0.02, 1.25, 0.5, 0.08)
RATIONAL = BrownConrady(1350, 1080, 600.0, 610.0, 670.0, 545.0, RATIONAL_K)
CAMERAS = {
    "endoscope": ENDOSCOPE,
    "wide": WIDE,
    "pinhole": PINHOLE,
    "scaramuzza": C3VD,
    "brown": BROWN,
    "rational": RATIONAL,
}
every_camera = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())


def small(camera):
    """The same camera with a few pixels only, one of them exactly on the axis."""
    camera = camera.resize(37, 29)
    return replace(camera, cx=round(camera.cx), cy=round(camera.cy))


def pixels(camera, step=1):
    """(rows, columns, 2) pixel coordinates, edges included."""
    columns = np.append(np.arange(0.0, camera.width - 1, step), camera.width - 0.5)
    rows = np.append(np.arange(0.0, camera.height - 1, step), camera.height - 0.5)
    return np.stack(np.meshgrid(columns, rows), axis=-1)


def directions(rng, count, max_degrees):
    theta = np.deg2rad(rng.uniform(0, max_degrees, count))
    phi = rng.uniform(0, 2 * np.pi, count)
    return np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)],
        axis=-1,
    )


def matrix(camera):
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])


@pytest.mark.parametrize("camera", [ENDOSCOPE, C3VD_KB], ids=["endoscope", "c3vd"])
def test_kannala_brandt_projects_as_opencv_does(rng, camera):
    points = directions(
        rng, 500, min(89.0, np.rad2deg(camera.max_angle))
    ) * rng.uniform(5, 200, (500, 1))
    here = np.zeros(3), np.zeros(3)
    expected, _ = cv2.fisheye.projectPoints(
        points[None], *here, matrix(camera), np.array(camera.k)
    )
    assert_allclose(camera.project(points), expected.reshape(-1, 2), rtol=0, atol=1e-9)


@pytest.mark.parametrize("camera", [BROWN, RATIONAL], ids=["brown", "rational"])
def test_brown_conrady_is_opencvs_usual_model(rng, camera):
    pixel = rng.uniform([0, 0], [camera.width, camera.height], (500, 2))
    ray = camera.unproject(pixel)
    seen = np.isfinite(ray[:, 0])
    assert seen.mean() > 0.98
    lens = matrix(camera), np.array(camera.k)
    expected, _ = cv2.projectPoints(7 * ray[seen], np.zeros(3), np.zeros(3), *lens)
    assert_allclose(expected[:, 0], pixel[seen], rtol=0, atol=1e-9)
    # OpenCV's iteration is slow where the picture is pressed together.
    calm = seen & (ray[:, 2] > np.cos(np.deg2rad(40)))
    assert calm.mean() > 0.4
    until = cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 500, 1e-15
    undone = cv2.undistortPoints(pixel[calm, None], *lens, criteria=until)
    assert_allclose(ray[calm, :2] / ray[calm, 2:], undone[:, 0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("side", [-1, 1], ids=["left", "right"])
@pytest.mark.parametrize("p2", [0.0, 5e-3, -5e-3])
def test_brown_conrady_ends_where_it_stops_growing(p2, side):
    """Against a fine table along the middle row; p2 ends it sooner on one side, and that side counts."""
    camera = replace(BROWN, k=(-0.33, 0.02, 0.0, p2))
    x = side * np.linspace(0, 1.5, 150001)
    distorted = x * (1 - 0.33 * x**2 + 0.02 * x**4) + 3 * p2 * x**2
    last = np.argmax(side * distorted)
    end = np.tan(camera.max_angle)
    sooner = side * p2 <= 0
    assert (
        np.abs(x[last]) == pytest.approx(end, abs=2e-5)
        if sooner
        else end < np.abs(x[last])
    )
    pixel = camera.cx + camera.fx * distorted[last]
    assert np.isnan(camera.unproject([pixel + side * 0.01, camera.cy])).all()
    if sooner:
        assert np.isfinite(camera.unproject([pixel - side * 0.01, camera.cy])).all()
    assert np.isfinite(camera.project([0.9999 * end, 0, 1])).all()
    assert np.isnan(camera.project([[1.0001 * end, 0, 1], [0, 0, -1], [0, 0, 0]])).all()


def test_brown_conrady_ends_before_a_pole():
    camera = BrownConrady(640, 480, 420, 420, 319.5, 239.5, (0, 0, 0, 0, 0, -0.5, 0, 0))
    assert np.tan(camera.max_angle) == pytest.approx(np.sqrt(2), rel=1e-6)
    assert np.isfinite(camera.field.rays).all()


def test_kannala_brandt_goes_on_beyond_90_degrees(rng):
    """Against the paper's formula, written out."""
    ray = directions(rng, 500, 150.0)
    theta = np.arccos(ray[:, 2])
    phi = np.arctan2(ray[:, 1], ray[:, 0])
    rho = theta + 0.01 * theta**3
    expected = 199.5 + 100 * rho[:, None] * np.stack(
        [np.cos(phi), np.sin(phi)], axis=-1
    )
    assert np.sum(ray[:, 2] < 0) > 100
    assert_allclose(WIDE.project(7 * ray), expected, rtol=0, atol=1e-10)
    assert_allclose(WIDE.unproject(expected), ray, rtol=0, atol=1e-12)


def test_scaramuzza_is_its_polynomial(rng):
    p = rng.uniform([-670, -540], [670, 535], (500, 2))
    r = np.hypot(*p.T)
    ray = np.column_stack([p, np.polynomial.polynomial.polyval(r, C3VD.a)])
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    pixel = p @ np.array([[C3VD.c, C3VD.d], [C3VD.e, 1.0]]).T + [C3VD.cx, C3VD.cy]
    assert_allclose(C3VD.unproject(pixel), ray, rtol=0, atol=1e-13)
    assert_allclose(C3VD.project(33 * ray), pixel, rtol=0, atol=1e-10)


@every_camera
def test_pixel_to_ray_to_pixel(camera):
    pixel = pixels(camera, 7)
    ray = camera.unproject(pixel)
    seen = np.isfinite(ray).all(axis=-1)
    assert seen.mean() > 0.9
    assert_allclose(np.linalg.norm(ray[seen], axis=-1), 1.0, rtol=0, atol=1e-14)
    for distance in (1e-3, 40, 1e3):
        assert_allclose(
            camera.project(distance * ray[seen]), pixel[seen], rtol=0, atol=1e-10
        )


def test_the_endoscopes_polynomial_ends_where_it_stops_growing():
    assert np.rad2deg(ENDOSCOPE.max_angle) == pytest.approx(90.84, abs=0.005)
    at = np.array([735.37, 552.80])
    assert np.all(np.isfinite(ENDOSCOPE.unproject(at + np.array([0, 745.5]))))
    assert np.all(np.isnan(ENDOSCOPE.unproject(at + np.array([0, 746.5]))))
    for camera in (ENDOSCOPE, PINHOLE):
        assert np.isnan(camera.project([[0, 0, 0], [1, 2, -1e3]])).all()


def test_scaramuzzas_polynomial_ends_where_the_angle_stops_growing():
    """Against a fine table of atan2(r, a(r))."""
    camera = Scaramuzza(400, 400, 199.5, 199.5, (100, 0, 2e-3, 1e-5, 1e-8))
    r = np.linspace(0, 400, 400001)
    angle = np.arctan2(r, np.polynomial.polynomial.polyval(r, camera.a))
    end = r[np.argmax(angle)]
    assert 50 < end < 200
    assert camera.max_angle == pytest.approx(angle.max(), abs=1e-9)
    assert np.all(np.isfinite(camera.unproject([199.5 + end - 0.01, 199.5])))
    assert np.all(np.isnan(camera.unproject([199.5, 199.5 - end - 0.01])))
    for step, seen in ((-1e-4, True), (1e-4, False)):
        at = camera.max_angle + step
        assert np.isfinite(camera.project([0, np.sin(at), np.cos(at)])).all() == seen


@every_camera
def test_jacobian_is_the_derivative_of_the_rays(camera):
    camera = small(camera)
    field = camera.field
    pixel = pixels(camera)[:-1, :-1]
    h = 1e-4
    ways = np.eye(2) * h
    numerical = [
        (camera.unproject(pixel + e) - camera.unproject(pixel - e)) / (2 * h)
        for e in ways
    ]
    numerical = np.stack(numerical, axis=-1)
    # Near the end of the endoscope's polynomial ϑ(ρ) has a square root's slope.
    calm = (np.abs(field.jacobian).max(axis=(-2, -1)) < 0.3)[:-1, :-1] & field.valid[
        :-1, :-1
    ]
    assert calm.mean() > 0.85
    assert_allclose(field.jacobian[:-1, :-1][calm], numerical[calm], rtol=0, atol=1e-7)


def test_solid_angle_of_a_picture():
    """√det G integrates to the solid angle; a pinhole's rectangle has a closed form."""
    camera = Pinhole(320, 240, 200.0, 200.0, 159.5, 119.5)
    uu, uv, vv = np.moveaxis(camera.field.inverse_metric, -1, 0)
    x = 160 / 200
    y = 120 / 200
    expected = 4 * np.arctan(x * y / np.sqrt(1 + x * x + y * y))
    assert np.sum(1 / np.sqrt(uu * vv - uv**2)) == pytest.approx(expected, rel=1e-5)


@pytest.fixture
def often_switched():
    """Have Python go from one thread to the next as often as it can."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def test_a_camera_that_threads_resize_is_right_in_each_and_stays_as_it_was(
    often_switched,
):
    camera = replace(ENDOSCOPE)

    def resize(number):
        for width in range(40, 240):
            size = width, 30 + number % 2
            resized = camera.resize(*size)
            assert (resized.width, resized.height) == size

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(resize, range(8)))
    assert camera.resize(64, 48) is camera.resize(64, 48)  # with its ray field
    assert (camera, hash(camera)) == (ENDOSCOPE, hash(ENDOSCOPE))
    assert pickle.loads(pickle.dumps(camera)) == camera


@every_camera
def test_resize_keeps_the_outer_edges(rng, camera):
    points = directions(rng, 100, 60.0)
    resized = camera.resize(camera.width // 3, camera.height * 2)
    scale = np.array([resized.width / camera.width, resized.height / camera.height])
    assert_allclose(
        resized.project(points) + 0.5,
        (camera.project(points) + 0.5) * scale,
        rtol=0,
        atol=1e-9,
    )
    here, there = (
        each.unproject((-0.5, each.height / 2 - 0.5)) for each in (resized, camera)
    )
    assert_allclose(here, there, rtol=0, atol=1e-12)
