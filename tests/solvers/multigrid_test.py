"""Coarser grids, and what solves the normal equations, against a direct solver."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from endolab.numerics.compiled import inner, pad_maps
from endolab.numerics.stencils import links, shift
from endolab.reconstruction.light_and_contours import cut_at_contours
from endolab.solvers.grid import Grid
from endolab.solvers.multigrid import Multigrid, multiply
from endolab.solvers.normal_equations import OFFSETS
from tests.tools.cuts import between
from tests.tools.problems import at_truth, every_regulariser


def equations(problem, v, inflow=None):
    """Coefficients and right-hand side of the step at v."""
    padded = pad_maps(np.where(problem.mask, v, 0.0))
    return Grid.of(problem, inflow).equations_at(padded, problem.lam)


@pytest.fixture(params=["first", "second"])
def system(request, rng):
    """Equations of a tube with holes and cuts all over, at a rough map, with a few pixels given.

    Their solver, right-hand side and free pixels.
    """
    problem, truth = at_truth("tube", 40, lam=0.7, regulariser=request.param)
    mask = problem.mask & (rng.random(truth.shape) > 0.05)
    problem = replace(problem, mask=mask, cuts=rng.random((2, *mask.shape)) > 0.95)
    v = truth + 0.02 * rng.normal(size=mask.shape)
    inflow = np.where(rng.random(v.shape) < 0.05, problem.log_d0, np.nan)
    coefficients, b = equations(problem, v, inflow)
    free = coefficients.active > 0
    assert 0.85 * mask.sum() < free.sum() < mask.sum()
    return Multigrid(coefficients), b, free


@every_regulariser
def test_where_whole_blocks_are_given_coarser_grids_are_finite(regulariser):
    problem, truth = at_truth("plane", 64, regulariser=regulariser)
    inflow = np.where(np.arange(truth.shape[0])[:, None] % 16 < 4, truth, np.nan)
    for level in Multigrid(equations(problem, truth, inflow)[0]).levels:
        assert np.isfinite(level.matrix).all()


@pytest.mark.parametrize("cut", [False, True])
def test_a_straight_map_survives_the_way_down_and_up(cut):
    """Block means lie in the blocks' centres, and gradients at the rim and a cut are as good as inside."""
    problem, _ = at_truth("plane", 64)
    rows, columns = np.indices(problem.mask.shape)
    right = cut * (columns > 31)
    fine = Grid.of(replace(problem, cuts=between(right)))
    v = pad_maps(2.0 + right + 0.02 * columns - 0.01 * rows)
    back = fine.interpolate(fine.restrict(v))
    assert_allclose(inner(back), inner(v), atol=1e-13)


@pytest.mark.parametrize("centre", [(30, 40), (31, 41), (30.5, 40.3)])
def test_no_coarse_grid_mixes_the_sides_of_a_cut(centre):
    """A map of two levels has them on every grid, and a line of cuts is closed on all of them."""
    problem, _ = at_truth("plane", 80)
    i, j = np.indices(problem.mask.shape)
    inside = np.hypot(i - centre[0], j - centre[1]) < 14.3
    grid = Grid.of(replace(problem, cuts=between(inside)))
    v = pad_maps(np.where(inside, 1.0, 2.0))
    for _ in range(3):
        fine = grid
        grid = grid.coarser
        v = fine.restrict(v)
        levels = inner(v)
        assert set(np.unique(levels)) == {1.0, 2.0}
        for axis, link in ((1, inner(grid.link)[0]), (0, inner(grid.link)[1])):
            assert_array_equal(link > 0, levels == shift(levels, 1, axis, 0.0))
        assert np.isin(np.round(inner(fine.interpolate(v)), 12), (1.0, 2.0)).all()


def dense(matrix):
    """The matrix that seven or thirteen numbers a pixel stand for."""
    place = np.arange(matrix[0].size).reshape(matrix.shape[1:])
    total = np.zeros((place.size, place.size))
    for numbers, (down, right) in zip(matrix, OFFSETS[: len(matrix)], strict=True):
        i, j = np.nonzero(numbers)
        here, there = place[i, j], place[i + down, j + right]
        total[here, there] = total[there, here] = numbers[i, j]
    return total


def interpolation(structure):
    """P from blocks to pixels, as a matrix."""
    active = structure.coarser.active
    steps = np.eye(active.size)[active.ravel() > 0].reshape(-1, *active.shape)
    columns = np.zeros((len(steps), *structure.active.shape))
    for step, column in zip(steps, columns, strict=True):
        structure.interpolation.add(step, column)
    return columns.reshape(len(steps), -1).T


def test_restriction_is_the_adjoint_of_interpolation(system, rng):
    structure = system[0].levels[0].structure
    below = structure.coarser.active
    fine = rng.normal(size=structure.active.shape)
    down = np.zeros(below.shape)
    structure.interpolation.adjoint(fine * structure.active, below, down)
    way = interpolation(structure)
    assert_allclose(down[below > 0], fine.ravel() @ way, atol=1e-11)
    assert not down[below == 0].any()
    assert not way[structure.active.ravel() == 0].any()


def test_a_coarse_grid_has_the_fine_ones_matrix(system):
    """C = P'AP, readably; what is further than two blocks apart is on the diagonal."""
    solver = system[0]
    for fine, coarse in pairwise(solver.levels):
        way = interpolation(fine.structure)
        expected = way.T @ dense(fine.matrix) @ way
        places = np.argwhere(coarse.structure.active)
        kept = np.flatnonzero(coarse.structure.active)
        found = dense(coarse.matrix)[np.ix_(kept, kept)]
        apart = np.abs(places[:, None] - places).max(axis=2)
        off = found - np.where(apart > 2, 0.0, expected)
        largest = np.abs(expected).max()
        moved = np.diag(off).copy()
        np.fill_diagonal(off, 0.0)
        assert np.abs(off).max() < 1e-12 * largest
        rest = np.where(apart > 2, np.abs(expected), 0.0).sum(axis=1)
        assert np.all(moved > rest - 1e-12 * largest)
        assert moved.max() < 0.02 * largest


def test_cuts_cost_few_steps():
    """A colon, cut along all its lines; coarse equations of their own took 11; measured 6."""
    problem, truth = at_truth("colon", 160)
    problem = cut_at_contours(problem, 0.02)
    assert problem.cuts.sum() > 300
    coefficients, b = equations(problem, truth)
    assert Multigrid(coefficients).solve(b, 0.1, 200)[1] <= 6


@pytest.mark.parametrize("thickness", [6, 10])
def test_a_thin_strip_that_runs_askew_costs_few_steps(thickness):
    """Coarse grids that left it out, as no three of its blocks are in a line, took 8 or 9; measured 3."""
    problem, truth = at_truth("tube", 320)
    i, j = np.indices(problem.mask.shape)
    strip = (abs(i - j + 40) < thickness / 1.4) & (j > 100) & (j < 240)
    cuts = between(strip) & links(problem.mask) & (j >= 115)  # it hangs by one end
    problem = replace(problem, cuts=cuts)
    coefficients, _ = equations(problem, truth)
    solver = Multigrid(coefficients)
    tilt = np.where(strip & problem.mask & (j > 115), (j - 115) / 200, 0.0)
    b = np.zeros(coefficients.active.shape)
    multiply(solver.levels[0].matrix, pad_maps(tilt), b)
    assert solver.solve(b, 0.1, 200)[1] <= 4


def test_it_agrees_with_a_direct_solver_and_holds_what_is_given(system):
    solver, b, free = system
    kept = np.flatnonzero(free)
    matrix = dense(solver.levels[0].matrix)[np.ix_(kept, kept)]
    expected = np.linalg.solve(matrix, b.flat[kept])
    # Whatever is asked of pixels that are held.
    for right in (b, np.where(free, b, 7.0)):
        x, steps, remaining = solver.solve(right, 1e-12, 300)
        assert steps < 200  # measured 42 and 127 for equations as rough as these
        assert remaining <= 1e-12
        off = np.abs(x.flat[kept] - expected).max()
        assert off < 1e-10 * np.abs(expected).max()
        assert not x[~free].any()
    x, steps, remaining = solver.solve(np.zeros_like(b), 0.1, 20)
    assert (steps, remaining, x.any()) == (0, 0.0, False)


@pytest.mark.parametrize(("scene", "few", "many"), [("plane", 3, 10), ("tube", 5, 38)])
@every_regulariser
def test_the_number_of_steps_does_not_grow_with_the_picture(
    scene, few, many, regulariser
):
    """Measured at 80, 160 and 320 px, to 0.1 and 1e-3: plane 2 and up to 8, tube 4 and up to 33."""
    steps = []
    for width in (80, 160, 320):
        problem, truth = at_truth(scene, width, regulariser=regulariser)
        coefficients, b = equations(problem, truth)
        solver = Multigrid(coefficients)
        steps.append([solver.solve(b, tolerance, 200)[1] for tolerance in (0.1, 1e-3)])
    assert np.all(np.max(steps, axis=0) <= [few, many])
    assert steps[2][1] <= 1.3 * steps[0][1] + 2
