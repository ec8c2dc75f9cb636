"""Derivatives of a map on a pixel grid with a mask.

A map is an array of shape (H, W) whose values outside the mask are never read:
a hole, whatever it holds, does not reach its neighbours.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


def shifted(a: NDArray, step: int, axis: int, fill: float | bool) -> NDArray:
    """Return the array whose element at i is ``a`` at i + step, `fill` beyond the border."""
    out = np.full_like(a, fill)
    length = a.shape[axis]
    if abs(step) < length:
        here = [slice(None)] * a.ndim
        there = [slice(None)] * a.ndim
        here[axis] = slice(max(0, -step), length - max(0, step))
        there[axis] = slice(max(0, step), length - max(0, -step))
        out[tuple(here)] = a[tuple(there)]
    return out


def _derivative(f: FloatArray, mask: BoolArray, axis: int) -> FloatArray:
    f = np.where(mask, f, 0.0)
    value = {step: shifted(f, step, axis, 0.0) for step in (-2, -1, 1, 2)}
    inside = {step: shifted(mask, step, axis, False) for step in (-2, -1, 1, 2)}
    forward, backward = value[1] - f, f - value[-1]
    # A border pixel takes the three-point one-sided formula, as accurate as the central one.
    forward3 = 1.5 * forward - 0.5 * (value[2] - value[1])
    backward3 = 1.5 * backward - 0.5 * (value[-1] - value[-2])
    return np.select(
        [
            ~mask,
            inside[1] & inside[-1],
            inside[1] & inside[2],
            inside[-1] & inside[-2],
            inside[1],
            inside[-1],
        ],
        [np.nan, 0.5 * (forward + backward), forward3, backward3, forward, backward],
        default=0.0,
    )


def gradient(f: FloatArray, mask: BoolArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Gradient of a map per pixel: central differences, one-sided where a neighbour is masked.

    Parameters
    ----------
    f : (H, W) float array
        The map. Values outside the mask are not read.
    mask : (H, W) bool array, optional
        Where the map is defined; everywhere by default.

    Returns
    -------
    f_u, f_v : (H, W) float arrays
        Derivatives along columns (u, to the right) and rows (v, downwards), per pixel.
        nan outside the mask; 0 along an axis on which a pixel has no neighbour.
    """
    f = np.asarray(f, dtype=np.float64)
    inside = np.ones(f.shape, dtype=bool) if mask is None else np.asarray(mask, dtype=bool)
    return _derivative(f, inside, axis=1), _derivative(f, inside, axis=0)


def forward_gradient(f: FloatArray, mask: BoolArray | None = None) -> FloatArray:
    """Differences to the right and lower neighbour.

    Parameters
    ----------
    f : (H, W) float array
        The map. Values outside the mask are not read.
    mask : (H, W) bool array, optional
        Where the map is defined; everywhere by default.

    Returns
    -------
    (2, H, W) float array
        f_u, f_v per pixel; 0 where either pixel is outside the mask or the picture.
    """
    inside = np.ones(np.shape(f), dtype=bool) if mask is None else np.asarray(mask, dtype=bool)
    f = np.where(inside, f, 0.0)
    return np.stack([(shifted(f, 1, a, 0.0) - f) * (inside & shifted(inside, 1, a, False)) for a in (1, 0)])


def hessian(f: FloatArray, mask: BoolArray | None = None) -> FloatArray:
    """Second differences, such that the norm of the three is the Hessian's Frobenius norm.

    Parameters
    ----------
    f : (H, W) float array
        The map. Values outside the mask are not read.
    mask : (H, W) bool array, optional
        Where the map is defined; everywhere by default.

    Returns
    -------
    (3, H, W) float array
        f_uu, √2 f_uv, f_vv per pixel squared; 0 where a pixel of the stencil (three in a row, or
        a square of four) is outside the mask or the picture.
    """
    inside = np.ones(np.shape(f), dtype=bool) if mask is None else np.asarray(mask, dtype=bool)
    f = np.where(inside, f, 0.0)
    out = np.zeros((3, *f.shape))
    for index, axis in ((0, 1), (2, 0)):
        whole = inside & shifted(inside, 1, axis, False) & shifted(inside, -1, axis, False)
        out[index] = whole * (shifted(f, 1, axis, 0.0) - 2 * f + shifted(f, -1, axis, 0.0))
    lower, lower_in = shifted(f, 1, 0, 0.0), shifted(inside, 1, 0, False)
    whole = inside & lower_in & shifted(inside & lower_in, 1, 1, False)
    out[1] = np.sqrt(2) * whole * (shifted(lower - f, 1, 1, 0.0) - (lower - f))
    return out
