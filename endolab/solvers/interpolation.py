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

A pixel's side is that of its own block if the block stands for it (`main`). Otherwise it is that of the
neighbours for which theirs does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np

from endolab.numerics.arrays import BoolArray, ByteArray, FloatArray, IntArray, Span
from endolab.numerics.compiled import PAD, active_blocks, inner, kernel
from endolab.numerics.threads import on_cores, rows_within
from endolab.solvers.cuts import coarser_links, largest_fragments


@on_cores(cost=0.4)
def prolong_add(rows: Span, x: FloatArray, regular: FloatArray, step: FloatArray) -> None:
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
            x[i, j] += regular[i, j] * left
            x[i, j + 1] += regular[i, j + 1] * right


@on_cores(cost=2)
def restrict(
    rows: Span, out: FloatArray, r: FloatArray, regular: FloatArray, coarse: ByteArray
) -> None:
    """Adjoint of `prolong_add`."""
    first, last = rows_within(rows, PAD, out.shape[0] - PAD)
    sums = np.empty(r.shape[1])  # of the four rows around a block
    for ci in range(first, last):
        i = 2 * ci - PAD
        for j in range(r.shape[1]):
            inner_rows = regular[i, j] * r[i, j] + regular[i + 1, j] * r[i + 1, j]
            outer_rows = regular[i - 1, j] * r[i - 1, j] + regular[i + 2, j] * r[i + 2, j]
            sums[j] = 3 * inner_rows + outer_rows
        for cj in range(out.shape[1] - 2 * PAD):
            j = PAD + 2 * cj
            total = 3 * (sums[j] + sums[j + 1]) + (sums[j - 1] + sums[j + 2])
            out[ci, cj + 2] = coarse[ci, cj + 2] * total


@kernel
def _add_up(interpolation: Interpolation, step: FloatArray, x: FloatArray) -> None:
    """x += the blocks' step, for pixels beside rims and cuts."""
    _, _, pixel, row, column, weight = interpolation
    values = x.reshape(-1)
    for k in range(pixel.size):
        values[pixel[k]] += weight[k] * step[row[k], column[k]]


@kernel
def _add_down(interpolation: Interpolation, r: FloatArray, out: FloatArray) -> None:
    """Adjoint of `_add_up`."""
    _, _, pixel, row, column, weight = interpolation
    values = r.ravel()
    for k in range(pixel.size):
        out[row[k], column[k]] += weight[k] * values[pixel[k]]


@kernel
def _fill(
    active: ByteArray,
    main: ByteArray,
    link: ByteArray,
    blocks: ByteArray,
    block_link: ByteArray,
    cut: BoolArray,
    interpolation: Interpolation,
) -> int:
    """Write the way from blocks to pixels; return how many weights it has beside rims and cuts."""
    regular, start, pixel, block_row, block_column, weight = interpolation
    height, width = regular.shape
    count = 0
    near = np.empty(
        4, np.bool_
    )  # the block that it lies in, and those beside, below and diagonal
    for i in range(height):
        down = 2 * ((i - PAD) % 2) - 1
        ci = PAD + (i - PAD) // 2
        top = min(down, 0)
        for j in range(width):
            start[i * width + j] = count
            if not active[i, j]:
                continue
            right = 2 * ((j - PAD) % 2) - 1
            cj = PAD + (j - PAD) // 2
            left = min(right, 0)

            # Which of the four blocks around are of its side, reached from block to block or pixel to pixel
            if main[i, j]:
                beside = not cut[0, ci, cj + left]
                below = not cut[1, ci + top, cj]
            else:
                beside = link[0, i, j + left] > 0 and main[i, j + right] > 0
                below = link[1, i + top, j] > 0 and main[i + down, j] > 0
            diagonal = beside and not cut[1, ci + top, cj + right]
            diagonal = diagonal or (below and not cut[0, ci + down, cj + left])
            near[0] = main[i, j] > 0 and blocks[ci, cj] > 0
            near[1] = beside and blocks[ci, cj + right] > 0
            near[2] = below and blocks[ci + down, cj] > 0
            near[3] = diagonal and blocks[ci + down, cj + right] > 0
            if near.all():
                regular[i, j] = 1 / 16
                continue

            # The nearest of them, which may be two
            if near[0]:
                near[1:] = False
            elif near[1] or near[2]:
                near[3] = False
            of_each = 1 / max(near.sum(), 1)
            for k in range(4):
                if not near[k]:
                    continue
                row = ci + (down if k > 1 else 0)
                column = cj + (right if k % 2 else 0)
                # Where the pixel is from the block's centre, in blocks
                aside_v = (i - PAD) / 2 - 0.25 - (row - PAD)
                aside_u = (j - PAD) / 2 - 0.25 - (column - PAD)
                of_block = 1.0
                for axis, aside in ((0, aside_u), (1, aside_v)):
                    ahead = 1 if aside > 0 else -1
                    for side in (ahead, -ahead):
                        r = row + side * axis
                        c = column + side * (1 - axis)
                        if block_link[axis, min(r, row), min(c, column)] and blocks[r, c]:
                            pixel[count] = i * width + j
                            block_row[count] = r
                            block_column[count] = c
                            weight[count] = of_each * aside * side
                            of_block = of_block - aside * side
                            count += 1
                            break
                pixel[count] = i * width + j
                block_row[count] = row
                block_column[count] = column
                weight[count] = of_each * of_block
                count += 1
    start[height * width] = count
    return count


class Interpolation(NamedTuple):
    """Linear interpolation P from blocks to the active pixels of a grid."""

    regular: FloatArray  # 1/16 for pixels amid four blocks of their side, else 0
    # Of the other pixels' rows of P, pixel after pixel: where each pixel's begins, and at last their number.
    start: IntArray
    pixel: IntArray  # flat
    row: IntArray  # of the block
    column: IntArray
    weight: FloatArray

    def add(self, step: FloatArray, x: FloatArray) -> None:
        """x += P step."""
        prolong_add(x, self.regular, step)
        _add_up(self, step, x)

    def adjoint(self, r: FloatArray, active: ByteArray, out: FloatArray) -> None:
        """Write Pᵀ r to out, for blocks that are active."""
        restrict(out, r, self.regular, active)
        _add_down(self, r, out)


@dataclass(frozen=True, eq=False)
class Structure:
    """What of a grid depends on mask and cuts alone, here and on coarser grids; padded arrays."""

    active: ByteArray
    link: ByteArray  # (2, ...): steps that derivatives take, see `numerics.stencils.links`
    uncut_links: ByteArray  # those that there would be without cuts: the same array where nothing is cut
    kind: int  # which of `problem.REGULARISERS`

    @property
    def is_cut(self) -> bool:
        """Whether any step is cut."""
        return self.link is not self.uncut_links

    @property
    def pixels(self) -> int:
        """Rows times columns, without the padding."""
        return int(inner(self.active).size)

    @cached_property
    def main(self) -> ByteArray:
        """Pixels for which the coarser grid's blocks stand, see `cuts`; all, where nothing is cut."""
        return largest_fragments(self.active, self.link, self.uncut_links)

    @cached_property
    def coarser(self) -> Self:
        """The same on half the pixels."""
        link, uncut_links = coarser_links(self.main, self.link, self.uncut_links)
        return replace(
            self,
            active=active_blocks(self.active),
            link=link,
            uncut_links=uncut_links,
            **self.coarser_maps(),
        )

    def coarser_maps(self) -> dict[str, Any]:
        """What else half the pixels have."""
        return {}

    @cached_property
    def interpolation(self) -> Interpolation:
        """Linear interpolation from the coarser grid."""
        most = 6 * np.count_nonzero(self.active)
        interpolation = Interpolation(
            regular=np.zeros(self.active.shape),
            start=np.empty(self.active.size + 1, np.int64),
            pixel=np.empty(most, np.int64),
            row=np.empty(most, np.int64),
            column=np.empty(most, np.int64),
            weight=np.empty(most),
        )
        blocks = self.coarser
        cut = blocks.link < blocks.uncut_links
        count = _fill(
            self.active,
            self.main,
            self.link,
            blocks.active,
            blocks.link,
            cut,
            interpolation,
        )
        others: Any = [part[:count].copy() for part in interpolation[2:]]
        return Interpolation(interpolation.regular, interpolation.start, *others)
