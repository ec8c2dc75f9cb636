"""The Gauss-Newton model at an estimate, against dense matrices of tiny problems."""

from dataclasses import replace

import numpy as np
import pytest

from endolab.numerics.compiled import inner, pad_maps
from endolab.reconstruction.uncertainty import Linearised
from endolab.solvers.multigrid import multiply
from tests.tools.problems import at_truth


@pytest.mark.parametrize("regulariser", ["first", "second"])
def test_its_slopes_are_those_of_the_steps(rng, regulariser):
    """JᵀWJ of a worn tube at a rough map, without a prior, and xᵀ(Jᵀy) = (Jx)ᵀy."""
    problem, truth = at_truth("tube", 16, regulariser=regulariser)
    mask = problem.mask & (rng.random(problem.mask.shape) > 0.05)
    cuts = rng.random((2, *mask.shape)) > 0.97
    problem = replace(problem, mask=mask, cuts=cuts, lam=0.0)
    surface = Linearised(problem, truth + 0.02 * rng.normal(size=mask.shape))
    x, y = mask * rng.normal(size=(2, *mask.shape))
    assert np.vdot(x, surface.adjoint(y)) == pytest.approx(np.vdot(surface.apply(x), y))
    expected = np.zeros(surface.coefficients.active.shape)
    multiply(surface.coefficients.matrix(0.0), pad_maps(x), expected)
    found = surface.adjoint(surface.weight * surface.apply(x))
    np.testing.assert_allclose(found, inner(expected), atol=1e-12 * np.abs(found).max())
