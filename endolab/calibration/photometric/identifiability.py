"""What samples can tell of k and γ: measured before the fit, so that what they can't is refused.

Scale γ by 1 + δ: the grey levels stay as they are if L grows by the factor 1 + δ as well. Of L,
the k log cos α, the gains and log f are free to do so. What isn't is

    s = -2 log d + log cos θ + log a   (a of materials whose reflectance is known)

unless a constant per frame (the gain), a function of θ (the BRDF) and a multiple of log cos α
make up for δ·s. What is left of s after a regression on them is all that the samples know of γ:

              s                            error of log γ  =  σ / |left|, left in grey levels
             /|
            / | left                       likewise of k, with log cos α for s,
           /  |                            and γ taken as known
    ------o---+------------  what the others imitate: per frame 1, of θ any function, and log cos α

On a flat sheet with the light at the camera nothing is left: the sheet's height over the camera is
d cos θ, so s = -2 log height + 3 log cos θ, a constant per frame and a function of θ.

The regression gives f many more nodes than the fit has. Else the error of interpolating f between
few nodes would count as information, and would fix γ at a wrong value.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from endolab.calibration.least_squares import Arrow, Linearised
from endolab.calibration.photometric.model import (
    GREY_LEVELS,
    LightModel,
    LightUnknowns,
    hats,
)
from endolab.calibration.photometric.result import PhotometricFit
from endolab.numerics.arrays import BoolArray, FloatArray, IntArray

# What samples must show before k and γ are believed, and what is worth a sentence.
#
# A signal is the part of s, and of log cos α, that only γ, or k, can explain: root mean square. Errors of
# the poses make up some of it where there is none: 0.3 % of the distance and 0.1° of the normal, apart
# for each sample, 0.009 of s. A fold of 3° gives 0.02 to 0.05 of it, tilts up to 5° give 0.02 of
# log cos α.
RICH_NODES = 60  # of the BRDF, in the regression
LEAST_GAMMA_SIGNAL = 0.018
LEAST_K_SIGNAL = 0.012
LARGEST_GAMMA_ERROR = 0.05  # relative
LARGEST_K_ERROR = 0.1
# Share of 1/r² cos θ: between a lamp at the lens, 1 (0.67 on the roughest paper), and the light of a
# room, 0. Below the first the light is refused, below the second the verdict remarks it.
LEAST_FALL_OFF = 0.6
USUAL_FALL_OFF = 0.85
# Grey levels; an endoscope's own light leaves 3 to 8, of a poor camera 13.
LARGEST_SIGMA = 15.0
# A jump of the gain, in medians of the steps of so many frames around, and how many are named.
JUMP = 6.0
JUMP_WINDOW = 11
JUMPS_NAMED = 5
HELD_TO = 1e-3  # of its standard deviation, to which an unknown is held
# Standard deviations of the noise by which levels should stay inside the sensor's range.
CLEARANCE = 3.5
# Of the distances, for which the verdict says what it would do.
POSE_ERROR = 0.001


class NotIdentifiableError(ValueError):
    """The samples do not tell an unknown: "gamma", "k", "brdf" or "light"."""

    def __init__(self, unknown: str, reason: str) -> None:
        super().__init__(reason)
        self.unknown = unknown


@dataclass(frozen=True)
class Strength:
    """How well samples determine an unknown, before it is fitted.

    `signal` is the root mean square of that part of its influence that no other unknown can imitate, as a
    relative change of the light for a change of 1 in the unknown (in log γ for γ).
    """

    sd: float  # standard error to expect; of log γ for γ
    signal: float  # with the reflectances that are roughly known taken as known
    alone: float  # with these free


def regress(
    columns: FloatArray,
    target: FloatArray,
    weight: FloatArray,
    group: IntArray,
    ridge: FloatArray | float = 0.0,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weighted least squares on columns, (n, p), and a free constant per group (ascending, no gaps from 0).

    `ridge` weighs coefficient² in the sum that is minimised. Returns the coefficients, the shortest where
    they are not determined, the constants, and the target's residual.
    """
    count = columns.shape[1]
    stiffness = np.diag(np.sqrt(np.broadcast_to(ridge, count)))
    ones = np.ones((len(target), 1, 1))
    lin = Linearised(target[:, None], -columns[:, None], -ones, np.zeros(count), stiffness)
    solved, own = Arrow(lin, weight, group).solve(0.0)
    constant = own[:, 0]
    return solved, constant, target - columns @ solved - constant[group]


def strengths(
    model: LightModel, unknowns: LightUnknowns, sigma: float
) -> dict[str, Strength]:
    """Measure what the samples know of "k" (γ being given) and of "gamma", unless γ is known.

    The unknowns must be near the truth; σ is the noise in grey levels.
    """
    samples = model.samples
    used = model.usable(unknowns)
    weight = np.where(used, (model.predict(unknowns) / unknowns.gamma) ** 2, 0.0)
    tiny = np.finfo(float).tiny
    columns = [np.zeros((len(used), 0))]
    if len(model.nodes) > 1:
        count = int(np.clip(used.sum() // 10, len(model.nodes), RICH_NODES))
        rich = np.linspace(model.nodes[0], model.nodes[-1], count)
        columns.append(hats(rich, model.geometry.theta))
    roughly: list[FloatArray] = []
    stiff: list[float] = []
    for material in model.loose_materials:
        is_material = (samples.material == material)[:, None].astype(float)
        known = model.reflectances[material]
        if isinstance(known, tuple):
            roughly.append(is_material)
            stiff.append((sigma / known[1]) ** 2)
        else:
            columns.append(is_material)

    def left_over(
        target: FloatArray, others: list[FloatArray], ridge: FloatArray | float = 0.0
    ) -> float:
        """Least sum of squares of a target that others imitate."""
        imitate = np.concatenate(others, axis=1)
        solved, _, residual = regress(imitate, target, weight, model.group, ridge)
        return float(weight @ residual**2 + np.sum(ridge * solved**2))

    def measure(target: FloatArray) -> Strength:
        squares = information = alone = left_over(target, columns)
        if roughly:
            free = columns + roughly
            ridge = np.zeros(sum(column.shape[1] for column in free))
            alone = left_over(target, free)
            ridge[-len(stiff) :] = stiff
            information = left_over(target, free, ridge)
        total = max(weight.sum(), tiny)
        sd = sigma / np.sqrt(max(information, tiny))
        return Strength(sd, np.sqrt(squares / total), np.sqrt(alone / total))

    fall_off = model.geometry.log_cos_alpha
    strength = {"k": measure(fall_off)}
    if model.free[1]:
        columns.append(fall_off[:, None])
        target = model.geometry.falloff + model.given_log_reflectance
        strength["gamma"] = measure(target)
    return strength


def refuse(model: LightModel, evidence: dict[str, Strength]) -> None:
    """Raise, saying what to do, if the samples cannot tell k, or a γ that is to be found from them alone."""
    k = evidence["k"]
    normals = model.samples.normals
    frames = len(np.unique(model.samples.frame))
    tabulated = len(model.nodes) > 1
    if tabulated and k.signal < LEAST_K_SIGNAL:
        raise NotIdentifiableError(
            "k",
            "these samples do not determine k: in all frames the incidence angle goes with the angle off "
            "the axis, as on a sheet that faces the camera, and a free BRDF explains whatever k does; "
            "tilt the sheet, or assume a matt sheet (lambertian BRDF)",
        )
    if tabulated and frames == 1 and np.all(np.std(normals, axis=0) < 1e-3):
        why = "a single frame of a flat sheet does not determine k"
        error = "an error of its one pose would pass for fall-off"
        ways = "take more frames, or assume a matt sheet (lambertian BRDF)"
        raise NotIdentifiableError("k", f"{why}: {error}; {ways}")
    if k.sd > LARGEST_K_ERROR:
        have = f"{len(normals)} samples of {frames} frame{'' if frames == 1 else 's'}"
        why = f"these samples do not determine k: its standard error would be {k.sd:.2g} with {have}"
        raise NotIdentifiableError("k", f"{why}; take more of them, over a wider field")
    if model.known[1] is not None:
        return
    gamma = evidence["gamma"]
    if gamma.signal < LEAST_GAMMA_SIGNAL or gamma.sd > LARGEST_GAMMA_ERROR:
        ways = "fold the sheet, print grey patches of known ratio, or lock the gain and vary the distance"
        raise NotIdentifiableError(
            "gamma",
            "these samples do not determine gamma, only k/gamma: a change of gamma is made up for by "
            f"k, the gains and the BRDF to {100 * gamma.signal:.2g} % of the light "
            f"({100 * LEAST_GAMMA_SIGNAL:g} % is needed; the standard error would be "
            f"{100 * min(gamma.sd, 99):.2g} %); {ways}, or give gamma",
        )


def fall_off_share(
    model: LightModel, unknowns: LightUnknowns, used: BoolArray
) -> tuple[float, float]:
    """Measure how much of 1/r² cos θ is in the brightness within frames: 1 of a lamp at the lens.

    The surface is taken to be matt. Returns the exponent, and its standard error; both hold for γ as it is in
    the unknowns. Light that stays in the room gives 0, however it is exposed: for a flat sheet, a BRDF of
    1/cos³ θ would pass for it, so that neither residuals nor k betray it.
    """
    geometry = model.geometry
    level = np.where(used, model.samples.level, 1.0)
    weight = np.where(used, level**2, 0.0)
    loose = [model.samples.material == material for material in model.loose_materials]
    others = np.column_stack([geometry.log_cos_alpha, *loose])
    target = unknowns.gamma * np.log(level) - model.given_log_reflectance
    _, _, light = regress(others, target, weight, model.group)
    _, _, lamp = regress(others, geometry.falloff, weight, model.group)
    information = float(weight @ lamp**2) + np.finfo(float).tiny
    share = float(weight @ (lamp * light)) / information
    rest = float(weight @ (light - share * lamp) ** 2) / (int(used.sum()) + 1)
    return share, float(np.sqrt(rest / information))


def judge_light(
    model: LightModel, unknowns: LightUnknowns, used: BoolArray, sigma: float
) -> list[str]:
    """Raise if what was fitted is no light that moves with the camera; return what is doubtful about it."""
    remarks = []
    ways = "use the endoscope's own light, and no other"
    if (
        model.known[1] is not None
    ):  # a free γ would make up for it, and run out of its bounds
        share, error = fall_off_share(model, unknowns, used & (model.samples.level > 0))
        power = f"to the power {share:.2f} ± {error:.2f} of what a lamp at the lens does"
        if share + 2 * error < LEAST_FALL_OFF:
            why = "the brightness hardly falls with distance and tilt, as in a lit room"
            raise NotIdentifiableError("light", f"{why}: {power}; {ways}")
        if share + 2 * error < USUAL_FALL_OFF:
            why = "there was another light, γ is larger, or the paper is rough"
            remarks.append(f"The brightness falls with distance and tilt {power}: {why}.")
    if sigma > LARGEST_SIGMA:
        why = (
            f"the residuals of {sigma:.0f} grey levels are too large for a lamp at the lens"
        )
        raise NotIdentifiableError("light", f"{why}; {ways}")
    return remarks


def hold_unknowns(model: LightModel, evidence: dict[str, Strength]) -> LightModel:
    """Hold what is roughly known at its value (to `held_to` of its sd) where the samples cannot tell it.

    Left to the fit, such an unknown would follow the error of interpolating the BRDF between few
    nodes, and would seem to be known. `widen` gives the uncertainty back.
    """
    if "gamma" not in evidence:
        return model
    known = list(model.known)
    hold_gamma = evidence["gamma"].signal < LEAST_GAMMA_SIGNAL
    hold_reflectance = evidence["gamma"].alone < LEAST_GAMMA_SIGNAL
    for i, belief in enumerate(known):
        if isinstance(belief, tuple) and (hold_gamma if i == 1 else hold_reflectance):
            known[i] = belief[0], HELD_TO * belief[1]
    return replace(model, known=tuple(known))


def widen(covariance: FloatArray, model: LightModel, stiff: LightModel) -> FloatArray:
    """Add to a covariance, (q, q), what the unknowns that were held may vary, and others with them."""
    result = covariance.copy()
    for number, i in enumerate(np.flatnonzero(model.free)):
        known = model.known[i]
        if isinstance(known, tuple) and known != stiff.known[i]:
            variance = covariance[number, number]
            along = covariance[:, number] / variance  # d(all)/d(held)
            result += (known[1] ** 2 - variance) * np.outer(along, along)
    return result


def gain_jumps(frames: IntArray, gains: FloatArray) -> list[tuple[int, float]]:
    """Find the frames where the gain changes at once, far more than around: (frame, ratio), largest first."""
    if len(gains) < JUMP_WINDOW:
        return []
    # Gains follow the sheet, at times fast but smoothly; a jump stands out from the steps beside it.
    steps = np.diff(np.log(gains))
    excess = np.abs(steps - scipy.ndimage.median_filter(steps, size=5, mode="nearest"))
    usual = scipy.ndimage.median_filter(excess, size=JUMP_WINDOW, mode="nearest")
    jumps = np.flatnonzero(excess > np.maximum(JUMP * usual, np.log(1.3)))
    jumps = jumps[np.argsort(-np.abs(steps[jumps]))]
    return [(int(frames[i + 1]), float(np.exp(steps[i]))) for i in jumps]


def _say_gamma(
    model: LightModel, fit: PhotometricFit, expected: dict[str, Strength]
) -> list[str]:
    """Say what determines k and γ."""
    k = fit.k
    gamma = fit.photometry.gamma
    errors = fit.standard_errors
    known = model.known[1]
    ratio = f"k/γ = {fit.ratio:.4f} ± {errors['k/gamma']:.4f}"
    measured_k = f"k = {k:.4f} ± {errors['k']:.4f}"
    if isinstance(known, float):
        given = f"γ = {gamma:g} was given, not measured: where it is wrong by 1 %, k is wrong by 1 %"
        return [
            f"{ratio} is determined by how the light falls off across the frames; {given}.",
            f"{measured_k}, if γ is {gamma:g}.",
        ]
    if known is None:
        locked = fit.photometry.gain is not None
        source = "the distance " + (
            "under a locked gain" if locked else "within each frame"
        )
        if any(known is not None for known in model.reflectances[1:]):
            source = "the reflectances that are known"
        bias = (2 * POSE_ERROR / expected["gamma"].signal) ** 2 * gamma
        errs = f"Random errors of {100 * POSE_ERROR:g} % in the distances"
        return [
            f"γ = {gamma:.4f} ± {errors['gamma']:.4f} is measured, by {source}.",
            f"{errs} would raise γ by {bias:.2g}, and k with it.",
            f"{measured_k} is measured; {ratio}.",
        ]
    mean, sd = known
    source = f"leave ± {errors['gamma']:.4f}"
    if errors["gamma"] ** 2 > 0.9 * sd**2:
        source = "add nothing to that"
    return [
        f"γ = {gamma:.4f}: {mean:g} ± {sd:g} was given, and the samples {source}.",
        f"{measured_k}; {ratio} is known better than either.",
    ]


def describe_verdict(
    model: LightModel, fit: PhotometricFit, expected: dict[str, Strength]
) -> list[str]:
    """Say in words what is determined, by what, and what is not."""
    sentences = _say_gamma(model, fit, expected)
    say = sentences.append
    if len(model.nodes) == 1:
        also = " and γ" if model.free[1] else ""
        say(
            f"The surface was taken to be matt (Lambertian): a sheen would show as wrong k{also}."
        )
    low, high = np.rad2deg(fit.alpha_range)
    say(
        f"The fall-off was seen from {low:.0f}° to {high:.0f}° off the axis; it is a guess beyond."
    )
    if len(model.nodes) > 1:
        low, high = np.rad2deg(fit.theta_range)
        seen = f"The BRDF was seen from {low:.0f}° to {high:.0f}° and is constant beyond"
        say(f"{seen}; its scale and that of the gains cannot be told apart.")
    for material in model.loose_materials:
        error = fit.standard_errors[f"reflectance {material}"]
        value = f"{fit.reflectance[material]:.4f} ± {error:.4f}"
        say(f"Material {material} reflects {value} of what material 0 does.")
    low, high = GREY_LEVELS * np.array(model.levels)
    needed = CLEARANCE * fit.sigma
    if min(low, GREY_LEVELS - high) < needed:
        say(
            f"The residuals, of {fit.sigma:.1f} grey levels, reach out of the sensor's range from the levels "
            f"that were used, {low:.0f} to {high:.0f}, which biases the result: keep "
            f"{needed:.0f} inside 0 and 255."
        )
    if fit.photometry.gain is not None:
        say("One gain was fitted for all frames.")
    known = np.isfinite(fit.gain_errors)
    jumps = gain_jumps(fit.frames[known], fit.gains[known])
    if jumps:
        largest = sorted(jumps[:JUMPS_NAMED])
        named = ", ".join(f"{frame} (×{jump:.2g})" for frame, jump in largest)
        rest = len(jumps) - len(largest)
        more = f" and {rest} more" if rest else ""
        say(f"The gain jumps at frame {named}{more}.")
    return sentences
