"""Checks of notebook 03: the residual of a grey level, glossy paper taken for matt, a γ that is wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from endolab.calibration.photometric.fit import calibrate_light
from endolab.calibration.photometric.result import PhotometricFit
from endolab.calibration.photometric.samples import Samples
from endolab.course.verdict import Wrong, alike, verdict
from endolab.model.brdf import TabulatedBRDF
from endolab.model.photometry import Photometry
from endolab.numerics.arrays import FloatArray

GREY = 255.0  # grey levels of a stored value of 1
# What the residual is tried with; not the values of the notebook, lest they are written into the answer.
K, GAMMA = 2.3, 1.9
NODES = np.deg2rad([0.0, 10.0, 25.0, 45.0, 90.0])
F_R = np.array([0.41, 0.36, 0.30, 0.27, 0.24])  # 1/sr
TRIED = 600  # samples, or a few more
LEAST_THETA = 2.0  # ° of a sample; taken for radians, it lies beyond the nodes
CLOSE = 1e-3  # grey levels
EXACT = 1e-6  # of a logarithm

# Answers that a model's level can be read from: what is wrong with them, and how. Of two readings that
# complain alike, the first is taken.
FORMS: tuple[tuple[str, Callable[[FloatArray, FloatArray], FloatArray]], ...] = (
    ("What is taken away is in grey levels, but the model is not.", lambda e, stored: e + GREY * stored),
    ("", lambda e, stored: e / GREY + stored),
    ("The sign is turned round: it is the model less what is stored.", lambda e, stored: stored - e / GREY),
    ("The unit is a grey level, of which there are 255: multiply by 255.", lambda e, stored: e + stored),
    ("It is 255 times the model *less what is stored*, not the reverse.", lambda e, stored: stored - e),
    ("This is the model's grey level; take away what is stored.", lambda e, stored: e / GREY),
    ("This is the model's level; take away what is stored, then multiply by 255.", lambda e, stored: e),
    ("The model is in grey levels, but what is taken away is not.", lambda e, stored: (e + stored) / GREY),
)


@dataclass(frozen=True)
class _Trial:
    """Samples, what they are tried with, and what the library makes of them."""

    samples: Samples
    gains: FloatArray  # (frames,)

    @property
    def alpha(self) -> FloatArray:
        return np.arccos(np.minimum(self.samples.cos_alpha, 1.0))

    @property
    def theta(self) -> FloatArray:
        return np.arccos(np.minimum(self.samples.cos_theta, 1.0))

    @property
    def level(self) -> FloatArray:
        """Stored values that the model expects, by the library, (n,)."""
        light = Photometry(K, GAMMA, 1.0, TabulatedBRDF(tuple(NODES), tuple(F_R)))
        shape = light.intensity(self.samples.points, self.samples.normals)
        return shape * self.gains[self.samples.frame] ** (1 / GAMMA)


def _trial(samples: Samples) -> _Trial:
    tilted = samples[samples.cos_theta < np.cos(np.deg2rad(LEAST_THETA))]
    few = tilted[:: max(len(tilted) // TRIED, 1)]
    return _Trial(few, 3000.0 * (1 + np.arange(few.frame.max() + 1) % 7))


def _look_ups(trial: _Trial) -> dict[str, FloatArray]:
    """f_r of each sample, if looked up rightly or wrongly; what to say of it."""
    nearest = np.abs(trial.theta[:, None] - NODES).argmin(axis=1)
    return {
        "": np.interp(trial.theta, NODES, F_R),
        "The BRDF is looked up at α; what it depends on is θ.": np.interp(trial.alpha, NODES, F_R),
        "The BRDF is looked up at cos θ, but the nodes are angles, in radians.": np.interp(
            np.cos(trial.theta), NODES, F_R
        ),
        "Between its nodes the BRDF runs along straight lines: `np.interp`.": F_R[nearest],
    }


def _powers(level: FloatArray, trial: _Trial, f_r: FloatArray) -> FloatArray | None:
    """Powers with which d, cos α, cos θ, f_r and g enter a level, and the logarithm of what is left, (6,).

    None if it is no such product.
    """
    if not (level > 0).all():
        return None
    samples = trial.samples
    quantities = (samples.distance, samples.cos_alpha, samples.cos_theta, f_r, trial.gains[samples.frame])
    matrix = np.column_stack([*map(np.log, quantities), np.ones(len(level))])
    solved = np.linalg.lstsq(matrix, np.log(level), rcond=None)[0]
    return solved if np.abs(matrix @ solved - np.log(level)).max() < EXACT else None


def _is(value: float, other: float) -> bool:
    return abs(value - other) < 1e-4


def _of_response(powers: FloatArray) -> tuple[str, FloatArray]:
    """Tell what is wrong with the response, and the powers in the light before it."""
    light = GAMMA * powers
    shares = light[:5] / [-2.0, K, 1.0, 1.0, 1.0]
    if np.ptp(shares) < 1e-4 and not _is(shares[0], 0):
        share = float(shares[0])  # that all have in common
    else:
        share = max((1.0, GAMMA, GAMMA**2), key=lambda one: np.sum(np.abs(shares - one) < 1e-4))
    if _is(share, 1):
        return "", light
    if _is(share, GAMMA):
        return "What is stored is the light to the power 1/γ; here it is the light itself.", light / share
    if _is(share, GAMMA**2):
        return "The power of the response is 1/γ; here it is γ.", light / share
    power = share / GAMMA
    told = f"The light is taken to the power {power:.3f}; with γ = {GAMMA} it is 1/γ = {1 / GAMMA:.3f}."
    return told, light / share


def _of_angles(distance: float, alpha: float, theta: float) -> list[str]:
    """Tell what is wrong with the powers of d, cos α and cos θ."""
    told = []
    if _is(distance, -1):
        told.append("Light thins out with the *square* of the distance; here it falls as 1/d.")
    elif _is(distance, 0):
        told.append("The distance plays no part: light thins out as 1/d².")
    elif not _is(distance, -2):
        told.append(f"The distance enters with the power {distance:.2f}: light thins out as 1/d².")
    if _is(alpha, 1) and _is(theta, K):
        told.append("α and θ have changed places: cosᵏ is of α, off the axis, and θ is at the paper.")
    elif _is(alpha, K + 1) and _is(theta, 0):
        told.append("The tilt of the paper is cos θ, of the angle at its normal; here it is taken at α.")
    elif _is(alpha, 0) and _is(theta, K + 1):
        told.append("The fall-off cosᵏ is of α, the angle off the axis; here it is taken at θ.")
    else:
        if _is(alpha, 0):
            told.append("The fall-off off the axis, cosᵏα, is missing.")
        elif _is(alpha, K - 2) or _is(alpha, K - 1):
            told.append("d is the distance, the length of a row of `points`, not its part z along the axis.")
        elif not _is(alpha, K):
            told.append(f"cos α enters with the power {alpha:.2f}; here k = {K}.")
        if _is(theta, 0):
            told.append("cos θ is missing: tilted paper catches less light.")
        elif _is(theta, 2):
            told.append("cos θ is there twice.")
        elif not _is(theta, 1):
            told.append(f"cos θ enters with the power {theta:.2f}, and should once.")
    return told


def _of_factors(f_r: float, gain: float, rest: float) -> list[str]:
    """Tell what is wrong with the powers of f_r and g, and with the logarithm of what is left."""
    told = []
    if _is(f_r, 0) and _is(rest, np.log(F_R[-1])):
        told.append("The BRDF is looked up in degrees, but the nodes are in radians.")
        rest = 0.0
    elif _is(f_r, 0):
        told.append("The BRDF is missing.")
    elif not _is(f_r, 1):
        told.append(f"f_r enters with the power {f_r:.2f}, and should once.")
    if _is(gain, 0):
        told.append("The gain of the frame is missing.")
    elif _is(gain, GAMMA):
        told.append("The gain belongs into the bracket: the response bends it like all light.")
    elif not _is(gain, 1):
        told.append(f"The gain enters with the power {gain:.2f}, and should once.")
    if _is(abs(rest), np.log(np.pi)):
        told.append("There is a π too many: f_r, in 1/sr, comes as it is.")
    elif not _is(rest, 0):
        told.append(f"All the light is {np.exp(rest):.4g} times what it should be.")
    return told


def _mistakes(e: FloatArray, trial: _Trial) -> list[str]:
    """Say what is wrong with residuals, as far as it can be told."""
    readings = []
    for form, level_of in FORMS:
        level = level_of(e, trial.samples.level)
        for look_up, f_r in _look_ups(trial).items():
            powers = _powers(level, trial, f_r)
            if powers is None:
                continue
            response, (distance, alpha, theta, of_f, gain, rest) = _of_response(powers)
            told = [form, look_up, response, *_of_angles(distance, alpha, theta)]
            readings.append([one for one in (*told, *_of_factors(of_f, gain, rest)) if one])
    return min(readings, key=len) if readings else [_unlike(e, trial)]


def _unlike(e: FloatArray, trial: _Trial) -> str:
    """Say how residuals differ that are no product of what the model is a product of."""
    level = e / GREY + trial.samples.level
    with np.errstate(all="ignore"):
        off = np.log(level / trial.level)
    frame = trial.samples.frame
    if np.isfinite(off).all() and all(np.ptp(off[frame == one]) < EXACT for one in np.unique(frame)):
        return "Within a frame all is right: does each sample take the gain of its own frame?"
    one = trial.samples[:1]
    d, cos_alpha, cos_theta = one.distance[0], one.cos_alpha[0], one.cos_theta[0]
    place = f"d = {d:.3f} mm, cos α = {cos_alpha:.4f}, cos θ = {cos_theta:.4f}"
    expected = f"The model makes {GREY * trial.level[0]:.2f} grey levels of it"
    return f"The first sample that was tried has {place}. {expected}, yours {GREY * level[0]:.2f}."


def _not_numbers(wrong: np.ndarray, trial: _Trial) -> str:
    """Say why residuals are not finite, (n,) bool."""
    if wrong.all():
        return (
            "None of them is a number (nan): a negative light has no root. Is cos θ negative? "
            "The normals face the camera, and the way back to it is -x."
        )
    in_degrees = [np.cos(np.rad2deg(angle)) < 0 for angle in (trial.alpha, trial.theta)]
    if any(np.array_equal(wrong, which) for which in (*in_degrees, in_degrees[0] | in_degrees[1])):
        return "Some are not a number (nan): `np.cos` takes radians, and here it is given degrees."
    return f"{np.sum(wrong)} of {len(wrong)} residuals are not finite numbers."


@verdict
def residual(answer: Callable[..., Any], samples: Samples) -> str:
    """Check a function of k, γ, the gain of each frame, the BRDF's nodes and values there, and samples.

    It returns what the model expects of each sample less what is stored, grey levels, (n,).
    """
    trial = _trial(samples)
    with np.errstate(all="ignore"):
        found = answer(K, GAMMA, trial.gains, NODES, F_R, trial.samples)
    if found is None:
        raise Wrong("The function returns nothing: end it with `return`.")
    e = np.asarray(found, dtype=np.float64)
    if e.shape != (len(trial.samples),):
        raise Wrong(f"One number a sample is asked for, shape ({len(trial.samples)},); this is {e.shape}.")
    if not np.isfinite(e).all():
        raise Wrong(_not_numbers(~np.isfinite(e), trial))
    expected = GREY * (trial.level - trial.samples.level)
    if np.abs(e - expected).max() > CLOSE:
        raise Wrong(" ".join(_mistakes(e, trial)))
    return f"{len(e)} samples, with another k, γ, gain and paper: right to a thousandth of a grey level."


@verdict
def exercise_1(off: float, warned: str, folded: Samples, glossy: PhotometricFit, truth: Photometry) -> str:
    """Check by how many standard errors γ is off if glossy paper is taken for matt, and what warns of it.

    `glossy` is the fit of the same samples with a table of the BRDF.
    """
    matt = calibrate_light(folded, gamma="free", brdf="lambertian")
    error, se = matt.photometry.gamma - truth.gamma, matt.standard_errors["gamma"]
    error_of_k = matt.photometry.k - truth.k
    of_table, se_of_table = glossy.photometry.gamma - truth.gamma, glossy.standard_errors["gamma"]
    wrong = {
        "That is the error of γ itself; how many of its standard errors are in it?": error,
        "That is the error in percent; divide it by the standard error instead.": 100 * error / truth.gamma,
        "That is in units of σ, the noise of a sample; γ has a standard error of its own.": error
        / matt.sigma,
        "That is what k is off by; γ is asked for.": error_of_k / matt.standard_errors["k"],
        "That is the fit with a table; take the paper for matt.": of_table / se_of_table,
        "Divide by the standard error of the matt fit, not by that of the one with a table.": (
            error / se_of_table
        ),
    }
    if not np.isclose(abs(off), abs(error / se), rtol=0.05):
        amount = {told: abs(value) for told, value in wrong.items()}
        otherwise = "`told` prints γ and its standard error: how many of these are between γ and the truth?"
        raise Wrong(alike(abs(off), amount, otherwise))
    if warned == "standard errors":
        raise Wrong(f"They say ± {se:.4f}, and know of noise only, not of a wrong model.")
    if warned != "residuals":
        raise Wrong('The second answer is "residuals" or "standard errors".')
    told = f"γ is off by {error:+.3f}, {abs(error / se):.0f} standard errors."
    return f"{told} The residuals have {matt.sigma:.1f} grey levels, and {glossy.sigma:.1f} with a table."


@verdict
def exercise_2(factor: float) -> str:
    """Check how much farther a wall at 100 mm seems than one at 25 mm, with γ = 2.0 where it is 2.2."""
    truth = Photometry(gamma=2.2, gain=1.0)
    levels = truth.intensity([[0, 0, 25.0], [0, 0, 100.0]], [0, 0, -1.0])
    near, far = replace(truth, gamma=2.0).canonical(levels, 1.0) ** -0.5
    seems = far / near
    wrong = {
        "That is the truth, and what a right γ would find.": 4.0,
        "The other way round: which γ made the picture, and which one undoes it?": 4.0**1.1,
        "The two γ make a *power* of the factor, not a factor to it.": 4 * 2.0 / 2.2,
        "That is the nearer wall over the farther one; turn it round.": 1 / seems,
        "That is the factor between their lights; light goes with the square of the distance.": seems**2,
        "That is the factor between their true lights; the distances that are found are asked for.": 16.0,
        "That is by how much it is short; which is the factor between the two walls?": 1 - seems / 4,
        "That is by how many percent it is short; which is the factor between the two walls?": (
            100 - 25 * seems
        ),
    }
    if not np.isclose(factor, seems, rtol=0.005):
        raise Wrong(alike(factor, wrong, "With the wrong γ, to which power does a distance come?"))
    return f"{seems:.2f} instead of 4: {1 - seems / 4:.0%} short, and no residual would have told."
