"""The way between a grid and that of half its pixels: linear interpolation, and its adjoint.

Blocks of 2×2 pixels have their centres (o) two pixels apart, and a pixel (x) is half a pixel from its own's:

      own o - - - - - - o beside
          |  x          |             x = (9 own + 3 beside + 3 below + 1 diagonal) / 16
          |             |
    below o - - - - - - o diagonal

amid four blocks of its own side. Twice over, that makes quadratic splines: what is smooth on a coarse grid
is smooth on a fine one. At a rim of the mask, and beside a cut (see `cuts`), it has the value of the block
next to it, a = ±¼ block from it along an axis, and that block's differences Δ with others of its side,

    x = own + a_u Δ_u + a_v Δ_v,

so that no straight map is bent there: second differences would find that dear. The weights are the rows of a
matrix P; steps go up by P and residuals down by Pᵀ.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from endolab.numerics.arrays import BoolArray, ByteArray, FloatArray, IntArray, Span
from endolab.numerics.compiled import PAD, kernel
from endolab.numerics.threads import on_cores, rows_within
from endolab.solvers.cuts import Cells, nearest_blocks, same_side

# Those of `Interpolation`: pixel, block, weight.
Strands = tuple[IntArray, IntArray, FloatArray]


@on_cores(cost=0.4)
def prolong_add(rows: Span, x: FloatArray, share: FloatArray, step: FloatArray) -> None:
    """x += the coarse step, interpolated linearly between the coarse pixels that take part."""
    first, last = rows_within(rows, PAD, x.shape[0] - PAD)
    for i in range(first, last):
        ci = PAD + (i - PAD) // 2
        ni = 1 if (i - PAD) % 2 else -1
        for cj in range(step.shape[1] - 2 * PAD):
            j = PAD + 2 * cj
            nearest = 9 * step[ci, cj + 2]
            beneath = step[ci + ni, cj + 2]
            left = nearest + 3 * (beneath + step[ci, cj + 1]) + step[ci + ni, cj + 1]
            right = nearest + 3 * (beneath + step[ci, cj + 3]) + step[ci + ni, cj + 3]
            x[i, j] += share[i, j] * left
            x[i, j + 1] += share[i, j + 1] * right


@on_cores(cost=2)
def restrict(
    rows: Span, out: FloatArray, r: FloatArray, share: FloatArray, coarse: ByteArray
) -> None:
    """Adjoint of `prolong_add`."""
    first, last = rows_within(rows, PAD, out.shape[0] - PAD)
    sums = np.empty(r.shape[1])  # of the four rows around a block
    for ci in range(first, last):
        i = 2 * ci - PAD
        for j in range(r.shape[1]):
            inner_rows = share[i, j] * r[i, j] + share[i + 1, j] * r[i + 1, j]
            outer_rows = share[i - 1, j] * r[i - 1, j] + share[i + 2, j] * r[i + 2, j]
            sums[j] = 3 * inner_rows + outer_rows
        for cj in range(out.shape[1] - 2 * PAD):
            j = PAD + 2 * cj
            total = 3 * (sums[j] + sums[j + 1]) + (sums[j - 1] + sums[j + 2])
            out[ci, cj + 2] = coarse[ci, cj + 2] * total


@kernel
def _place(i: int, j: int, k: int) -> tuple[int, int, float, float]:
    """Row and column of the k-th block around a pixel; where the pixel is from its centre, in blocks.

    i and j count from the first block's first pixel.
    """
    row = i // 2 + (2 * (i % 2) - 1 if k > 1 else 0)
    column = j // 2 + (2 * (j % 2) - 1 if k % 2 else 0)
    return PAD + row, PAD + column, i / 2 - 0.25 - row, j / 2 - 0.25 - column


@kernel
def add_from(
    source: IntArray, target: IntArray, weight: FloatArray, a: FloatArray, out: FloatArray
) -> None:
    """Add weighted elements of one array to those of another, rounding but once."""
    values = a.ravel()
    sums = out.reshape(-1)
    more = np.zeros(out.size)
    for k in range(weight.size):
        more[target[k]] += weight[k] * values[source[k]]
    for k in range(weight.size):
        sums[target[k]] += more[target[k]]
        more[target[k]] = 0.0


@kernel
def add_sorted(
    source: IntArray, target: IntArray, weight: FloatArray, a: FloatArray, out: FloatArray
) -> None:
    """Do the same where equal targets follow one another."""
    values = a.ravel()
    sums = out.reshape(-1)
    k = 0
    while k < target.size:
        place = target[k]
        more = 0.0
        while k < target.size and target[k] == place:
            more += weight[k] * values[source[k]]
            k += 1
        sums[place] += more


def _share(active: ByteArray, main: ByteArray, blocks: Cells) -> FloatArray:
    """1/16 for pixels amid four blocks with nothing between, else 0."""
    known = blocks.active > 0
    uncut = blocks.link == blocks.uncut_links
    amid = known[:-1, :-1] & known[:-1, 1:] & known[1:, :-1] & known[1:, 1:]
    amid &= uncut[0, :-1, :-1] & uncut[0, 1:, :-1] & uncut[1, :-1, :-1] & uncut[1, :-1, 1:]
    rows, columns = ((np.arange(size) + PAD - 1) // 2 for size in active.shape)
    return amid[rows[:, None], columns] * (active > 0) * (main > 0) / 16


@kernel
def _fill_strands(
    pixels: Cells, main: ByteArray, blocks: Cells, share: FloatArray, strands: Strands
) -> int:
    """Write the strands to active pixels that have no share, or their shares; return how many strands."""
    active, link, uncut_links = pixels
    known, across, _ = blocks
    pixel, block, weight = strands
    count = 0
    wide = known.shape[1]
    for i in range(PAD, active.shape[0] - PAD):
        for j in range(PAD, active.shape[1] - PAD):
            if not active[i, j] or share[i, j] > 0:
                continue
            of_side = same_side(main, link, uncut_links, blocks, i, j)
            if of_side[0] and of_side[1] and of_side[2] and of_side[3]:
                share[i, j] = 1 / 16
                continue
            first_block, last_block = nearest_blocks(of_side)
            if first_block == 4:
                continue
            share_of_each = 1.0 if first_block == last_block else 0.5
            for k in range(first_block, last_block + 1):
                row, column, down, right = _place(i - PAD, j - PAD, k)
                own = 1.0
                centre = row * wide + column
                for axis, aside, step in ((0, right, 1), (1, down, wide)):
                    ahead = 1 if aside > 0 else -1
                    for way in (ahead, -ahead):
                        r = row + way * axis
                        c = column + way * (1 - axis)
                        if across[axis, min(r, row), min(c, column)] and known[r, c]:
                            pixel[count] = i * active.shape[1] + j
                            block[count] = centre + way * step
                            weight[count] = share_of_each * aside * way
                            own = own - aside * way
                            count = count + 1
                            break
                pixel[count] = i * active.shape[1] + j
                block[count] = centre
                weight[count] = share_of_each * own
                count += 1
    return count


class Interpolation(NamedTuple):
    """Linear interpolation from blocks to the active pixels of a grid; places are flat indices."""

    share: FloatArray  # 1/16 for pixels amid four blocks of their side, else 0
    pixel: IntArray  # of each pair of another pixel and a block of its side; sorted
    block: IntArray
    weight: FloatArray

    @classmethod
    def between(cls, coarse: Any, fine: Any) -> Interpolation:
        """Find the way from one grid to the finer one: `Grid`s, or a `Structure` and its coarser one."""
        blocks = Cells(coarse.active, coarse.link, coarse.uncut_links)
        pixels = Cells(fine.active, fine.link, fine.uncut_links)
        share = _share(fine.active, fine.main, blocks)
        most = 6 * np.count_nonzero((fine.active > 0) & (share == 0))
        strands = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most)
        count = _fill_strands(pixels, fine.main, blocks, share, strands)
        pixel, block, weight = strands
        return cls(share, pixel[:count], block[:count], weight[:count])

    def add(self, step: FloatArray, x: FloatArray) -> None:
        """x += the blocks' step, interpolated."""
        prolong_add(x, self.share, step)
        add_sorted(self.block, self.pixel, self.weight, step, x)

    def adjoint(self, r: FloatArray, active: ByteArray, out: FloatArray) -> None:
        """Write the adjoint of `add` to out, for blocks that are active."""
        restrict(out, r, self.share, active)
        add_from(self.pixel, self.block, self.weight, r, out)

    @property
    def at_rims(self) -> BoolArray:
        """Whether a pixel has its value from fewer than four blocks, padded."""
        out = np.zeros(self.share.shape, np.bool_)
        out.flat[self.pixel] = True
        return out
