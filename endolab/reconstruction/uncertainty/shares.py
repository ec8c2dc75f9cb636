"""Who decided a pixel: the picture there, what comes in over borders and contours, or the prior.

Borders and contours: what a pixel's log d follows if the values are all moved by one over which the light's
equation enters: at the mask's rim and behind contours, wherever the distance falls towards them. Of the
rest, the picture's share is how much of a small bump of the true surface would come through from the
picture, and the prior's what would not.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from endolab.numerics.arrays import FloatArray
from endolab.numerics.compiled import inner, pad_maps
from endolab.reconstruction.uncertainty.causes import mean_square_around
from endolab.reconstruction.uncertainty.linearised import LINEAR_SOLVE, Linearised
from endolab.solvers.multigrid import Multigrid, multiply
from endolab.solvers.normal_equations import Coefficients

OUTSIDE, DATA, BORDER, PRIOR = range(4)  # values of `dominant_source`


def follow_rim(
    surface: Linearised, log_distance: FloatArray
) -> Callable[[FloatArray], FloatArray]:
    """Return how log d answers to a change of it where light's equation enters, as a function."""
    coefficients = surface.coefficients
    held = surface.grid.inflow_pixels(pad_maps(log_distance))
    matrix = coefficients.matrix(LINEAR_SOLVE.damping)
    free = coefficients.active * pad_maps((~held).astype(np.int8))
    rest = replace(coefficients.structure, active=free)
    multigrid = Multigrid(Coefficients(coefficients.parts, rest), LINEAR_SOLVE.damping)

    def follow(change: FloatArray) -> FloatArray:
        given = pad_maps(np.where(held, change, 0.0))
        pulled = np.zeros_like(given)
        multiply(matrix, given, pulled)
        x = multigrid.solve(
            -pulled * free, LINEAR_SOLVE.precision, LINEAR_SOLVE.most_steps
        )[0]
        return np.asarray(inner(given + x))

    return follow


def shares_of(
    surface: Linearised,
    log_distance: FloatArray,
    bumps: Sequence[FloatArray],
    answers: Sequence[FloatArray],
    length: float,
) -> FloatArray:
    """Shares of data, border or contour, and prior, (3, H, W): 1 in all in the mask, 0 outside.

    `bumps` of the true surface are as wide as `length`, px; `answers` is what comes through of them.
    """
    there = surface.problem.mask.astype(np.float64)

    def power(field: FloatArray) -> FloatArray:
        return mean_square_around(field, there, length)

    recovered = np.zeros(there.shape)
    true = np.zeros(there.shape)
    for bump, answer in zip(bumps, answers, strict=True):
        recovered += power(bump + answer) - power(bump - answer)
        true += 4 * power(bump)
    follows = follow_rim(surface, log_distance)(np.ones(there.shape))
    border = np.clip(follows, 0.0, 1.0)
    data = (1 - border) * np.clip(recovered / np.maximum(true, 1e-12), 0.0, 1.0)
    return there * np.stack([data, border, 1 - border - data])
