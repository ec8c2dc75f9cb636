"""Solving the normal equations M x = b of a Gauss-Newton step in a time proportional to the pixels.

Conjugate gradients solve them, preconditioned by one V-cycle. A coarse level has half the rows and columns
and the matrix Pᵀ M P (Briggs, Henson, McCormick, "A multigrid tutorial", 2000, chapters 3 and 10; see
`galerkin`); P is that of `interpolation`:

    all pixels     smooth                  smooth
    a quarter        Pᵀr ↘ smooth    smooth ↗ x + P x
    ...                        ↘    ↗
    at most 96                 invert

Smoothing changes all pixels at once, so that a mirrored picture has the mirrored solution. It is Chebyshev's
of the fourth kind (Lottes, "Optimal polynomial smoothers for multigrid V-cycles", 2023) by rows' sums,

    x += s,   r -= M s,   s ← max(2n-1, 0)/(2n+3) s + (8n+4)/(2n+3) r / Σ_j |M_ij|,    n = 0, 1, 2, ...

Behind cuts little holds a surface: there rounding grew a million times within one solve. So all is in double
precision. Vectors are padded (see `numerics.compiled`) and zero outside the mask.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from endolab.numerics.arrays import ByteArray, FloatArray, IntArray, Span
from endolab.numerics.compiled import PAD, clear_row, kernel
from endolab.numerics.threads import on_cores, rows_within
from endolab.solvers.galerkin import coarsen
from endolab.solvers.interpolation import (
    Interpolation,
    add_from,
    add_sorted,
    prolong_add,
    restrict,
)
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
    Structure,
)


@dataclass(frozen=True)
class Cycle:
    """How a V-cycle is made; chosen by hand."""

    coarsest: int = 96  # pixels; so many or fewer are solved by an inverse matrix
    # Share of the diagonal that is added to it there, or islands that nothing holds let rounding grow.
    ridge: float = 1e-4
    degree: int = 2  # smoothing steps before and after a coarser grid


CYCLE = Cycle()


@kernel
def _row_times(m: FloatArray, x: FloatArray, k: int, i: int, out: FloatArray) -> None:
    """Row i of the matrix times the k-th of the maps x; out[j] is of column PAD + j.

    Pixels that change places in a mirrored or transposed picture are added first, so that the sum is the
    same to the last digit. In this and the following loops, j begins at 0 and what is added to it is not
    negative: so they compile to instructions that take many pixels at once. Views of rows would do as well,
    but counting who holds a view takes longer than a row, and the cores wait for one another to count.
    k and i are never written as numbers: the loop would be compiled once more for each.
    """
    count = x.shape[2] - 2 * PAD
    for j in range(count):
        around = _pair(m, E, x, k, i, j + 2) + _pair(m, S, x, k, i, j + 2)
        askew = _pair(m, SE, x, k, i, j + 2) + _pair(m, SW, x, k, i, j + 2)
        out[j] = (m[CENTRE, i, j + 2] * x[k, i, j + 2] + around) + askew
    for j in range(count):
        out[j] += _pair(m, EE, x, k, i, j + 2) + _pair(m, SS, x, k, i, j + 2)
    if len(m) <= SEE:
        return
    for j in range(count):
        wide = _pair(m, SEE, x, k, i, j + 2) + _pair(m, SWW, x, k, i, j + 2)
        steep = _pair(m, SSE, x, k, i, j + 2) + _pair(m, SSW, x, k, i, j + 2)
        out[j] += wide + steep
    for j in range(count):
        out[j] += _pair(m, SE2, x, k, i, j + 2) + _pair(m, SW2, x, k, i, j + 2)


@kernel
def _pair(m: FloatArray, entry: int, x: FloatArray, k: int, i: int, j: int) -> float:
    """An entry of the pixel (i, j), and the one that couples it to the pixel on the other side."""
    down, right = OFFSETS[entry]
    after = m[entry, i, j] * x[k, i + down, j + right]
    return after + m[entry, i - down, j - right] * x[k, i - down, j - right]


@on_cores(cost=0.3)
def _dots(rows: Span, a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Scalar products of the rows of two vectors, by four sums, so that none waits for the last."""
    width = a.shape[1]
    even = width - width % 4
    for i in range(rows[0], rows[1]):
        one = two = three = four = 0.0
        for j in range(0, even, 4):
            one += a[i, j] * b[i, j]
            two += a[i, j + 1] * b[i, j + 1]
            three += a[i, j + 2] * b[i, j + 2]
            four += a[i, j + 3] * b[i, j + 3]
        for j in range(even, width):
            one += a[i, j] * b[i, j]
        out[i] = (one + two) + (three + four)


def dot(a: FloatArray, b: FloatArray) -> float:
    """Scalar product of two vectors, the same on any number of threads."""
    products = np.empty(len(a))
    _dots(a, b, products)
    return float(products.sum())


@on_cores(cost=2)
def _multiply(rows: Span, out: FloatArray, m: FloatArray, x: FloatArray) -> None:
    first, last = rows_within(rows, PAD, out.shape[0] - PAD)
    row = np.empty(out.shape[1] - 2 * PAD)
    for i in range(first, last):
        _row_times(m, x, len(x) - 1, i, row)
        for j in range(row.size):
            out[i, j + 2] = row[j]


def multiply(m: FloatArray, x: FloatArray, out: FloatArray) -> None:
    """out = M x."""
    _multiply(out, m, x[None])


@kernel
def _smooth_row(
    m: FloatArray,
    inverse: FloatArray,
    steps: FloatArray,
    x: FloatArray,
    r: FloatArray,
    first: int,
    k: int,
    i: int,
    row: FloatArray,
) -> None:
    """Go the k-th step in row i, x += step and r -= M step, and write the one that follows."""
    _row_times(m, steps, k, i, row)
    n = first + k
    kept = max(2 * n - 1, 0) / (2 * n + 3)
    added = (8 * n + 4) / (2 * n + 3)
    for j in range(row.size):
        step = steps[k, i, j + 2]
        x[i, j + 2] += step
        r[i, j + 2] -= row[j]
        steps[k + 1, i, j + 2] = kept * step + added * inverse[i, j + 2] * r[i, j + 2]


@on_cores(cost=20, turns=2)
def _smooth(
    rows: Span,
    turns: Span,
    x: FloatArray,
    r: FloatArray,
    m: FloatArray,
    inverse: FloatArray,
    steps: FloatArray,
    first: int,
) -> None:
    """Take smoothing steps, from `steps[0]`; `first` is the number of its polynomial.

    A step needs two rows of the one before on either side. So steps follow one another at two rows'
    distance, while what they read is still near; and where rows are another's to do, each of its steps
    ends two rows earlier than the one before. What is left there is the second turn's.
    """
    top = PAD
    end = x.shape[0] - PAD
    degree = len(steps) - 1
    row = np.empty(x.shape[1] - 2 * PAD)
    if turns[0] == 0:
        for leading in range(rows[0], rows[1] + PAD * degree):
            for k in range(degree):
                i = leading - PAD * k
                above = top if rows[0] == 0 else max(top, rows[0] + PAD * k)
                below = end if rows[1] == x.shape[0] else min(end, rows[1] - PAD * k)
                if above <= i < below:
                    _smooth_row(m, inverse, steps, x, r, first, k, i, row)
    if turns[1] == 2 and rows[0] > 0:
        for k in range(1, degree):
            for i in range(max(top, rows[0] - PAD * k), min(end, rows[0] + PAD * k)):
                _smooth_row(m, inverse, steps, x, r, first, k, i, row)


@on_cores(cost=0.4)
def _add(rows: Span, x: FloatArray, share: float, y: FloatArray) -> None:
    """x += share · y."""
    for i in range(rows[0], rows[1]):
        for j in range(x.shape[1]):
            x[i, j] += share * y[i, j]


@on_cores(cost=1)
def _begin(
    rows: Span,
    x: FloatArray,
    r: FloatArray,
    b: FloatArray,
    inverse: FloatArray,
    steps: FloatArray,
) -> None:
    """x = 0, r = b, and the first of the smoothing steps from there."""
    for i in range(rows[0], rows[1]):
        for j in range(x.shape[1]):
            x[i, j] = 0.0
            r[i, j] = b[i, j]
            steps[0, i, j] = 4 / 3 * (inverse[i, j] * b[i, j])


@on_cores(cost=10)
def _invert_sums(rows: Span, out: FloatArray, m: FloatArray, active: ByteArray) -> None:
    """The reciprocal of each row's absolute sum; 0 where a pixel is held at 0."""
    first, last = rows_within(rows, PAD, out.shape[0] - PAD)
    row = np.empty(out.shape[1] - 2 * PAD)
    ones = np.ones((1, 2 * PAD + 1, out.shape[1]))
    sizes = np.empty((len(m), PAD + 1, out.shape[1]))  # of this row and those above
    for i in range(first, last):
        for k in range(len(m)):
            for above in range(PAD + 1):
                for j in range(out.shape[1]):
                    sizes[k, PAD - above, j] = abs(m[k, i - above, j])
        _row_times(sizes, ones, len(ones) - 1, sizes.shape[1] - 1, row)
        for j in range(row.size):
            out[i, j + 2] = 1 / row[j] if active[i, j + 2] and row[j] > 0 else 0.0


def _invert(m: FloatArray, active: ByteArray) -> FloatArray:
    """Inverse of the matrix of a small grid's active pixels."""
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
    dense[np.diag_indices(i.size)] = np.where(
        diagonal > 0, (1 + CYCLE.ridge) * diagonal, 1.0
    )
    return np.asarray(np.linalg.inv(dense), dtype=np.float64)


class _Level(NamedTuple):
    """One grid: its pixels, its matrix, the way from the coarser one, and room for vectors."""

    active: ByteArray
    share: FloatArray  # this and the next three: those of `Interpolation`; empty on the coarsest grid
    pixel: IntArray
    block: IntArray
    weight: FloatArray
    matrix: FloatArray
    inverse: FloatArray  # of the rows' sums of sizes; 0 where a pixel is held at 0
    x: FloatArray
    b: FloatArray
    r: FloatArray
    steps: FloatArray  # (`Cycle.degree` + 1, ...), of smoothing

    @classmethod
    def on(cls, structure: Structure, entries: int) -> _Level:
        """Make room for so many numbers of a pixel."""
        shape = structure.active.shape
        inverse, x, b, r = np.zeros((4, *shape))
        steps = np.zeros((CYCLE.degree + 1, *shape))
        nowhere = np.empty(0, np.int64)
        way = Interpolation(np.empty((0, 0)), nowhere, nowhere, np.empty(0))
        if not _is_coarsest(structure):
            way = structure.way
        matrix = np.empty((entries, *shape))
        return cls(structure.active, *way, matrix, inverse, x, b, r, steps)

    @property
    def way(self) -> Interpolation:
        return Interpolation(self.share, self.pixel, self.block, self.weight)

    def begin(self) -> None:
        """Smooth x, from nothing; leaves in r what is left of b."""
        _begin(self.x, self.r, self.b, self.inverse, self.steps)
        _smooth(self.x, self.r, self.matrix, self.inverse, self.steps, 1)

    def correct(self, coarse: FloatArray) -> None:
        """Add a coarser grid's correction, and smooth x."""
        self.steps[0] = 0.0
        self.way.add(coarse, self.steps[0])
        _smooth(self.x, self.r, self.matrix, self.inverse, self.steps, 0)
        _add(self.x, 1.0, self.steps[-1])


def _is_coarsest(structure: Structure) -> bool:
    return structure.pixels <= CYCLE.coarsest


MOST_LEVELS = 12  # more than any picture has: each halves rows and columns

# The same loops, for compiled ones to call.
_begin_alone = _begin.loop
_smooth_alone = _smooth.loop
_add_alone = _add.loop
_restrict_alone = restrict.loop
_prolong_alone = prolong_add.loop


@kernel
def _cycle_alone(
    levels: tuple[_Level, ...],
    depths: Span,
    turns: Span,
    numbers: Span,
    places: IntArray,
    solution: FloatArray,
) -> None:
    """A V-cycle from the first depth to the last, by one core: x of a level from its b.

    On small grids calls from Python would take as long as what they do. `turns` are all of `_smooth`, and
    `numbers` those of its first polynomials: were they written here, it would be compiled for each anew.
    """
    first, last = depths
    top = turns[0]
    for depth in range(first, last):
        at = levels[depth]
        below = levels[depth + 1]
        rows = (top, at.x.shape[0])
        _begin_alone(rows, at.x, at.r, at.b, at.inverse, at.steps)
        _smooth_alone(rows, turns, at.x, at.r, at.matrix, at.inverse, at.steps, numbers[0])
        _restrict_alone((top, below.b.shape[0]), below.b, at.r, at.share, below.active)
        add_from(at.pixel, at.block, at.weight, at.r, below.b)
    coarsest = levels[last]
    b = coarsest.b.ravel()
    x = coarsest.x.reshape(-1)
    for i in range(places.size):
        total = 0.0
        for j in range(places.size):
            total += solution[i, j] * b[places[j]]
        x[places[i]] = total
    for depth in range(last - 1, first - 1, -1):
        at = levels[depth]
        below = levels[depth + 1]
        rows = (top, at.x.shape[0])
        for i in range(top, rows[1]):
            clear_row(at.steps[0, i])
        _prolong_alone(rows, at.steps[0], at.share, below.x)
        add_sorted(at.block, at.pixel, at.weight, below.x, at.steps[0])
        _smooth_alone(rows, turns, at.x, at.r, at.matrix, at.inverse, at.steps, numbers[1])
        _add_alone(rows, at.x, 1.0, at.steps[len(at.steps) - 1])


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
        if old is None or old.structures[0] is not structure:
            self.room = np.empty((3, *structure.active.shape))
            self.structures: list[Structure] = [structure]
            while not _is_coarsest(self.structures[-1]):
                self.structures.append(self.structures[-1].coarser)
            self.levels = [_Level.on(structure, SEE)]
            self.levels += [_Level.on(each, len(OFFSETS)) for each in self.structures[1:]]
        else:
            self.room = old.room
            self.structures = old.structures
            self.levels = old.levels
        coefficients.matrix(damping, self.levels[0].matrix)
        for structure, (level, coarser) in zip(
            self.structures, pairwise(self.levels), strict=False
        ):
            _invert_sums(level.inverse, level.matrix, level.active)
            coarsen(level.matrix, structure.way, structure.rows, coarser.matrix)
        coarsest = self.levels[-1]
        self.solution = _invert(coarsest.matrix, coarsest.active)
        self.places = np.flatnonzero(coarsest.active)

    def _cycle(self, depth: int = 0) -> None:
        """One V-cycle: x of a level from its right-hand side b, starting at nothing."""
        at = self.levels[depth]
        last = len(self.levels) - 1
        if depth == last or _smooth.cores_for(at.x) == 1:
            # Of one length, so that it is compiled once.
            filled = (*self.levels, *[self.levels[-1]] * (MOST_LEVELS - last - 1))
            _cycle_alone(filled, (depth, last), (0, 2), (1, 0), self.places, self.solution)
            return
        at.begin()
        below = self.levels[depth + 1]
        at.way.adjoint(at.r, below.active, below.b)
        self._cycle(depth + 1)
        at.correct(below.x)

    def solve(
        self, b: FloatArray, tolerance: float, most: int
    ) -> tuple[FloatArray, int, float]:
        """Conjugate gradients on M x = b, until the preconditioned residual is `tolerance` of what it was.

        A residual may be that of a few pixels at first, beside which all others look solved. So what it
        promises still, r·M⁻¹r, must also be no more than this share of what x has, b·x. Returns x, which
        the next call overwrites (0 where a pixel is not active), the steps that were taken, `most` at most,
        and that share.
        """
        top = self.levels[0]
        x, direction, product = self.room
        self.room[:] = 0.0
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
