"""What is printed on a sheet, and how much of the light it swallows, cell by cell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from endolab.operators import FloatArray


@dataclass(frozen=True)
class Ink:
    """What is printed: black discs, black rectangles, grey discs.

    Attributes
    ----------
    discs : (n, 3) float array
        Centre x, y and radius, mm.
    rectangles : (n, 4) float array
        Left, top, width, height, mm.
    greys : (n, 4) float array
        Centre x, y, radius, mm, and reflectance relative to the white of the paper.
    """

    discs: FloatArray
    rectangles: FloatArray
    greys: FloatArray


def rows_of(values: ArrayLike, columns: int) -> FloatArray:
    """Make a table of so many columns of a list that may be empty."""
    return np.asarray(values, dtype=np.float64).reshape(-1, columns)


def darkness(
    ink: Ink, corner: ArrayLike, shape: Sequence[int], step: float, black: float = 0.0
) -> NDArray[np.float32]:
    """Average what is printed over the cells of a raster.

    Parameters
    ----------
    ink : Ink
    corner : two floats
        x and y of the raster's upper left corner, mm; what lies outside is left out.
    shape : two ints
        Its rows and columns.
    step : float
        Side of a cell, mm.
    black : float
        Reflectance of the ink, relative to the paper.

    Returns
    -------
    (rows, columns) float32 array
        1 - reflectance: 0 where the paper is bare. Exact for rectangles; the rim of a disc is
        taken as straight within a cell.
    """
    dark = np.zeros(shape, np.float32)
    left, top = np.asarray(corner, dtype=np.float64)

    def span(start: float, length: float, count: int) -> tuple[int, int]:
        """First and last (excluded) cell that an interval touches."""
        first, last = np.floor(start / step - 0.5), np.ceil((start + length) / step + 0.5)
        return int(np.clip(first, 0, count)), int(np.clip(last, 0, count))

    for x, y, radius, reflectance in [*((*disc, black) for disc in ink.discs), *ink.greys]:
        (r0, r1), (c0, c1) = (
            span(middle - radius, 2 * radius, count)
            for middle, count in zip((y - top, x - left), shape, strict=True)
        )
        down = (np.arange(r0, r1) + 0.5) * step - (y - top)
        across = (np.arange(c0, c1) + 0.5) * step - (x - left)
        cover = np.clip((radius - np.hypot(down[:, None], across)) / step + 0.5, 0, 1)
        dark[r0:r1, c0:c1] += cover * (1 - reflectance)
    for x, y, width, height in ink.rectangles:
        covers, cells = [], []
        for start, length, count in ((y - top, height, shape[0]), (x - left, width, shape[1])):
            first, last = span(start, length, count)
            edges = np.clip(np.arange(first, last + 1), start / step, (start + length) / step)
            covers.append(edges[1:] - edges[:-1])
            cells.append(slice(first, last))
        dark[tuple(cells)] += np.outer(*covers) * (1 - black)
    return dark
