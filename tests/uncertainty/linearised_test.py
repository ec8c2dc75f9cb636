"""The Gauss-Newton model at an estimate, against dense matrices of tiny problems."""

from dataclasses import replace

import numpy as np
import pytest

from endolab.numerics.compiled import inner
from endolab.uncertainty import linearised
from endolab.uncertainty.linearised import DAMPING, Linearised
from tests.depth.gauss_newton_model import GaussNewtonModel
from tests.tools.problems import at_truth


@pytest.fixture(params=["first", "second", "curvature"])
def tiny(request, rng, monkeypatch):
    """A worn tube of 16x12 px linearised at a rough map, solved exactly; and its readable twin."""
    monkeypatch.setattr(linearised, "PRECISION", 1e-9)
    monkeypatch.setattr(linearised, "MOST", 1000)
    problem, truth = at_truth("tube", 16, regulariser=request.param)
    mask = problem.mask & (rng.random(problem.mask.shape) > 0.05)
    problem = replace(problem, mask=mask, cuts=rng.random((2, *mask.shape)) > 0.97)
    v = truth + 0.02 * rng.normal(size=mask.shape)
    return Linearised.at(problem, v), GaussNewtonModel.at(problem, v)


def dense(operator, mask):
    """A linear operator of maps as a matrix of the mask's pixels."""
    units = np.eye(mask.size).reshape(-1, *mask.shape)[mask.ravel()]
    return np.stack([np.asarray(operator(one))[mask] for one in units], axis=1)


def undamped(twin):
    """Jᵀ W J + R of the readable model, of the sum over pixels."""
    mask = twin.problem.mask
    return dense(lambda x: mask.sum() * twin.multiply(x), mask)


def hessian(twin):
    """H: the same with the damping of the compiled one."""
    damping = DAMPING * (twin.data_weight * twin.by_v**2)[twin.problem.mask]
    return undamped(twin) + np.diag(damping)


class OneHot:
    """A generator whose normal numbers are all 0 but for one, which is 1."""

    def __init__(self, index):
        self.index = index

    def standard_normal(self, shape):
        out = np.zeros(shape)
        out.flat[self.index] = 1
        return out


def test_it_is_the_readable_model(tiny, rng):
    surface, twin = tiny
    mask = surface.problem.mask
    applied, adjoint = dense(surface.applied, mask), dense(surface.adjoint, mask)
    assert np.abs(adjoint - applied.T).max() < 1e-12
    weights = surface.weight[mask]
    prior = undamped(twin) - applied.T @ np.diag(weights) @ applied
    root = np.stack([surface.prior_draw(OneHot(i))[mask] for i in range(3 * mask.size)], axis=1)
    assert np.abs(root @ root.T - prior).max() < 1e-5 * np.abs(prior).max()  # maps are of single precision


def test_answers_are_those_of_the_dense_inverse(tiny, rng):
    surface, twin = tiny
    mask = surface.problem.mask
    change = rng.normal(size=mask.shape)
    expected = np.linalg.solve(hessian(twin), surface.adjoint(surface.weight * change)[mask])
    assert surface.to_picture(change)[mask] == pytest.approx(expected, abs=1e-5 * np.abs(expected).max())


def test_draws_of_picture_and_prior_have_the_covariance_of_the_inverse(tiny, rng):
    """Perturb and solve: 1000 draws tell a variance to 4.5 %, one σ; neighbours are off alike.

    The damping takes variance where pixels hang by little: it is the inverse's but for that.
    """
    surface, twin = tiny
    mask = surface.problem.mask
    inverse = np.linalg.inv(hessian(twin))
    expected = np.diag(inverse @ undamped(twin) @ inverse)
    white = np.divide(1, np.sqrt(surface.weight), out=np.zeros(mask.shape), where=surface.weight > 0)
    draws = [
        surface.to_picture(white * rng.standard_normal(mask.shape)) + surface.solved(surface.prior_draw(rng))
        for _ in range(1000)
    ]
    ratio = np.mean(np.square(draws), axis=0)[mask] / expected
    assert np.median(ratio) == pytest.approx(1, abs=0.1)
    assert np.abs(np.log(ratio)).max() < 0.25


def test_probing_finds_the_same_inverse(tiny):
    """One solve for each pixel tells H⁻¹ exactly."""
    surface, twin = tiny
    mask = surface.problem.mask
    found, expected = dense(surface.solved, mask), np.linalg.inv(hessian(twin))
    assert found == pytest.approx(expected, abs=1e-5 * np.abs(expected).max())


def test_light_that_is_brighter_everywhere_moves_all_pixels_alike(tiny):
    surface, _ = tiny
    mask = surface.problem.mask
    assert surface.to_light(np.full(mask.shape, 0.2))[mask] == pytest.approx(-0.1, abs=1e-9)
    assert inner(surface.coefficients.active).sum() == mask.sum()
