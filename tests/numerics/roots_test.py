"""Roots and inverses, by the functions' own values."""

import numpy as np
import pytest
from numpy.polynomial import polynomial
from scipy.optimize import brentq

from endolab.numerics.roots import invert_increasing, smallest_positive_root


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


FUNCTIONS = {
    "cubic": (lambda x: (x + x**3, 1 + 3 * x**2), 2.0),
    "steep": (lambda x: (np.expm1(3 * x) / 20, 0.15 * np.exp(3 * x)), 1.5),
    "flat at the end": (lambda x: (np.sin(x), np.cos(x)), np.pi / 2),
    "flat in the middle": (lambda x: ((x - 1) ** 3 + 1, 3 * (x - 1) ** 2), 2.0),
}


@pytest.mark.parametrize(("function", "high"), FUNCTIONS.values(), ids=FUNCTIONS)
def test_invert_increasing_inverts(function, high):
    target = np.linspace(*function(np.array([0.0, high]))[0], 101)
    x = invert_increasing(function, target, 0.0, high)
    assert np.all((x >= 0) & (x <= high))
    value, slope = function(x)
    assert np.all(np.abs(value - target) <= 1e-15 * np.maximum(1.0, slope))
