"""Derivatives of maps on a pixel grid with a mask and cuts: apply, adjoint, and rows of normal equations.

A map is an array of shape (H, W) whose values outside the mask are never read: a hole, whatever
it holds, does not reach its neighbours. A cut is a step between
neighbouring pixels that no derivative takes, as at an occluding contour: `cuts`, (2, H, W),
holds those from each pixel to its right (first) and lower (second) neighbour. Both come down to
`links`: which steps there are.

A difference of a pixel is a sum over it and its neighbours, t₀ x₀ + t₁ x₁ + ..., whose weights t are 0 where
a link is missing (`links`), as over a cut. There are three kinds, of up to three terms each:

    CENTRAL    the mean of the differences that there are, along the row and along the column
    FIRST      the difference to the right and to the pixel below
    SECOND     f_uu, √2 f_uv of the square to the lower right, f_vv

Compiled loops take a row of weights at a time (`stencil_row`), of padded maps, see `compiled`; `Differences`
is the same for whole maps. With K x the differences, ⟨K x, y⟩ = ⟨x, Kᵀ y⟩.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from endolab.numerics.arrays import BoolArray, ByteArray, FloatArray, Span
from endolab.numerics.compiled import PAD, copy_row, inner, kernel, pad_maps
from endolab.numerics.threads import on_cores, rows_within

# A pixel and its neighbours: right, left, below, above and lower right.
DOWN = (0, 0, 0, 1, -1, 1)
RIGHT = (0, 1, -1, 0, 0, 1)
FIRST, SECOND, CENTRAL = range(3)
ROOT_2 = 2**0.5
# Which weights are not 0 everywhere, (term, neighbour): of each kind the first so many.
ENTRIES = np.array(
    [(0, 0), (0, 1), (2, 0), (2, 3), (0, 2), (2, 4), (1, 0), (1, 1), (1, 3), (1, 5)]
)
ENTRY_COUNT = (4, 10, 6)
# Of each kind, with r = 1 where there is a link ahead, else 0, and l likewise behind: the weight of the pixel
# ahead is r (a + b l), of that behind l (c + d r), and of the pixel itself what makes their sum 0.
COEFFICIENTS = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 1.0), (1.0, -0.5, -1.0, 0.5))


@kernel
def _weights(
    link: ByteArray, i: int, j: int, a: float, b: float, c: float, d: float
) -> tuple[float, float, float, float]:
    """Weights of the pixels to the right, left, below and above, by a kind's coefficients."""
    right = float(link[0, i, j])
    left = float(link[0, i, j - 1])
    south = float(link[1, i, j])
    north = float(link[1, i - 1, j])
    return (
        right * (a + b * left),
        left * (c + d * right),
        south * (a + b * north),
        north * (c + d * south),
    )


@kernel
def _square(link: ByteArray, i: int, j: int) -> float:
    """√2 where the four pixels from column j and row i to the right and below are joined, 0 elsewhere."""
    upper = float(link[0, i, j]) * link[1, i, j]
    return ROOT_2 * (upper * link[0, i + 1, j] * link[1, i, j + 1])


@kernel
def stencil_row(link: ByteArray, kind: int, i: int, t: FloatArray) -> None:
    """Write the weights of a row's differences, (3, 6, W); those that are not of its `ENTRIES` stay."""
    a, b, c, d = COEFFICIENTS[kind]
    for j in range(t.shape[2]):
        right, left, south, north = _weights(link, i, j + PAD, a, b, c, d)
        t[0, 0, j] = -(right + left)
        t[0, 1, j] = right
        t[0, 2, j] = left
        t[2, 0, j] = -(south + north)
        t[2, 3, j] = south
        t[2, 4, j] = north
    if kind == SECOND:
        for j in range(t.shape[2]):
            square = _square(link, i, j + PAD)
            t[1, 0, j] = square
            t[1, 1, j] = -square
            t[1, 3, j] = -square
            t[1, 5, j] = square


@kernel
def apply_row(link: ByteArray, kind: int, x: FloatArray, i: int, y: FloatArray) -> None:
    """Write the differences of a row of x, y = K x, (3, W)."""
    a, b, c, d = COEFFICIENTS[kind]
    for j in range(y.shape[1]):
        right, left, south, north = _weights(link, i, j + PAD, a, b, c, d)
        here = x[i, j + PAD]
        along = right * (x[i, j + PAD + 1] - here)
        y[0, j] = along + left * (x[i, j + PAD - 1] - here)
        down = south * (x[i + 1, j + PAD] - here)
        y[2, j] = down + north * (x[i - 1, j + PAD] - here)
    if kind == SECOND:
        for j in range(y.shape[1]):
            upper = x[i, j + PAD] - x[i, j + PAD + 1]
            lower = x[i + 1, j + PAD] - x[i + 1, j + PAD + 1]
            y[1, j] = _square(link, i, j + PAD) * (upper - lower)


@kernel
def adjoint_row(
    t: FloatArray, kind: int, y: FloatArray, i: int, rows: Span, x: FloatArray
) -> None:
    """Add Kᵀ y of a row to these rows of x."""
    for n in range(ENTRY_COUNT[kind]):
        term, k = ENTRIES[n]
        row = i + DOWN[k]
        column = PAD + RIGHT[k]
        if rows[0] <= row < rows[1]:
            for j in range(y.shape[1]):
                x[row, column + j] += t[term, k, j] * y[term, j]


@on_cores(cost=10)
def apply_padded(
    rows: Span, y: FloatArray, x: FloatArray, link: ByteArray, kind: int
) -> None:
    """Write y = K x of padded maps."""
    row = np.zeros((3, x.shape[1] - 2 * PAD))  # contiguous: twice as fast
    first, last = rows_within(rows, PAD, x.shape[0] - PAD)
    for i in range(first, last):
        apply_row(link, kind, x, i, row)
        for k in range(3):
            copy_row(row[k], y[k, i, PAD:])


@on_cores(cost=10)
def adjoint_padded(
    rows: Span, x: FloatArray, y: FloatArray, link: ByteArray, kind: int
) -> None:
    """Write x = Kᵀ y of padded maps."""
    x[rows[0] : rows[1]] = 0.0
    t = np.zeros((3, len(DOWN), x.shape[1] - 2 * PAD))
    row = np.zeros((3, x.shape[1] - 2 * PAD))
    first, last = rows_within((rows[0] - 1, rows[1] + 1), PAD, x.shape[0] - PAD)
    for i in range(first, last):
        stencil_row(link, kind, i, t)
        for k in range(3):
            copy_row(y[k, i, PAD:-PAD], row[k])
        adjoint_row(t, kind, row, i, rows, x)


@dataclass(frozen=True, eq=False)
class Differences:
    """K of maps (H, W) over `links` (2, H, W), of a kind."""

    links: BoolArray
    kind: int

    def apply(self, x: FloatArray) -> FloatArray:
        """K x, (3, H, W)."""
        x = pad_maps(np.asarray(x, dtype=np.float64))
        y = np.zeros((3, *x.shape))
        apply_padded(y, x, pad_maps(self.links.view(np.int8)), self.kind)
        return np.asarray(inner(y))

    def adjoint(self, y: FloatArray) -> FloatArray:
        """Kᵀ y, (H, W), of y (3, H, W)."""
        y = pad_maps(y)
        x = np.zeros(y.shape[1:])
        adjoint_padded(x, y, pad_maps(self.links.view(np.int8)), self.kind)
        return np.asarray(inner(x))


def px_per_reference(shape: tuple[int, ...]) -> float:
    """How many pixels of a picture (H, W, ...) are 1/320 of its longer side, the unit of thresholds."""
    return max(shape[:2]) / 320


def shift(a: NDArray, step: int, axis: int, fill: float | bool) -> NDArray:
    """Return the array whose element at i is ``a`` at i + step, `fill` beyond the border."""
    out = np.roll(a, -step, axis)
    beyond = slice(-step, None) if step > 0 else slice(0, -step)
    np.moveaxis(out, axis, 0)[beyond] = fill
    return out


def links(mask: BoolArray, cuts: BoolArray | None = None) -> BoolArray:
    """Steps that derivatives may take, (2, H, W): between neighbours in the mask that are not cut apart."""
    joined = np.stack([mask & shift(mask, 1, axis, False) for axis in (1, 0)])
    return joined if cuts is None else joined & ~cuts


def gradient(
    f: FloatArray, mask: BoolArray, cuts: BoolArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Gradient of a map (H, W): central differences; beside a missing step the three-point formula.

    That is as accurate; two pixels have one difference. Returns the derivatives along columns (u, to the
    right) and rows (v, downwards), per pixel: nan outside the mask; 0 along an axis on which a pixel has no
    neighbour.
    """
    link = links(mask, cuts)
    inside = np.where(mask, f, 0.0)
    f_u, f_v = (_derivative(inside, link[i], axis) for i, axis in ((0, 1), (1, 0)))
    return np.where(mask, f_u, np.nan), np.where(mask, f_v, np.nan)


def _derivative(f: FloatArray, after: BoolArray, axis: int) -> FloatArray:
    before, far_before, far_after = (shift(after, i, axis, False) for i in (-1, -2, 1))
    ahead = shift(f, 1, axis, 0.0) - f
    behind, far_behind, far_ahead = (shift(ahead, i, axis, 0.0) for i in (-1, -2, 1))
    return np.select(
        [after & before, after & far_after, before & far_before, after, before],
        [
            0.5 * (ahead + behind),
            1.5 * ahead - 0.5 * far_ahead,
            1.5 * behind - 0.5 * far_behind,
            ahead,
            behind,
        ],
        0.0,
    )


def _apply_over(
    f: FloatArray, mask: BoolArray, cuts: BoolArray | None, kind: int
) -> FloatArray:
    return Differences(links(mask, cuts), kind).apply(np.where(mask, f, 0.0))


def central_gradient(
    f: FloatArray, mask: BoolArray, cuts: BoolArray | None = None
) -> FloatArray:
    """The gradient as the energy has it, (2, H, W): from two pixels beside a missing step."""
    return _apply_over(f, mask, cuts, CENTRAL)[::2]


def forward_gradient(
    f: FloatArray, mask: BoolArray, cuts: BoolArray | None = None
) -> FloatArray:
    """Differences to the right and lower neighbour, (2, H, W), per pixel; 0 where there is no such step."""
    return _apply_over(f, mask, cuts, FIRST)[::2]


def differences(
    f: FloatArray, mask: BoolArray, cuts: BoolArray | None = None
) -> FloatArray:
    """Differences to the right, the lower, the left and the upper neighbour, (4, H, W), over √2.

    Their norm is the gradient's, whichever way the map is turned; 0 where there is no such step.
    """
    right, down = forward_gradient(f, mask, cuts)
    left, up = shift(right, -1, 1, 0.0), shift(down, -1, 0, 0.0)
    return np.stack([right, down, left, up]) / ROOT_2


def hessian(f: FloatArray, mask: BoolArray, cuts: BoolArray | None = None) -> FloatArray:
    """Second differences (6, H, W), such that their norm is the Hessian's Frobenius norm.

    f_uu, f_vv, and f_uv/√2 of the squares to the four corners of each pixel, per pixel squared; 0 where the
    stencil (three in a row, or a square of four) is not valid.
    """
    f_uu, square, f_vv = _apply_over(f, mask, cuts, SECOND)
    right = [0.5 * square, 0.5 * shift(square, -1, 1, 0.0)]
    return np.stack([f_uu, f_vv, *right, *(shift(each, -1, 0, 0.0) for each in right)])
