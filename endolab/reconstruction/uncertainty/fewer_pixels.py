"""A solved frame on fewer pixels, and maps back: σ is as smooth as textures, which go with the width."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from scipy.ndimage import affine_transform, distance_transform_edt

from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.compiled import inner, leads, pad_maps
from endolab.solvers.grid import Grid
from endolab.solvers.result import Iterate

MOST_COLUMNS = 400  # columns: a texture's Gaussian then has σ of 7 px and more


def thin(iterate: Iterate) -> Iterate:
    """The same on half the pixels along both sides, until there are at most `MOST_COLUMNS`."""
    while max(iterate.mask.shape) > MOST_COLUMNS:
        iterate = _halve(iterate)
    return iterate


def _halve(iterate: Iterate) -> Iterate:
    problem = iterate.problem
    grid = Grid.of(problem)
    coarse = grid.coarser()
    height, width = coarse.mask.shape
    down, across = leads(pad_maps(problem.mask))
    camera: Any = problem.camera
    covered = {
        "width": 2 * width,
        "height": 2 * height,
        "cx": camera.cx + across,
        "cy": camera.cy + down,
    }
    # Blocks may reach beyond the frame.
    camera = replace(camera, **covered).resize(width, height)
    smaller = replace(
        problem,
        image=inner(coarse.image),
        mask=coarse.mask & camera.field.valid,
        camera=camera,
        cuts=coarse.cuts,
        evidence=inner(coarse.evidence) if coarse.evidence.size else None,
        picture=np.asarray(
            cv2.resize(problem.shown, (width, height), interpolation=cv2.INTER_AREA), float
        ),
        report=replace(problem.report, smooth=problem.report.smooth / 2),
    )
    v = inner(grid.restrict(pad_maps(np.where(iterate.mask, iterate.log_distance, 0.0))))
    return Iterate.of(smaller, np.where(smaller.mask, v, 0.0))


def enlarge(a: FloatArray, known: BoolArray, mask: BoolArray) -> FloatArray:
    """Maps (..., h, w), known in a mask, on the pixels that were `thin`, (..., H, W); nan outside them."""
    if known.shape == mask.shape:
        return np.where(mask, a, np.nan)
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    filled = a[(..., *nearest)].reshape(-1, *known.shape)
    shares = np.array(mask.shape) / known.shape
    step = 1 / np.round(shares.max())  # both grids have one middle
    offset = 0.5 * (np.array(known.shape) - 1 - step * (np.array(mask.shape) - 1))
    large = affine_transform(
        filled,
        [1.0, step, step],
        [0.0, *offset],
        output_shape=(len(filled), *mask.shape),
        order=1,
        mode="nearest",
    )
    return np.where(mask, large.reshape(*a.shape[:-2], *mask.shape), np.nan)
