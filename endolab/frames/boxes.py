"""Boxes on the screen, such as menus and second pictures: their edges are straight along rows and columns."""

import cv2
import numpy as np

from endolab.frames.surround import dilate
from endolab.numerics.arrays import BoolArray, FloatArray, IntArray

SIDE = 320  # px of the longer side of what is looked at


def find_box(
    image: FloatArray,
    mask: BoolArray,
    *,
    shortest: int = 12,
    largest: float = 0.5,
    covered: float = 0.55,
) -> tuple[int, ...] | None:
    """Find the box that most probably covers the wall: its columns, from and to, and its rows; or None.

    Sides may be the picture's border, but for two of them. A fold leaves a row after some pixels, and no four
    make a rectangle. A side is `shortest` px of what is looked at or more, a box at most the share `largest`
    of it, and each side an edge along the share `covered`.
    """
    step = max(1, round(max(mask.shape) / SIDE))
    few = np.atleast_3d(np.nan_to_num(image[::step, ::step]))
    inner = ~dilate(~mask[::step, ::step], 1)
    rows, y = _edges(few, inner)
    columns, x = _edges(few.swapaxes(0, 1), inner.T)
    # Every pair of rows with every pair of columns.
    (top, bottom), (left, right) = (
        line[np.array(np.triu_indices(len(line), 1))] for line in (y, x)
    )
    top, bottom = top[:, None], bottom[:, None]
    wide, high = right - left, bottom - top
    fits = (wide >= shortest) & (high >= shortest) & (wide * high <= largest * inner.size)
    score = np.zeros(fits.shape)
    sides = np.zeros(fits.shape)
    for edges, first, last, length, places in (
        (rows, left, right, wide, (top, bottom)),
        (columns, top, bottom, high, (left, right)),
    ):
        for place in places:
            real = (place > 0) & (place < len(edges) - 1)
            found = edges[place, last] - edges[place, first]
            fits &= ~real | (found > covered * length)
            score += real * (2 * found - length)
            sides += real
    score[~fits | (sides < 2)] = 0
    if not score.any():
        return None
    i, j = np.unravel_index(score.argmax(), score.shape)
    ends = left[j], right[j], top[i, 0], bottom[i, 0]
    return tuple(int(step * end) for end in ends)


def flat_boxes(image: FloatArray, mask: BoolArray) -> BoolArray:
    """Find boxes of one colour, with text or not, (H, W), edges included: surely no wall."""
    found = np.zeros(mask.shape, bool)
    edge = max(1, round(max(mask.shape) / SIDE))
    while box := find_box(image, mask & ~found):
        left, right, top, bottom = box
        inside = np.atleast_3d(image[top:bottom, left:right])
        off = np.abs(inside - np.median(inside, axis=(0, 1))).max(axis=-1)
        if np.mean(off < 3 / 255) < 0.5:  # as near to the box's own colour
            break
        found[max(top - edge, 0) : bottom + edge, max(left - edge, 0) : right + edge] = True
    return found


def _edges(
    picture: FloatArray,
    inner: BoolArray,
    *,
    step: float = 0.02,
    sharp: float = 2.0,
    lines: int = 12,
) -> tuple[FloatArray, IntArray]:
    """Count the sharp edges above the pixels before one, (H + 1, W + 1).

    Across an edge a stored value changes by more than `step`, and `sharp` times as much as beside it.
    Returned, too, are so many rows, `lines`, with most of them, the picture's borders among these.
    """
    change = np.maximum.reduce(cv2.split(np.abs(np.diff(picture, axis=0))))
    change[~(inner[1:] & inner[:-1])] = 0
    beside = np.maximum(np.roll(change, 2, axis=0), np.roll(change, -2, axis=0))
    is_edge = (change > step) & (change > sharp * beside)
    counts = np.pad(np.cumsum(is_edge, axis=1, dtype=float), ((1, 1), (1, 0)))
    most = np.argsort(counts[:, -1])[-lines:]
    return counts, np.unique([0, len(counts) - 1, *most])
