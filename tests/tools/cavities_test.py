"""Cavities against their equation, known distances, finite differences and an independent ray caster."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from endolab.metrics.depth_errors import angle_between, occlusion_cuts
from endolab.model.cameras import KannalaBrandt, Pinhole
from tests.tools.cavities import Cavity, Fold, Polyp
from tests.tools.tangents import points_and_normals

PINHOLE = Pinhole(48, 36, 30.0, 30.0, 23.5, 17.5)
FISHEYE = KannalaBrandt(41, 41, 14.0, 14.0, 20.0, 20.0, (0.01, 0.0, 0.0, 0.0))
AXIS = np.array([0.0, 0.0, 1.0])
RINGS = tuple(Fold(s, 7.0, 3.5, 0.9 * s, reach=1.5, lean=4.0) for s in (-30.0, 22.0, 45.0, 70.0))
CAVITIES = {
    "tube": Cavity(),
    "bent": Cavity(bend=1 / 60, sway=(7.0, 150.0), place=(3.0, -4.0), look=(120.0, 8.0, -5.0)),
    "colon": Cavity(bend=1 / 90, look=(30.0, 4.0, 9.0), folds=RINGS, bumps=0.4),
    "polyps": Cavity(polyps=(Polyp(35.0, 0.5, 6.0, 12.0), Polyp(50.0, 3.0, 4.0, 4.0)), look=(0.0, 10.0, 0.0)),
    "bag": Cavity(40.0, 10.0, 5.0, ends=(35.0, 45.0), look=(0.0, 30.0, 20.0), rugae=3.0, bumps=1.0),
}
every_cavity = pytest.mark.parametrize("cavity", CAVITIES.values(), ids=CAVITIES.keys())
every_camera = pytest.mark.parametrize("camera", [PINHOLE, FISHEYE], ids=["pinhole", "fisheye"])


def test_known_distances():
    plain = Cavity(radius=20.0, ahead=50.0, behind=30.0, ends=(15.0, 25.0), place=(4.0, 0.0))
    right, down = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    assert plain.distance(right) == pytest.approx(16.0)
    assert plain.distance(down) == pytest.approx(np.sqrt(400 - 16))
    middle = replace(plain, place=(0.0, 0.0))
    assert middle.distance(AXIS) == pytest.approx(65.0)
    assert middle.distance(-AXIS) == pytest.approx(55.0)
    # Straight ahead in a bent tube: to the outer wall, where √(z² + 80²) = 80 + 20.
    bent = replace(middle, ahead=60.0, bend=1 / 80)
    assert bent.distance(AXIS) == pytest.approx(60.0)
    assert bent.distance(right) == pytest.approx(20.0)
    turned = replace(middle, look=(0.0, 90.0, 0.0))  # the camera looks to the right
    assert turned.distance(AXIS) == pytest.approx(20.0)
    ring = replace(middle, folds=(Fold(0.0, 5.0, 2.0, 0.0, reach=0.0, lean=0.0),))
    assert ring.distance(right) == ring.distance(down) == pytest.approx(15.0)
    domed = replace(middle, polyps=(Polyp(0.0, np.pi / 2, 6.0, 3.0),))
    height = 20 - domed.distance(down)
    assert height == pytest.approx(3.0 * np.exp(-((height / 6) ** 4)))


@every_camera
@every_cavity
def test_points_are_on_the_wall_and_normals_across_it(cavity, camera):
    here, across = points_and_normals(cavity, camera)
    known = np.isfinite(here[..., 0])
    assert known.mean() > 0.7
    assert np.abs(cavity.inside(here[known])).max() < 1e-6
    normals = cavity.normals(here)
    assert_allclose(np.linalg.norm(normals[known], axis=-1), 1, rtol=1e-12)
    assert np.einsum("ni,ni->n", here[known], normals[known]).max() < 0
    off = angle_between(across, normals)[known]
    assert np.percentile(off, 98) < 0.02
    assert np.mean(off > 0.5) < 0.01  # pixels that an edge crosses


@every_cavity
def test_the_wall_is_the_first_that_a_ray_meets(cavity):
    rays = FISHEYE.field.rays[FISHEYE.field.valid][::2]
    distance = cavity.distance(rays)
    t = np.linspace(0, 1, 300)[:-1, None] * (distance - 0.02)
    assert cavity.inside(t[..., None] * rays).min() > 0


def test_a_colon_hides_some_of_itself():
    distance = CAVITIES["colon"].distance(PINHOLE.field.rays)
    assert occlusion_cuts(distance, 0.2).sum() > 30


@every_cavity
def test_open3d_sees_the_same(open3d, cavity):
    vertices, triangles = cavity.mesh(160)
    assert triangles.max() == len(vertices) - 1
    assert np.abs(cavity.inside(vertices)).max() < 1e-5
    caster, tensor = open3d.t.geometry.RaycastingScene(), open3d.core.Tensor
    caster.add_triangles(tensor(vertices.astype(np.float32)), tensor(triangles.astype(np.uint32)))
    rays = PINHOLE.field.rays.reshape(-1, 3)
    answer = caster.cast_rays(tensor(np.concatenate([np.zeros_like(rays), rays], -1).astype(np.float32)))
    distance = cavity.distance(rays)
    error = np.abs(answer["t_hit"].numpy() / distance - 1)
    assert np.median(error) < 1e-3
    assert np.mean(error > 0.02) < 0.03  # beside contours, now the near side is seen, now the far one
    facets = answer["primitive_normals"].numpy()
    cosine = np.abs(np.einsum("ni,ni->n", cavity.normals(distance[:, None] * rays), facets))
    assert np.rad2deg(np.median(np.arccos(np.minimum(cosine, 1)))) < 1.5


def test_rays_that_are_not_there_and_walls_that_are_not():
    found = Cavity().distance(np.array([[np.nan, np.nan, np.nan], AXIS]))
    assert np.isnan(found[0])
    assert found[1] == pytest.approx(140.0)
    with pytest.raises(ValueError, match="1 of 1 rays come to no wall within 1000 mm"):
        Cavity(ahead=2000.0).distance(AXIS[None])
