"""Roots of polynomials and inverses of increasing functions."""

from collections.abc import Callable

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import ArrayLike

from endolab.numerics.arrays import FloatArray


def smallest_positive_root(coefficients: ArrayLike, limit: float) -> float:
    """Return a polynomial's first positive real root, `limit` if none is below it; lowest degree first."""
    c = np.asarray(coefficients, dtype=np.float64)
    size = np.abs(c) * float(limit) ** np.arange(c.size)
    degree = np.flatnonzero(size >= 1e-20 * size.max())[-1]  # smaller terms are none
    roots = polynomial.polyroots(c[: degree + 1])
    real = roots.real[
        (np.abs(roots.imag) < 1e-9 * np.maximum(1.0, np.abs(roots.real))) & (roots.real > 0)
    ]
    return float(min(real.min(initial=limit), limit))


def invert_increasing(
    function: Callable[[FloatArray], tuple[FloatArray, FloatArray]],
    target: FloatArray,
    low: float,
    high: float,
) -> FloatArray:
    """Solve f(x) = target, of any shape, by Newton's steps from a table.

    The function returns f and its derivative; f increases on [low, high], and the targets lie between f(low)
    and f(high). To rounding where f has a slope.
    """
    places = np.linspace(low, high, 4096)
    values = function(places)[0]
    cell = np.clip(np.searchsorted(values, target), 1, places.size - 1)
    x = np.interp(target, values, places)
    for _ in range(12):  # two are enough where the slope is not 0
        value, slope = function(x)
        step = (value - target) / np.where(slope > 0, slope, np.inf)
        x = np.clip(x - step, places[cell - 1], places[cell])
    return np.asarray(x)
