"""Depth maps to surfaces: normals against exact scenes, and against tangents."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy import ndimage

from endolab.metrics import angle_between
from endolab.model import surface
from endolab.synthetic.scenes import SCENES, Tube
from tests.model.conftest import every_camera


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


@every_camera
@pytest.mark.parametrize("name", ["plane", "curved", "tube"])
def test_normals_of_exact_scenes(name, camera):
    """One of the pixels lies exactly on the axis."""
    camera = camera.resize(240, 180)
    camera = replace(camera, cx=round(camera.cx), cy=round(camera.cy))
    v, exact, mask = seen(SCENES[name], camera)
    inside = ndimage.binary_erosion(mask, iterations=2)
    assert inside.mean() > 0.2
    found = surface.normals(v, camera.field)
    error = angle_between(found, exact)
    assert error[inside].mean() < 0.05
    assert np.percentile(error[inside], 99) < 0.5
    assert error[mask].mean() < 0.2
    assert_array_equal(np.isfinite(found).all(axis=-1), mask)
