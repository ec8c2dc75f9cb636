"""What a pixel is evidence of: its share in the energy, on every grid, and what is found where it is none."""

from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab.numerics.compiled import inner
from endolab.solvers.gauss_newton import gauss_newton
from endolab.solvers.grid import Grid
from endolab.solvers.primal_dual import primal_dual
from endolab.solvers.problem import EXACT, LOWER_BOUND, NONE
from tests.tools.problems import check_it_falls, percent_off, problem_of


def with_evidence(problem, where, what):
    evidence = np.where(where & problem.mask, what, EXACT).astype(np.int8)
    return replace(problem, evidence=evidence)


@pytest.mark.parametrize(
    ("evidence", "image", "of_block", "mean"),
    [
        ([NONE, NONE, NONE, EXACT], [0.9, 0.9, 0.9, 0.3], EXACT, 0.3),
        ([NONE] * 4, [0.1, 0.3, 0.5, 0.7], NONE, 0.4),
        ([LOWER_BOUND, LOWER_BOUND, EXACT, NONE], [1, 1, 0.7, 0.1], LOWER_BOUND, 0.9),
        ([LOWER_BOUND, LOWER_BOUND, EXACT, EXACT], [0.5] * 4, EXACT, 0.5),
    ],
)
def test_a_block_says_what_its_pixels_say(evidence, image, of_block, mean):
    problem, _ = problem_of("plane", 32)
    evidences = np.full(problem.mask.shape, EXACT, np.int8)
    images = np.full(problem.mask.shape, 0.5)
    evidences[:2, :2].flat = evidence
    images[:2, :2].flat = image
    coarse = Grid.of(replace(problem, image=images, evidence=evidences)).coarser
    assert inner(coarse.evidence)[0, 0] == of_block
    assert inner(coarse.image)[0, 0] == pytest.approx(mean)


@pytest.mark.parametrize(
    ("gain", "exact", "bounded"), [(1.5, 3.0, 0.6), (2.0, 8.5, 2.5)]
)
def test_a_bowl_whose_nearest_part_is_saturated(gain, exact, bounded):
    """Measured inside the saturated part, in %: 3.5 and 0.40 at 1.5 times the gain, 9.3 and 1.8 at twice."""
    problem, seen = problem_of("curved", bits=8, gain=gain)
    bright = problem.mask & (problem.image >= 254.5 / 255)
    assert bright.mean() > 0.1
    before = el.run(gauss_newton(problem))
    after = el.run(gauss_newton(with_evidence(problem, bright, LOWER_BOUND)))
    assert percent_off(before, seen, bright) > exact
    assert percent_off(after, seen, bright) < bounded
    assert percent_off(after, seen, ~bright) < percent_off(before, seen, ~bright) / 2
    assert after.status is el.Status.CONVERGED
    check_it_falls(after)


@pytest.mark.parametrize(
    ("solver", "width", "radius", "as_data"),
    [(gauss_newton, 160, 6, 15), (gauss_newton, 160, 12, 15), (primal_dual, 80, 4, 10)],
)
def test_a_painted_blob_on_a_plane_is_seen_through(solver, width, radius, as_data):
    """A white disc, not inpainted. Measured inside it, in %: 17 and 18 as data, 0.02 and 0.04 ignored."""
    problem, seen = problem_of("plane", width, bits=8)
    rows, columns = np.indices(problem.mask.shape)
    blob = np.hypot(rows - 0.38 * width, columns - 0.44 * width) < radius
    problem = replace(problem, image=np.where(blob, 1.0, problem.image))
    taken, ignored = (
        el.run(solver(each, max_iterations=300))
        for each in (problem, with_evidence(problem, blob, NONE))
    )
    assert percent_off(taken, seen, blob) > as_data
    assert percent_off(ignored, seen, blob) < 0.1
    assert solver is primal_dual or percent_off(ignored, seen, ~blob) < 0.05
