"""Differences of maps over links: apply, adjoint, and the rows that they bring to normal equations.

A difference of a pixel is a sum over it and its neighbours, t₀ x₀ + t₁ x₁ + ..., whose weights t are 0 where
a link is missing (`derivatives.links`), as over a cut. There are three kinds, of up to three terms each:

    CENTRAL    the mean of the differences that there are, along the row and along the column
    FIRST      the difference to the right and to the pixel below
    SECOND     f_uu, √2 f_uv of the square to the lower right, f_vv

Compiled loops take a row of weights at a time (`stencil_row`), of padded maps, see `compiled`; `Differences`
is the same for whole maps. With K x the differences, ⟨K x, y⟩ = ⟨x, Kᵀ y⟩.
"""

from dataclasses import dataclass

import numpy as np

from endolab.numerics.arrays import BoolArray, ByteArray, FloatArray, IntArray, Span
from endolab.numerics.compiled import PAD, inner, kernel, pad_maps
from endolab.numerics.threads import on_cores, rows_within

# A pixel and its neighbours: right, left, below, above and lower right.
DOWN = (0, 0, 0, 1, -1, 1)
RIGHT = (0, 1, -1, 0, 0, 1)
FIRST, SECOND, CENTRAL = range(3)
# Of each kind, which weights are not 0 everywhere: (term, neighbour).
ENTRIES = [
    np.array([(0, 0), (0, 1), (2, 0), (2, 3)]),
    np.array(
        [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 3), (1, 5), (2, 0), (2, 3), (2, 4)]
    ),
    np.array([(0, 0), (0, 1), (0, 2), (2, 0), (2, 3), (2, 4)]),
]


@kernel
def stencil_row(link: ByteArray, kind: int, i: int, t: FloatArray) -> None:
    """Write the weights of a row's differences, (3, 6, W); those that are not of its `ENTRIES` stay."""
    right = t[0, 1]
    left = t[0, 2]
    south = t[2, 3]
    north = t[2, 4]
    for j in range(right.size):
        right[j] = link[0, i, j + PAD]
        left[j] = link[0, i, j + PAD - 1]
        south[j] = link[1, i, j + PAD]
        north[j] = link[1, i - 1, j + PAD]
    if kind == CENTRAL:
        for j in range(right.size):
            mean = 1 - 0.5 * (right[j] * left[j])
            right[j] *= mean
            left[j] *= -mean
            mean = 1 - 0.5 * (south[j] * north[j])
            south[j] *= mean
            north[j] *= -mean
    elif kind == FIRST:
        left[:] = 0.0
        north[:] = 0.0
    else:
        for j in range(right.size):
            right[j] = left[j] = right[j] * left[j]
            south[j] = north[j] = south[j] * north[j]
    for j in range(right.size):
        t[0, 0, j] = -(right[j] + left[j])
        t[2, 0, j] = -(south[j] + north[j])
    if kind != SECOND:
        return
    root2 = np.sqrt(2.0)
    for j in range(t.shape[2]):
        upper = float(link[0, i, j + PAD]) * link[1, i, j + PAD]
        square = root2 * (upper * link[0, i + 1, j + PAD] * link[1, i, j + PAD + 1])
        t[1, 0, j] = square
        t[1, 1, j] = -square
        t[1, 3, j] = -square
        t[1, 5, j] = square


@kernel
def apply_row(t: FloatArray, kind: int, x: FloatArray, i: int, y: FloatArray) -> None:
    """Write the differences of a row of x, y = K x, (3, W): weights of a term sum to 0."""
    for j in range(y.shape[1]):
        here = x[i, j + PAD]
        right = t[0, 1, j] * (x[i, j + PAD + 1] - here)
        y[0, j] = right + t[0, 2, j] * (x[i, j + PAD - 1] - here)
        below = t[2, 3, j] * (x[i + 1, j + PAD] - here)
        y[2, j] = below + t[2, 4, j] * (x[i - 1, j + PAD] - here)
    if kind == SECOND:
        for j in range(y.shape[1]):
            upper = x[i, j + PAD] - x[i, j + PAD + 1]
            lower = x[i + 1, j + PAD] - x[i + 1, j + PAD + 1]
            y[1, j] = t[1, 0, j] * (upper - lower)


@kernel
def adjoint_row(
    t: FloatArray, entries: IntArray, y: FloatArray, i: int, rows: Span, x: FloatArray
) -> None:
    """Add Kᵀ y of a row to these rows of x."""
    for n in range(len(entries)):
        term, k = entries[n]
        row = i + DOWN[k]
        column = PAD + RIGHT[k]
        if rows[0] <= row < rows[1]:
            for j in range(y.shape[1]):
                x[row, column + j] += t[term, k, j] * y[term, j]


@on_cores(cost=10)
def _apply(rows: Span, y: FloatArray, x: FloatArray, link: ByteArray, kind: int) -> None:
    t = np.zeros((3, len(DOWN), x.shape[1] - 2 * PAD))
    first, last = rows_within(rows, PAD, x.shape[0] - PAD)
    for i in range(first, last):
        stencil_row(link, kind, i, t)
        apply_row(t, kind, x, i, y[:, i, PAD:-PAD])


@on_cores(cost=10)
def _adjoint(
    rows: Span, x: FloatArray, y: FloatArray, link: ByteArray, kind: int, entries: IntArray
) -> None:
    x[rows[0] : rows[1]] = 0.0
    t = np.zeros((3, len(DOWN), x.shape[1] - 2 * PAD))
    first, last = rows_within((rows[0] - 1, rows[1] + 1), PAD, x.shape[0] - PAD)
    for i in range(first, last):
        stencil_row(link, kind, i, t)
        adjoint_row(t, entries, y[:, i, PAD:-PAD], i, rows, x)


@dataclass(frozen=True)
class Differences:
    """K of maps (H, W) over `links` (2, H, W), of a kind."""

    links: BoolArray
    kind: int

    def apply(self, x: FloatArray) -> FloatArray:
        """K x, (3, H, W)."""
        x = pad_maps(np.asarray(x, dtype=np.float64))
        y = np.zeros((3, *x.shape))
        _apply(y, x, pad_maps(self.links.view(np.int8)), self.kind)
        return np.asarray(inner(y))

    def adjoint(self, y: FloatArray) -> FloatArray:
        """Kᵀ y, (H, W), of y (3, H, W)."""
        y = pad_maps(y)
        x = np.zeros(y.shape[1:])
        _adjoint(x, y, pad_maps(self.links.view(np.int8)), self.kind, ENTRIES[self.kind])
        return np.asarray(inner(x))

    def norm(self, y: FloatArray) -> FloatArray:
        """|K x| of each pixel, (H, W): a square's difference counts a quarter in each of its pixels."""
        along, square, down = pad_maps(y) ** 2
        square = square + np.roll(square, 1, axis=0)
        square = 0.25 * (square + np.roll(square, 1, axis=1))
        return np.asarray(inner(np.sqrt(along + square + down)))
