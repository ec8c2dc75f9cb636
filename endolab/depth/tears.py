"""Half the pixels of a torn surface: no block of 2×2 pixels mixes the two sides of a cut.

A block that cuts divide stands for its largest part alone, the first of equals; the pixels left out
follow a neighbouring block of their own side, if there is one. So a line of cuts is a line of cuts on
every coarser grid. `link` holds the steps that there are and `whole` those that there would be without
cuts, padded both (see `numerics.compiled`); where nothing is torn they are one array.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from endolab.numerics.arrays import FloatArray
from endolab.numerics.compiled import PAD, halved_links, kernel
from endolab.numerics.derivatives import shifted


@kernel
def _main_parts(active: Any, link: Any, whole: Any, out: Any) -> None:
    """Mark the active pixels of each block that are of its largest part."""
    pixels, part = np.zeros((4, 2), np.int64), np.zeros(4, np.int64)
    for top in range(PAD, active.shape[0] - PAD, 2):
        for first in range(PAD, active.shape[1] - PAD, 2):
            pixels[:, 0] = top, top, top + 1, top + 1
            pixels[:, 1] = first, first + 1, first + 1, first
            # Around the block from pixel to pixel: 0 to 1, 1 to 2, 2 to 3, 3 to 0.
            steps = link[0, top, first], link[1, top, first + 1], link[0, top + 1, first], link[1, top, first]
            would = whole[0, top, first] + whole[1, top, first + 1] + whole[0, top + 1, first]
            is_torn = steps[0] + steps[1] + steps[2] + steps[3] < would + whole[1, top, first]
            part[:] = 0
            if is_torn:
                part[:] = 0, 1, 2, 3
                for _ in range(3):
                    for k in range(4):
                        if steps[k]:
                            part[k] = part[(k + 1) % 4] = min(part[k], part[(k + 1) % 4])
            largest, most = 0, 0
            for one in range(4):
                size = 0
                for k in range(4):
                    size += active[pixels[k, 0], pixels[k, 1]] if part[k] == one else 0
                if size > most:
                    largest, most = one, size
            for k in range(4):
                i, j = pixels[k]
                out[i, j] = active[i, j] if part[k] == largest else 0


def main_parts(active: Any, link: Any, whole: Any) -> Any:
    """Active pixels for which the block that they are in stands."""
    if link is whole:
        return active
    out = np.zeros_like(active)
    _main_parts(active, link, whole, out)
    return out


def coarser_links(main: Any, link: Any, whole: Any) -> tuple[Any, Any]:
    """Links between the main parts of blocks, and those that there would be without cuts."""
    coarse = halved_links(whole)
    if link is whole:
        return coarse, coarse
    there = np.stack([shifted(main, 1, axis, 0) for axis in (1, 0)])
    return halved_links(link & main & there), coarse


def held(link: Any, second: bool) -> Any:
    """Pixels that a difference of ξ along a row or a column takes, first or second, int8.

    Where a region is too thin for any, a picture alone says too little of the way it may move as a whole.
    """
    out = np.zeros_like(link[0])
    for step, axis in ((link[0], 1), (link[1], 0)):
        taken = step & shifted(step, -1, axis, 0) if second else step
        out |= taken | shifted(taken, -1, axis, 0) | (shifted(taken, 1, axis, 0) if second else 0)
    return out


class Strands(NamedTuple):
    """Interpolation from blocks to the pixels beside cuts; what is what by flat indices of padded maps."""

    beside: NDArray[np.int64]  # pixels for which one of the four blocks around is of another side
    pixel: NDArray[np.int64]  # of each pair of a pixel and a block of its side
    block: NDArray[np.int64]
    weight: FloatArray

    def prolong_add(self, step: FloatArray, x: FloatArray) -> None:
        """x += the coarse step, interpolated between the blocks of the pixels' sides."""
        _add_from(self.block, self.pixel, self.weight, step, x)

    def restrict_add(self, r: FloatArray, out: FloatArray) -> None:
        """Adjoint of `prolong_add`."""
        _add_from(self.pixel, self.block, self.weight, r, out)


@kernel
def _add_from(source: Any, target: Any, weight: FloatArray, a: FloatArray, out: FloatArray) -> None:
    """Add weighted elements of one array to those of another."""
    values, sums = a.ravel(), out.reshape(-1)
    for k in range(weight.size):
        sums[target[k]] += weight[k] * values[source[k]]


def _torn(link: Any, whole: Any, i: Any, j: Any, down: Any, right: Any) -> Any:
    """Whether the step from (i, j), down or right by ±1, is cut."""
    axis = (down != 0).astype(np.int64)
    i, j = i + np.minimum(down, 0), j + np.minimum(right, 0)
    return (whole[axis, i, j] != 0) & (link[axis, i, j] == 0)


class Blocks(NamedTuple):
    """A grid of half the pixels: which of its pixels take part, and its links; padded."""

    active: Any
    link: Any
    whole: Any


def sides(main: Any, link: Any, whole: Any, blocks: Blocks, i: Any, j: Any) -> tuple[Any, Any, Any]:
    """Which of the four blocks around the pixels (i, j) are of their side, and where they are, (4, n).

    The four are those that linear interpolation takes: the pixel's own, the nearest beside it, above or
    below it, and on the diagonal.
    """
    down, right, none = 2 * (i % 2) - 1, 2 * (j % 2) - 1, np.zeros_like(i)
    ci, cj = PAD + (i - PAD) // 2, PAD + (j - PAD) // 2
    is_main = main[i, j] > 0

    def reaches(down: Any, right: Any) -> Any:
        """Whether the block on that side may be reached: from block to block, or from pixel to pixel."""
        from_block = is_main & ~_torn(blocks.link, blocks.whole, ci, cj, down, right)
        linked = link[(down != 0).astype(np.int64), i + np.minimum(down, 0), j + np.minimum(right, 0)]
        return from_block | (~is_main & (linked > 0) & (main[i + down, j + right] > 0))

    beside, below = reaches(none, right), reaches(down, none)
    diagonal = beside & ~_torn(blocks.link, blocks.whole, ci, cj + right, down, none)
    diagonal |= below & ~_torn(blocks.link, blocks.whole, ci + down, cj, none, right)
    rows, columns = np.stack([ci, ci, ci + down, ci + down]), np.stack([cj, cj + right, cj, cj + right])
    return np.stack([is_main, beside, below, diagonal]) & (blocks.active[rows, columns] > 0), rows, columns


def strands(active: Any, main: Any, link: Any, whole: Any, blocks: Blocks) -> Strands:
    """Linear interpolation from the blocks of a pixel's side, for active pixels with another side near."""
    i, j = np.nonzero(active)
    of_side, rows, columns = sides(main, link, whole, blocks, i, j)
    beside = ((blocks.active[rows, columns] > 0) & ~of_side).any(axis=0)
    weight = (np.array([[9.0], [3.0], [3.0], [1.0]]) * of_side)[:, beside]
    weight /= np.maximum(weight.sum(axis=0), 1.0)
    pixel = (i * active.shape[1] + j)[beside]
    block = (rows * blocks.active.shape[1] + columns)[:, beside]
    kept = weight > 0
    return Strands(pixel, np.broadcast_to(pixel, weight.shape)[kept], block[kept], weight[kept])
