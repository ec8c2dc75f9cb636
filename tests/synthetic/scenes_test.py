"""Exact scenes against their equations, finite differences and an independent ray caster."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import endolab as el
from endolab.synthetic.scenes import SCENES, Bowl, Bump, Colon, Plane, Tube

CAMERAS = {
    "pinhole": el.Pinhole(80, 60, 50.0, 50.0, 39.5, 29.5),
    # The axis, and 125° off it.
    "fisheye": el.KannalaBrandt(81, 81, 22.0, 22.0, 40.0, 40.0, (0.01, 0.0, 0.0, 0.0)),
}
SHAPES = [
    *SCENES.values(),
    Plane(60.0, -35.0),
    Bowl(50.0, (-30.0, 20.0, 10.0)),
    Tube(radius=14.0, length=90.0, tilt=12.0, offset=(3.0, -5.0)),
    Colon(18.0, 0.6, 20.0, sharpness=15.0, winding=5.0, length=120.0),
    Bump(60.0, 25.0, 9.0),
    Bump(60.0, -30.0, 8.0),
]
every_camera = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
every_shape = pytest.mark.parametrize("scene", SHAPES, ids=repr)


def turned(x, degrees):
    """Coordinates in a frame whose z axis leans to the camera's right."""
    a = np.deg2rad(degrees)
    right = np.array([np.cos(a), 0, -np.sin(a)])
    ahead = np.array([np.sin(a), 0, np.cos(a)])
    return x @ right, x[..., 1], x @ ahead


def plane_equation(scene, x):
    return -turned(x - [0, 0, scene.depth], scene.tilt)[2]


def bowl_equation(scene, x):
    return scene.radius - np.linalg.norm(x - np.asarray(scene.centre), axis=-1)


def tube_equation(scene, x):
    right, down, ahead = turned(x, scene.tilt)
    side = scene.radius - np.hypot(right + scene.offset[0], down + scene.offset[1])
    return np.minimum(side, scene.length - ahead)


def colon_equation(scene, x):
    """The docstring's, from the camera's place, the phase and the twist of the folds."""
    right, down, s = np.moveaxis(x + np.asarray(scene._camera), -1, 0)
    swing = scene.winding * (1 - np.cos(2 * np.pi * s / scene._period))
    right = right - swing
    down = down - 0.3 * swing
    phi = np.arctan2(down, right) + scene._twist * s
    wave = np.cos(2 * np.pi * (s - scene._phase) / scene.fold_spacing)
    folds = np.exp(scene.sharpness * (wave - 1)) * (0.6 + 0.4 * np.cos(3 * phi))
    side = scene.radius * (1 - scene.fold_height * folds) - np.hypot(right, down)
    return np.minimum(side, scene.length - s)


def bump_equation(scene, x):
    flat = np.sum(x[..., :2] ** 2, axis=-1) / scene.width**2
    return scene.depth - scene.height * np.exp(-flat / 2) - x[..., 2]


# Positive inside the lumen, zero on the wall, mm; negative behind it.
EQUATIONS = {
    Bump: bump_equation,
    Plane: plane_equation,
    Bowl: bowl_equation,
    Tube: tube_equation,
    Colon: colon_equation,
}


@every_camera
@every_shape
def test_points_satisfy_the_equation_and_normals_are_unit_and_face_the_camera(
    scene, camera
):
    inside = EQUATIONS[type(scene)]
    rays = camera.field.rays[camera.field.valid]
    distance = scene.distance(rays)
    rays = rays[np.isfinite(distance)]
    distance = distance[np.isfinite(distance)]
    points = distance[:, None] * rays
    normals = scene.normals(points)
    assert np.abs(inside(scene, points) / distance).max() < 1e-12
    # The first wall on the way: nothing is met before.
    for share in np.linspace(0.01, 0.99, 30):
        assert inside(scene, share * points).min() > 0
    assert_allclose(np.linalg.norm(normals, axis=-1), 1.0, rtol=0, atol=1e-12)
    assert np.einsum("ni,ni->n", rays, normals).max() < 0


@every_camera
@every_shape
def test_normals_are_across_the_tangents(scene, camera):
    """Finite differences of the points, a thousandth of a pixel apart."""
    row, column = np.indices((camera.height, camera.width))
    pixels = np.stack([column + 0.013, row + 0.021], axis=-1)

    def at(*step):
        rays = camera.unproject(pixels + 5e-4 * np.array(step))
        return scene.distance(rays)[..., None] * rays

    across = np.cross(at(1, 0) - at(-1, 0), at(0, -1) - at(0, 1))
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    sine = np.linalg.norm(np.cross(across, scene.normals(at(0, 0))), axis=-1)
    met = np.isfinite(sine)
    assert met.mean() > 0.4
    assert np.rad2deg(np.percentile(sine[met], 99)) < 1e-3
    # What is left are pixels that an edge crosses.
    assert np.mean(np.rad2deg(sine[met]) > 0.1) < 2e-3


@pytest.mark.parametrize(
    ("name", "mean"), [("plane", 110), ("curved", 60), ("tube", 40)]
)
def test_mean_distances_are_about_the_papers(name, mean):
    rays = CAMERAS["pinhole"].field.rays
    assert SCENES[name].distance(rays).mean() == pytest.approx(mean, rel=0.2)
