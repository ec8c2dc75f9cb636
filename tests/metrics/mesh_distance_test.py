"""Distances of meshes, by Open3D, against surfaces whose distance is known."""

import numpy as np
import pytest

from endolab.metrics.mesh_distance import distance_to, to_open3d
from endolab.solvers.mesh import make_mesh

Y, X = np.indices((5, 7)) - 2.0
WALL = np.dstack([X, Y, np.full_like(X, 50.0)])


def test_a_wall_is_as_large_in_open3d_and_faces_the_camera(open3d):
    made = to_open3d(make_mesh(WALL, np.full(X.shape, 0.5)))
    assert made.get_surface_area() == pytest.approx(4 * 6)
    assert np.asarray(made.vertex_colors) == pytest.approx(0.5)
    assert np.asarray(made.vertex_normals)[:, 2] == pytest.approx(-1)
    made.compute_triangle_normals()
    assert np.asarray(made.triangle_normals)[:, 2] == pytest.approx(-1)


@pytest.mark.parametrize("truth", [make_mesh(WALL), WALL], ids=["mesh", "points"])
def test_a_tilted_wall_is_as_far_as_it_was_tilted(truth, open3d):
    away = np.tile(np.linspace(2, 3, 7), (5, 1))
    found = distance_to(make_mesh(np.dstack([X, Y, 50 + away])), truth)
    assert found.distance == pytest.approx(away.ravel(), abs=1e-4)
    stated = (found.mean, found.median, found.percentile_95)
    assert stated == pytest.approx((2.5, 2.5, 3.0), abs=1e-4)
