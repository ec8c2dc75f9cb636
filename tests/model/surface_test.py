"""Depth maps to surfaces: normals against exact scenes, and against tangents."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.ndimage import binary_erosion

import endolab as el
from endolab.metrics import angle_between
from endolab.model import surface
from endolab.synthetic.scenes import SCENES, Tube

CAMERAS = {
    "pinhole": el.Pinhole(160, 120, 100.0, 100.0, 79.5, 59.5),
    "brown_conrady": el.BrownConrady(
        160, 120, 110.0, 110.0, 79.5, 59.5, (-0.33, 0.1, 2e-3, 0.0)
    ),
    "kannala_brandt": el.load_calibration("paper", 240).camera,
    "scaramuzza": el.load_calibration("c3vd", 225).camera,
    "beyond 90°": el.KannalaBrandt(
        240, 240, 60.0, 60.0, 119.5, 119.5, (0.01, 0.0, 0.0, 0.0)
    ),
}


def seen(scene, camera):
    """Log-distance, exact normals and mask of a scene; for the tube away from its far wall."""
    field = camera.field
    rays = np.where(field.valid[..., None], field.rays, [0.0, 0.0, 1.0])
    distance = scene.distance(rays)
    exact = scene.normals(distance[..., None] * rays)
    mask = field.valid & np.isfinite(distance)
    mask &= field.cos_alpha > np.cos(np.deg2rad(72))
    if isinstance(scene, Tube):
        mask &= distance * field.cos_alpha < scene.length - 0.5
    return np.where(mask, np.log(distance), np.nan), exact, mask


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
@pytest.mark.parametrize("name", ["plane", "curved", "tube"])
def test_normals_of_exact_scenes(name, camera):
    v, exact, mask = seen(SCENES[name], camera)
    inside = binary_erosion(mask, iterations=2)
    assert inside.mean() > 0.2
    found = surface.normals(v, camera.field)
    error = angle_between(found, exact)
    assert error[inside].mean() < 0.05
    assert np.percentile(error[inside], 99) < 0.5
    assert error[mask].mean() < 0.2
    assert_array_equal(np.isfinite(found).all(axis=-1), mask)


def test_normals_beside_a_cut_are_of_their_own_side():
    camera = CAMERAS["pinhole"]
    (v, exact, mask), (beyond, others, _) = (
        seen(SCENES[name], camera) for name in ("plane", "curved")
    )
    right = np.arange(camera.width) > 80
    cuts = np.zeros((2, *mask.shape), bool)
    cuts[0, :, 80] = True
    found = surface.normals(np.where(right, beyond, v), camera.field, cuts=cuts)
    error = angle_between(found, np.where(right[:, None], others, exact))
    assert error[mask].max() < 1
