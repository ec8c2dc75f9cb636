"""Roots of polynomials, by their own values."""

import numpy as np
import pytest
from numpy.polynomial import polynomial
from scipy.optimize import brentq

from endolab.numerics.roots import smallest_positive_root


@pytest.mark.parametrize("seed", range(20))
def test_smallest_positive_root_is_the_first_sign_change(seed):
    """On a fine grid, polished by Brent."""
    coefficients = np.random.default_rng(seed).normal(size=5)
    x = np.linspace(0, 5.0, 20001)[1:]
    change = np.diff(np.sign(polynomial.polyval(x, coefficients))) != 0
    expected = 5.0
    if change.any():
        first = change.argmax()
        polyval = polynomial.Polynomial(coefficients)
        expected = brentq(polyval, x[first], x[first + 1], xtol=1e-14)
    found = smallest_positive_root(coefficients, 5.0)
    assert found == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("coefficients", "root"),
    [([1, 0, 1], 3.0), ([1, -2, 0, 0], 0.5), ([1, -2, 0, 1e-320], 0.5)],
)
def test_no_positive_root_gives_the_limit_and_trailing_zeros_are_no_degree(
    coefficients, root
):
    assert smallest_positive_root(coefficients, 3.0) == pytest.approx(root)
