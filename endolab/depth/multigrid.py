"""Solving the normal equations of a Gauss-Newton step in a time proportional to the pixels.

Conjugate gradients solve them, preconditioned by one V-cycle: a Gauss-Seidel sweep forwards, a
coarse correction, a sweep backwards. Coarse levels are the same equations written down on a grid
of half the pixels, from averaged coefficients (Briggs, Henson, McCormick, "A multigrid
tutorial", 2000, chapters 3 and 10).

Vectors are padded (see `numerics.compiled`) and zero outside the mask, as the matrices are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from endolab.depth.interpolation import Interpolation
from endolab.depth.normal_equations import CENTRE, EE, SE, SEE, SS, SSE, SW, Coefficients, E, S
from endolab.depth.tears import Blocks, beside_cuts
from endolab.numerics.arrays import FloatArray
from endolab.numerics.compiled import PAD, kernel

COARSEST = 64  # pixels; there the equations are swept until they are solved
SWEEPS = 20
BAND, MORE = 3, 3  # pixels on either side of a cut, and how many sweeps more they have


@kernel
def _others(m: Any, x: FloatArray, i: int, j: int) -> float:
    """Row of the matrix times x, but for the diagonal and the two pixels to the left."""
    return (
        m[E, i, j] * x[i, j + 1]
        + m[EE, i, j] * x[i, j + 2]
        + m[S, i, j] * x[i + 1, j]
        + m[SS, i, j] * x[i + 2, j]
        + m[SE, i, j] * x[i + 1, j + 1]
        + m[SW, i, j] * x[i + 1, j - 1]
        + m[S, i - 1, j] * x[i - 1, j]
        + m[SS, i - 2, j] * x[i - 2, j]
        + m[SE, i - 1, j - 1] * x[i - 1, j - 1]
        + m[SW, i - 1, j + 1] * x[i - 1, j + 1]
        + m[SEE, i, j] * x[i + 1, j + 2]
        + m[SSE, i, j] * x[i + 2, j + 1]
        + m[SEE, i - 1, j - 2] * x[i - 1, j - 2]
        + m[SSE, i - 2, j - 1] * x[i - 2, j - 1]
    )


@kernel
def multiply(m: Any, x: FloatArray, out: FloatArray) -> None:
    """out = M x."""
    for i in range(PAD, x.shape[0] - PAD):
        for j in range(PAD, x.shape[1] - PAD):
            left = m[E, i, j - 1] * x[i, j - 1] + m[EE, i, j - 2] * x[i, j - 2]
            out[i, j] = m[CENTRE, i, j] * x[i, j] + left + _others(m, x, i, j)


@kernel
def dot(a: FloatArray, b: FloatArray) -> float:
    """Scalar product of two vectors; of one thread, unlike NumPy's, whose threads wait in circles."""
    total = 0.0
    for i in range(PAD, a.shape[0] - PAD):
        row = 0.0
        for j in range(PAD, a.shape[1] - PAD):
            row += a[i, j] * b[i, j]
        total += row
    return total


@kernel
def _conjugate(z: FloatArray, share: float, direction: FloatArray) -> None:
    """direction = z + share · direction."""
    for i in range(z.shape[0]):
        for j in range(z.shape[1]):
            direction[i, j] = z[i, j] + share * direction[i, j]


@kernel
def _proceed(length: float, direction: FloatArray, product: FloatArray, x: FloatArray, r: FloatArray) -> None:
    """x += length · direction, r -= length · product."""
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            x[i, j] += length * direction[i, j]
            r[i, j] -= length * product[i, j]


@kernel
def residual(m: Any, x: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """out = b - M x."""
    for i in range(PAD, x.shape[0] - PAD):
        for j in range(PAD, x.shape[1] - PAD):
            left = m[E, i, j - 1] * x[i, j - 1] + m[EE, i, j - 2] * x[i, j - 2]
            out[i, j] = b[i, j] - (m[CENTRE, i, j] * x[i, j] + left + _others(m, x, i, j))


@kernel
def sweep_forwards(m: Any, inverse: FloatArray, x: FloatArray, b: FloatArray) -> None:
    """One Gauss-Seidel sweep in reading order."""
    row = np.empty(x.shape[1])
    for i in range(PAD, x.shape[0] - PAD):
        for j in range(PAD, x.shape[1] - PAD):
            row[j] = b[i, j] - _others(m, x, i, j)
        for j in range(PAD, x.shape[1] - PAD):
            left = m[E, i, j - 1] * x[i, j - 1] + m[EE, i, j - 2] * x[i, j - 2]
            x[i, j] = (row[j] - left) * inverse[i, j]


@kernel
def sweep_backwards(m: Any, inverse: FloatArray, x: FloatArray, b: FloatArray) -> None:
    """One Gauss-Seidel sweep against reading order: the adjoint of the other."""
    row = np.empty(x.shape[1])
    for i in range(x.shape[0] - PAD - 1, PAD - 1, -1):
        for j in range(PAD, x.shape[1] - PAD):
            left = m[E, i, j - 1] * x[i, j - 1] + m[EE, i, j - 2] * x[i, j - 2]
            right = m[E, i, j] * x[i, j + 1] + m[EE, i, j] * x[i, j + 2]
            row[j] = b[i, j] - left - (_others(m, x, i, j) - right)
        for j in range(x.shape[1] - PAD - 1, PAD - 1, -1):
            right = m[E, i, j] * x[i, j + 1] + m[EE, i, j] * x[i, j + 2]
            x[i, j] = (row[j] - right) * inverse[i, j]


@kernel
def sweep_some(m: Any, inverse: FloatArray, x: FloatArray, b: FloatArray, pixels: Any, step: int) -> None:
    """`MORE` Gauss-Seidel sweeps over some pixels: as they are listed, step 1, or the other way, -1."""
    for _ in range(MORE):
        for i, j in pixels[::step]:
            left = m[E, i, j - 1] * x[i, j - 1] + m[EE, i, j - 2] * x[i, j - 2]
            x[i, j] = (b[i, j] - left - _others(m, x, i, j)) * inverse[i, j]


@dataclass(frozen=True)
class _Level:
    """One grid: its matrix, and room for a right-hand side, a solution and a residual."""

    matrix: FloatArray
    inverse: FloatArray  # of the diagonal; 0 where a pixel is held at 0
    active: Any
    way: Interpolation | None  # from the next coarser grid, if there is one
    band: NDArray[np.int64]  # (n, 2), pixels near cuts, where the way down and up is rough
    x: FloatArray
    b: FloatArray
    r: FloatArray

    @classmethod
    def of(
        cls, coefficients: Coefficients, damping: float, coarser: Coefficients | None, old: _Level | None
    ) -> _Level:
        active = coefficients.active
        m = coefficients.matrix(damping, None if old is None else old.matrix)
        inverse = 1 / np.where((active == 0) | (m[CENTRE] <= 0), np.inf, m[CENTRE])
        if old is not None and np.array_equal(old.active, active):
            return replace(old, inverse=inverse)
        way = None
        if coarser is not None:
            blocks = Blocks(coarser.active, coarser.link, coarser.whole)
            fine = (active, coefficients.main, coefficients.link, coefficients.whole)
            way = Interpolation.to(*fine, blocks)
        band = np.argwhere(active * beside_cuts(coefficients.link, coefficients.whole, BAND))
        return cls(m, inverse, active, way, band, *np.zeros((3, *inverse.shape)))


class Multigrid:
    """V-cycles for one set of normal equations, whose `damping` is that of `Coefficients.matrix`.

    `old` is a multigrid of other coefficients on the same grid, whose memory may be used; it is spoilt.
    """

    def __init__(
        self, coefficients: Coefficients, damping: float = 1e-3, old: Multigrid | None = None
    ) -> None:
        grids = [coefficients]
        while grids[-1].pixels > COARSEST:
            grids.append(grids[-1].coarser())
        olds: list[_Level | None] = [None] * len(grids) if old is None else [*old.levels]
        self.levels: list[_Level] = [
            _Level.of(grid, damping, coarser, spoilt)
            for grid, coarser, spoilt in zip(grids, [*grids[1:], None], olds, strict=True)
        ]
        self.room: FloatArray = np.empty((3, *coefficients.by_v.shape)) if old is None else old.room

    def _cycle(self, depth: int = 0) -> None:
        """One V-cycle: x of a level from its right-hand side b, starting at nothing."""
        at = self.levels[depth]
        at.x[:] = 0.0
        sweep_forwards(at.matrix, at.inverse, at.x, at.b)
        sweep_some(at.matrix, at.inverse, at.x, at.b, at.band, 1)
        if at.way is None:
            for _ in range(SWEEPS):
                sweep_backwards(at.matrix, at.inverse, at.x, at.b)
                sweep_forwards(at.matrix, at.inverse, at.x, at.b)
        else:
            below = self.levels[depth + 1]
            residual(at.matrix, at.x, at.b, at.r)
            at.way.adjoint(at.r, below.active, below.b)
            self._cycle(depth + 1)
            at.way.add(below.x, at.x)
        sweep_some(at.matrix, at.inverse, at.x, at.b, at.band, -1)
        sweep_backwards(at.matrix, at.inverse, at.x, at.b)

    def solve(self, b: FloatArray, tolerance: float, most: int) -> tuple[FloatArray, int, float]:
        """Conjugate gradients on M x = b, until the preconditioned residual is `tolerance` of what it was.

        A residual may be that of a few pixels at first, beside which all others look solved. So what it
        promises still, r·M⁻¹r, must also be no more than this share of what x has, b·x. Returns x, which
        the next call overwrites (0 where a pixel is not active), the steps that were taken, `most` at most,
        and that share.
        """
        top = self.levels[0]
        x, direction, product = self.room
        self.room[:] = 0.0
        r = top.b  # a cycle leaves its right-hand side alone
        r[:] = b
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
            multiply(top.matrix, direction, product)
            length = now / dot(direction, product)
            done += length * now
            _proceed(length, direction, product, x, r)
        return x, step, left
