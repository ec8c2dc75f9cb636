"""Find the dots of a coded grid, and say which they are.

A dot's bit is its darkness over the area of its lattice cell, which neither tilt nor blur changes.
"""

from itertools import product

import numpy as np

from endolab.calibration import constants
from endolab.calibration.detection.blobs import Blobs, find_blobs
from endolab.calibration.detection.lattice import (
    check_places,
    find_lattices,
    places_of,
)
from endolab.calibration.refusals import Refusal
from endolab.calibration.targets import DotGrid
from endolab.numerics.arrays import FloatArray, IntArray, nan_if_undefined


def read_bits(owner: IntArray, blobs: Blobs, cell: FloatArray, gap: float) -> FloatArray:
    """How much larger or smaller each dot is than the mean of the two sizes: about -1 or 1; nan if none.

    `owner`, (h, w), is which blob is at each place of the lattice, `cell` the area of its cell there, px²,
    `gap` the logarithm of the ratio of the areas of large and small dots.
    """
    with nan_if_undefined():
        values = np.log(
            np.where((owner >= 0) & (cell > 0), blobs.ink[owner] / cell, np.nan)
        )
    level = np.nanquantile(values, [0.1, 0.9]).mean()
    return (values - level) / (gap / 2)


# Turns and shears of a lattice: small whole matrices of determinant 1, plain ones first.
MATRICES = np.array(list(product((0, 1, -1, 2, -2), repeat=4))).reshape(-1, 2, 2)
TURNS = MATRICES[np.round(np.linalg.det(MATRICES)) == 1]


def match_code(places: IntArray, size: FloatArray, code: IntArray) -> IntArray | None:
    """Move places of a lattice, (n, 2), onto the sheet by their sizes (`read_bits`); None if not clear.

    All turns, shears and shifts of a piece are tried, never mirrored; it must lie within the sheet.
    """
    value = np.clip(size, -1, 1)
    best = -np.inf
    trials = 1
    for turn in TURNS:
        spot = places @ turn.T
        spot = spot - spot.min(axis=0)
        spare = np.array(code.shape) - spot.max(axis=0)
        if spare.min() <= 0:
            continue
        shift = np.argwhere(np.ones(spare))
        row, column = (spot + shift[:, None]).transpose(2, 0, 1)
        score = (2 * code - 1)[row, column] @ value
        trials += len(shift)
        if score.max() > best:
            best = score.max()
            onto = spot + shift[score.argmax()]
    # Chance of so few errors for random bits, times the placements tried (Chernoff's bound), below e⁻⁵.
    total = np.abs(value).sum()
    wrong = np.clip((1 - best / total) / 2, 1e-9, 0.5)
    rarity = total * (np.log(2) + wrong * np.log(wrong) + (1 - wrong) * np.log(1 - wrong))
    return onto if rarity >= np.log(trials) + 5 else None


def detect_dots(image: FloatArray, target: DotGrid) -> tuple[IntArray, FloatArray]:
    """Find the dots of a coded grid in (H, W) float32 of [0, 1]: ids, ascending, and pixels."""
    blobs = find_blobs(image)
    Refusal.FEW_SPOTS.if_(len(blobs.ink) < constants.LEAST_DOTS)
    gap = 2 * np.log(target.large / target.small)
    area = np.pi * target.radii**2 / target.spacing**2
    # Ink is not quite black, and near the rim of a lattice its cell is not quite known.
    cover = 0.35 * float(area.min()), 2.2 * float(area.max())
    pieces = find_lattices(blobs, cover, 2 * (target.columns + target.rows) + 5)
    Refusal.NO_GRID.if_(not pieces)
    code = target.code
    sheet = np.full(code.shape, -1)
    for piece in pieces:
        _, cell = check_places(places_of(piece, blobs), np.zeros(piece.shape, int))
        size = read_bits(piece, blobs, cell, gap)
        places = np.argwhere(np.isfinite(size))
        onto = match_code(places, size[tuple(places.T)], code)
        if onto is not None:
            sheet[tuple(onto.T)] = piece[tuple(places.T)]
    Refusal.OTHER_CODE.if_(np.all(sheet < 0))
    panel = target.panel_of(target.points).reshape(code.shape)
    for _ in range(2):
        fits, cell = check_places(places_of(sheet, blobs), panel)
        off = np.abs(read_bits(sheet, blobs, cell, gap) - (2 * code - 1))
        # Halfway to the other size is 1.
        sheet = np.where(fits & (off < 0.8), sheet, -1)
        Refusal.ROUGH_DOTS.if_((sheet >= 0).sum() < constants.LEAST_DOTS)
    ids = np.flatnonzero(sheet >= 0)
    return ids, blobs.centres[sheet.ravel()[ids]]
