"""What samples can tell of k and γ: measured before the fit, so that what they can't is refused.

Scale γ by 1 + δ: the grey levels stay as they are if L grows by the factor 1 + δ as well. Of L,
the k log cos α, the gains and log f are free to do so. What isn't is

    s = -2 log d + log cos θ + log a   (a of materials whose reflectance is known)

unless a constant per frame (the gain), a function of θ (the BRDF) and a multiple of log cos α
make up for δ·s. What is left of s after a regression on them is all that the samples know of γ:

              s                            `left` is the signal: its root mean square is a share
             /|                            of the light. Likewise of k, with log cos α for s,
            / | left                       and γ taken as known
           /  |
    ------o---+------------  what the others imitate: per frame 1, of θ any function, and log cos α

On a flat sheet with the light at the camera nothing is left: the sheet's height over the camera is
d cos θ, so s = -2 log height + 3 log cos θ, a constant per frame and a function of θ.

The regression gives f many more nodes than the fit has. Else the error of interpolating f between
few nodes would count as information, and would fix γ at a wrong value.
"""

import numpy as np

from endolab.calibration.least_squares import Arrow, Fit
from endolab.calibration.photometric.model import (
    GREY_LEVELS,
    LightModel,
    hats,
)
from endolab.numerics.arrays import BoolArray, FloatArray


def regress(
    model: LightModel, target: FloatArray, columns: FloatArray, weight: FloatArray
) -> tuple[FloatArray, FloatArray, Arrow]:
    """Explain a target, (n,), by columns, (n, p), and a constant per frame.

    Returns the coefficients, what is left, (n,), and the equations.
    """
    ones = np.ones((len(target), 1, 1))
    arrow = Arrow(target[:, None], -columns[:, None], -ones, weight, model.group)
    solved, constant = arrow.solve(0.0)
    return solved, target - columns @ solved - constant[model.group, 0], arrow


def signals(model: LightModel, good: BoolArray) -> tuple[float, float, float]:
    """Measure what the good samples know of k, of γ, and of 1 mm of a lamp's place (the worse of x and y).

    What is roughly known is believed.
    """
    weight = np.where(good, model.samples.level**2, 0.0)
    material = slice(model.of_brdf.stop, None)
    others = model.materials[:, np.isinf(model.sd[material])].astype(float)
    if len(model.nodes) > 1:
        count = int(np.clip(good.sum() // 10, len(model.nodes), 60))
        rich = np.linspace(model.nodes[0], model.nodes[-1], count)
        others = np.column_stack([hats(rich, model.samples.theta), others])
    k = model.log_cos_alpha
    gamma = model.falloff + model.materials @ model.mean[material]
    _, of_k, _ = regress(model, k, others, weight)
    known = np.column_stack([others, k])
    _, of_gamma, _ = regress(model, gamma, known, weight)
    beside = model.with_lamps(1)
    own = np.zeros((int(model.group[-1]) + 1, 1))
    by_place = beside.shine(beside.mean, own)[1][:, beside.of_lamps]
    of_lamp = [regress(model, axis, known, weight)[1] for axis in by_place.T]
    left = np.square([of_k, of_gamma, *of_lamp])
    of_k, of_gamma, *sides = np.sqrt(np.average(left, axis=1, weights=weight)).tolist()
    return of_k, of_gamma, min(sides)


def power_of_lamp(model: LightModel, gamma: float, used: BoolArray) -> tuple[float, float]:
    """Measure how much of 1/d² cos θ is in the brightness within frames: 1 of a lamp at the lens.

    The surface is taken to be matt. Returns the exponent, and its standard error; both hold for this γ.
    Light that stays in the room gives 0, however it is exposed: for a flat sheet, a BRDF of
    1/cos³ θ would pass for it, so that neither residuals nor k betray it.
    """
    level = np.where(used, model.samples.level, 1.0)
    weight = np.where(used, level**2, 0.0)
    material = slice(model.of_brdf.stop, None)
    loose = model.sd[material] > 0
    lamp = model.falloff, model.log_cos_alpha, model.materials[:, loose]
    given = model.materials @ np.where(loose, 0.0, model.mean[material])
    light = gamma * np.log(level) - given
    solved, left, arrow = regress(model, light, np.column_stack(lamp), weight)
    rest = np.sum(weight * left**2) / (used.sum() + 1)
    return float(solved[0]), float(np.sqrt(rest * arrow.covariance()[0][0, 0]))


def left_of_light(model: LightModel, fitted: Fit) -> tuple[FloatArray, FloatArray]:
    """Return what a fit leaves of the logarithm of the light, (n,), and what each sample counts, (n,)."""
    off = fitted.residual[:, 0] / GREY_LEVELS
    level = np.where(fitted.used, model.samples.level - off, 1.0)  # predicted
    return fitted.common[1] * off / level, np.where(fitted.used, level**2, 0.0)


def one_sided(model: LightModel, fitted: Fit) -> float:
    """Measure by what part of the light one side of the picture is brighter than a fit says, rim to rim."""
    across = model.samples.points[:, :2] / model.samples.distance[:, None]
    off, weight = left_of_light(model, fitted)
    slope, *_ = regress(model, off, across, weight)
    return float(
        2 * np.linalg.norm(across[fitted.used], axis=1).max() * np.linalg.norm(slope)
    )
