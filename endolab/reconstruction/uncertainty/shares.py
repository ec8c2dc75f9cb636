"""Who decided a pixel: the picture there, what comes in over borders and contours, or the prior.

Borders and contours: what a pixel's log d follows if the values are all moved by one over which the light's
equation enters: at the mask's rim and behind contours, wherever the distance falls towards them. Of the
rest, the picture's share is how much of a small bump of the true surface would come through from the
picture, and the prior's what would not.
"""

from dataclasses import replace

import numpy as np

from endolab.numerics.arrays import FloatArray
from endolab.numerics.compiled import inner, pad_maps
from endolab.numerics.derivatives import px_per_reference
from endolab.reconstruction.uncertainty.causes import CAUSES, correlated_field, rms_around
from endolab.reconstruction.uncertainty.linearised import LINEAR_SOLVE, Linearised
from endolab.solvers.multigrid import Multigrid, multiply
from endolab.solvers.normal_equations import Coefficients

OUTSIDE, DATA, BORDER, PRIOR = range(4)  # values of `dominant_source`


class Rim:
    """A surface whose values are given where light's equation enters: how all others follow them."""

    def __init__(self, surface: Linearised, log_distance: FloatArray) -> None:
        coefficients = surface.coefficients
        self._held = surface.grid.inflow_pixels(pad_maps(log_distance))
        self._matrix = coefficients.matrix(LINEAR_SOLVE.damping)
        self._free = coefficients.active * pad_maps((~self._held).astype(np.int8))
        rest = replace(coefficients.structure, active=self._free)
        self._multigrid = Multigrid(
            Coefficients(coefficients.parts, rest), LINEAR_SOLVE.damping
        )

    def follow(self, change: FloatArray) -> FloatArray:
        """How log d answers to a change of it at the rim."""
        given = pad_maps(np.where(self._held, change, 0.0))
        pulled = np.zeros_like(given)
        multiply(self._matrix, given, pulled)
        x = self._multigrid.solve(
            -pulled * self._free, LINEAR_SOLVE.precision, LINEAR_SOLVE.most_steps
        )[0]
        return np.asarray(inner(given + x))


class Bumps:
    """Small bumps of the true surface, and how much of them comes through from the picture."""

    def __init__(self, surface: Linearised, rng: np.random.Generator) -> None:
        self._surface = surface
        self._rng = rng
        mask = surface.problem.mask
        self._length = CAUSES.length * px_per_reference(mask.shape)
        self._there = mask.astype(np.float64)
        self._recovered = np.zeros(mask.shape)
        self._true = np.zeros(mask.shape)

    def try_field(self) -> FloatArray:
        """What is not found of a field of bumps of unit variance."""
        bump = self._there * correlated_field(self._rng, self._there.shape, self._length)
        answer = self._surface.to_picture(self._surface.apply(bump))
        here = self._there
        length = self._length
        self._recovered += (
            rms_around(bump + answer, here, length) ** 2
            - rms_around(bump - answer, here, length) ** 2
        )
        self._true += 4 * rms_around(bump, here, length) ** 2
        return np.asarray(bump - answer)

    def shares(self, log_distance: FloatArray) -> FloatArray:
        """Shares of data, border or contour, and prior, (3, H, W): 1 in all in the mask, 0 outside."""
        follows = Rim(self._surface, log_distance).follow(np.ones(log_distance.shape))
        border = np.clip(follows, 0.0, 1.0)
        share = np.clip(self._recovered / np.maximum(self._true, 1e-12), 0.0, 1.0)
        data = (1 - border) * share
        return self._there * np.stack([data, border, 1 - border - data])
