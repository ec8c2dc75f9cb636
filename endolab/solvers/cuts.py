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
from endolab.numerics.compiled import PAD, halve_links
from endolab.numerics.stencils import shift


def largest_fragments(
    active: ByteArray, link: ByteArray, uncut_links: ByteArray
) -> ByteArray:
    """Active pixels for which the block that they are in stands."""
    if link is uncut_links:
        return active
    height, width = active.shape
    cut = uncut_links > link
    across = cut[0] | shift(cut[0], 1, 0, False)
    within = across | cut[1] | shift(cut[1], 1, 1, False)
    divided = np.nonzero(within[PAD : height - PAD : 2, PAD : width - PAD : 2])
    i, j = (PAD + 2 * places for places in divided)

    # Around the block from pixel to pixel: 0 to 1, 1 to 2, 2 to 3, 3 to 0.
    rows = np.stack([i, i, i + 1, i + 1])
    columns = np.stack([j, j + 1, j + 1, j])
    joined = [link[0, i, j], link[1, i, j + 1], link[0, i + 1, j], link[1, i, j]]
    part = np.repeat(np.arange(4), i.size).reshape(4, -1)
    for k in 3 * (0, 1, 2, 3):
        pair = part[[k, (k + 1) % 4]]
        part[[k, (k + 1) % 4]] = np.where(joined[k] > 0, pair.min(axis=0), pair)

    # Of equals that nearer the picture's middle: it lies behind the other, most often. Of halves on either
    # side of the middle that which hangs by more links, so that a mirrored picture has the mirrored parts.
    away = (rows - (height - 1) / 2) ** 2 + (columns - (width - 1) / 2) ** 2
    link_count = link[0] + link[1] + shift(link[0], -1, 1, 0) + shift(link[1], -1, 0, 0)
    size = active[rows, columns] * (1 - 1e-9 * away + 1e-12 * link_count[rows, columns])
    sizes = [(size * (part == label)).sum(axis=0) for label in range(4)]
    out = active.copy()
    out[rows, columns] *= part == np.argmax(sizes, axis=0)
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
