"""Checks of notebook 01: lights that balance or do not, and what a facing sheet cannot tell."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from endolab.course.verdict import Wrong, verdict
from endolab.datasets.known_endoscopes import load_calibration
from endolab.model.lights import SpotLight
from endolab.model.photometry import Photometry
from endolab.numerics.arrays import FloatArray
from endolab.synthetic.scenes import Plane

HEIGHTS = np.array([30.0, 40.0, 60.0, 80.0, 120.0])  # mm, of the planes of section 6
WEIGHTS = (1.0, 2.0, 4.0)
CLOSE = 0.03  # between slopes

BrdfOf = Callable[[FloatArray, FloatArray, float, float, float, float], FloatArray]


def _errors(weight: float) -> list[FloatArray]:
    """By how much the virtual light of a pair at x = -4 and 4 mm is off, on each plane; a map each."""
    pair = tuple(
        SpotLight((x, 0.0, 0.0), exponent=1.5, weight=w) for x, w in ((-4.0, 1.0), (4.0, float(weight)))
    )
    real = Photometry(k=1.0, gain=1.0, lights=pair)
    rays, facing = load_calibration("simple", 80).camera.field.rays, np.array([0.0, 0.0, -1.0])
    found = []
    for height in HEIGHTS:
        points = Plane(float(height), 0.0).distance(rays)[..., None] * rays
        light, virtual = (m.intensity(points, facing) ** m.gamma for m in (real, real.simplified()))
        found.append(virtual / light - 1)
    return found


def _slope(values: FloatArray) -> float:
    return float(np.polyfit(np.log(HEIGHTS), np.log(np.abs(values)), 1)[0])


@verdict
def exercise_1(slope: Callable[[float], float]) -> str:
    """Look at a function that measures how fast the virtual light's error falls, for a pair of lamps.

    Parameters
    ----------
    slope : callable
        Takes the weight of the lamp at x = 4 mm, that at -4 mm having 1; returns the slope of the rms error
        over the distance of the plane, on logarithmic axes.

    Returns
    -------
    Verdict
    """
    answers = np.array([slope(weight) for weight in WEIGHTS], dtype=float)
    if not np.all(np.isfinite(answers)):
        raise Wrong("That is no number. Is there an error of 0 whose logarithm is taken?")
    maps = [_errors(weight) for weight in WEIGHTS]
    right = np.array([_slope(np.array([np.sqrt(np.mean(off**2)) for off in each])) for each in maps])
    if np.allclose(answers, right, atol=CLOSE):
        return (
            f"Slope {right[0]:.2f} where the lamps balance, {right[1]:.2f} and {right[2]:.2f} where one is "
            "2 and 4 times as bright: the centre of mass has left the lens, and the first order wins."
        )
    slips = {
        "The error falls with the distance, so its slope is negative.": -right,
        "Turn it round: the error over the distance, not the distance over the error.": 1 / right,
        "Does the weight reach the second lamp? Your slope is the same for all.": np.full(3, right[0]),
        "Averaged with their signs, errors left and right cancel. Average their squares.": np.array(
            [_slope(np.array([np.mean(off) for off in each])) for each in maps]
        ),
        "That is the slope of the mean square; take its root, or half the slope.": 2 * right,
        "The axes are logarithmic, both of them.": np.array(
            [np.polyfit(HEIGHTS, [np.log(np.sqrt(np.mean(off**2))) for off in each], 1)[0] for each in maps]
        ),
    }
    for said, values in slips.items():
        if np.allclose(answers, values, rtol=0.02, atol=1e-3):
            raise Wrong(said)
    raise Wrong(
        f"For equal lamps you find {answers[0]:.2f}, it is {right[0]:.2f}. Both lamps have exponent 1.5 and "
        "lie at x = ±4 mm, the vignetting is k′ = 1, and the planes are those from 30 mm on."
    )


@verdict
def exercise_2(twin: BrdfOf) -> str:
    """Look at a function that finds the BRDF with which another k and γ give the same stored values.

    Parameters
    ----------
    twin : callable
        ``twin(brdf, cosine, k, gamma, other_k, other_gamma)`` returns the other BRDF at angles of these
        cosines; a constant factor is free, as the gain is.

    Returns
    -------
    Verdict
    """
    cosine = np.cos(np.deg2rad(np.arange(0.0, 71.0, 5.0)))
    brdf = 0.2 * (1 + 0.3 * np.exp(-np.arccos(cosine) / 0.2))

    def off(k: float, gamma: float, other_k: float, other_gamma: float, power: float = 3.0) -> float:
        """By how much the stored values of a facing plane differ, were its own fall-off cos^power."""
        other = np.asarray(twin(brdf, cosine, k, gamma, other_k, other_gamma), dtype=float)
        if other.shape != cosine.shape:
            raise Wrong(f"The BRDF should have {cosine.size} values, one for each cosine, not {other.shape}.")
        with np.errstate(invalid="ignore", divide="ignore"):
            one = np.log(cosine ** (k + power) * brdf) / gamma
            ratio = np.log(cosine ** (other_k + power) * other) / other_gamma - one
        return float(np.ptp(ratio)) if np.all(np.isfinite(ratio)) else np.inf

    both, same_gamma, same_k = (2.5, 2.2, 3.1, 1.8), (2.5, 2.2, 3.1, 2.2), (2.5, 2.2, 2.5, 1.8)
    if off(2.5, 2.2, 2.5, 2.2) > 1e-9:
        raise Wrong("With the same k and γ, the BRDF must stay as it is; yours becomes another one.")
    if off(*both) < 1e-9 and off(*same_gamma) < 1e-9 and off(*same_k) < 1e-9:
        return (
            "The same stored values from another k and another γ: on a facing plane the BRDF takes up any of "
            "both. Turn the sheet, or fold it, and θ is α no more."
        )
    for power, said in {
        0.0: "On a facing plane cos θ/d² falls off as well: with which power of cos α?",
        1.0: "You have the cos θ; what of 1/d², with $d = D/\\cos\\alpha$?",
        2.0: "You have the 1/d²; where is the cos θ of the surface?",
    }.items():
        if off(*both, power) < 1e-9 and off(*same_k, power) < 1e-9:
            raise Wrong(said)
    if off(*same_gamma) < 1e-9:
        raise Wrong(
            "Right for another k. Another γ raises all of the light to γ′/γ, the fall-off of the plane too."
        )
    if off(*same_k) < 1e-9:
        raise Wrong("Right for another γ alone. What must the BRDF make up for when k changes as well?")
    if off(2.5, 2.2, 1.3 * 2.5, 1.3 * 2.2) < 1e-9:
        raise Wrong("Right where k/γ stays as it is. Let k and γ change each for itself.")
    if _is_inverse(twin, brdf, cosine):
        raise Wrong("It makes the difference twice as large: old and new k have changed places.")
    raise Wrong(
        "Stored values still differ. Write γ log I of both, set them equal up to a constant, and solve."
    )


def _is_inverse(twin: BrdfOf, brdf: FloatArray, cosine: FloatArray) -> bool:
    """Whether the power that makes up for another k has the wrong sign."""
    found = np.log(np.asarray(twin(brdf, cosine, 2.5, 2.2, 3.1, 2.2), dtype=float) / brdf)
    return float(np.ptp(found - 0.6 * np.log(cosine))) < 1e-9
