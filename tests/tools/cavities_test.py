"""Cavities against known distances and an independent ray caster."""

import numpy as np
import pytest

from endolab.model.cameras import Pinhole
from tests.tools.cavities import Cavity, Fold, Polyp

PINHOLE = Pinhole(48, 36, 30.0, 30.0, 23.5, 17.5)
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


def test_known_distances():
    ahead = np.array([0.0, 0.0, 1.0])
    right = np.array([1.0, 0.0, 0.0])
    plain = Cavity(radius=20.0, ahead=50.0, behind=30.0, ends=(15.0, 25.0))
    assert plain.distance(ahead) == pytest.approx(65.0)
    assert plain.distance(-ahead) == pytest.approx(55.0)
    assert plain.distance(right) == pytest.approx(20.0)
    # Straight ahead in a bent tube: to the outer wall, where √(z² + 80²) = 80 + 20.
    assert Cavity(radius=20.0, ahead=60.0, bend=1 / 80).distance(
        ahead
    ) == pytest.approx(60.0)


@pytest.mark.parametrize("cavity", CAVITIES.values(), ids=CAVITIES.keys())
def test_open3d_sees_the_same(open3d, cavity):
    vertices, triangles = cavity.mesh(160)
    caster = open3d.t.geometry.RaycastingScene()
    tensor = open3d.core.Tensor
    caster.add_triangles(
        tensor(vertices.astype(np.float32)), tensor(triangles.astype(np.uint32))
    )
    rays = PINHOLE.field.rays.reshape(-1, 3)
    answer = caster.cast_rays(
        tensor(np.concatenate([np.zeros_like(rays), rays], -1).astype(np.float32))
    )
    distance = cavity.distance(rays)
    error = np.abs(answer["t_hit"].numpy() / distance - 1)
    assert np.median(error) < 1e-3
    assert (
        np.mean(error > 0.02) < 0.03
    )  # beside contours, now the near side is seen, now the far one
    facets = answer["primitive_normals"].numpy()
    cosine = np.abs(
        np.einsum("ni,ni->n", cavity.normals(distance[:, None] * rays), facets)
    )
    assert np.rad2deg(np.median(np.arccos(np.minimum(cosine, 1)))) < 1.5
