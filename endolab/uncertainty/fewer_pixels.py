"""A solved frame on fewer pixels, and maps back: σ is as smooth as textures, which go with the width."""

from dataclasses import replace

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt

from endolab.depth.grid import Grid
from endolab.depth.result import Iterate
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.compiled import inner, padded

ENOUGH = 400  # columns: a texture's Gaussian then has σ of 7 px and more


def thinned(iterate: Iterate) -> Iterate:
    """The same on half the pixels along both sides, as often as it takes to have `ENOUGH` columns at most."""
    while max(iterate.mask.shape) > ENOUGH:
        iterate = _halved(iterate)
    return iterate


def _halved(iterate: Iterate) -> Iterate:
    problem = iterate.problem
    grid = Grid.of(problem)
    coarse = grid.coarser()
    height, width = coarse.mask.shape
    camera = problem.camera.resize(width, height)
    smaller = replace(
        problem,
        image=inner(coarse.image),
        mask=coarse.mask & camera.field.valid,
        camera=camera,
        discontinuities=coarse.discontinuities,
        evidence=inner(coarse.evidence) if coarse.evidence.size else None,
        picture=np.asarray(cv2.resize(problem.shown, (width, height), interpolation=cv2.INTER_AREA), float),
    )
    provenance = replace(iterate.provenance, smooth=iterate.provenance.smooth / 2)
    v = inner(grid.restrict(padded(np.where(iterate.mask, iterate.log_distance, 0.0))))
    return Iterate.of(smaller, np.where(smaller.mask, v, 0.0), provenance=provenance)


def enlarged(a: FloatArray, known: BoolArray, mask: BoolArray) -> FloatArray:
    """Maps (..., h, w), known in a mask, on the pixels of a larger one, (..., H, W); nan outside it."""
    if known.shape == mask.shape:
        return np.where(mask, a, np.nan)
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    filled = a[(..., *nearest)].reshape(-1, *known.shape)
    size = mask.shape[::-1]
    large = np.stack([cv2.resize(small, size, interpolation=cv2.INTER_LINEAR) for small in filled])
    return np.where(mask, large.reshape(*a.shape[:-2], *mask.shape), np.nan)
