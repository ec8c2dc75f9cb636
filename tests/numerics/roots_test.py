"""Roots and inverses against NumPy's and Brent's."""

import numpy as np
import pytest
from numpy.polynomial import polynomial
from numpy.testing import assert_allclose
from scipy.optimize import brentq

from endolab.numerics.roots import invert_increasing, smallest_positive_root


def sampled_root(coefficients, limit):
    """First sign change on a fine grid, polished by Brent."""
    x = np.linspace(0, limit, 20001)[1:]
    f = polynomial.polyval(x, coefficients)
    change = np.flatnonzero(np.diff(np.sign(f)))
    if change.size == 0:
        return limit
    return brentq(
        lambda t: polynomial.polyval(t, coefficients),
        x[change[0]],
        x[change[0] + 1],
        xtol=1e-14,
    )


@pytest.mark.parametrize("seed", range(20))
def test_smallest_positive_root_is_the_first_sign_change(seed):
    coefficients = np.random.default_rng(seed).normal(size=5)
    expected = sampled_root(coefficients, 5.0)
    assert smallest_positive_root(coefficients, 5.0) == pytest.approx(
        expected, abs=1e-9
    )


def test_no_positive_root_gives_the_limit_and_trailing_zeros_are_no_degree():
    assert smallest_positive_root([1.0, 0.0, 1.0], 3.0) == 3.0
    assert smallest_positive_root([1.0, -2.0, 0.0, 0.0], 3.0) == pytest.approx(0.5)
    assert smallest_positive_root([1.0, -2.0, 0.0, 1e-320], 3.0) == pytest.approx(0.5)


FUNCTIONS = {
    "cubic": (lambda x: (x + x**3, 1 + 3 * x**2), 0.0, 2.0),
    "steep": (lambda x: (np.expm1(3 * x) / 20, 0.15 * np.exp(3 * x)), 0.0, 1.5),
    "flat at the end": (lambda x: (np.sin(x), np.cos(x)), 0.0, np.pi / 2),
    "flat in the middle": (lambda x: ((x - 1) ** 3 + 1, 3 * (x - 1) ** 2), 0.0, 2.0),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_invert_increasing_agrees_with_brent(name):
    function, low, high = FUNCTIONS[name]
    ends = [function(np.array(x))[0] for x in (low, high)]
    target = np.linspace(*ends, 101)
    x = invert_increasing(function, target, low, high)
    assert np.all((x >= low) & (x <= high))
    value, slope = function(x)
    assert np.all(np.abs(value - target) <= 1e-15 * np.maximum(1.0, slope))
    steep = np.flatnonzero(slope > 0.01)[1:-1]
    assert steep.size > 80
    brent = [
        brentq(lambda s, t=t: function(s)[0] - t, low, high, xtol=1e-15)
        for t in target[steep]
    ]
    assert_allclose(x[steep], brent, rtol=0, atol=1e-12)
