"""Solving the normal equations M x = b of a Gauss-Newton step in a time proportional to the pixels.

Conjugate gradients solve them, preconditioned by one V-cycle. A coarse level has half the rows and columns
and the matrix Pᵀ M P (Briggs, Henson, McCormick, "A multigrid tutorial", 2000, chapters 3 and 10; see
`galerkin`); P is that of `interpolation`:

    all pixels     smooth                  smooth
    a quarter        Pᵀr ↘ smooth    smooth ↗ x + P x
    ...                        ↘    ↗
    at most 320                solve

Smoothing changes all pixels at once, so that a mirrored picture has the mirrored solution. It is Chebyshev's
of the fourth kind (Lottes, "Optimal polynomial smoothers for multigrid V-cycles", 2023) by rows' sums,

    x += s,   r -= M s,   s ← max(2n-1, 0)/(2n+3) s + (8n+4)/(2n+3) r / Σ_j |M_ij|,    n = 0, 1, 2, ...

Behind cuts little holds a surface: there rounding grew a million times within one solve. So all is in double
precision. Vectors are padded (see `numerics.compiled`) and zero outside the mask.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from endolab.numerics.arrays import ByteArray, FloatArray, Span
from endolab.numerics.compiled import PAD, copy_row, kernel
from endolab.numerics.threads import on_cores, rows_within
from endolab.solvers.galerkin import coarsen
from endolab.solvers.interpolation import Structure
from endolab.solvers.normal_equations import (
    CENTRE,
    EE,
    OFFSETS,
    SE,
    SE2,
    SEE,
    SS,
    SSE,
    SSW,
    SW,
    SW2,
    SWW,
    Coefficients,
    E,
    S,
)


@kernel
def _row_times(m: FloatArray, x: FloatArray, i: int, out: FloatArray) -> None:
    """Row i of the matrix times x; out[j] is of column PAD + j.

    In this and the following loops, j begins at 0 and what is added to it is not
    negative: so they compile to instructions that take many pixels at once. Views of rows would do as well,
    but counting who holds a view takes longer than a row, and the cores wait for one another to count.
    """
    count = x.shape[1] - 2 * PAD
    for j in range(count):
        around = _pair(m, E, x, i, j + 2) + _pair(m, S, x, i, j + 2)
        askew = _pair(m, SE, x, i, j + 2) + _pair(m, SW, x, i, j + 2)
        out[j] = (m[CENTRE, i, j + 2] * x[i, j + 2] + around) + askew
    for j in range(count):
        out[j] += _pair(m, EE, x, i, j + 2) + _pair(m, SS, x, i, j + 2)
    if len(m) <= SEE:
        return
    for j in range(count):
        wide = _pair(m, SEE, x, i, j + 2) + _pair(m, SWW, x, i, j + 2)
        steep = _pair(m, SSE, x, i, j + 2) + _pair(m, SSW, x, i, j + 2)
        out[j] += wide + steep
    for j in range(count):
        out[j] += _pair(m, SE2, x, i, j + 2) + _pair(m, SW2, x, i, j + 2)


@kernel
def _pair(m: FloatArray, entry: int, x: FloatArray, i: int, j: int) -> float:
    """An entry of the pixel (i, j), and the one that couples it to the pixel on the other side."""
    down, right = OFFSETS[entry]
    after = m[entry, i, j] * x[i + down, j + right]
    return after + m[entry, i - down, j - right] * x[i - down, j - right]


def dot(a: FloatArray, b: FloatArray) -> float:
    """Scalar product of two vectors, the same on any number of threads, as BLAS' is not."""
    return float(np.einsum("ij,ij->i", a, b).sum())


@on_cores(cost=2)
def multiply(rows: Span, m: FloatArray, x: FloatArray, out: FloatArray) -> None:
    """out = M x."""
    first, last = rows_within(rows, PAD, out.shape[0] - PAD)
    row = np.empty(out.shape[1] - 2 * PAD)
    for i in range(first, last):
        _row_times(m, x, i, row)
        copy_row(row, out[i, PAD:])


@on_cores(cost=20)
def _smooth(
    rows: Span,
    x: FloatArray,
    r: FloatArray,
    left: FloatArray,
    m: FloatArray,
    inverse: FloatArray,
    step: FloatArray,
    next_step: FloatArray,
    last_step: FloatArray,
    n: int,
) -> None:
    """Go the n-th step and the next in these rows of x; of the residual r, write what is left.

    The second step needs two rows of the first on either side: it follows at two rows' distance, while what
    it reads is still near. Cores write the rows between theirs both, the same numbers. The step that would
    follow becomes `last_step`.
    """
    count = x.shape[1] - 2 * PAD
    row = np.empty(count)
    residuals = np.empty((PAD + 1, count))  # after the first step
    kept = max(2 * n - 1, 0) / (2 * n + 3)
    added = (8 * n + 4) / (2 * n + 3)
    kept_next = (2 * n + 1) / (2 * n + 5)
    added_next = (8 * n + 12) / (2 * n + 5)
    first, last = rows_within((rows[0] - PAD, rows[1] + PAD), PAD, x.shape[0] - PAD)
    own_first, own_last = rows_within(rows, PAD, x.shape[0] - PAD)
    for i in range(first, own_last + PAD):
        if i < last:
            _row_times(m, step, i, row)
            k = i % (PAD + 1)
            for j in range(count):
                residuals[k, j] = r[i, j + 2] - row[j]
            for j in range(count):
                new = added * inverse[i, j + 2] * residuals[k, j]
                next_step[i, j + 2] = kept * step[i, j + 2] + new
        before = i - PAD
        if before >= own_first:
            _row_times(m, next_step, before, row)
            k = before % (PAD + 1)
            for j in range(count):
                row[j] = residuals[k, j] - row[j]
                left[before, j + 2] = row[j]
            for j in range(count):
                x[before, j + 2] += step[before, j + 2] + next_step[before, j + 2]
            for j in range(count):
                new = added_next * inverse[before, j + 2] * row[j]
                last_step[before, j + 2] = kept_next * next_step[before, j + 2] + new


@on_cores(cost=0.4)
def _add(rows: Span, x: FloatArray, length: float, y: FloatArray) -> None:
    """x += length · y."""
    for i in range(rows[0], rows[1]):
        for j in range(x.shape[1]):
            x[i, j] += length * y[i, j]


@on_cores(cost=10)
def _invert_sums(rows: Span, out: FloatArray, m: FloatArray, active: ByteArray) -> None:
    """The reciprocal of each row's absolute sum; 0 where a pixel is held at 0."""
    first, last = rows_within(rows, PAD, out.shape[0] - PAD)
    row = np.empty(out.shape[1] - 2 * PAD)
    for i in range(first, last):
        for j in range(row.size):
            row[j] = abs(m[CENTRE, i, j + 2])
        for entry in range(1, len(m)):
            down, right = OFFSETS[entry]
            column = max(
                PAD - right, 0
            )  # never less; but, told so, the loop takes many pixels at once
            for j in range(row.size):
                row[j] += abs(m[entry, i, j + 2]) + abs(m[entry, i - down, j + column])
        for j in range(row.size):
            out[i, j + 2] = 1 / row[j] if active[i, j + 2] and row[j] > 0 else 0.0


def _factorise(m: FloatArray, active: ByteArray) -> tuple[FloatArray, bool]:
    """Cholesky's factor of the matrix of a small grid's active pixels, as `scipy.linalg` has it."""
    i, j = np.nonzero(active)
    number = np.full(active.shape, -1)
    dense = np.zeros((i.size, i.size))
    number[i, j] = np.arange(i.size)
    for entry, (down, right) in enumerate(OFFSETS[: len(m)]):
        other = number[i + down, j + right]
        known = other >= 0
        row = number[i, j][known]
        column = other[known]
        dense[row, column] = dense[column, row] = m[entry, i, j][known]
    diagonal = np.diag(dense)
    # With this ridge islands that nothing holds let no rounding grow.
    dense[np.diag_indices(i.size)] = np.where(diagonal > 0, (1 + 1e-4) * diagonal, 1.0)
    return cho_factor(dense, overwrite_a=True, check_finite=False)


class _Level:
    """One grid: its pixels, its matrix of so many numbers a pixel, and room for vectors."""

    def __init__(self, structure: Structure, entries: int) -> None:
        shape = structure.active.shape
        self.structure = structure
        self.matrix = np.empty((entries, *shape))
        # Of the rows' sums of sizes; 0 where a pixel is held at 0
        self.inverse, self.x, self.b, self.r, self.left = np.zeros((5, *shape))
        self.steps = [np.zeros(shape) for _ in range(3)]  # of smoothing

    def begin(self) -> None:
        """Smooth x, from nothing; leaves in r what is left of b."""
        self.x[:] = 0.0
        np.multiply(self.inverse, self.b, out=self.steps[0])
        self.steps[0] *= 4 / 3
        _smooth(self.x, self.b, self.r, self.matrix, self.inverse, *self.steps, 1)

    def correct(self, coarse: FloatArray) -> None:
        """Add a coarser grid's correction, and smooth x."""
        self.steps[0][:] = 0.0
        self.structure.interpolation.add(coarse, self.steps[0])
        _smooth(self.x, self.r, self.left, self.matrix, self.inverse, *self.steps, 0)
        self.x += self.steps[2]


class Multigrid:
    """V-cycles for one set of normal equations, whose `damping` is that of `Coefficients.matrix`.

    `old` is a multigrid of other coefficients on the same structure, whose memory is used; it is spoilt.
    """

    def __init__(
        self,
        coefficients: Coefficients,
        damping: float = 1e-3,
        old: Multigrid | None = None,
    ) -> None:
        structure = coefficients.structure
        if old is None or old.levels[0].structure is not structure:
            self.workspace = np.empty((3, *structure.active.shape))
            self.levels: list[_Level] = [_Level(structure, SEE)]
            # So few are solved as they are. Of usual pictures these are 20×15, each a whole number of times
            # halved: a row that is left over at one end would know left from right.
            while structure.pixels > 320:
                structure = structure.coarser
                self.levels.append(_Level(structure, len(OFFSETS)))
        else:
            self.workspace = old.workspace
            self.levels = old.levels
        coefficients.matrix(damping, self.levels[0].matrix)
        for level, coarser in pairwise(self.levels):
            _invert_sums(level.inverse, level.matrix, level.structure.active)
            coarsen(coarser.matrix, level.matrix, level.structure.interpolation)
        coarsest = self.levels[-1]
        self.factor = _factorise(coarsest.matrix, coarsest.structure.active)
        self.places = np.flatnonzero(coarsest.structure.active)

    def _cycle(self, depth: int = 0) -> None:
        """One V-cycle: x of a level from its right-hand side b, starting at nothing."""
        at = self.levels[depth]
        if depth + 1 == len(self.levels):
            at.x.flat[self.places] = cho_solve(
                self.factor, at.b.flat[self.places], check_finite=False
            )
            return
        at.begin()
        below = self.levels[depth + 1]
        at.structure.interpolation.adjoint(at.r, below.structure.active, below.b)
        self._cycle(depth + 1)
        at.correct(below.x)

    def solve(
        self, b: FloatArray, tolerance: float, most: int
    ) -> tuple[FloatArray, int, float]:
        """Conjugate gradients on M x = b, until the preconditioned residual is `tolerance` of what it was.

        A residual may be that of a few pixels at first, beside which all others look solved. So what it
        promises still, r·M⁻¹r, must also be no more than this fraction of what x has, b·x. Returns x, which
        the next call overwrites (0 where a pixel is not active), the steps that were taken, `most` at most,
        and that fraction.
        """
        top = self.levels[0]
        x, direction, product = self.workspace
        self.workspace[:] = 0.0
        r = top.b
        r[:] = b
        start = 0.0
        last = 1.0
        done = 0.0
        for step in range(most + 1):
            self._cycle()
            now = max(dot(r, top.x), 0.0)
            start = now if step == 0 else start
            left = now / done if done > 0 else np.inf if now > 0 else 0.0
            if (now <= tolerance**2 * start and left <= tolerance) or step == most:
                break
            direction *= now / last if step else 0.0
            direction += top.x
            last = now
            multiply(top.matrix, direction, product)
            curved = dot(direction, product)
            if curved <= 0:  # nothing is left but rounding
                break
            length = now / curved
            done += length * now
            _add(x, length, direction)
            _add(r, -length, product)
        return x, step, left
