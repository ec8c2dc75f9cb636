"""The matrix of a Gauss-Newton step, and the same on half the pixels.

With J, W and r the slopes, weights and residuals of the data, ξ the regularised map, X its slope by v, D the
differences and Q their weights, the step δ solves

    (Jᵀ W J + X Dᵀ Q D X + C) δ = -Jᵀ W r - X Dᵀ Q D ξ,

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

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from endolab.numerics.arrays import ByteArray, FloatArray, IntArray, Span
from endolab.numerics.compiled import (
    PAD,
    active_blocks,
    clear_row,
    inner,
    kernel,
)
from endolab.numerics.stencils import DOWN, RIGHT, square, step_means, steps
from endolab.numerics.threads import BAND_ROWS, on_cores, rows_within
from endolab.solvers.cuts import coarser_links, largest_fragments
from endolab.solvers.galerkin import Rows
from endolab.solvers.interpolation import Interpolation
from endolab.solvers.problem import FIRST

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
# Which of the six of `numerics.stencils` are in the three differences, for each of `problem.REGULARISERS`;
# those of a row of J, which comes fourth, are the first five.
CROSS = range(5)
STENCILS: list[list[Sequence[int]]] = [
    [(0, 1), (), (0, 3)],
    [(0, 1, 2), (0, 1, 3, 5), (0, 3, 4)],
]


class Form(NamedTuple):
    """A regulariser's kind, the entries of its `STENCILS` as (term, pixel), and which products they have."""

    kind: int
    entries: IntArray
    products: IntArray

    @classmethod
    def of(cls, kind: int) -> Form:
        """List them: the two pixels, the first of which holds the entry, the entry, and the term."""
        stencils = STENCILS[kind]
        products = []
        for k in range(len(DOWN)):
            for other in range(len(DOWN)):
                step = (DOWN[other] - DOWN[k], RIGHT[other] - RIGHT[k])
                if step not in OFFSETS:
                    continue
                entry = OFFSETS.index(step)
                for term, pixels in enumerate([*stencils, CROSS]):
                    if k in pixels and other in pixels:
                        products.append((k, other, entry, term))
        entries = [(term, k) for term in range(3) for k in stencils[term]]
        return cls(kind, np.array(entries), np.array(products))


FORMS = [Form.of(kind) for kind in range(len(STENCILS))]
# The maps of `Coefficients`, and how many there are.
BY_V, BY_U, BY_W, WEIGHT, SLOPE, SLOPE_DAMPING_U, SLOPE_DAMPING_W, SMOOTHNESS, PARTS = (
    range(9)
)


@kernel
def _add_products(
    left: FloatArray, right: FloatArray, products: IntArray, i: int, m: FloatArray
) -> None:
    """Add products of the six pixels' numbers to their entries of m."""
    for n in range(len(products)):
        k, other, entry, term = products[n]
        row = i + DOWN[k]
        column = PAD + RIGHT[k]
        for j in range(left.shape[2]):
            m[entry, row, column + j] += left[term, k, j] * right[term, other, j]


@kernel
def _data_row(
    parts: FloatArray,
    link: ByteArray,
    i: int,
    damping: float,
    t: FloatArray,
    qt: FloatArray,
    m: FloatArray,
) -> None:
    """Write J of a row and W J; add the damping, and the squared differences of the step itself."""
    count = t.shape[2]
    for j in range(count):
        right, left, _, _ = steps(link, i, j + 2)
        mean_u, _ = step_means(link, i, j + 2)
        u = parts[BY_U, i, j + 2] * mean_u
        t[3, 1, j] = u * right
        t[3, 2, j] = -u * left
    for j in range(count):
        _, _, south, north = steps(link, i, j + 2)
        _, mean_w = step_means(link, i, j + 2)
        w = parts[BY_W, i, j + 2] * mean_w
        t[3, 3, j] = w * south
        t[3, 4, j] = -w * north
    by_v = parts[BY_V, i]
    weight = parts[WEIGHT, i]
    for j in range(count):
        t[3, 0, j] = by_v[j + 2] - (t[3, 1, j] + t[3, 2, j]) - (t[3, 3, j] + t[3, 4, j])
    for k in range(5):
        for j in range(count):
            qt[3, k, j] = weight[j + 2] * t[3, k, j]
    for j in range(count):
        m[CENTRE, i, j + 2] += damping * weight[j + 2] * by_v[j + 2] * by_v[j + 2]
    _add_springs(parts[SLOPE_DAMPING_U], link[0], i, 0, 1, m, E)
    _add_springs(parts[SLOPE_DAMPING_W], link[1], i, 1, 0, m, S)


@kernel
def _add_springs(
    damping: FloatArray,
    link: ByteArray,
    i: int,
    down: int,
    right: int,
    m: FloatArray,
    entry: int,
) -> None:
    """Add squared differences of a step between a row's pixels and their neighbours down or right."""
    start = PAD + right
    count = link.shape[1] - 2 * PAD
    spring = np.empty(count)
    for j in range(count):
        both = damping[i, j + PAD] + damping[i + down, j + start]
        spring[j] = 0.5 * float(link[i, j + PAD]) * both
    for j in range(count):
        m[CENTRE, i, j + PAD] += spring[j]
        m[entry, i, j + PAD] -= spring[j]
    for j in range(count):
        m[CENTRE, i + down, j + start] += spring[j]


@kernel
def _stencils_row(link: ByteArray, kind: int, i: int, t: FloatArray) -> None:
    """Weights of the six pixels for the gradient or the second differences: those in its `STENCILS`."""
    own = -1.0 if kind == FIRST else -2.0
    for j in range(t.shape[2]):
        right, left, south, north = steps(link, i, j + 2)
        along = right if kind == FIRST else right * left
        down = south if kind == FIRST else south * north
        t[0, 0, j] = own * along
        t[0, 1, j] = along
        t[0, 2, j] = along
        t[2, 0, j] = own * down
        t[2, 3, j] = down
        t[2, 4, j] = down
    if kind == FIRST:
        return
    root2 = np.sqrt(2.0)
    for j in range(t.shape[2]):
        joined = root2 * square(link, i, j + 2)
        t[1, 0, j] = joined
        t[1, 1, j] = -joined
        t[1, 3, j] = -joined
        t[1, 5, j] = joined


@kernel
def _smooth_row(
    parts: FloatArray,
    link: ByteArray,
    form: Form,
    i: int,
    t: FloatArray,
    qt: FloatArray,
) -> None:
    """Write D X of a row and Q D X."""
    kind, entries, _ = form
    _stencils_row(link, kind, i, t)
    count = t.shape[2]
    for n in range(len(entries)):
        term, k = entries[n]
        row = i + DOWN[k]
        column = PAD + RIGHT[k]
        for j in range(count):
            t[term, k, j] *= parts[SLOPE, row, column + j]
    here = parts[SMOOTHNESS, i]
    below = parts[SMOOTHNESS, i + 1]
    for n in range(len(entries)):
        term, k = entries[n]
        for j in range(count):
            weight = here[j + 2]
            if term == 1:  # a square has a quarter of the weight of each of its pixels
                weight = 0.25 * ((weight + below[j + 3]) + (here[j + 3] + below[j + 2]))
            qt[term, k, j] = weight * t[term, k, j]


@on_cores(cost=10, turns=3)
def _assemble(
    rows: Span,
    turns: Span,
    m: FloatArray,
    parts: FloatArray,
    link: ByteArray,
    form: Form,
    damping: float,
) -> None:
    """Write the normal equations Jᵀ W J + X Dᵀ Q D X into m; `parts` are those of `Coefficients`.

    A pixel's row of J is a + b·∇ with the mean of the differences that `link` allows, D is the
    forward gradient or the Hessian, X the slope of ξ. Squared differences of the step itself come in
    with the damping of slopes, a² W once more by `damping`.
    """
    products = form[2]
    count = m.shape[2] - 2 * PAD
    t = np.empty((4, len(DOWN), count))
    qt = np.empty((4, len(DOWN), count))
    for turn in range(turns[0], turns[1]):
        if turn == 0:
            for i in range(rows[0], rows[1]):
                for k in range(len(m)):
                    clear_row(m[k, i])
            continue
        # Every second band: what a row adds to its neighbours' must not meet.
        odd = turn - 1
        for start in range(rows[0] + odd * BAND_ROWS, rows[1], 2 * BAND_ROWS):
            first, last = rows_within((start, start + BAND_ROWS), PAD, m.shape[1] - PAD)
            for i in range(first, last):
                _smooth_row(parts, link, form, i, t, qt)
                _data_row(parts, link, i, damping, t, qt, m)
                _add_products(t, qt, products, i, m)


@dataclass(frozen=True)
class Structure:
    """What of normal equations depends on mask and cuts alone, here and on coarser grids; padded arrays."""

    active: ByteArray
    link: ByteArray
    uncut_links: ByteArray  # the links that there would be without cuts: the same array where nothing is cut
    kind: int  # which of `problem.REGULARISERS`

    @property
    def pixels(self) -> int:
        """Rows times columns, without the padding."""
        return int(inner(self.active).size)

    @cached_property
    def main(self) -> ByteArray:
        """Pixels for which the coarser grid's blocks stand, see `cuts`; all, where nothing is cut."""
        return largest_fragments(self.active, self.link, self.uncut_links)

    @cached_property
    def coarser(self) -> Structure:
        """The same on half the pixels."""
        link, uncut_links = coarser_links(self.main, self.link, self.uncut_links)
        active = active_blocks(self.main)
        return Structure(active, link, uncut_links, self.kind)

    @cached_property
    def way(self) -> Interpolation:
        """Linear interpolation from the coarser grid."""
        return Interpolation.between(self.coarser, self)

    @cached_property
    def rows(self) -> Rows:
        """Its rows beside cuts and rims."""
        return Rows.of(self.way, self.coarser.active.shape[1])


@dataclass(frozen=True)
class Coefficients:
    """What the normal equations are made of: `PARTS` padded maps, and what they are on."""

    parts: FloatArray
    structure: Structure

    @property
    def active(self) -> ByteArray:
        """Pixels that the equations are of."""
        return self.structure.active

    @property
    def by_v(self) -> FloatArray:
        """a of J's rows a + b·∇."""
        return self.parts[BY_V]

    @property
    def by_v_u(self) -> FloatArray:
        """b of J, along rows."""
        return self.parts[BY_U]

    @property
    def by_v_v(self) -> FloatArray:
        """b of J, along columns."""
        return self.parts[BY_W]

    @property
    def weight(self) -> FloatArray:
        """W."""
        return self.parts[WEIGHT]

    def matrix(self, damping: float, out: FloatArray | None = None) -> FloatArray:
        """Matrix of the normal equations; a share `damping` of a² W is added to its diagonal."""
        on = self.structure
        m = np.empty((SEE, *self.active.shape)) if out is None else out
        _assemble(m, self.parts, on.link, FORMS[on.kind], damping)
        return m
