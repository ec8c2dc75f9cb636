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
            joined = (
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
                joined[0] + joined[1] + joined[2] + joined[3]
                < would + uncut_links[1, top, first]
            )
            part[:] = 0
            if is_divided:
                part[:] = 0, 1, 2, 3
                for _ in range(3):
                    for k in range(4):
                        if joined[k]:
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
