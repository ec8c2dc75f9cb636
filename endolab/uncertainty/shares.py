"""Who decided a pixel: the picture there, what comes in over borders and contours, or the prior.

Borders and contours: what a pixel's log d follows if the values are all moved by one over which the light's
equation enters: at the mask's rim and behind contours, wherever the distance falls towards them. Of the
rest, the picture's share is how much of a small bump of the true surface would come through from the
picture, and the prior's what would not.
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
from endolab.uncertainty.causes import LENGTH, around, correlated
from endolab.uncertainty.linearised import DAMPING, MOST, PRECISION, Linearised

OUTSIDE, DATA, BORDER, PRIOR = range(4)  # values of `decided_by`


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


class Rim:
    """The same surface, the values at its rim being given: how all others follow them."""

    def __init__(self, surface: Linearised, held: BoolArray) -> None:
        coefficients = surface.coefficients
        self._held, self._matrix = held, coefficients.matrix(DAMPING)
        self._free = coefficients.active * padded((~held).astype(np.int8))
        rest = replace(coefficients.structure, active=self._free)
        self._multigrid = Multigrid(Coefficients(coefficients.parts, rest), DAMPING)

    def moved(self, change: FloatArray) -> FloatArray:
        """How log d answers to a change of it at the rim."""
        given = padded(np.where(self._held, change, 0.0))
        pulled = np.zeros_like(given)
        multiply(self._matrix, given, pulled)
        x = self._multigrid.solve(-pulled * self._free, PRECISION, MOST)[0]
        return np.asarray(inner(given + x))


def of_border(surface: Linearised, log_distance: FloatArray) -> FloatArray:
    """What log d follows if that of the rim moves by one, 0 to 1."""
    ones = np.ones(log_distance.shape)
    return np.clip(Rim(surface, rim(surface.problem, log_distance)).moved(ones), 0.0, 1.0)


class Bumps:
    """Small bumps of the true surface, and how much of them comes through from the picture."""

    def __init__(self, surface: Linearised, rng: np.random.Generator) -> None:
        self._surface, self._rng = surface, rng
        mask = surface.problem.mask
        self._length = LENGTH * surface.problem.camera.width / REFERENCE_WIDTH
        self._there = mask.astype(np.float64)
        self._seen, self._whole = np.zeros(mask.shape), np.zeros(mask.shape)

    def try_one(self) -> FloatArray:
        """What is not found of a field of bumps of unit variance."""
        bump = self._there * correlated(self._rng, self._there.shape, self._length)
        found = self._surface.to_picture(self._surface.applied(bump))
        here, length = self._there, self._length
        self._seen += around(bump + found, here, length) ** 2 - around(bump - found, here, length) ** 2
        self._whole += 4 * around(bump, here, length) ** 2
        return np.asarray(bump - found)

    def share(self) -> FloatArray:
        """How much of bumps is found at each pixel, 0 to 1."""
        return np.clip(self._seen / np.maximum(self._whole, 1e-12), 0.0, 1.0)


def shares(mask: BoolArray, border: FloatArray, picture: FloatArray) -> FloatArray:
    """Shares of data, border or contour, and prior, (3, H, W): 1 in all in the mask, 0 outside."""
    data = (1 - border) * picture
    return np.where(mask, np.stack([data, border, 1 - border - data]), 0.0)


def decided_by(parts: FloatArray, mask: BoolArray) -> np.ndarray:
    """Which of the three shares is the largest, uint8; 0 outside the mask."""
    return np.where(mask, DATA + np.argmax(parts, axis=0), OUTSIDE).astype(np.uint8)
