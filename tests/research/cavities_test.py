"""Cavities: known distances, and a wall that rays, mesh and normals agree on."""

import numpy as np
import pytest

import endolab as el
from tests.research.cavities import Cavity, Fold, Polyp

PINHOLE = el.Pinhole(24, 18, 15.0, 15.0, 11.5, 8.5)
RINGS = tuple(
    Fold(s, 7.0, 3.5, 0.9 * s, reach=1.5, lean=4.0) for s in (-30.0, 22.0, 45.0, 70.0)
)
DOMES = (Polyp(35.0, 0.5, 6.0, 12.0), Polyp(50.0, 3.0, 4.0, 4.0))
CAVITIES = {
    "bent": Cavity(
        bend=1 / 60, sway=(7.0, 150.0), place=(3.0, -4.0), look=(120.0, 8.0, -5.0)
    ),
    "colon": Cavity(
        bend=1 / 90, look=(30.0, 4.0, 9.0), folds=RINGS, polyps=DOMES, bumps=0.4
    ),
    "bag": Cavity(
        40.0, 10.0, 5.0, ends=(35.0, 45.0), look=(0.0, 30.0, 20.0), rugae=3.0, bumps=1.0
    ),
}


@pytest.mark.parametrize("cavity", CAVITIES.values(), ids=CAVITIES)
def test_rays_and_mesh_end_at_the_wall_and_normals_are_those_of_its_triangles(cavity):
    rays = PINHOLE.field.rays.reshape(-1, 3)
    far = cavity.distance(rays)
    part = np.linspace(0, 1, 200)[:, None, None]
    assert np.abs(cavity.inside(far[:, None] * rays)).max() < 1e-6
    assert np.mean(cavity.inside(part[:-1] * far[:, None] * rays) > 0) > 0.999
    vertices, triangles = cavity.mesh(160)
    assert np.abs(cavity.inside(vertices)).max() < 1e-6
    corners = vertices[triangles]
    facets = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = cavity.normals(corners.mean(axis=1))
    sine = np.linalg.norm(np.cross(normals, facets), axis=-1)
    assert np.median(sine / np.maximum(np.linalg.norm(facets, axis=-1), 1e-12)) < 0.026
