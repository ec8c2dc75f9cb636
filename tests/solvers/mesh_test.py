"""Meshes: whole where the surface is, cut where it is cut, written as they are."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import spearmanr

import endolab as el
from endolab.metrics.depth_errors import depth_cuts
from endolab.solvers.mesh import make_mesh
from tests.tools.problems import coloured_colon

CAMERA = el.load_calibration("paper", 160).camera
RAYS = CAMERA.field.rays


def facing(mesh):
    """Cross product of two sides of each triangle, and its first corner."""
    corners = mesh.vertices[mesh.triangles]
    return np.cross(
        corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    ), corners[:, 0]


def wall(rows=5, columns=7):
    x, y = np.meshgrid(np.arange(columns) - 3.0, np.arange(rows) - 2.0)
    return np.stack([x, y, np.full_like(x, 50.0)], axis=-1)


@pytest.mark.parametrize(
    ("place", "lost"), [((2, 3), 4), ((0, 0), 1), ((0, 3), 2), ((4, 6), 1)]
)
def test_a_hole_takes_its_pixel_and_no_more(place, lost):
    """Each square is two triangles; those around it keep that of their other three corners."""
    whole = make_mesh(wall(5, 7))
    assert whole.triangles.shape == (2 * 4 * 6, 3)
    assert np.linalg.norm(facing(whole)[0], axis=-1).sum() / 2 == pytest.approx(24.0)
    points = wall(5, 7)
    points[place] = np.nan
    mesh = make_mesh(points)
    assert len(mesh.vertices) == 34
    assert len(mesh.triangles) == 48 - lost
    assert np.isfinite(mesh.vertices).all()
    assert np.allclose(mesh.normals, [0, 0, -1])


def test_no_triangle_crosses_a_cut():
    cuts = np.zeros((2, 6, 8), dtype=bool)
    cuts[0, :, 3] = True  # columns 3 and 4 are cut apart
    cuts[1, 2, :4] = True  # and rows 2 and 3 on the left
    mesh = make_mesh(wall(6, 8), cuts=cuts)
    is_left, is_upper = np.moveaxis(mesh.vertices[mesh.triangles][..., :2] < 0.5, -1, 0)
    part = np.where(is_left, 1 + is_upper, 0)
    assert np.all(part == part[:, :1])
    assert len(mesh.triangles) == 2 * (3 * 5 + 3 * 2 * 2)
    assert len(mesh.vertices) == 48


def test_a_result_brings_colours_cuts_and_unit():
    problem, colon = coloured_colon(CAMERA)
    cuts = depth_cuts(colon.distance)
    problem = replace(problem, cuts=cuts, metric=False)
    iterate = el.Iterate.of(problem, np.log(colon.distance))
    mesh = make_mesh(iterate)
    assert mesh.unit == "relative units"
    again = make_mesh(
        np.where(problem.mask[..., None], iterate.points, np.nan),
        colon.image,
        cuts=cuts,
    )
    assert np.array_equal(mesh.triangles, again.triangles)
    assert np.array_equal(mesh.colours, again.colours)


@pytest.mark.parametrize("name", el.SCENES)
def test_normals_face_the_camera_and_are_the_scenes(name):
    scene = el.SCENES[name]
    distance = scene.distance(RAYS)
    mesh = make_mesh(distance[..., None] * RAYS, cuts=depth_cuts(distance))
    assert (np.einsum("ni,ni->n", *facing(mesh)) < 0).all()
    assert (np.einsum("ni,ni->n", mesh.normals, mesh.vertices) < 0).all()
    assert np.allclose(np.linalg.norm(mesh.normals, axis=-1), 1)
    cosine = np.einsum("ni,ni->n", mesh.normals, scene.normals(mesh.vertices)).clip(
        -1, 1
    )
    assert np.rad2deg(np.median(np.arccos(cosine))) < 1.0


def test_a_step_needs_both_a_jump_and_a_grazing_view_to_be_cut():
    """Of the second wall, whose step is slight, and of the third, whose pixels are far apart, all stays."""
    for size, step, columns in ((1, 1.5, 4), (1, 1.05, 5), (30, 1.2, 5)):
        points = wall(4, 6) * (size, size, 1)
        points[:, 3:] *= step
        assert len(make_mesh(points).triangles) == 2 * 3 * columns


def test_colours_of_sigma_grow_brighter_with_it_and_say_so():
    """On a surface whose σ grows to the right, up to a fifth of the distance."""
    problem, colon = coloured_colon(CAMERA.resize(80, 60))
    iterate = el.Iterate.of(problem, np.log(colon.distance))
    percent = np.tile(np.linspace(1, 20, 80), (60, 1))
    mesh = make_mesh(iterate, sigma=percent / 100 * iterate.distance)
    assert np.array_equal(mesh.vertices, make_mesh(iterate).vertices)
    most = float(re.search(r"bright ([\d.]+) % of it", mesh.legend)[1])
    assert most == pytest.approx(20, rel=0.05)
    bright = mesh.colours.sum(axis=-1)
    right = iterate.problem.camera.project(mesh.vertices)[:, 0]
    assert spearmanr(bright, right).statistic > 0.999
