"""Half the pixels of a cut surface: no block of 2×2 pixels mixes the two sides of a cut.

A block that cuts divide stands for its largest fragment alone, of equals that nearer the middle, which lies
behind the other most often. Pixels left out (·) follow a neighbouring block of their side, if there is one:

    a  a ┆ a ┃ b ┆ b  b           a  a ┆ a  · ┆ b  b
         ┆   ┗━━━┪        main         ┆      ┆        blocks
    a  a ┆ a  a  ┃ b  b  ----->   a  a ┆ a  a ┆ b  b  ------->   A   A ┃ B

So a line of cuts is a line of cuts on every coarser grid: two blocks are linked where a pair of their pixels
is, p of the one and q of the other, next to each other,

    link(A, B) = ⋁ main(p) ∧ main(q) ∧ link(p, q),        cut = uncut_link ∧ ¬ link.

`link` holds the steps that there are and `uncut_links` those that there would be without cuts, both padded
(`numerics.compiled`); where nothing is cut they are one array.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from endolab.numerics.arrays import ByteArray
from endolab.numerics.compiled import PAD, halve_links, kernel
from endolab.numerics.stencils import shift


@kernel
def _largest_fragments(
    active: ByteArray,
    link: ByteArray,
    uncut_links: ByteArray,
    out: ByteArray,
) -> None:
    """Mark the active pixels of each block that are of its largest part."""
    pixels = np.zeros((4, 2), np.int64)
    part = np.zeros(4, np.int64)
    middle = (active.shape[0] - 1) / 2, (active.shape[1] - 1) / 2
    for top in range(PAD, active.shape[0] - PAD, 2):
        for first in range(PAD, active.shape[1] - PAD, 2):
            pixels[:, 0] = top, top, top + 1, top + 1
            pixels[:, 1] = first, first + 1, first + 1, first
            # Around the block from pixel to pixel: 0 to 1, 1 to 2, 2 to 3, 3 to 0.
            steps = (
                link[0, top, first],
                link[1, top, first + 1],
                link[0, top + 1, first],
                link[1, top, first],
            )
            would = (
                uncut_links[0, top, first]
                + uncut_links[1, top, first + 1]
                + uncut_links[0, top + 1, first]
            )
            is_divided = (
                steps[0] + steps[1] + steps[2] + steps[3]
                < would + uncut_links[1, top, first]
            )
            part[:] = 0
            if is_divided:
                part[:] = 0, 1, 2, 3
                for _ in range(3):
                    for k in range(4):
                        if steps[k]:
                            part[k] = part[(k + 1) % 4] = min(part[k], part[(k + 1) % 4])
            largest = 0
            most = 0.0
            for label in range(4):
                size = 0.0
                for k in range(4):
                    i, j = pixels[k]
                    if part[k] == label and active[i, j]:
                        # Of equals that nearer the picture's middle: it lies behind the other, most often.
                        size += 1 - 1e-9 * ((i - middle[0]) ** 2 + (j - middle[1]) ** 2)
                if size > most:
                    largest = label
                    most = size
            for k in range(4):
                i, j = pixels[k]
                out[i, j] = active[i, j] if part[k] == largest else 0


def largest_fragments(
    active: ByteArray, link: ByteArray, uncut_links: ByteArray
) -> ByteArray:
    """Active pixels for which the block that they are in stands."""
    if link is uncut_links:
        return active
    out = np.zeros_like(active)
    _largest_fragments(active, link, uncut_links, out)
    return out


def coarser_links(
    main: ByteArray, link: ByteArray, uncut_links: ByteArray
) -> tuple[ByteArray, ByteArray]:
    """Links between the main parts of blocks, and those that there would be without cuts."""
    coarse = halve_links(uncut_links)
    if link is uncut_links:
        return coarse, coarse
    next_main = np.stack([shift(main, 1, axis, 0) for axis in (1, 0)])
    return halve_links(link & main & next_main), coarse


class Cells(NamedTuple):
    """Which pixels of a grid, or blocks of them, take part, and their links; padded."""

    active: ByteArray
    link: ByteArray
    uncut_links: ByteArray


@kernel
def _is_cut(
    link: ByteArray, uncut_links: ByteArray, i: int, j: int, down: int, right: int
) -> bool:
    """Whether the step from (i, j), down or right by ±1, is cut."""
    axis = abs(down)
    i = i + min(down, 0)
    j = j + min(right, 0)
    return uncut_links[axis, i, j] and not link[axis, i, j]


@kernel
def same_side(
    main: ByteArray,
    link: ByteArray,
    uncut_links: ByteArray,
    blocks: Cells,
    i: int,
    j: int,
) -> tuple[bool, bool, bool, bool]:
    """Which of the four blocks around a pixel are of its side.

    The four are those that linear interpolation takes: the pixel's own, the nearest beside it, above or
    below it, and on the diagonal. A block is reached from block to block, or from pixel to pixel.
    """
    active, across, uncut = blocks
    down = 2 * ((i - PAD) % 2) - 1
    right = 2 * ((j - PAD) % 2) - 1
    ci = PAD + (i - PAD) // 2
    cj = PAD + (j - PAD) // 2
    if main[i, j]:
        beside = not _is_cut(across, uncut, ci, cj, 0, right)
        below = not _is_cut(across, uncut, ci, cj, down, 0)
    else:
        beside = link[0, i, j + min(right, 0)] > 0 and main[i, j + right] > 0
        below = link[1, i + min(down, 0), j] > 0 and main[i + down, j] > 0
    diagonal = beside and not _is_cut(across, uncut, ci, cj + right, down, 0)
    diagonal = diagonal or (below and not _is_cut(across, uncut, ci + down, cj, 0, right))
    return (
        main[i, j] > 0 and active[ci, cj] > 0,
        beside and active[ci, cj + right] > 0,
        below and active[ci + down, cj] > 0,
        diagonal and active[ci + down, cj + right] > 0,
    )


@kernel
def nearest_blocks(of_side: tuple[bool, bool, bool, bool]) -> tuple[int, int]:
    """The first and the last of the blocks that are reached and nearest, which may be two; 4 if none is."""
    own, beside, below, diagonal = of_side
    if own or not (beside or below):
        only = 0 if own else 3 if diagonal else 4
        return only, only
    return 1 if beside else 2, 2 if below else 1
