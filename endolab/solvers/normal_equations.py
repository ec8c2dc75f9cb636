"""The matrix of a Gauss-Newton step, and the same on half the pixels.

With J, W and r the slopes, weights and residuals of the data, ξ the regularised map, X its slope by v, K the
differences (`numerics.stencils`) and Q their weights, the step δ solves

    (Jᵀ W J + X Kᵀ Q K X + C) δ = -Jᵀ W r - X Kᵀ Q K ξ,

C being what is charged for slopes and sizes of the step itself. So a pixel (*) is coupled to the twelve that
the squared central differences and the squared Hessian reach; on coarser grids (`galerkin`), to all that
are two rows and two columns away at most. The matrix is symmetric, so that a pixel holds its own entry and
those towards later pixels: seven numbers, or with those in brackets thirteen.

      ·      ·     o     ·      ·
      ·      o     o     o      ·
      o      o     *     E      EE
    (SWW)    SW    S     SE   (SEE)
    (SW2)  (SSW)   SS  (SSE)  (SE2)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from endolab.numerics.arrays import ByteArray, FloatArray, IntArray, Span
from endolab.numerics.compiled import PAD, clear_row, kernel
from endolab.numerics.stencils import (
    CENTRAL,
    DOWN,
    ENTRIES,
    ENTRY_COUNT,
    RIGHT,
    stencil_row,
)
from endolab.numerics.threads import on_cores, rows_within
from endolab.solvers.interpolation import Structure

# A pixel's own entry and those towards later pixels, and how many rows and columns away these are.
CENTRE, E, EE, S, SS, SE, SW, SEE, SSE, SWW, SSW, SE2, SW2 = range(13)
OFFSETS: tuple[tuple[int, int], ...] = (
    (0, 0),
    (0, 1),
    (0, 2),
    (1, 0),
    (2, 0),
    (1, 1),
    (1, -1),
)
OFFSETS += ((1, 2), (2, 1), (1, -2), (2, -1), (2, 2), (2, -2))  # of coarser grids alone
# The maps of `Coefficients`, and how many there are.
BY_V, BY_U, BY_W, WEIGHT, SLOPE, SLOPE_DAMPING_U, SLOPE_DAMPING_W, SMOOTHNESS, PARTS = (
    range(9)
)
# What is squared, as rows of weights: the three terms of K, J, and links along rows and columns.
ALONG_ROWS = 4
ALONG_COLUMNS = 5


@cache
def products_of(kind: int) -> IntArray:
    """Of each term, which two neighbours bring a product to which entry: (term, first, other, entry)."""
    pixels: list[set[int]] = [set() for _ in range(6)]
    for term, k in ENTRIES[: ENTRY_COUNT[kind]]:
        pixels[term].add(int(k))
    pixels[3] = {int(k) for _, k in ENTRIES[: ENTRY_COUNT[CENTRAL]]}
    pixels[ALONG_ROWS] = {0, 1}
    pixels[ALONG_COLUMNS] = {0, 3}
    return np.array(
        [
            (term, k, other, OFFSETS.index(step))
            for term, near in enumerate(pixels)
            for k in sorted(near)
            for other in sorted(near)
            if (step := (DOWN[other] - DOWN[k], RIGHT[other] - RIGHT[k])) in OFFSETS
        ]
    )


@kernel
def _weigh_row(
    parts: FloatArray,
    link: ByteArray,
    kind: int,
    i: int,
    t: FloatArray,
    qt: FloatArray,
) -> None:
    """Write the six terms of a row, K X, J and links, and the same weighted by Q, W and C."""
    count = t.shape[2]

    # J = a + b ∇
    stencil_row(link, CENTRAL, i, t)
    for k in range(1, 5):
        term = 0 if k < 3 else 2
        part = BY_U if k < 3 else BY_W
        for j in range(count):
            t[3, k, j] = parts[part, i, PAD + j] * t[term, k, j]
    for j in range(count):
        own = parts[BY_V, i, PAD + j] - (t[3, 1, j] + t[3, 2, j])
        t[3, 0, j] = own - (t[3, 3, j] + t[3, 4, j])
    for k in range(5):
        for j in range(count):
            qt[3, k, j] = parts[WEIGHT, i, PAD + j] * t[3, k, j]

    # Links, whose weight is the mean of both pixels'
    for term, k in ((ALONG_ROWS, 1), (ALONG_COLUMNS, 3)):
        damping = parts[SLOPE_DAMPING_U + term - ALONG_ROWS]
        row = i + DOWN[k]
        column = PAD + RIGHT[k]
        for j in range(count):
            both = damping[i, PAD + j] + damping[row, column + j]
            qt[term, k, j] = 0.5 * float(link[term - ALONG_ROWS, i, PAD + j]) * both
        for j in range(count):
            qt[term, 0, j] = -qt[term, k, j]
            t[term, 0, j] = -1.0
            t[term, k, j] = 1.0

    # K X
    stencil_row(link, kind, i, t)
    here = parts[SMOOTHNESS, i]
    below = parts[SMOOTHNESS, i + 1]
    for n in range(ENTRY_COUNT[kind]):
        term, k = ENTRIES[n]
        row = i + DOWN[k]
        column = PAD + RIGHT[k]
        for j in range(count):
            t[term, k, j] *= parts[SLOPE, row, column + j]
        if term == 1:  # a square has a quarter of the weight of each of its pixels
            for j in range(count):
                weight = (here[j + 2] + below[j + 3]) + (here[j + 3] + below[j + 2])
                qt[term, k, j] = 0.25 * weight * t[term, k, j]
        else:
            for j in range(count):
                qt[term, k, j] = here[j + 2] * t[term, k, j]


@on_cores(cost=20)
def _assemble(
    rows: Span,
    m: FloatArray,
    parts: FloatArray,
    link: ByteArray,
    kind: int,
    products: IntArray,
    damping: float,
) -> None:
    """Write these rows of the normal equations into m; a² W comes in once more by `damping`."""
    count = m.shape[2] - 2 * PAD
    t = np.zeros((6, len(DOWN), count))
    qt = np.zeros((6, len(DOWN), count))
    for k in range(len(m)):
        for i in range(rows[0], rows[1]):
            clear_row(m[k, i])
    first, last = rows_within((rows[0] - 1, rows[1] + 1), PAD, m.shape[1] - PAD)
    for i in range(first, last):
        _weigh_row(parts, link, kind, i, t, qt)
        for n in range(len(products)):
            term, k, other, entry = products[n]
            row = i + DOWN[k]
            column = PAD + RIGHT[k]
            if rows[0] <= row < rows[1]:
                for j in range(count):
                    m[entry, row, column + j] += t[term, k, j] * qt[term, other, j]
        if rows[0] <= i < rows[1]:
            for j in range(PAD, PAD + count):
                by_v = parts[BY_V, i, j]
                m[CENTRE, i, j] += damping * parts[WEIGHT, i, j] * by_v * by_v


@dataclass(frozen=True, eq=False)
class Coefficients:
    """What the normal equations are made of: `PARTS` padded maps, and what they are on."""

    parts: FloatArray
    structure: Structure

    @property
    def active(self) -> ByteArray:
        """Pixels that the equations are of."""
        return self.structure.active

    def matrix(self, damping: float, out: FloatArray | None = None) -> FloatArray:
        """Matrix of the normal equations; a fraction `damping` of a² W is added to its diagonal."""
        on = self.structure
        m = np.empty((SEE, *self.active.shape)) if out is None else out
        kind = on.kind
        _assemble(m, self.parts, on.link, kind, products_of(kind), damping)
        return m
