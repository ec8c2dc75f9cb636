"""Order spots into a lattice, by local prediction.

All steps are local in the picture, so no camera is needed: each next spot is predicted from its
neighbours, which follows fisheye curvature, perspective and the kink at a fold.
"""

import numpy as np
import scipy

from endolab.calibration import constants
from endolab.calibration.detection.blobs import Blobs
from endolab.numerics.arrays import BoolArray, FloatArray, IntArray, nan_if_undefined

CLOSE = 0.3  # lattice steps that a spot may lie off what is predicted
REACH = 2  # lattice steps that the surroundings of a place reach to each side


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Give the area that pairs of vectors span."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _in_cells(vector: FloatArray, along: FloatArray, down: FloatArray) -> FloatArray:
    """Length of vectors of the picture in lattice steps."""
    with nan_if_undefined():
        parts = np.hypot(cross(vector, down), cross(along, vector))
        return parts / np.abs(cross(along, down))


def _windows(grid: FloatArray, row: IntArray, column: IntArray) -> FloatArray:
    """Surroundings of some places of a lattice, (n, 5, 5, c); nan where not known."""
    beside = (REACH, REACH)
    padded = np.pad(grid, (beside, beside, (0, 0)), constant_values=np.nan)
    i, j = np.indices((5, 5))
    return padded[row[:, None, None] + i, column[:, None, None] + j]


def _predict(window: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Where the lattice passes the middle of windows, (n, 5, 5, 2), and its steps there: three (n, 2), px.

    A quadratic of column and row is fitted to the places around, without the middle.
    """
    i, j = np.indices((5, 5)).reshape(2, -1) - REACH
    design = np.column_stack([np.ones(25), i, j, i * i, i * j, j * j])
    products = design[:, :, None] * design[:, None]
    spots = window.reshape(-1, 25, 2)
    known = np.isfinite(spots[..., 0]) & (i * i + j * j > 0)
    weight = known / (1 + 0.5 * (i * i + j * j))
    # What is not told bends as little as it can.
    normal = np.tensordot(weight, products, 1) + np.diag([1e-9] * 3 + [1e-3] * 3)
    fit = np.linalg.solve(normal, design.T @ (weight[..., None] * np.nan_to_num(spots)))
    return fit[:, 0], fit[:, 2], fit[:, 1]


def places_of(owner: IntArray, blobs: Blobs) -> FloatArray:
    """Where the blobs of a lattice are, (h, w, 2), px; nan where there is none, -1."""
    return np.where(owner[..., None] >= 0, blobs.centres[owner], np.nan)


def grow(owner: IntArray, blobs: Blobs, cover: tuple[float, float]) -> IntArray:
    """Grow a lattice: predict each next dot from its neighbours and take the blob that lies there.

    `owner`, (h, w), is which blob is at each place, -1 where none; `cover` the least and largest share of
    its cell that a dot may cover.
    """
    owner = owner.copy()
    tree = scipy.spatial.cKDTree(blobs.centres)
    while True:
        taken = owner >= 0
        near_taken = scipy.ndimage.uniform_filter(9.0 * taken, 3, mode="constant")
        row, column = np.nonzero(~taken & (near_taken > 1.5))
        window = _windows(places_of(owner, blobs), row, column)
        guess, along, down = _predict(window)
        which = tree.query(np.nan_to_num(guess))[1]
        off = _in_cells(blobs.centres[which] - guess, along, down)
        with nan_if_undefined():
            covered = blobs.ink[which] / np.abs(cross(along, down))
        good = (off < CLOSE) & (covered > cover[0]) & (covered < cover[1])
        if not good.any():
            return owner
        order = np.flatnonzero(good)[np.argsort(off[good], kind="stable")]
        order = order[np.unique(which[order], return_index=True)[1]]
        owner[row[order], column[order]] = which[order]


def find_lattices(blobs: Blobs, cover: tuple[float, float], size: int) -> list[IntArray]:
    """Find the pieces of a lattice among blobs: squares of side `size` of which blob is where, -1 where none.

    Columns and rows run in a right-handed way in the picture, but may be sheared and turned against those
    of the target. `cover` is as for `grow`.
    """
    centres = blobs.centres
    number = np.arange(len(centres))
    which = scipy.spatial.cKDTree(centres).query(centres, k=17)[1][:, 1:]
    vectors = centres[which] - centres[:, None]
    length = np.linalg.norm(vectors, axis=-1)
    # A step of the lattice has its opposite.
    apart = np.linalg.norm(vectors[:, :, None] + vectors[:, None], axis=-1)
    miss = apart.min(axis=2) / length
    first = (miss < CLOSE).argmax(axis=1)
    area = cross(vectors[number, first][:, None], vectors)
    across = (miss < CLOSE) & (area > 0.7 * length * length[number, first][:, None])
    second = across.argmax(axis=1)
    miss = np.maximum(miss[number, first], miss[number, second])
    opposite = apart.argmin(axis=2)
    pieces: list[IntArray] = []
    free = across.any(axis=1)
    for _ in range(60):
        if not free.any():
            break
        seed = np.where(free, miss, np.inf).argmin()
        owner = np.full((size, size), -1)
        middle = size // 2
        a = first[seed]
        b = second[seed]
        owner[middle, middle] = seed
        owner[middle, [middle + 1, middle - 1]] = which[seed, [a, opposite[seed, a]]]
        owner[[middle + 1, middle - 1], middle] = which[seed, [b, opposite[seed, b]]]
        owner = grow(owner, blobs, cover)
        free[owner[owner >= 0]] = False
        if (owner >= 0).sum() >= constants.LEAST_DOTS:
            pieces.append(owner)
    return pieces


def check_places(
    grid: FloatArray, panel: IntArray, least: int = 6
) -> tuple[BoolArray, FloatArray]:
    """Tell which features of a sheet lie where their neighbours place them: `least` at least, of one panel.

    `grid`, (h, w, 2), px, is nan where a feature is not seen. Returns, (h, w) each: False for those that
    lie off by 8 % of a step; the area of the lattice's cell, px².
    """
    row, column = np.indices(panel.shape).reshape(2, -1)
    window = _windows(grid, row, column)
    same = _windows(panel[..., None].astype(np.float64), row, column)[..., 0]
    window[same != panel.reshape(-1, 1, 1)] = np.nan
    place, along, down = _predict(window)
    cell = cross(along, down).reshape(panel.shape)
    miss = _in_cells(grid.reshape(-1, 2) - place, along, down).reshape(panel.shape)
    known = np.isfinite(window[..., 0]).sum(axis=(1, 2)).reshape(panel.shape)
    return (miss < 0.08) & (known > least), cell
