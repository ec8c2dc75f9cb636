"""Cameras against OpenCV, against their own definitions, and there and back again."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from endolab.model.cameras import BrownConrady, Scaramuzza
from tests.model.conftest import BROWN, C3VD, ENDOSCOPE, PINHOLE, WIDE, every_camera


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
    camera = BrownConrady(640, 480, 420, 420, 319.5, 239.5, (0, 0, 0, 0, 0, -0.5, 0, 0))
    assert np.tan(camera.max_angle) == pytest.approx(np.sqrt(2), rel=1e-6)
    assert np.isfinite(camera.field.rays).all()


def test_kannala_brandt_goes_on_beyond_90_degrees(rng):
    """Against the paper's formula, written out."""
    ray = directions(rng, 500, 150.0)
    theta = np.arccos(ray[:, 2])
    phi = np.arctan2(ray[:, 1], ray[:, 0])
    rho = theta + 0.01 * theta**3
    expected = 199.5 + 100 * np.stack([rho * np.cos(phi), rho * np.sin(phi)], axis=-1)
    assert_allclose(WIDE.project(7 * ray), expected, rtol=0, atol=1e-10)
    assert_allclose(WIDE.unproject(expected), ray, rtol=0, atol=1e-12)


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
    assert replace(WIDE, k=(0.01, 0, 0, 1e-320)).max_angle == WIDE.max_angle
    assert np.isfinite(ENDOSCOPE.unproject([735.37, 552.80 + 745.5])).all()
    assert np.isnan(ENDOSCOPE.unproject([735.37, 552.80 + 746.5])).all()
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
    assert np.isfinite(camera.unproject([199.5 + end - 0.01, 199.5])).all()
    assert np.isnan(camera.unproject([199.5, 199.5 - end - 0.01])).all()


@every_camera
def test_resize_keeps_the_outer_edges(rng, camera):
    points = directions(rng, 100, 60.0)
    resized = camera.resize(camera.width // 3, camera.height * 2)
    scale = np.array([resized.width / camera.width, resized.height / camera.height])
    expected = (camera.project(points) + 0.5) * scale - 0.5
    assert_allclose(resized.project(points), expected, rtol=0, atol=1e-9)
