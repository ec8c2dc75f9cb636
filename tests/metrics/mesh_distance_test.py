"""Distances of meshes, by Open3D, against surfaces whose distance is known."""

import numpy as np
import pytest

from endolab.metrics.mesh_distance import distance_to
from endolab.reconstruction.mesh import make_mesh


def wall(z=50.0):
    x, y = np.meshgrid(np.arange(7) - 3.0, np.arange(5) - 2.0)
    return np.stack([x, y, np.full_like(x, z)], axis=-1)


@pytest.mark.parametrize("truth", [make_mesh(wall()), wall()], ids=["mesh", "points"])
def test_a_tilted_wall_is_as_far_as_it_was_tilted(truth, open3d):
    points = wall(52.0)
    points[..., 2] += np.linspace(0, 1, 7)
    found = distance_to(make_mesh(points), truth)
    expected = np.tile(2 + np.linspace(0, 1, 7), 5)
    assert found.distance == pytest.approx(expected, abs=1e-4)
    stated = (found.mean, found.median, found.percentile_95)
    assert stated == pytest.approx((2.5, 2.5, 3.0), abs=1e-4)
