"""Order spots into a lattice, by local prediction.

All steps are local in the picture, so no camera is needed: each next spot is predicted from its
neighbours, which follows fisheye curvature, perspective and the kink at a fold.
"""

from itertools import product

import numpy as np
import scipy

from endolab.calibration.detection.blobs import Blobs
from endolab.numerics.arrays import BoolArray, FloatArray, IntArray, nan_if_undefined

EIGHT_NEIGHBOURS = [step for step in product((-1, 0, 1), repeat=2) if step != (0, 0)]


# What a piece of a lattice is, and how far its features may lie off; chosen by hand.
LEAST_SPOTS = 12  # of a piece
MOST_PIECES = 6
SLACK = 0.3  # px that a feature may lie off, beyond what is usual
MOST_MISS = 0.12  # the same at most, lattice steps


def _mean(values: FloatArray) -> FloatArray:
    """Mean of the known ones of vectors (n, k, 2); nan where none is."""
    known = np.isfinite(values[..., :1])
    with nan_if_undefined():
        return np.where(known, values, 0).sum(axis=1) / known.sum(axis=1)


def steps(grid: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Give the local steps in the picture along a row and along a column of the lattice, (h, w, 2)."""
    return _steps_along(grid), _steps_along(grid.swapaxes(0, 1)).swapaxes(0, 1)


def _steps_along(grid: FloatArray) -> FloatArray:
    """Average the step to the next place of a row and that from the one before."""
    step = np.pad(np.diff(grid, axis=1), ((0, 0), (1, 1), (0, 0)), constant_values=np.nan)
    both = np.stack([step[:, 1:], step[:, :-1]], axis=2)
    return _mean(both.reshape(-1, 2, 2)).reshape(grid.shape)


def _in_cells(
    vector: FloatArray,
    along: FloatArray,
    down: FloatArray,
) -> FloatArray:
    """Express vectors of the picture in lattice steps."""
    areas = np.stack([cross(vector, down), cross(along, vector)], axis=-1)
    with nan_if_undefined():
        return areas / cross(along, down)[..., None]


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Give the area that pairs of vectors span."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def grow(
    owner: IntArray,
    blobs: Blobs,
    cover: tuple[float, float],
    tolerance: float,
) -> IntArray:
    """Grow a lattice: predict each next dot from its neighbours and take the blob that lies there.

    `owner`, (h, w), is which blob is at each place, -1 where none; `cover` the least and largest share of
    its cell that a dot may cover; `tolerance`, in lattice steps, how far a blob may lie off.
    """
    owner = owner.copy()
    centres = blobs.centres
    tree = scipy.spatial.cKDTree(centres)
    neighbours = min(4, len(centres))
    limit = tolerance / 3
    for _ in range(3 * sum(owner.shape)):
        taken = owner >= 0
        near_taken = scipy.ndimage.uniform_filter(9.0 * taken, 3, mode="constant")
        row, column = np.nonzero(~taken & (near_taken > 1.5))
        if not len(row):
            break
        window = windows(np.where(taken[..., None], centres[owner], np.nan), row, column)
        places = np.stack(predict(window))
        sought = np.isfinite(places).all(axis=(0, 2))
        if not sought.any():
            break
        row = row[sought]
        column = column[sought]
        guess, along, down = places[:, sought]
        which = tree.query(guess, k=neighbours)[1].reshape(len(row), -1)
        offset = _in_cells(centres[which] - guess[:, None], along[:, None], down[:, None])
        distance = np.linalg.norm(offset, axis=-1)
        closest = (np.arange(len(row)), distance.argmin(axis=1))
        which = which[closest]
        distance = distance[closest]
        covered = blobs.ink[which] / np.abs(cross(along, down))
        close = (distance < limit) & ~np.isin(which, owner)
        close &= (covered > cover[0]) & (covered < cover[1])
        order = np.flatnonzero(close)[np.argsort(distance[close], kind="stable")]
        order = order[np.unique(which[order], return_index=True)[1]]
        owner[row[order], column[order]] = which[order]
        if len(order):
            limit = tolerance / 3
        elif limit < tolerance:  # what is certain first, so that it guides the rest
            limit += tolerance / 3
        else:
            break
    return owner


WINDOW_REACH = 3  # lattice steps that the surroundings of a place reach to each side
_ROW, _COLUMN = np.indices((2 * WINDOW_REACH + 1, 2 * WINDOW_REACH + 1)) - WINDOW_REACH


def windows(
    grid: FloatArray,
    row: IntArray,
    column: IntArray,
) -> FloatArray:
    """Surroundings of some places of a lattice, (n, 7, 7, 2), px; nan where not known."""
    beside = (WINDOW_REACH, WINDOW_REACH)
    padded = np.pad(grid, (beside, beside, (0, 0)), constant_values=np.nan)
    rows = row[:, None, None] + _ROW + WINDOW_REACH
    columns = column[:, None, None] + _COLUMN + WINDOW_REACH
    return padded[rows, columns]


def predict(window: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Where the lattice passes the middle of windows, and its steps there: three (n, 2), px."""
    middle = WINDOW_REACH
    i, j = np.array(EIGHT_NEIGHBOURS).T
    first, second, third = (window[:, middle - n * i, middle - n * j] for n in (1, 2, 3))
    step = first - second
    # Perspective and fisheye shrink steps by about the same factor each time.
    with nan_if_undefined():
        ratio = np.linalg.norm(step, axis=-1) / np.linalg.norm(second - third, axis=-1)
    ratio = np.where(np.isfinite(ratio), np.clip(ratio, 0.5, 2), 1.0)
    ahead = first + step * ratio[..., None]
    i, j = np.array(list(product((-1, 1), repeat=2))).T
    beside = window[:, middle + i, middle] + window[:, middle, middle + j]
    beside -= window[:, middle + i, middle + j]
    inner = window[:, 1:-1, 1:-1]
    along, down = (np.diff(inner, axis=axis).reshape(len(window), -1, 2) for axis in (2, 1))
    return _mean(np.concatenate([ahead, beside], axis=1)), _mean(along), _mean(down)


def find_lattices(
    blobs: Blobs,
    cover: tuple[float, float],
    size: int,
) -> list[IntArray]:
    """Find the pieces of a lattice among blobs: squares of side `size` of which blob is where, -1 where none.

    Columns and rows run in a right-handed way in the picture, but may be sheared and turned against those
    of the target. `cover` is as for `grow`.
    """
    pieces: list[IntArray] = []
    centres = blobs.centres
    if len(centres) < 9:
        return pieces
    neighbours = min(17, len(centres))
    which = scipy.spatial.cKDTree(centres).query(centres, k=neighbours)[1][:, 1:]
    vectors = centres[which] - centres[:, None]
    length = np.linalg.norm(vectors, axis=-1)
    # A step of the lattice has its opposite.
    miss = np.linalg.norm(vectors[:, :, None] + vectors[:, None], axis=-1).min(axis=2)
    paired = miss < 0.3 * length
    number = np.arange(len(centres))
    first = paired.argmax(axis=1)
    a = vectors[number, first]
    area = cross(a[:, None], vectors)
    second = (paired & (area > 0.7 * length * length[number, first][:, None])).argmax(
        axis=1
    )
    b = vectors[number, second]
    usable = paired[number, first] & paired[number, second] & (area[number, second] > 0)
    covered = blobs.ink / np.where(usable, area[number, second], 1.0)
    usable &= (covered > cover[0]) & (covered < cover[1])
    around = np.stack([j * a + i * b for i, j in EIGHT_NEIGHBOURS], axis=1)
    beside = vectors[:, None] - around[:, :, None]
    offset = _in_cells(beside, a[:, None, None], b[:, None, None])
    distance = np.where(usable[:, None, None], np.linalg.norm(offset, axis=-1), np.inf)
    nearest = distance.min(axis=2)
    is_hit = nearest < 0.3
    neighbour = which[number[:, None], distance.argmin(axis=2)]
    score = is_hit.sum(axis=1) - (is_hit * np.minimum(nearest, 0.3)).sum(axis=1) / 8
    free = np.ones(len(centres), bool)
    for seed in np.argsort(-score, kind="stable"):
        if score[seed] < 6 or len(pieces) == MOST_PIECES:
            break
        taken = neighbour[seed][is_hit[seed]]
        if not (free[seed] and free[taken].all()):
            continue
        owner = np.full((size, size), -1)
        middle = size // 2
        owner[middle, middle] = seed
        row, column = middle + np.array(EIGHT_NEIGHBOURS)[is_hit[seed]].T
        owner[row, column] = taken
        # Those of other pieces are out of reach.
        left = Blobs(np.where(free[:, None], centres, 1e9), blobs.ink)
        owner = grow(
            owner,
            left,
            cover,
            0.3,
        )
        free[owner[owner >= 0]] = False
        if (owner >= 0).sum() >= LEAST_SPOTS:
            pieces.append(owner)
    return pieces


def _nearby(grid: FloatArray) -> FloatArray:
    """Return the places within two steps of each of a lattice, (h, w, c), as (h w, 25, c); nan if unknown."""
    row, column = np.indices(grid.shape[:2]).reshape(2, -1)
    return windows(grid, row, column)[:, 1:-1, 1:-1].reshape(len(row), 25, -1)


def _local_fit(
    grid: FloatArray,
    panel: IntArray,
    least: int,
) -> tuple[FloatArray, FloatArray]:
    """Tell how far each feature lies from where its neighbours place it, in steps, and its cell's area, px².

    A quadratic is fitted, robustly, to those of the same panel within two steps; inf if they are too few.
    """
    spots = _nearby(grid)
    same = _nearby(panel[..., None].astype(np.float64))
    i, j = (a[1:-1, 1:-1].ravel() for a in (_ROW, _COLUMN))
    design = np.column_stack([np.ones(25), i, j, i * i, i * j, j * j])
    products = design[:, :, None] * design[:, None]
    known = np.isfinite(spots[..., 0]) & (same[..., 0] == panel.reshape(-1, 1))
    known &= i * i + j * j > 0
    spots = np.where(known[..., None], spots, 0.0)
    nearness = known / (1 + 0.5 * (i * i + j * j))
    miss = np.zeros(panel.shape)
    for _ in range(4):
        nearby_weight = 1 / (1 + (np.where(np.isfinite(miss), miss, 0) / 0.05) ** 2)
        weight = nearness * np.nan_to_num(_nearby(nearby_weight[..., None])[..., 0])
        normal = np.tensordot(weight, products, 1) + np.diag([1e-9] * 3 + [1e-3] * 3)
        fit = np.linalg.solve(normal, design.T @ (weight[..., None] * spots))
        fit = fit.reshape(*panel.shape, 6, 2)
        off = _in_cells(grid - fit[..., 0, :], fit[..., 2, :], fit[..., 1, :])
        miss = np.linalg.norm(off, axis=-1)
    enough = known.sum(axis=1).reshape(panel.shape) >= least
    cell = cross(fit[..., 2, :], fit[..., 1, :])
    return np.where(enough & np.isfinite(miss), miss, np.inf), cell


def check_places(
    grid: FloatArray,
    panel: IntArray,
    least: int = 6,
) -> tuple[BoolArray, FloatArray]:
    """Tell which features of a sheet lie where their neighbours place them: `least` at least, of one panel.

    `grid`, (h, w, 2), px, is nan where a feature is not seen. Returns, (h, w) each: False for those that
    lie off by much more than is usual nearby; the area of the lattice's cell, px².
    """
    miss, cell = _local_fit(grid, panel, least)
    nearby = _nearby(np.where(np.isfinite(miss), miss, np.nan)[..., None])[..., 0]
    nearby[~np.isfinite(nearby).any(axis=1)] = 0.0
    usual = np.nanmedian(nearby, axis=1).reshape(panel.shape)
    with nan_if_undefined():
        slack = SLACK / np.sqrt(cell)
        return miss <= np.minimum(3 * usual + slack, MOST_MISS), cell
