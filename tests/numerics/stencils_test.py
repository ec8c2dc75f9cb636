"""The difference operator of the solvers: its adjoint, and the same differences of whole maps."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from endolab.numerics.stencils import (
    CENTRAL,
    FIRST,
    SECOND,
    Differences,
    forward_gradient,
    gradient,
    hessian,
    links,
)


@pytest.fixture
def worn(rng):
    """A ragged mask, cuts, and a map on it."""
    mask = rng.random((17, 23)) < 0.8
    cuts = rng.random((2, *mask.shape)) < 0.1
    return mask, cuts, rng.normal(size=mask.shape)


@pytest.mark.parametrize("kind", [FIRST, SECOND, CENTRAL])
def test_the_adjoint_is_one(rng, worn, kind):
    """⟨K x, y⟩ = ⟨x, Kᵀ y⟩."""
    mask, cuts, x = worn
    differences = Differences(links(mask, cuts), kind)
    y = rng.normal(size=(3, *mask.shape))
    expected = np.vdot(differences.apply(x), y)
    assert np.vdot(x, differences.adjoint(y)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("kind", "plain"), [(FIRST, forward_gradient), (SECOND, hessian)]
)
def test_its_norm_is_that_of_the_plain_differences(worn, kind, plain):
    mask, cuts, x = worn
    differences = Differences(links(mask, cuts), kind)
    expected = np.linalg.norm(plain(x, mask, cuts), axis=0)
    found = differences.norm(differences.apply(x))
    assert_allclose(found[mask], expected[mask], rtol=1e-12, atol=1e-14)


def test_central_differences_are_the_gradient_of_two_pixels(worn):
    mask, cuts, x = worn
    along, _, down = Differences(links(mask, cuts), CENTRAL).apply(x)
    expected = gradient(x, mask, cuts, edge_order=1)
    assert_allclose(
        np.stack([along, down])[:, mask], np.stack(expected)[:, mask], atol=1e-14
    )
