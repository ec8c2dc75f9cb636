"""σ of a large frame is told on fewer pixels: what is kept, and what comes back."""

from dataclasses import replace

import numpy as np
import pytest

from endolab.reconstruction.uncertainty.estimate import uncertainty_of
from endolab.reconstruction.uncertainty.fewer_pixels import MOST_COLUMNS, thin
from endolab.solvers.gauss_newton import gauss_newton
from endolab.solvers.problem import NONE
from endolab.solvers.provenance import PreparationReport, Provenance
from endolab.solvers.result import run
from tests.tools.problems import problem_of


@pytest.fixture(scope="module")
def large():
    problem, _ = problem_of("tube", 2 * MOST_COLUMNS + 2, noise=1.0)
    mask = problem.mask.copy()
    mask[:50, :90] = False
    problem = replace(problem, mask=mask)
    return run(gauss_newton(problem, max_iterations=10))


def test_sigma_is_that_of_the_frame_taken_smaller(large):
    small = thin(large.iterate)
    whole = uncertainty_of(large)
    fewer = uncertainty_of(small)
    known = [
        np.isfinite(whole.sigma),
        np.isfinite(whole.shares[0]),
        whole.dominant_source > 0,
    ]
    np.testing.assert_array_equal(known, [large.mask] * 3)
    np.testing.assert_allclose(whole.shares.sum(axis=0)[large.mask], 1)
    assert whole.sigma_scale == fewer.sigma_scale
    medians = [
        np.nanmedian(uncertainty.sigma / result.distance)
        for uncertainty, result in ((whole, large), (fewer, small))
    ]
    assert medians[0] / medians[1] == pytest.approx(1, abs=0.02)


def test_cuts_evidence_and_blur_go_along(large):
    shape = large.mask.shape
    evidence = np.zeros(shape, np.int8)
    evidence[200:300, 300:500] = NONE
    cuts = np.zeros((2, *shape), bool)
    cuts[0, :, 399] = True
    report = PreparationReport("frame", shape[::-1], "green", *shape, 2.0, "keep")
    provenance = Provenance(preparation=report)
    problem = replace(large.problem, evidence=evidence, cuts=cuts)
    fewer = thin(replace(large.iterate, problem=problem, provenance=provenance))
    assert fewer.provenance.preparation.smooth == 0.5
    assert (fewer.problem.evidence[52:73, 77:123] == NONE).all()
    assert np.flatnonzero(fewer.problem.cuts[0].any(axis=0)).size == 1
