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

from typing import Any

import numpy as np

from endolab.calibration.least_squares import Arrow, Linearised
from endolab.calibration.photometric.model import LightModel, hats
from endolab.numerics.arrays import BoolArray, FloatArray

# What samples must show before k and γ are believed.
#
# Errors of the poses make up some signal where there is none: 0.3 % of the distance and 0.1° of the
# normal, apart for each sample, 0.009 of s. A fold of 3° gives 0.02 to 0.05 of it, tilts up to 5° give
# 0.02 of log cos α.
RICH_NODES = 60  # of the BRDF, in the regression
LEAST_GAMMA_SIGNAL = 0.018
LEAST_K_SIGNAL = 0.012


class NotIdentifiableError(ValueError):
    """The samples do not tell an unknown: "gamma", "k", "brdf" or "light"."""

    def __init__(self, unknown: str, reason: str) -> None:
        super().__init__(reason)
        self.unknown = unknown


def refuse(*cases: tuple[str, Any, str]) -> None:
    """Raise for the first case, of an unknown, a condition and the reason, that is so."""
    for unknown, is_so, reason in cases:
        if is_so:
            raise NotIdentifiableError(unknown, reason)


def remainder(
    model: LightModel, target: FloatArray, others: FloatArray, weight: FloatArray
) -> FloatArray:
    """What is left of a target, (n,), after a regression on columns, (n, p), and a constant per frame."""
    ones = np.ones((len(target), 1, 1))
    lin = Linearised(target[:, None], -others[:, None], -ones)
    solved, constant = Arrow(lin, weight, model.group).solve(0.0)
    return target - others @ solved - constant[model.group, 0]


def signals(model: LightModel, good: BoolArray) -> tuple[float, float]:
    """Measure what the good samples know of k, and of γ; what is roughly known is believed."""
    weight = np.where(good, model.samples.level**2, 0.0)
    material = slice(model.of_brdf.stop, None)
    others = model.materials[:, np.isinf(model.sd[material])].astype(float)
    if len(model.nodes) > 1:
        count = int(np.clip(good.sum() // 10, len(model.nodes), RICH_NODES))
        rich = np.linspace(model.nodes[0], model.nodes[-1], count)
        others = np.column_stack([hats(rich, model.samples.theta), others])
    k = model.log_cos_alpha
    gamma = model.falloff + model.materials @ model.mean[material]
    left = (
        remainder(model, k, others, weight),
        remainder(model, gamma, np.column_stack([others, k]), weight),
    )
    of_k, of_gamma = (float(np.sqrt(np.average(one**2, weights=weight))) for one in left)
    return of_k, of_gamma


def power_of_lamp(model: LightModel, gamma: float, used: BoolArray) -> tuple[float, float]:
    """Measure how much of 1/d² cos θ is in the brightness within frames: 1 of a lamp at the lens.

    The surface is taken to be matt. Returns the exponent, and its standard error; both hold for this γ.
    Light that stays in the room gives 0, however it is exposed: for a flat sheet, a BRDF of
    1/cos³ θ would pass for it, so that neither residuals nor k betray it.
    """
    level = np.where(used, model.samples.level, 1.0)
    weight = np.where(used, level**2, 0.0)
    loose = model.sd[model.of_brdf.stop :] > 0
    others = np.column_stack([model.log_cos_alpha, model.materials[:, loose]])
    given = model.materials @ np.where(loose, 0.0, model.mean[model.of_brdf.stop :])
    light = remainder(model, gamma * np.log(level) - given, others, weight)
    lamp = remainder(model, model.falloff, others, weight)
    information = float(weight @ lamp**2) + np.finfo(float).tiny
    power = float(weight @ (lamp * light)) / information
    rest = float(weight @ (light - power * lamp) ** 2) / (int(used.sum()) + 1)
    return power, float(np.sqrt(rest / information))
