"""Depth maps to surfaces: normals against exact scenes, against tangents, and their derivatives."""

import numpy as np
import pytest

from endolab.model import surface
from endolab.model.cameras import KannalaBrandt, Pinhole, Scaramuzza
from endolab.synthetic.scenes import SCENES, Tube

A = (769.243600037, 0.0, -0.000812770624150226, 6.25674244578925e-07, -1.1966218214428e-09)
CAMERAS = {
    "pinhole": Pinhole(160, 120, 100.0, 100.0, 79.5, 59.5),
    "kannala_brandt": KannalaBrandt(
        1440, 1080, 717.21, 717.48, 735.37, 552.80, (-0.13893, -1.2396e-3, 9.1258e-4, -4.0716e-5)
    ).resize(240, 180),
    "scaramuzza": Scaramuzza(
        1350, 1080, 678.544839, 542.975888, A, 0.99998686, 0.00288274, -0.00296316
    ).resize(225, 180),
    "beyond 90°": KannalaBrandt(240, 240, 60.0, 60.0, 119.5, 119.5, (0.01, 0.0, 0.0, 0.0)),
}
every_camera = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())


def degrees(a, b):
    """Angle between unit vectors, exact for small ones."""
    return np.rad2deg(2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2, 0, 1)))


def seen(scene, camera, max_off_axis=72.0):
    """Log-distance, exact normals and mask of a scene; for the tube away from its far wall."""
    field = camera.field
    rays = np.where(field.valid[..., None], field.rays, [0.0, 0.0, 1.0])
    distance = scene.distance(rays)
    exact = scene.normals(distance[..., None] * rays)
    mask = field.valid & np.isfinite(distance) & (field.cos_alpha > np.cos(np.deg2rad(max_off_axis)))
    if isinstance(scene, Tube):
        mask &= distance * field.cos_alpha < scene.length - 0.5
    return np.where(mask, np.log(distance), np.nan), exact, mask


def eroded(mask, steps=2):
    inside = np.pad(mask, steps)
    for _ in range(steps):
        grown = [np.roll(inside, step, axis) for step in (-1, 1) for axis in (0, 1)]
        inside = np.logical_and.reduce([inside, *grown])
    return inside[steps:-steps, steps:-steps]


# ξ -------------------------------------------------------------------------------------


@pytest.mark.parametrize("xi", surface.XI)
def test_xi_there_and_back(rng, xi):
    v, cos_alpha = rng.uniform(0, 5, (6, 8)), rng.uniform(0.1, 1, (6, 8))
    np.testing.assert_allclose(
        surface.from_xi(surface.to_xi(v, xi, cos_alpha), xi, cos_alpha), v, rtol=0, atol=1e-14
    )


def test_xi_is_what_its_name_says():
    v, cos_alpha = np.log(40.0), 0.8
    for xi, value in {"1/z": 1 / 32, "d": 40.0, "1/d": 1 / 40}.items():
        assert surface.to_xi(v, xi, cos_alpha) == pytest.approx(value, rel=1e-14)


def test_xi_where_there_is_none():
    assert np.isnan(surface.to_xi(3.0, "1/z", -0.1))
    assert np.isnan(surface.to_xi(3.0, "1/z", 0.0))
    for xi in surface.XI:
        assert np.all(np.isnan(surface.from_xi([0.0, -1.0], xi, 1.0)))
    for function in (surface.to_xi, surface.from_xi):
        with pytest.raises(ValueError, match="unknown xi 'depth'; choose 1/z, d, 1/d"):
            function(3.0, "depth", 1.0)


# Normals -------------------------------------------------------------------------------


@every_camera
@pytest.mark.parametrize("name", ["plane", "curved", "tube"])
def test_normals_of_exact_scenes(name, camera):
    v, exact, mask = seen(SCENES[name], camera)
    inside = eroded(mask)
    assert inside.mean() > 0.2
    error = degrees(surface.normals(v, camera.field), exact)[inside]
    assert error.mean() < 0.05
    assert np.percentile(error, 99) < 0.5
    assert degrees(surface.normals(v, camera.field), exact)[mask].mean() < 0.2


@every_camera
@pytest.mark.parametrize("name", ["plane", "curved", "tube"])
def test_two_ways_to_the_normals(name, camera):
    """By the ray metric, and by tangents of points that know no camera."""
    v, _, mask = seen(SCENES[name], camera)
    by_metric = surface.normals(v, camera.field)
    by_tangents = surface.normals_by_cross_product(surface.points(v, camera.field))
    assert degrees(by_metric, by_tangents)[eroded(mask)].mean() < 0.1
    np.testing.assert_array_equal(np.isfinite(by_metric).all(axis=-1), mask)


@pytest.mark.parametrize("name", ["kannala_brandt", "scaramuzza"])
def test_error_of_the_normals_is_of_second_order(name):
    """Twice the pixels, a quarter of the error."""
    errors = []
    for factor in (1, 2):
        camera = CAMERAS[name].resize(CAMERAS[name].width * factor // 2, CAMERAS[name].height * factor // 2)
        v, exact, mask = seen(SCENES["curved"], camera, 60.0)
        errors.append(degrees(surface.normals(v, camera.field), exact)[eroded(mask)].mean())
    assert 3.3 < errors[0] / errors[1] < 4.7


@every_camera
def test_normals_have_unit_length_and_face_the_camera(rng, camera):
    """On any map of distances, however rough."""
    field = camera.field
    v = rng.normal(3.5, 0.1, field.shape)
    normals = surface.normals(v, field)[field.valid]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1.0, rtol=1e-9)
    assert np.all(np.einsum("ni,ni->n", normals, field.rays[field.valid]) < 0)


def test_the_slant_is_the_angle_between_ray_and_normal(rng):
    camera = CAMERAS["scaramuzza"].resize(45, 36)
    f_u, f_v = rng.normal(scale=0.05, size=(2, 36, 45))
    p = surface.slant(f_u, f_v, camera.field)
    normals = surface.normals_from_gradient(f_u, f_v, camera.field)
    cosine = -np.einsum("hwi,hwi->hw", normals, camera.field.rays)
    np.testing.assert_allclose(1 / cosine**2 - 1, p, rtol=1e-9)


@every_camera
def test_a_ball_around_the_camera_is_seen_face_on(camera):
    field = camera.field
    normals = surface.normals(np.full(field.shape, np.log(30.0)), field)
    np.testing.assert_allclose(normals[field.valid], -field.rays[field.valid], rtol=0, atol=1e-12)


@every_camera
def test_the_normal_does_not_know_the_scale(rng, camera):
    v, _, mask = seen(SCENES["curved"], camera)
    difference = surface.normals(v + np.log(1000.0), camera.field) - surface.normals(v, camera.field)
    assert np.abs(difference[mask]).max() < 1e-9
    difference = surface.normals_by_cross_product(
        1000 * surface.points(v, camera.field)
    ) - surface.normals_by_cross_product(surface.points(v, camera.field))
    assert np.abs(difference[mask]).max() < 1e-9


@every_camera
def test_derivative_of_the_normal_by_the_gradient(rng, camera):
    field = camera.resize(24, 20).field
    f_u, f_v = rng.normal(scale=0.05, size=(2, 20, 24))
    h = 1e-6
    numerical = np.stack(
        [
            surface.normals_from_gradient(f_u + du, f_v + dv, field)
            - surface.normals_from_gradient(f_u - du, f_v - dv, field)
            for du, dv in ((h, 0), (0, h))
        ],
        axis=-1,
    ) / (2 * h)
    actual = surface.normals_by_gradient(f_u, f_v, field)
    calm = field.valid & (np.abs(field.inverse_metric).max(axis=-1) < 1e4)
    assert calm.mean() > 0.85
    np.testing.assert_allclose(actual[calm], numerical[calm], rtol=1e-6, atol=1e-7)


def test_points_lie_on_the_rays():
    camera = CAMERAS["kannala_brandt"]
    v, _, mask = seen(SCENES["tube"], camera)
    points = surface.points(v, camera.field)[mask]
    np.testing.assert_allclose(np.linalg.norm(points, axis=-1), np.exp(v[mask]), rtol=1e-13)
    rows, columns = np.nonzero(mask)
    np.testing.assert_allclose(camera.project(points), np.column_stack([columns, rows]), rtol=0, atol=1e-9)


# Holes ---------------------------------------------------------------------------------


@pytest.mark.parametrize("rubbish", [np.nan, np.inf, 50.0])
def test_a_hole_touches_its_neighbours_only(rubbish):
    camera = CAMERAS["pinhole"]
    v, _, mask = seen(SCENES["curved"], camera)
    row, column = np.indices(mask.shape)
    hole = (np.hypot(row - 40, column - 60) < 9) | ((row == 80) & (column == 100))
    assert mask[hole].all()
    holed = surface.normals(np.where(hole, rubbish, v), camera.field, mask & ~hole)
    np.testing.assert_array_equal(np.isnan(holed).any(axis=-1), ~mask | hole)
    touched = mask & ~eroded(mask & ~hole, 1)
    whole = surface.normals(v, camera.field, mask)
    np.testing.assert_array_equal(holed[mask & ~touched], whole[mask & ~touched])
    assert degrees(holed, whole)[touched & ~hole].max() < 2.0

    points = np.where(hole[..., None], rubbish, surface.points(v, camera.field))
    by_tangents = surface.normals_by_cross_product(points, mask & ~hole)
    assert degrees(by_tangents, whole)[mask & ~hole].max() < 2.0


def test_the_default_mask_is_where_the_map_is_finite():
    camera = CAMERAS["pinhole"].resize(16, 12)
    v = np.full((12, 16), 3.0)
    v[4, 5] = np.nan
    v[0] = np.inf
    normals = surface.normals(v, camera.field)
    np.testing.assert_array_equal(np.isnan(normals).any(axis=-1), ~np.isfinite(v))
    by_tangents = surface.normals_by_cross_product(
        np.exp(np.where(v > 9, np.nan, v))[..., None] * camera.field.rays
    )
    np.testing.assert_array_equal(np.isnan(by_tangents).any(axis=-1), ~np.isfinite(v))


def test_a_lonely_pixel_has_no_tangents_but_a_slant_of_zero():
    camera = CAMERAS["pinhole"].resize(16, 12)
    mask = np.zeros((12, 16), dtype=bool)
    mask[4, 5] = True
    v = np.full((12, 16), 3.0)
    np.testing.assert_allclose(
        surface.normals(v, camera.field, mask)[4, 5], -camera.field.rays[4, 5], rtol=0, atol=1e-15
    )
    assert np.isnan(surface.normals_by_cross_product(surface.points(v, camera.field), mask)[4, 5]).all()
