"""Derivatives of a map on a pixel grid with a mask and cuts.

A map is an array of shape (H, W) whose values outside the mask are never read: a hole, whatever
it holds, does not reach its neighbours; the mask is everywhere by default. A cut is a step between
neighbouring pixels that no derivative takes, as at an occluding contour: `cuts`, (2, H, W),
holds those from each pixel to its right (first) and lower (second) neighbour. Both come down to
`links`: which steps there are.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from endolab.numerics.arrays import BoolArray, FloatArray


def px_per_reference(shape: tuple[int, ...]) -> float:
    """How many pixels of a picture (H, W, ...) are 1/320 of its longer side, the unit of thresholds."""
    return max(shape[:2]) / 320


def shift(a: NDArray, step: int, axis: int, fill: float | bool) -> NDArray:
    """Return the array whose element at i is ``a`` at i + step, `fill` beyond the border."""
    out = np.full_like(a, fill)
    length = a.shape[axis]
    if abs(step) < length:
        target = [slice(None)] * a.ndim
        source = [slice(None)] * a.ndim
        target[axis] = slice(max(0, -step), length - max(0, step))
        source[axis] = slice(max(0, step), length - max(0, -step))
        out[tuple(target)] = a[tuple(source)]
    return out


def links(mask: BoolArray, cuts: BoolArray | None = None) -> BoolArray:
    """Steps that derivatives may take, (2, H, W): between neighbours in the mask that are not cut apart."""
    joined = np.stack([mask & shift(mask, 1, axis, False) for axis in (1, 0)])
    return joined if cuts is None else joined & ~cuts


def _links_of(
    f: FloatArray, mask: BoolArray | None, cuts: BoolArray | None
) -> tuple[BoolArray, BoolArray]:
    inside = (
        np.ones(np.shape(f), dtype=bool) if mask is None else np.asarray(mask, dtype=bool)
    )
    return inside, links(inside, cuts)


def _derivative(
    f: FloatArray,
    inside: BoolArray,
    link: BoolArray,
    axis: int,
    edge_order: int,
    step: int,
) -> FloatArray:
    pad = [(2, 2) if i == axis else (0, 0) for i in (0, 1)]

    def beside(a: NDArray) -> list[NDArray]:
        """Values two pixels before, one before, here, one on and two on; views, thinned."""
        length = a.shape[axis]
        padded = np.moveaxis(np.pad(a, pad), axis, 0)
        return [
            np.moveaxis(padded[i : i + length : step, ::step], 0, axis) for i in range(5)
        ]

    values = beside(f)
    far_behind, behind, ahead, far_ahead = (b - a for a, b in pairwise(values))
    far_before, before, after, far_after, _ = beside(link)
    one_sided = np.select([after, before], [ahead, behind], 0.0)
    if edge_order == 2:
        # A border pixel takes the three-point formula, as accurate as the central one.
        bends = [ahead - far_ahead, behind - far_behind]
        far = [after & far_after, before & far_before]
        one_sided = one_sided + 0.5 * np.select(far, bends, 0.0)
    return np.select(
        [~inside[::step, ::step], after & before],
        [np.nan, 0.5 * (ahead + behind)],
        one_sided,
    )


def gradient(
    f: FloatArray,
    mask: BoolArray | None = None,
    cuts: BoolArray | None = None,
    edge_order: int = 2,
    step: int = 1,
) -> tuple[FloatArray, FloatArray]:
    """Gradient of a map (H, W): central differences, one-sided where a step is missing.

    `edge_order` is the accuracy of the one-sided ones: from three pixels (2) or from two (1). Returns the
    derivatives along columns (u, to the right) and rows (v, downwards), per pixel: nan outside the mask; 0
    along an axis on which a pixel has no neighbour. Of every `step`-th row and column alone, if it is given.
    """
    inside, link = _links_of(f, mask, cuts)
    f = np.where(inside, np.asarray(f, dtype=np.float64), 0.0)
    f_u, f_v = (
        _derivative(f, inside, link[i], axis, edge_order, step)
        for i, axis in ((0, 1), (1, 0))
    )
    return f_u, f_v


def forward_gradient(
    f: FloatArray, mask: BoolArray | None = None, cuts: BoolArray | None = None
) -> FloatArray:
    """Differences to the right and lower neighbour, (2, H, W), per pixel; 0 where there is no such step."""
    inside, link = _links_of(f, mask, cuts)
    f = np.where(inside, f, 0.0)
    return np.stack(
        [(shift(f, 1, axis, 0.0) - f) * link[i] for i, axis in ((0, 1), (1, 0))]
    )


def differences(
    f: FloatArray, mask: BoolArray | None = None, cuts: BoolArray | None = None
) -> FloatArray:
    """Differences to the right, the lower, the left and the upper neighbour, (4, H, W), over √2.

    Their norm is the gradient's, whichever way the map is turned; 0 where there is no such step.
    """
    ahead = forward_gradient(f, mask, cuts)
    behind = [shift(part, -1, axis, 0.0) for part, axis in zip(ahead, (1, 0), strict=True)]
    return np.concatenate([ahead, behind]) / np.sqrt(2)


def hessian_stencils(link: BoolArray) -> tuple[BoolArray, BoolArray, BoolArray]:
    """Where f_uu, f_uv and f_vv have all the steps that they need."""
    along_u, along_v = link
    return (
        along_u & shift(along_u, -1, 1, False),
        along_u & shift(along_u, 1, 0, False) & along_v & shift(along_v, 1, 1, False),
        along_v & shift(along_v, -1, 0, False),
    )


def hessian(
    f: FloatArray, mask: BoolArray | None = None, cuts: BoolArray | None = None
) -> FloatArray:
    """Second differences (6, H, W), such that their norm is the Hessian's Frobenius norm.

    f_uu, f_vv, and f_uv/√2 of the squares to the lower right, lower left, upper right and upper left, per
    pixel squared; 0 where the stencil (three in a row, or a square of four) is not valid.
    """
    inside, link = _links_of(f, mask, cuts)
    f = np.where(inside, f, 0.0)
    valid_uu, valid_uv, valid_vv = hessian_stencils(link)
    along_u, along_v = (shift(f, 1, axis, 0.0) - f for axis in (1, 0))
    mixed = valid_uv * (shift(along_u, 1, 0, 0.0) - along_u) / np.sqrt(2)
    above = shift(mixed, -1, 0, 0.0)
    return np.stack(
        [
            valid_uu * (along_u - shift(along_u, -1, 1, 0.0)),
            valid_vv * (along_v - shift(along_v, -1, 0, 0.0)),
            *(mixed, shift(mixed, -1, 1, 0.0)),
            *(above, shift(above, -1, 1, 0.0)),
        ]
    )
