"""Solving the normal equations of a Gauss-Newton step in a time proportional to the pixels.

Conjugate gradients solve them, preconditioned by one V-cycle: Gauss-Seidel sweeps forwards, a
coarse correction, sweeps backwards. Coarse levels are the same equations written down on a grid
of half the pixels, from averaged coefficients (Briggs, Henson, McCormick, "A multigrid
tutorial", 2000, chapters 3 and 10).

A cycle is in single precision: it is a guess that conjugate gradients, in double precision, put right.
In single precision the matrix of a large frame may not be positive definite.
On a grid, every second band of rows is swept at once (`numerics.threads`), and then those between.

Vectors are padded (see `numerics.compiled`) and zero outside the mask, as the matrices are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from endolab.depth.normal_equations import CENTRE, EE, SE, SEE, SS, SSE, SW, Coefficients, E, S, Structure
from endolab.numerics.arrays import ByteArray, FloatArray, RealArray, SingleArray, Span
from endolab.numerics.compiled import PAD, kernel
from endolab.numerics.threads import ROWS, on_cores, rows_within

COARSEST = 64  # pixels; there the equations are swept until they are solved
SETTLING = 20  # sweeps down and up
SWEEPS = 2  # on finer grids, before and after the coarser one; with one, torn surfaces take twice the steps


@kernel
def _from_other_rows(m: RealArray, x: RealArray, i: int, out: RealArray) -> None:
    """Row i of the matrix times x, but for what comes from row i; out[j] is of column PAD + j.

    In this and the following loops, j begins at 0 and what is added to it is not negative: so they compile to
    instructions that take many pixels at once. Views of rows would do as well, but counting who holds a view
    takes longer than a row, and the cores wait for one another to count.
    """
    for j in range(x.shape[1] - 2 * PAD):
        out[j] = (
            m[S, i, j + 2] * x[i + 1, j + 2]
            + m[SS, i, j + 2] * x[i + 2, j + 2]
            + m[SE, i, j + 2] * x[i + 1, j + 3]
            + m[SW, i, j + 2] * x[i + 1, j + 1]
            + m[SEE, i, j + 2] * x[i + 1, j + 4]
            + m[SSE, i, j + 2] * x[i + 2, j + 3]
            + m[S, i - 1, j + 2] * x[i - 1, j + 2]
            + m[SS, i - 2, j + 2] * x[i - 2, j + 2]
            + m[SE, i - 1, j + 1] * x[i - 1, j + 1]
            + m[SW, i - 1, j + 3] * x[i - 1, j + 3]
            + m[SEE, i - 1, j] * x[i - 1, j]
            + m[SSE, i - 2, j + 1] * x[i - 2, j + 1]
        )


@kernel
def _row_times(m: RealArray, x: RealArray, i: int, out: RealArray) -> None:
    """Row i of the matrix times x; out[j] is of column PAD + j."""
    _from_other_rows(m, x, i, out)
    for j in range(x.shape[1] - 2 * PAD):
        here = (
            m[CENTRE, i, j + 2] * x[i, j + 2] + m[E, i, j + 2] * x[i, j + 3] + m[EE, i, j + 2] * x[i, j + 4]
        )
        out[j] += here + m[E, i, j + 1] * x[i, j + 1] + m[EE, i, j] * x[i, j]


@on_cores(cost=0.3)
def _dots(rows: Span, a: FloatArray, b: RealArray, out: FloatArray) -> None:
    """Scalar products of the rows of two vectors, by four sums, so that none waits for the last."""
    width = a.shape[1]
    whole = width - width % 4
    for i in range(rows[0], rows[1]):
        one = two = three = four = 0.0
        for j in range(0, whole, 4):
            one += a[i, j] * b[i, j]
            two += a[i, j + 1] * b[i, j + 1]
            three += a[i, j + 2] * b[i, j + 2]
            four += a[i, j + 3] * b[i, j + 3]
        for j in range(whole, width):
            one += a[i, j] * b[i, j]
        out[i] = (one + two) + (three + four)


def dot(a: FloatArray, b: RealArray) -> float:
    """Scalar product of two vectors, the same on any number of threads."""
    products = np.empty(len(a))
    _dots(a, b, products)
    return float(products.sum())


@on_cores(cost=2)
def _combine(
    rows: Span,
    out: RealArray,
    m: RealArray,
    x: RealArray,
    share: float,
    b: RealArray,
    sign: float,
) -> None:
    """out = share · b + sign · M x."""
    first, last = rows_within(rows, PAD, x.shape[0] - PAD)
    row = np.empty(x.shape[1] - 2 * PAD, x.dtype)
    kept, times = x.dtype.type(share), x.dtype.type(sign)
    for i in range(first, last):
        _row_times(m, x, i, row)
        for j in range(row.size):
            out[i, j + 2] = kept * b[i, j + 2] + times * row[j]


def multiply(m: FloatArray, x: FloatArray, out: FloatArray) -> None:
    """out = M x."""
    _combine(out, m, x, 0.0, x, 1.0)


@kernel
def _sweep_rows(
    m: SingleArray, inverse: SingleArray, x: SingleArray, b: SingleArray, first: int, last: int, step: int
) -> None:
    """Gauss-Seidel on some rows in turn; in a row every third column at once: they are not coupled.

    `step` 1 goes down the rows and from left to right, -1 back: the adjoint.
    """
    count = x.shape[1] - 2 * PAD
    rest, new = np.empty(count, x.dtype), np.empty(count, x.dtype)
    chosen = np.zeros((3, count), x.dtype)
    for column in range(3):
        chosen[column, column::3] = 1
    start, stop = (first, last) if step > 0 else (last - 1, first - 1)
    for i in range(start, stop, step):
        _from_other_rows(m, x, i, rest)
        for turn in range(3):
            now = turn if step > 0 else 2 - turn
            for j in range(count):
                right = m[E, i, j + 2] * x[i, j + 3] + m[EE, i, j + 2] * x[i, j + 4]
                left = m[E, i, j + 1] * x[i, j + 1] + m[EE, i, j] * x[i, j]
                solved = (b[i, j + 2] - rest[j] - right - left) * inverse[i, j + 2]
                new[j] = x[i, j + 2] + chosen[now, j] * (solved - x[i, j + 2])
            for j in range(count):
                x[i, j + 2] = new[j]


@on_cores(cost=2, turns=2)
def _sweep(
    rows: Span, turns: Span, x: SingleArray, m: SingleArray, inverse: SingleArray, b: SingleArray, step: int
) -> None:
    """`SWEEPS` sweeps over every second band, then over those between, which see what these have become.

    `step` 1 goes forwards, -1 back: the adjoint.
    """
    for turn in range(turns[0], turns[1]):
        odd = turn if step > 0 else 1 - turn
        for start in range(rows[0] + odd * ROWS, rows[1], 2 * ROWS):
            first, last = rows_within((start, start + ROWS), PAD, x.shape[0] - PAD)
            for _ in range(SWEEPS):  # while the band's part of the matrix is near the core
                _sweep_rows(m, inverse, x, b, first, last, step)


@kernel
def _settle(rows: Span, x: SingleArray, m: SingleArray, inverse: SingleArray, b: SingleArray) -> None:
    """Sweep until the coarsest grid is solved, as good as; forwards first, backwards last."""
    for _ in range(SETTLING):
        for step in (1, -1):
            _sweep_rows(m, inverse, x, b, rows[0], rows[1], step)


@on_cores(cost=0.3)
def _conjugate(rows: Span, z: SingleArray, share: float, direction: FloatArray) -> None:
    """direction = z + share · direction."""
    for i in range(rows[0], rows[1]):
        for j in range(z.shape[1]):
            direction[i, j] = z[i, j] + share * direction[i, j]


@on_cores(cost=0.8)
def _proceed(
    rows: Span,
    direction: FloatArray,
    length: float,
    product: FloatArray,
    x: FloatArray,
    r: FloatArray,
    b: SingleArray,
) -> None:
    """x += length · direction, r -= length · product, and r once more, in b."""
    for i in range(rows[0], rows[1]):
        for j in range(x.shape[1]):
            x[i, j] += length * direction[i, j]
        for j in range(x.shape[1]):
            r[i, j] -= length * product[i, j]
            b[i, j] = r[i, j]


@on_cores(cost=4)
def _shorten(rows: Span, m: FloatArray, out: SingleArray) -> None:
    """The matrix in single precision."""
    for i in range(rows[0], rows[1]):
        for k in range(9):
            for j in range(m.shape[2]):
                out[k, i, j] = m[k, i, j]


@on_cores(cost=0.3)
def _invert_diagonal(rows: Span, m: SingleArray, active: ByteArray, out: SingleArray) -> None:
    """One over the matrix's diagonal, 0 where a pixel is held at 0."""
    for i in range(rows[0], rows[1]):
        for j in range(m.shape[2]):
            centre = m[CENTRE, i, j]
            out[i, j] = 1 / centre if active[i, j] and centre > 0 else 0.0


@dataclass(frozen=True)
class _Level:
    """One grid in single precision: its matrix, and room for a right-hand side, a solution and a residual."""

    structure: Structure
    matrix: SingleArray
    inverse: SingleArray  # of the diagonal; 0 where a pixel is held at 0
    x: SingleArray
    b: SingleArray
    r: SingleArray

    @classmethod
    def on(cls, structure: Structure) -> _Level:
        """Make room."""
        shape = structure.active.shape
        inverse, x, b, r = np.zeros((4, *shape), np.float32)
        return cls(structure, np.empty((9, *shape), np.float32), inverse, x, b, r)


class Multigrid:
    """V-cycles for one set of normal equations, whose `damping` is that of `Coefficients.matrix`.

    `old` is a multigrid of other coefficients on the same structure, whose memory is used; it is spoilt.
    """

    def __init__(
        self, coefficients: Coefficients, damping: float = 1e-3, old: Multigrid | None = None
    ) -> None:
        if old is not None and old.levels[0].structure is not coefficients.structure:
            old = None
        self.matrix: FloatArray = coefficients.matrix(damping, None if old is None else old.matrix)
        self.room: FloatArray = np.empty((4, *coefficients.active.shape)) if old is None else old.room
        self.levels: list[_Level] = [_Level.on(coefficients.structure)] if old is None else old.levels
        self.coarse: list[SingleArray] = [] if old is None else old.coarse  # maps of `Coefficients`
        depth = 0
        while True:
            level = self.levels[depth]
            _shorten(self.matrix if depth == 0 else coefficients.matrix(damping), level.matrix)
            _invert_diagonal(level.matrix, coefficients.active, level.inverse)
            if coefficients.structure.pixels <= COARSEST:
                break
            if depth == len(self.coarse):
                below = coefficients.structure.coarser
                self.levels.append(_Level.on(below))
                parts = np.zeros((len(coefficients.parts), *below.active.shape), np.float32)
                self.coarse.append(parts)
            coefficients, depth = coefficients.coarser(self.coarse[depth]), depth + 1

    def _cycle(self, depth: int = 0) -> None:
        """One V-cycle: x of a level from its right-hand side b, starting at nothing."""
        at = self.levels[depth]
        at.x[:] = 0.0
        if depth == len(self.levels) - 1:
            _settle((PAD, len(at.x) - PAD), at.x, at.matrix, at.inverse, at.b)
            return
        below = self.levels[depth + 1]
        _sweep(at.x, at.matrix, at.inverse, at.b, 1)
        _combine(at.r, at.matrix, at.x, 1.0, at.b, -1.0)  # what is left of b
        at.structure.way.adjoint(at.r, below.structure.active, below.b)
        self._cycle(depth + 1)
        at.structure.way.add(below.x, at.x)
        _sweep(at.x, at.matrix, at.inverse, at.b, -1)

    def solve(self, b: FloatArray, tolerance: float, most: int) -> tuple[FloatArray, int, float]:
        """Conjugate gradients on M x = b, until the preconditioned residual is `tolerance` of what it was.

        A residual may be that of a few pixels at first, beside which all others look solved. So what it
        promises still, r·M⁻¹r, must also be no more than this share of what x has, b·x. Returns x, which
        the next call overwrites (0 where a pixel is not active), the steps that were taken, `most` at most,
        and that share.
        """
        top = self.levels[0]
        x, direction, product, r = self.room
        self.room[:3] = 0.0
        r[:] = b
        top.b[:] = b
        start, last, done = 0.0, 1.0, 0.0
        for step in range(most + 1):
            self._cycle()
            now = max(dot(r, top.x), 0.0)
            start = now if step == 0 else start
            left = now / done if done > 0 else np.inf if now > 0 else 0.0
            if (now <= tolerance**2 * start and left <= tolerance) or step == most:
                break
            _conjugate(top.x, now / last if step else 0.0, direction)
            last = now
            multiply(self.matrix, direction, product)
            curved = dot(direction, product)
            if curved <= 0:  # nothing is left but rounding
                break
            length = now / curved
            done += length * now
            _proceed(direction, length, product, x, r, top.b)
        return x, step, left
