"""Who decided a pixel: the picture there, what comes in over borders and contours, or the prior.

Borders and contours: what a pixel's log d follows if the values are all moved by one over which the
light's equation enters: at the mask's rim and behind contours, wherever the distance falls towards them. Of the rest, the picture's share is how much of a small bump of the true
surface would come through from the picture, and the prior's what would not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from endolab.depth.multigrid import Multigrid, multiply
from endolab.depth.normal_equations import Coefficients
from endolab.depth.problem import Problem
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.compiled import inner, padded
from endolab.numerics.derivatives import REFERENCE_WIDTH, gradient, links, shifted
from endolab.trust.causes import LENGTH, around, correlated
from endolab.trust.linearised import DAMPING, MOST, PRECISION, Linearised

OUTSIDE, DATA, BORDER, PRIOR = range(4)  # values of `decided_by`
BUMPS = 6  # that are tried


def rim(problem: Problem, log_distance: FloatArray) -> BoolArray:
    """Pixels over which light's equation enters: a step is missing there, on a side to which v falls."""
    mask, v = problem.mask, np.where(problem.mask, log_distance, 0.0)
    link = links(mask, problem.cuts)
    by_u, by_w = (np.nan_to_num(one) for one in gradient(v, mask, problem.cuts, edge_order=1))
    guu, guv, gvv = np.moveaxis(problem.field.inverse_metric, -1, 0)
    raised = np.nan_to_num(guu * by_u + guv * by_w), np.nan_to_num(guv * by_u + gvv * by_w)
    enters = np.zeros_like(mask)
    for step, axis, up in zip(link, (1, 0), raised, strict=True):
        enters |= (~step & (up < 0)) | (~shifted(step, -1, axis, False) & (up > 0))
    return mask & enters


def of_border(surface: Linearised, held: BoolArray) -> FloatArray:
    """What log d follows if that of the pixels that are held moves by one, 0 to 1."""
    coefficients = surface.coefficients
    ones = padded(held.astype(np.float64))
    moved = np.zeros_like(ones)
    multiply(coefficients.matrix(DAMPING), ones, moved)
    free = coefficients.active * padded((~held).astype(np.int8))
    rest = Coefficients(coefficients.parts, replace(coefficients.structure, active=free))
    x = Multigrid(rest, DAMPING).solve(-moved * free, PRECISION, MOST)[0]
    return np.where(held, 1.0, np.clip(inner(x), 0.0, 1.0))


def of_picture(surface: Linearised, rng: np.random.Generator) -> FloatArray:
    """How much of a bump comes through from the picture, 0 to 1."""
    mask = surface.problem.mask
    length = LENGTH * surface.problem.camera.width / REFERENCE_WIDTH
    there = mask.astype(np.float64)
    seen, whole = np.zeros(mask.shape), np.zeros(mask.shape)
    for _ in range(BUMPS):
        bump = np.where(mask, correlated(rng, mask.shape, length), 0.0)
        found = surface.to_picture(surface.applied(bump))
        seen += around(bump + found, there, length) ** 2 - around(bump - found, there, length) ** 2
        whole += 4 * around(bump, there, length) ** 2
    return np.where(mask, np.clip(seen / np.maximum(whole, 1e-12), 0.0, 1.0), 0.0)


def shares(surface: Linearised, log_distance: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Shares of data, border or contour, and prior, (3, H, W); they sum to 1 in the mask, and are 0 outside."""
    mask = surface.problem.mask
    border = of_border(surface, rim(surface.problem, log_distance))
    data = (1 - border) * of_picture(surface, rng)
    return np.where(mask, np.stack([data, border, 1 - border - data]), 0.0)


def decided_by(parts: FloatArray, mask: BoolArray) -> np.ndarray:
    """Which of the three shares is the largest, uint8; 0 outside the mask."""
    return np.where(mask, DATA + np.argmax(parts, axis=0), OUTSIDE).astype(np.uint8)
