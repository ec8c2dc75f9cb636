"""The Gauss-Newton model at an estimate, against dense matrices of tiny problems."""

from dataclasses import replace

import numpy as np
import pytest

from endolab.numerics.compiled import inner, pad_maps
from endolab.reconstruction.uncertainty import Linearised
from endolab.solvers.multigrid import multiply
from tests.tools.problems import at_truth


@pytest.fixture(params=["first", "second"])
def tiny(request, rng):
    """A worn tube of 16x12 px linearised at a rough map and solved exactly, and the same without a prior."""
    problem, truth = at_truth("tube", 16, regulariser=request.param)
    mask = problem.mask & (rng.random(problem.mask.shape) > 0.05)
    problem = replace(problem, mask=mask, cuts=rng.random((2, *mask.shape)) > 0.97)
    v = truth + 0.02 * rng.normal(size=mask.shape)
    how = {"precision": 1e-9, "most_steps": 1000}
    bare = replace(problem, lam=0.0)
    return Linearised(problem, v, **how), Linearised(bare, v, **how)


def dense(operator, mask):
    """A linear operator of maps as a matrix of the mask's pixels."""
    units = np.eye(mask.size).reshape(-1, *mask.shape)[mask.ravel()]
    return np.stack([np.asarray(operator(one))[mask] for one in units], axis=1)


def hessian(surface):
    """Jᵀ W J + R, as Gauss-Newton's steps have it."""

    def times(x):
        out = np.zeros(surface.coefficients.active.shape)
        multiply(surface.coefficients.matrix(0.0), pad_maps(x), out)
        return inner(out)

    return dense(times, surface.problem.mask)


def test_its_slopes_are_those_of_the_steps(tiny):
    _, alone = tiny
    mask = alone.problem.mask
    applied = dense(alone.apply, mask)
    expected = hessian(alone)
    found = applied.T @ np.diag(alone.weight[mask]) @ applied
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()


def test_probing_finds_the_same_inverse(tiny):
    """One solve for each pixel tells H⁻¹ exactly, H being damped."""
    surface, _ = tiny
    mask = surface.problem.mask
    by_v = inner(surface.coefficients.by_v)[mask]
    damping = 1e-3 * surface.weight[mask] * by_v**2
    found = dense(surface.solve, mask)
    expected = np.linalg.inv(hessian(surface) + np.diag(damping))
    assert found == pytest.approx(expected, abs=1e-5 * np.abs(expected).max())


def test_light_that_is_brighter_everywhere_moves_all_pixels_alike(tiny):
    surface, _ = tiny
    mask = surface.problem.mask
    assert surface.to_light(np.full(mask.shape, 0.2))[mask] == pytest.approx(
        -0.1, abs=1e-9
    )
    assert inner(surface.coefficients.active).sum() == mask.sum()
