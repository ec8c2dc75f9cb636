"""Roots of polynomials and inverses of increasing functions."""

from collections.abc import Callable

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import ArrayLike

from endolab.numerics.arrays import FloatArray

NEGLIGIBLE = 1e-20  # share of the largest term below which a polynomial's highest terms are none


def smallest_positive_root(coefficients: ArrayLike, limit: float) -> float:
    """Return a polynomial's first positive real root, `limit` if none is below it; lowest degree first."""
    c = np.asarray(coefficients, dtype=np.float64)
    size = np.abs(c) * float(limit) ** np.arange(c.size)
    degree = np.flatnonzero(size >= NEGLIGIBLE * size.max())[-1]
    roots = polynomial.polyroots(c[: degree + 1])
    real = roots.real[(np.abs(roots.imag) < 1e-9 * np.maximum(1.0, np.abs(roots.real))) & (roots.real > 0)]
    return float(min(real.min(initial=limit), limit))


def invert_increasing(
    function: Callable[[FloatArray], tuple[FloatArray, FloatArray]],
    target: FloatArray,
    low: float,
    high: float,
) -> FloatArray:
    """Solve f(x) = target, of any shape, by Newton steps kept inside a shrinking bracket; to rounding.

    A step is Newton's where that stays inside the bracket and halves it elsewhere. The function returns f
    and its derivative; f increases on [low, high] and is of the order of one there, and the targets lie
    between f(low) and f(high).
    """
    wanted = np.asarray(target, dtype=np.float64).ravel()
    x = np.clip(wanted, low, high)
    lower, upper = np.full(wanted.shape, low), np.full(wanted.shape, high)
    busy = np.arange(wanted.size)
    for _ in range(100):
        value, slope = function(x[busy])
        excess = value - wanted[busy]
        going = np.abs(excess) > 2e-16 * np.maximum(1.0, wanted[busy])
        busy, excess, slope = busy[going], excess[going], slope[going]
        if busy.size == 0:
            break
        lower[busy] = np.where(excess < 0, x[busy], lower[busy])
        upper[busy] = np.where(excess > 0, x[busy], upper[busy])
        with np.errstate(divide="ignore", invalid="ignore"):
            new = x[busy] - excess / slope
        outside = ~((new >= lower[busy]) & (new <= upper[busy]))
        new[outside] = 0.5 * (lower[busy] + upper[busy])[outside]
        moved = new != x[busy]
        x[busy] = new
        busy = busy[moved]
    return x.reshape(np.shape(target))
