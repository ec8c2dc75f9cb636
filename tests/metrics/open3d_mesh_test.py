"""Meshes in Open3D, against a wall whose size is known."""

import numpy as np
import pytest

from endolab.metrics.open3d_mesh import to_open3d
from endolab.solvers.mesh import make_mesh


def test_a_wall_is_as_large_in_open3d_and_faces_the_camera(open3d):
    y, x = np.indices((5, 7)) - 2.0
    wall = np.dstack([x, y, np.full_like(x, 50.0)])
    made = to_open3d(make_mesh(wall, np.full(x.shape, 0.5)))
    assert made.get_surface_area() == pytest.approx(4 * 6)
    assert np.asarray(made.vertex_colors) == pytest.approx(0.5)
    assert np.asarray(made.vertex_normals)[:, 2] == pytest.approx(-1)
    made.compute_triangle_normals()
    assert np.asarray(made.triangle_normals)[:, 2] == pytest.approx(-1)
