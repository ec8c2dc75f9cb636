"""The Gauss-Newton model at an estimate, against dense matrices of tiny problems."""

from dataclasses import replace

import numpy as np
import pytest

from endolab.numerics.compiled import inner
from endolab.reconstruction.uncertainty import Linearised
from tests.solvers.gauss_newton_model import GaussNewtonModel
from tests.tools.problems import at_truth


@pytest.fixture(params=["first", "second"])
def tiny(request, rng):
    """A worn tube of 16x12 px linearised at a rough map, solved exactly; and its readable twin."""
    problem, truth = at_truth("tube", 16, regulariser=request.param)
    mask = problem.mask & (rng.random(problem.mask.shape) > 0.05)
    problem = replace(problem, mask=mask, cuts=rng.random((2, *mask.shape)) > 0.97)
    v = truth + 0.02 * rng.normal(size=mask.shape)
    exact = Linearised(problem, v, precision=1e-9, most_steps=1000)
    return exact, GaussNewtonModel.at(problem, v)


def dense(operator, mask):
    """A linear operator of maps as a matrix of the mask's pixels."""
    units = np.eye(mask.size).reshape(-1, *mask.shape)[mask.ravel()]
    return np.stack([np.asarray(operator(one))[mask] for one in units], axis=1)


def hessian(twin):
    """Jᵀ W J + R of the readable model, of the sum over pixels."""
    mask = twin.problem.mask
    return dense(lambda x: mask.sum() * twin.multiply(x), mask)


def test_it_is_the_readable_model(tiny):
    surface, twin = tiny
    mask = surface.problem.mask
    applied = dense(surface.apply, mask)
    data = replace(twin, xi_slope=0 * twin.xi_slope)
    expected = hessian(data)
    found = applied.T @ np.diag(surface.weight[mask]) @ applied
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()


def test_probing_finds_the_same_inverse(tiny):
    """One solve for each pixel tells H⁻¹ exactly, H being damped."""
    surface, twin = tiny
    mask = surface.problem.mask
    damping = 1e-3 * (twin.data_weight * twin.by_v**2)[mask]
    found = dense(surface.solve, mask)
    expected = np.linalg.inv(hessian(twin) + np.diag(damping))
    assert found == pytest.approx(expected, abs=1e-5 * np.abs(expected).max())


def test_light_that_is_brighter_everywhere_moves_all_pixels_alike(tiny):
    surface, _ = tiny
    mask = surface.problem.mask
    assert surface.to_light(np.full(mask.shape, 0.2))[mask] == pytest.approx(
        -0.1, abs=1e-9
    )
    assert inner(surface.coefficients.active).sum() == mask.sum()
