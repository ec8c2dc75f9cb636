"""Find the dots of a coded grid, and say which they are.

A dot's bit is its darkness over the area of its lattice cell, which neither tilt nor blur changes.
"""

from itertools import product
from typing import Any

import numpy as np

from endolab.calibration.detection.blobs import Blobs, find_blobs
from endolab.calibration.detection.lattice import (
    check_places,
    cross,
    find_lattices,
    grow,
    steps,
)
from endolab.calibration.targets import DotGrid
from endolab.numerics.arrays import FloatArray, IntArray

Found = tuple[IntArray, FloatArray, str]  # ids, pixels, and the reason why there are none
# Of a piece of a lattice on a padded table: sum of products, number of the turn, shift.
Placement = tuple[float, int, tuple[int, int]]


# When a piece of a lattice is a part of the sheet; chosen by hand.
LEAST_DOTS = 20  # to tell the code by
PAD = 2  # columns and rows beside the sheet in which false spots may lie
MOST_WRONG = 0.1  # share of the bits
SURETY = 5.0  # logarithm of the odds against a match by chance
MOST_OFF = 0.8  # of a dot's size, where 1 is halfway to the other size


def _places(owner: IntArray, blobs: Blobs) -> FloatArray:
    """Where the blobs of a lattice are, (h, w, 2), px; nan where there is none."""
    return np.where(owner[..., None] >= 0, blobs.centres[owner], np.nan)


def read_bits(
    owner: IntArray,
    blobs: Blobs,
    cell: FloatArray,
    gap: float,
) -> FloatArray:
    """How much larger or smaller each dot is than the mean of the two sizes: about -1 or 1; nan if none.

    `owner`, (h, w), is which blob is at each place of the lattice, `cell` the area of its cell there, px²,
    `gap` the logarithm of the ratio of the areas of large and small dots.
    """
    size = np.full(owner.shape, np.nan)
    known = (owner >= 0) & (cell > 0)
    size[known] = np.log(blobs.ink[owner[known]] / cell[known])
    place = np.argwhere(known)
    values = size[known]
    level = _split(values, gap)
    design = np.column_stack([np.ones(len(place)), place - place.mean(axis=0)])
    for _ in range(3):
        # The level drifts over the picture with the white's exposure.
        rest = values - np.where(values > level, gap, -gap) / 2
        weight = np.abs(rest - level) < gap / 2
        if weight.sum() < 12:
            break
        level = design @ np.linalg.lstsq(design[weight], rest[weight], rcond=None)[0]
    size[known] = (values - level) / (gap / 2)
    return size


def _split(values: FloatArray, gap: float) -> Any:
    """Level halfway between two clusters that lie a known gap apart."""
    levels = np.linspace(values.min() - gap / 2, values.max() + gap / 2, 100)
    miss = np.abs(np.abs(values - levels[:, None]) - gap / 2)
    return levels[np.minimum(miss, gap / 2).sum(axis=1).argmin()]


# Turns and shears of a lattice: small whole matrices of determinant 1, plain ones first.
MATRICES = np.array(list(product((0, 1, -1, 2, -2), repeat=4))).reshape(-1, 2, 2)
TURNS = MATRICES[np.round(np.linalg.det(MATRICES)) == 1]


def _placements(
    places: IntArray,
    value: FloatArray,
    table: FloatArray,
) -> tuple[list[Placement], int]:
    """Try all turns, shears and shifts of a piece of a lattice over a table; never mirrored.

    Returns the best two shifts of each turn, best first; and how many were tried. A piece must lie within
    the table.
    """
    placements: list[Placement] = []
    trials = 0
    for number, turn in enumerate(TURNS):
        spot = places @ turn.T
        low = spot.min(axis=0)
        spot = spot - low
        spare = np.array(table.shape) - spot.max(axis=0)
        if spare.min() <= 0:
            continue
        i, j = np.indices(spare).reshape(2, -1)
        trials += len(i)
        score = table[spot[:, 0] + i[:, None], spot[:, 1] + j[:, None]] @ value
        for best in np.argsort(-score)[:2]:
            shift = int(i[best] - low[0]), int(j[best] - low[1])
            placements.append((float(score[best]), number, shift))
    return sorted(placements, reverse=True), trials


def _lay(
    piece: IntArray,
    placement: Placement,
    shape: tuple[int, int],
) -> IntArray:
    """Lay a piece of a lattice onto a sheet of a shape, whose table is padded: which blob is where."""
    _, turn, shift = placement
    place = np.argwhere(piece >= 0)
    on_sheet = place @ TURNS[turn].T + shift - PAD
    inside = np.all((on_sheet >= 0) & (on_sheet < shape), axis=1)
    sheet = np.full(shape, -1)
    sheet[tuple(on_sheet[inside].T)] = piece[tuple(place[inside].T)]
    return sheet


def match_code(size: FloatArray, code: IntArray) -> Placement | None:
    """Say how a piece of the lattice lies on the sheet, whose sizes `read_bits` gave; None if not clear."""
    value = np.clip(size[np.isfinite(size)], -1, 1)
    table = np.pad(2.0 * code - 1, PAD)
    placements, trials = _placements(np.argwhere(np.isfinite(size)), value, table)
    if not placements:
        return None
    total = np.abs(value).sum()
    score = placements[0][0]
    second = placements[1][0] if len(placements) > 1 else -np.inf
    # Chance of so few errors for random bits, times the placements tried (Chernoff's bound).
    wrong = np.clip((1 - score / total) / 2, 1e-9, 0.5)
    rarity = total * (np.log(2) + wrong * np.log(wrong) + (1 - wrong) * np.log(1 - wrong))
    if wrong > MOST_WRONG or score - second < 3:
        return None
    return placements[0] if rarity >= np.log(trials) + SURETY else None


def _cover(target: DotGrid) -> tuple[float, float]:
    """Least and largest share of its cell that a dot may seem to cover.

    Ink is not quite black, and near the rim of a lattice its cell is not quite known.
    """
    areas = np.pi * target.radii**2 / target.spacing**2
    return 0.35 * float(areas.min()), 2.2 * float(areas.max())


def detect_dots(image: FloatArray, target: DotGrid) -> Found:
    """Find the dots of a coded grid in (H, W) float32 of [0, 1]: ids, ascending; pixels; why none."""
    blobs = find_blobs(image, greys=target.greys is not None)
    if len(blobs) < LEAST_DOTS:
        return no_features("too few dark spots")
    gap = 2 * np.log(target.large / target.small)
    cover = _cover(target)
    pieces = find_lattices(blobs, cover, 2 * (target.columns + target.rows) + 5)
    if not pieces:
        return no_features("the dark spots form no grid")
    code = target.code
    sheet = np.full(code.shape, -1)
    for piece in pieces:
        cell = cross(*steps(_places(piece, blobs)))
        placement = match_code(read_bits(piece, blobs, cell, gap), code)
        if placement is not None:
            laid = _lay(piece, placement, code.shape)
            sheet = np.where(laid >= 0, laid, sheet)
    if np.all(sheet < 0):
        return no_features("the code of the dots does not match")
    sheet = grow(
        sheet,
        blobs,
        cover,
        0.25,
    )
    panel = target.panel_of(target.points).reshape(code.shape)
    for _ in range(2):
        fits, cell = check_places(_places(sheet, blobs), panel)
        off = np.abs(read_bits(sheet, blobs, cell, gap) - (2 * code - 1))
        fits &= off < MOST_OFF
        sheet = np.where(fits, sheet, -1)
        if (sheet >= 0).sum() < LEAST_DOTS:
            return no_features("the dots do not lie on a smooth sheet")
    ids = np.flatnonzero(sheet >= 0)
    return ids, blobs.centres[sheet.ravel()[ids]], ""


def no_features(reason: str) -> Found:
    """Give no features, and the reason."""
    return np.zeros(0, int), np.zeros((0, 2)), reason
