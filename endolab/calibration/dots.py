"""Find the dots of a coded grid, or of an asymmetric grid, and say which they are.

A dot's bit is its darkness over the area of its lattice cell, which neither tilt nor blur changes.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from endolab.calibration.blobs import Blobs, find_blobs
from endolab.calibration.lattice import find_lattices, grow, local_fit, steps, surroundings, cross
from endolab.calibration.targets import CircleGrid, DotGrid
from endolab.operators import BoolArray, FloatArray, IntArray

def _cells(owner: IntArray, blobs: Blobs) -> FloatArray:
    """Area of a lattice's cells, px²."""
    return _cross(*_steps(np.where(owner[..., None] >= 0, blobs.centres[owner], np.nan)))


def read_bits(owner: IntArray, blobs: Blobs, cell: FloatArray, gap: float) -> FloatArray:
    """How much larger or smaller each dot is than the mean of the two sizes.

    Parameters
    ----------
    owner : (h, w) int array
        Which blob is at each place of the lattice.
    blobs : Blobs
    cell : (h, w) float array
        Area of the lattice's cell there, px².
    gap : float
        Logarithm of the ratio of the areas of large and small dots.

    Returns
    -------
    (h, w) float array
        About -1 for a small and 1 for a large dot; nan where there is none.
    """
    size = np.full(owner.shape, np.nan)
    known = (owner >= 0) & (cell > 0)
    size[known] = np.log(blobs.ink[owner[known]] / cell[known])
    row, column = np.nonzero(known)
    values = size[known]
    level = _split(values, gap)
    design = np.column_stack([np.ones(len(row)), row - row.mean(), column - column.mean()])
    for _ in range(3):
        # The level drifts over the picture with the white's exposure.
        rest = values - np.where(values > level, gap, -gap) / 2
        weight = np.abs(rest - level) < gap / 2
        if weight.sum() < 12:
            break
        level = design @ np.linalg.lstsq(design[weight], rest[weight], rcond=None)[0]
    size[known] = (values - level) / (gap / 2)
    return size


def _split(values: FloatArray, gap: float) -> FloatArray:
    """Level halfway between two clusters that lie a known gap apart, the same for all values."""
    levels = np.linspace(values.min() - gap / 2, values.max() + gap / 2, 100)
    miss = np.abs(np.abs(values - levels[:, None]) - gap / 2)
    return np.full(len(values), levels[np.minimum(miss, gap / 2).sum(axis=1).argmin()])


_TURNS = [
    np.array(entries).reshape(2, 2)
    for entries in product((0, 1, -1, 2, -2), repeat=4)
    if entries[0] * entries[3] - entries[1] * entries[2] == 1
]


def match_code(size: FloatArray, code: IntArray) -> IntArray | None:
    """Say where on the sheet a piece of the lattice lies.

    Parameters
    ----------
    size : (h, w) float array
        From `read_bits`.
    code : (rows, columns) int array
        1 where the target's dot is large.

    Returns
    -------
    (h, w, 2) int array or None
        Row and column on the sheet for each place; None where no match is clear.
    """
    places = np.argwhere(np.isfinite(size))
    value = size[np.isfinite(size)]
    bit = np.sign(value) * np.minimum(np.abs(value), 1)
    rows, columns = code.shape
    pad = 2
    padded = np.pad(2.0 * code - 1, pad)
    found: list[tuple[float, int, int, int]] = []
    trials = 0
    for number, turn in enumerate(_TURNS):
        spot = places @ turn.T
        low = spot.min(axis=0)
        spot = spot - low
        spare = np.array(padded.shape) - spot.max(axis=0)
        if spare.min() <= 0:
            continue
        i, j = np.indices(spare).reshape(2, -1)
        trials += len(i)
        score = padded[spot[:, 0] + i[:, None], spot[:, 1] + j[:, None]] @ bit
        for best in np.argsort(-score)[:2]:
            offset = np.array([i[best], j[best]]) - low - pad
            found.append((float(score[best]), number, int(offset[0]), int(offset[1])))
    if not found:
        return None
    found.sort(reverse=True)
    total = np.abs(bit).sum()
    best_score = found[0][0]
    # Chance of so few errors for random bits, times the placements tried (Chernoff's bound).
    wrong = np.clip((1 - best_score / total) / 2, 1e-9, 0.5)
    rarity = total * (np.log(2) + wrong * np.log(wrong) + (1 - wrong) * np.log(1 - wrong))
    second = found[1][0] if len(found) > 1 else -np.inf
    if wrong > 0.1 or rarity < np.log(trials) + 5 or best_score - second < 3:
        return None
    _, number, row, column = found[0]
    return np.moveaxis(np.indices(size.shape), 0, -1) @ _TURNS[number].T + [row, column]


def _sound(sheet: IntArray, blobs: Blobs, panel: IntArray, code: IntArray, gap: float) -> BoolArray:
    """Which dots lie where their neighbours place them and are as large as the code says."""
    grid = np.where(sheet[..., None] >= 0, blobs.centres[sheet], np.nan)
    miss, cell = _local_fit(grid, panel)
    row, column = np.indices(sheet.shape).reshape(2, -1)
    known = np.where(np.isfinite(miss) & (sheet >= 0), miss, np.nan)[..., None]
    nearby = _windows(known, row, column)[:, 1:-1, 1:-1].reshape(len(row), -1)
    nearby[:, 0] = np.where(np.isfinite(nearby).any(axis=1), nearby[:, 0], 0.0)
    usual = np.nanmedian(nearby, axis=1).reshape(sheet.shape)
    with np.errstate(invalid="ignore"):
        pixel = 1 / np.sqrt(cell)
        fits = np.abs(read_bits(sheet, blobs, cell, gap) - (2 * code - 1)) < 0.8
    return (sheet >= 0) & fits & (miss <= np.minimum(3 * usual + 0.3 * pixel, 0.12))


def detect_dots(image: FloatArray, target: DotGrid) -> tuple[IntArray, FloatArray, str]:
    """Find the dots of a coded grid.

    Parameters
    ----------
    image : (H, W) float32 array
        Stored values in [0, 1].
    target : DotGrid

    Returns
    -------
    (n,) int array
        Which dots, ascending.
    (n, 2) float array
        Where, px.
    str
        Why none, if none.
    """
    none = np.zeros(0, int), np.zeros((0, 2))
    blobs = find_blobs(image)
    if len(blobs.centres) < LEAST_DOTS:
        return *none, f"too few dark spots ({len(blobs.centres)})"
    gap = 2 * np.log(target.large / target.small)
    size = 2 * (target.columns + target.rows) + 5
    # Of a cell; ink is not quite black, and the cell not quite known.
    share = tuple(np.pi * (radius / target.spacing) ** 2 for radius in (target.small, target.large))
    share = (0.35 * share[0], 2.2 * share[1])
    pieces = find_lattices(blobs, share, size)
    if not pieces:
        return *none, "the dark spots form no grid"
    code = target.code
    sheet = np.full(code.shape, -1)
    for piece in pieces:
        spot = match_code(read_bits(piece, blobs, _cells(piece, blobs), gap), code)
        if spot is None:
            continue
        on = (piece >= 0) & np.all((spot >= 0) & (spot < code.shape), axis=-1)
        free = on & (sheet[tuple(np.where(on[..., None], spot, 0).reshape(-1, 2).T)].reshape(on.shape) < 0)
        sheet[tuple(spot[free].T)] = piece[free]
    if np.all(sheet < 0):
        return *none, "the code of the dots does not match"
    sheet = grow(sheet, blobs, share, 0.25)
    panel = target.panel_of(target.points).reshape(code.shape)
    for _ in range(2):
        sheet = np.where(_sound(sheet, blobs, panel, code, gap), sheet, -1)
    if np.all(sheet < 0):
        return *none, "the dots do not lie on a smooth sheet"
    ids = np.flatnonzero(sheet.ravel() >= 0)
    return ids, blobs.centres[sheet.ravel()[ids]], ""
