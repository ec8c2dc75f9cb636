"""Cameras against OpenCV, against their own definitions, and there and back again."""

import gc
import pickle
import weakref
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

import endolab as el

ENDOSCOPE = el.load_calibration("paper").camera
WIDE = el.KannalaBrandt(400, 400, 100.0, 100.0, 199.5, 199.5, (0.01, 0.0, 0.0, 0.0))
PINHOLE = el.Pinhole(320, 240, 200.0, 210.0, 159.5, 119.5)
C3VD = el.load_calibration("c3vd").camera
BROWN = el.BrownConrady(
    640, 480, 420.0, 425.0, 310.0, 245.0, (-0.33, 0.12, 1e-3, -8e-4, -0.01)
)
RATIONAL_K = (0.9, 0.3, 1e-3, -5e-4, 0.02, 1.25, 0.5, 0.08)
RATIONAL = el.BrownConrady(1350, 1080, 600.0, 610.0, 670.0, 545.0, RATIONAL_K)
CAMERAS = {
    "endoscope": ENDOSCOPE,
    "wide": WIDE,
    "pinhole": PINHOLE,
    "scaramuzza": C3VD,
    "brown": BROWN,
    "rational": RATIONAL,
}
every_camera = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)


def pixels(camera, step=1):
    """(rows, columns, 2) pixel coordinates, edges included."""
    columns, rows = (
        np.append(np.arange(0.0, size - 1, step), size - 0.5)
        for size in (camera.width, camera.height)
    )
    return np.stack(np.meshgrid(columns, rows), axis=-1)


def directions(rng, count, max_degrees):
    theta = np.deg2rad(rng.uniform(0, max_degrees, count))
    phi = rng.uniform(0, 2 * np.pi, count)
    x, y = np.sin(theta) * [np.cos(phi), np.sin(phi)]
    return np.stack([x, y, np.cos(theta)], axis=-1)


@pytest.mark.parametrize("camera", [BROWN, RATIONAL], ids=["brown", "rational"])
def test_brown_conrady_is_opencvs_usual_model(rng, camera):
    pixel = rng.uniform([0, 0], [camera.width, camera.height], (500, 2))
    ray = camera.unproject(pixel)
    seen = np.isfinite(ray[:, 0])
    assert seen.mean() > 0.98
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    lens = np.zeros(3), np.zeros(3), matrix, np.array(camera.k)
    expected, _ = cv2.projectPoints(7 * ray[seen], *lens)
    assert_allclose(expected[:, 0], pixel[seen], rtol=0, atol=1e-9)


@pytest.mark.parametrize("side", [-1, 1], ids=["left", "right"])
@pytest.mark.parametrize("p2", [0.0, 5e-3, -5e-3])
def test_brown_conrady_ends_where_it_stops_growing(p2, side):
    """Against a fine table along the middle row; p2 ends it sooner on one side, and that side counts."""
    camera = replace(BROWN, k=(-0.33, 0.02, 0.0, p2))
    x = side * np.linspace(0, 1.5, 150001)
    distorted = x * (1 - 0.33 * x**2 + 0.02 * x**4) + 3 * p2 * x**2
    last = np.argmax(side * distorted)
    end = np.tan(camera.max_angle)
    assert end < np.abs(x[last]) + 2e-5
    if side * p2 <= 0:
        assert end == pytest.approx(np.abs(x[last]), abs=2e-5)
    pixel = camera.cx + camera.fx * distorted[last]
    assert np.isnan(camera.unproject([pixel + side * 0.01, camera.cy])).all()
    assert np.isfinite(camera.project([0.9999 * end, 0, 1])).all()
    assert np.isnan(camera.project([[1.0001 * end, 0, 1], [0, 0, -1], [0, 0, 0]])).all()


def test_brown_conrady_ends_before_a_pole():
    camera = el.BrownConrady(
        640, 480, 420, 420, 319.5, 239.5, (0, 0, 0, 0, 0, -0.5, 0, 0)
    )
    assert np.tan(camera.max_angle) == pytest.approx(np.sqrt(2), rel=1e-6)
    assert np.isfinite(camera.field.rays).all()


@pytest.mark.parametrize(("camera", "degrees"), [(ENDOSCOPE, 90.0), (WIDE, 150.0)])
def test_kannala_brandt_is_the_papers_polynomial(rng, camera, degrees):
    """Beyond 90°, too."""
    ray = directions(rng, 500, degrees)
    theta = np.arccos(ray[:, 2:])
    rho = theta * np.polynomial.polynomial.polyval(theta**2, (1, *camera.k))
    off_axis = np.array([camera.fx, camera.fy]) * ray[:, :2] / np.sin(theta)
    expected = rho * off_axis + [camera.cx, camera.cy]
    assert_allclose(camera.project(7 * ray), expected, rtol=0, atol=1e-9)


def test_scaramuzza_is_its_polynomial(rng):
    p = rng.uniform([-670, -540], [670, 535], (500, 2))
    z = np.polynomial.polynomial.polyval(np.hypot(*p.T), C3VD.a)
    ray = np.column_stack([p, z])
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    pixel = p @ np.array([[C3VD.c, C3VD.e], [C3VD.d, 1.0]]) + [C3VD.cx, C3VD.cy]
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
        found = camera.project(distance * ray[seen])
        assert_allclose(found, pixel[seen], rtol=0, atol=1e-10)


def test_the_endoscopes_polynomial_ends_where_it_stops_growing():
    assert np.rad2deg(ENDOSCOPE.max_angle) == pytest.approx(90.84, abs=0.005)
    assert np.isfinite(ENDOSCOPE.unproject([735.37, 552.80 + 745.5])).all()
    assert np.isnan(ENDOSCOPE.unproject([735.37, 552.80 + 746.5])).all()
    for camera in (ENDOSCOPE, PINHOLE):
        assert np.isnan(camera.project([[0, 0, 0], [1, 2, -1e3]])).all()


def test_scaramuzzas_polynomial_ends_where_the_angle_stops_growing():
    """Against a fine table of atan2(r, a(r))."""
    camera = el.Scaramuzza(400, 400, 199.5, 199.5, (100, 0, 2e-3, 1e-5, 1e-8))
    r = np.linspace(0, 400, 400001)
    angle = np.arctan2(r, np.polynomial.polynomial.polyval(r, camera.a))
    end = r[np.argmax(angle)]
    assert 50 < end < 200
    assert camera.max_angle == pytest.approx(angle.max(), abs=1e-9)
    assert np.isfinite(camera.unproject([199.5 + end - 0.01, 199.5])).all()
    assert np.isnan(camera.unproject([199.5, 199.5 - end - 0.01])).all()


@every_camera
def test_jacobian_is_the_derivative_of_the_rays(camera):
    """One of the few pixels lies exactly on the axis."""
    camera = camera.resize(37, 29)
    camera = replace(camera, cx=round(camera.cx), cy=round(camera.cy))
    inner = slice(None, -1), slice(None, -1)
    pixel = pixels(camera)[inner]
    numerical = [
        (camera.unproject(pixel + e) - camera.unproject(pixel - e)) / 2e-4
        for e in np.eye(2) * 1e-4
    ]
    found = camera.field.jacobian[inner]
    # Near the end of the endoscope's polynomial ϑ(ρ) has a square root's slope.
    calm = (np.abs(found).max(axis=(-2, -1)) < 0.3) & camera.field.valid[inner]
    assert calm.mean() > 0.85
    expected = np.stack(numerical, axis=-1)
    assert_allclose(found[calm], expected[calm], rtol=0, atol=1e-7)


def test_equal_cameras_have_one_ray_field_and_the_camera_stays_as_it_was():
    camera = replace(ENDOSCOPE)
    assert camera.resize(64, 48).field is camera.resize(64, 48).field
    assert (camera, hash(camera)) == (ENDOSCOPE, hash(ENDOSCOPE))
    assert pickle.loads(pickle.dumps(camera)) == camera


def test_of_many_sizes_the_ray_fields_of_one_and_of_few_pixels_are_kept():
    few, many = [(k, 30) for k in range(20, 30)], [(k, 500) for k in range(400, 404)]
    fields = [weakref.ref(ENDOSCOPE.resize(*size).field) for size in [*many, *few]]
    gc.collect()
    sizes = [field().valid.size for field in fields if field() is not None]
    assert sorted(sizes) == [27 * 30, 28 * 30, 29 * 30, 403 * 500]


@every_camera
def test_resize_keeps_the_outer_edges(rng, camera):
    points = directions(rng, 100, 60.0)
    resized = camera.resize(camera.width // 3, camera.height * 2)
    scale = np.array([resized.width / camera.width, resized.height / camera.height])
    expected = (camera.project(points) + 0.5) * scale - 0.5
    assert_allclose(resized.project(points), expected, rtol=0, atol=1e-9)
