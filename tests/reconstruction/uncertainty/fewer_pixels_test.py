"""σ of a large frame is told on fewer pixels: what is kept, and what comes back."""

from dataclasses import replace

import numpy as np
import pytest

from endolab.reconstruction.uncertainty import (
    take_every_nth_pixel,
    uncertainty_of,
)
from endolab.solvers.gauss_newton import gauss_newton
from endolab.solvers.problem import NONE
from endolab.solvers.result import run
from tests.tools.problems import problem_of


@pytest.fixture(scope="module")
def large():
    problem, _ = problem_of("tube", 602, noise=1.0)
    mask = problem.mask.copy()
    mask[:50, :90] = False
    problem = replace(problem, mask=mask)
    return run(gauss_newton(problem, max_iterations=10))


def test_sigma_is_that_of_the_frame_taken_smaller(large):
    small = take_every_nth_pixel(large.iterate)
    whole = uncertainty_of(large)
    fewer = uncertainty_of(small)
    known = [
        np.isfinite(whole.sigma),
        np.isfinite(whole.shares[0]),
        whole.dominant_source > 0,
    ]
    np.testing.assert_array_equal(known, [large.mask] * 3)
    np.testing.assert_allclose(whole.shares.sum(axis=0)[large.mask], 1)
    medians = [
        np.nanmedian(uncertainty.sigma / result.distance)
        for uncertainty, result in ((whole, large), (fewer, small))
    ]
    assert medians[0] / medians[1] == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize("column", [399, 400, 401])
def test_cuts_and_evidence_go_along(large, column):
    """A cut in any place between two pixels that are kept is one between these."""
    shape = large.mask.shape
    evidence = np.zeros(shape, np.int8)
    evidence[200:300, 300:500] = NONE
    cuts = np.zeros((2, *shape), bool)
    cuts[0, :, column] = True
    problem = replace(large.problem, evidence=evidence, cuts=cuts)
    fewer = take_every_nth_pixel(replace(large.iterate, problem=problem)).problem
    assert (fewer.evidence[67:99, 100:166] == NONE).all()
    cut = np.flatnonzero(fewer.cuts[0].all(axis=0))
    assert cut == (column - 1) // 3
