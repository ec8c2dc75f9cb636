r"""Photometric calibration: k, γ, the gain of each frame and the paper's BRDF, from samples.

    camera and light          I = 255 · exp(L/γ)
        o-------> axis        L = k log cos α             how light and lens fall off: k
         \ α                    - 2 log d + log cos θ    where the sample lies: known
        d \   ^ n               + log f(θ)               the BRDF, at nodes of θ
           \ / θ                + log a + log g          the patch, and the frame's gain
      ------x------ sheet

    `_start` (linear in log I) -> `strengths`, `refuse` -> `fit` -> `_result` (checks, verdict)

After Section IV of the paper, with three differences: the gains are eliminated from the normal
equations, the last stage forgets outliers instead of bounding them, and what the samples cannot
tell is refused or named (see `identifiability`).

The gauge: light, gain and reflectance only ever come as a product. The result sets the
reflectance: f_r = 1/π at the node of the BRDF that has the most light (or everywhere, if
Lambertian). Gains are then relative to a perfectly white sheet. To use the calibration on another
material, replace the BRDF by that of the material in 1/sr:
``dataclasses.replace(fit.photometry, brdf=Lambertian(0.4))``. k, γ and the gains stay valid, up to
the one factor by which the true paper is darker than that.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from endolab.calibration.least_squares import Covariance, Fit, FitIterate, fit
from endolab.calibration.photometric import identifiability
from endolab.calibration.photometric.identifiability import NotIdentifiableError, Strength
from endolab.calibration.photometric.model import (
    GREY_LEVELS,
    LIGHT_FIT,
    Known,
    LightModel,
    LightUnknowns,
    SampleGeometry,
    hats,
    place_nodes,
)
from endolab.calibration.photometric.result import PhotometricFit
from endolab.calibration.photometric.samples import Samples
from endolab.model.brdf import BRDF, Lambertian, TabulatedBRDF
from endolab.model.lights import SpotLight
from endolab.model.photometry import Photometry
from endolab.numerics.arrays import FloatArray, IntArray
from endolab.numerics.checks import check_int, excerpt
from endolab.numerics.iteration import Status


def _number_or_pair(value: ArrayLike) -> float | tuple[float, float] | None:
    """Read a number, or a mean and its standard deviation; None for what is neither, or not positive."""
    try:
        numbers = [float(number) for number in np.atleast_1d(value)]
    except OverflowError:  # a whole number of hundreds of digits
        return None
    if len(numbers) not in (1, 2) or not all(0 < number < np.inf for number in numbers):
        return None
    return numbers[0] if len(numbers) == 1 else (numbers[0], numbers[1])


def check_gamma(gamma: float | tuple[float, float] | str) -> Known:
    """Return γ as `calibrate_light` takes it, None if it is free; ValueError if it can be none."""
    if isinstance(gamma, str):
        if gamma != "free":
            raise ValueError(
                f'gamma must be a number, (mean, standard deviation) or "free", got {excerpt(gamma)}'
            )
        return None
    known = _number_or_pair(gamma)
    low, high = LIGHT_FIT.gamma_bounds
    if known is None or not low < np.ravel(known)[0] < high:
        allowed = "alone or with a positive standard deviation"
        raise ValueError(
            f"gamma must lie between {low:g} and {high:g}, {allowed}, got {excerpt(gamma)}"
        )
    return known


def _check_reflectance(reflectance: Sequence[Known]) -> tuple[Known, ...]:
    checked = tuple(
        None if value is None else _number_or_pair(value) for value in reflectance
    )
    for value, known in zip(reflectance, checked, strict=True):
        if value is not None and known is None:
            either = "None, positive, or (value, standard deviation)"
            raise ValueError(f"reflectance must be {either}, got {value}")
    return checked


def check_options(
    gamma: float | tuple[float, float] | str = 2.2,
    brdf: str = "tabulated",
    nodes: int = 15,
    gain: str = "free",
    reflectance: Sequence[Known] = (),
    light: str = "centred",
    levels: tuple[float, float] = LIGHT_FIT.levels,
) -> None:
    """Refuse options of `calibrate_light` that no samples could make right."""
    for name, value, choices in (
        ("brdf", brdf, ("tabulated", "lambertian")),
        ("gain", gain, ("free", "locked")),
        ("light", light, ("centred", "free")),
    ):
        if value not in choices:
            raise ValueError(
                f'{name} must be "{choices[0]}" or "{choices[1]}", got {excerpt(value)}'
            )
    check_int("nodes", nodes, 2)
    if not 0 <= levels[0] < levels[1]:
        raise ValueError(f"levels must ascend from 0 or above, got {levels}")
    check_gamma(gamma)
    _check_reflectance(reflectance)


def _start(model: LightModel) -> tuple[LightUnknowns, float]:
    """Solve in the logarithm of the light, where all but γ is linear; return σ in grey levels too.

    Noise of σ grey levels is γσ/I in log I^γ, hence weights I². Outliers fade by a few
    reweightings. What is saturated is told from the measured level here, for want of a better one.
    """
    samples = model.samples
    gamma = (
        model.gamma
        if isinstance(model.gamma, float)
        else model.gamma[0]
        if model.gamma
        else LIGHT_FIT.first_gamma
    )
    log_reflectance = model.given_log_reflectance
    loose = [m for m in model.loose_materials if model.reflectance[m - 1] is None]
    geometry, _ = model.geometry(LightUnknowns(0, 1, np.zeros(0), np.zeros(0), np.zeros(0)))
    good = (
        geometry.valid
        & (samples.level > model.levels[0])
        & (samples.level < model.levels[1])
    )
    level = np.where(good, samples.level, 0.5)
    target = gamma * np.log(level) - geometry.falloff - log_reflectance[samples.material]
    free = np.arange(len(model.nodes)) != model.pinned
    loosely = ((samples.material == m)[:, None].astype(float) for m in loose)
    columns = [geometry.log_cos_psi[:, None], *loosely]
    if len(model.nodes) > 1:
        columns.append(hats(model.nodes, geometry.theta)[:, free])
    matrix = np.concatenate(columns, axis=1)
    weight = level**2 * good
    for _ in range(5):
        solved, residual = identifiability.regress(matrix, target, weight, model.group)
        grey = GREY_LEVELS * level * residual / gamma
        sigma = 1.4826 * float(np.median(np.abs(grey[good]))) + 1e-12
        weight = level**2 * good / (1 + (grey / (3 * sigma)) ** 2) ** 2
    log_brdf = np.full(len(model.nodes), -np.log(np.pi))
    log_reflectance[loose] = solved[1 : 1 + len(loose)]
    if len(model.nodes) > 1:
        log_brdf[free] += np.clip(solved[1 + len(loose) :], -5, 5)
    groups = int(model.group[-1]) + 1
    start = LightUnknowns(
        float(solved[0]), gamma, log_brdf, log_reflectance, np.zeros(groups)
    )
    # The gain of a frame whose samples are all out of range is read from these all the same.
    alone = np.bincount(model.group, weight, groups) == 0
    weight = np.where(alone[model.group], samples.level**2 + 1e-6, weight)
    measured = np.clip(samples.level, 1e-3, None)
    expected = np.maximum(model.predict(start) / GREY_LEVELS, 1e-9)
    rest = gamma * np.log(measured / expected)
    gain = np.bincount(model.group, weight * rest, groups) / np.bincount(
        model.group, weight, groups
    )
    return replace(start, log_gain=gain), sigma


def calibrate_light(
    samples: Samples,
    *,
    gamma: float | tuple[float, float] | str = 2.2,
    brdf: str = "tabulated",
    nodes: int = 15,
    gain: str = "free",
    reflectance: Sequence[Known] = (),
    light: str = "centred",
    levels: tuple[float, float] = LIGHT_FIT.levels,
    observers: Iterable[Callable[[FitIterate], bool | None]] = (),
) -> PhotometricFit:
    """Calibrate light, response and gains from samples of known place and normal.

    Parameters
    ----------
    samples : Samples
        Of a calibration sheet, or of any surface that is known.
    gamma : float, (mean, sd) or "free"
        The response exponent: given, roughly known, or to be found. It can be found from a folded
        sheet, from patches of known reflectance, under a locked gain, or on known geometry that
        isn't one plane; never from one flat sheet with free gains.
    brdf : {"tabulated", "lambertian"}
        Whether the surface's BRDF is fitted at nodes of θ or taken to be constant.
    nodes : int
        Nodes of the BRDF, at most.
    gain : {"free", "locked"}
        One for each frame, or one for all.
    reflectance : sequence
        Of materials 1 and up, relative to material 0: a number, (value, sd), or None if free.
        They share the shape of the BRDF.
    light : {"centred", "free"}
        At the optical centre and looking forward, or with its offset and direction fitted. Then
        the result's k is the exponent of that light.
    levels : (low, high)
        Stored values between which a sample's *predicted* value must lie for it to count; choose
        them 4 standard deviations of the noise inside the sensor's range, which is 0 to 1.
    observers : iterable of callables
        Each is shown every iterate, a `FitIterate` of `LightUnknowns`; True stops the fit.

    Returns
    -------
    PhotometricFit
        Light, gains, residuals and standard errors; `verdict` says what they are worth.

    Raises
    ------
    NotIdentifiableError
        If the samples cannot tell what is asked, naming it and the reason; if they are too few, or of
        another light than an endoscope's.
    ValueError
        If an argument has a wrong value.

    Examples
    --------
    >>> import endolab as el
    >>> from endolab.calibration.photometric.fit import calibrate_light
    >>> from endolab.calibration.simulation.video import simulate_samples
    >>> paper = el.load_calibration("paper", width=320)
    >>> samples, _ = simulate_samples(el.TARGETS["vicalib_small"], paper.camera, el.Photometry(k=2.5), 60)
    >>> fit = calibrate_light(samples)
    >>> abs(fit.k - 2.5) < 3 * fit.standard_errors["k"]
    True
    """
    check_options(gamma, brdf, nodes, gain, reflectance, light, levels)
    numbers = np.column_stack([samples.level, samples.points, samples.normals])
    finite = np.isfinite(numbers).all(axis=1)
    if not finite.all():
        raise ValueError(f"samples must be finite, got {np.sum(~finite)} that are not")
    if len(samples) < LIGHT_FIT.least_samples:
        why = "white paper shows between the ink in too few places, or too small"
        raise NotIdentifiableError(
            "light",
            f"{LIGHT_FIT.least_samples} samples are needed, got {len(samples)}: {why}",
        )
    frames, frame = np.unique(samples.frame, return_inverse=True)
    group = frame if gain == "free" else np.zeros(len(samples), int)
    if gain == "locked":  # then the frames have no unknowns of their own
        samples = replace(samples, slack=np.zeros((0, 0)))
    known = _check_reflectance(reflectance)
    most = int(samples.material.max())
    if samples.material.min() < 0 or most != len(known):
        each = f"each of materials 1 to {most} of the samples"
        raise ValueError(f"reflectance must have an entry for {each}, got {len(known)}")
    theta, pinned = _nodes(samples, 1 if brdf == "lambertian" else nodes, levels)
    model = LightModel(
        samples, group, theta, pinned, check_gamma(gamma), known, light == "free", levels
    )
    begin, sigma = _start(model)
    expected = identifiability.strengths(model, begin, sigma)
    identifiability.refuse(model, expected)
    stiff = identifiability.hold_unknowns(model, expected)
    fitted = fit(stiff, begin, observers)
    covariance = identifiability.widen(fitted.covariance.common, model, stiff)
    fitted = replace(fitted, covariance=Covariance(covariance, fitted.covariance.own))
    return _result(model, frames, expected, fitted)


def _nodes(
    samples: Samples, count: int, levels: tuple[float, float]
) -> tuple[FloatArray, int]:
    """Choose the nodes of the BRDF, rad, and the pinned one, which has the most light."""
    geometry = SampleGeometry.of(samples, np.zeros(5))
    good = geometry.valid & (samples.level > levels[0]) & (samples.level < levels[1])
    if good.sum() < LIGHT_FIT.least_samples:
        which = (
            f"{good.sum()} of {len(good)} samples are lit and neither dark nor saturated"
        )
        raise NotIdentifiableError(
            "light", f"{which}, {LIGHT_FIT.least_samples} are needed; change the exposure"
        )
    theta = geometry.theta[good]
    chosen = np.zeros(1)
    if count > 1:
        if np.ptp(theta) < 1e-3:
            why = "samples that all lie at one incidence angle do not determine the BRDF"
            ways = "tilt the sheet, or assume a matt sheet (lambertian BRDF)"
            raise NotIdentifiableError(
                "brdf", f"{why}, {np.rad2deg(theta[0]):.1f}°; {ways}"
            )
        chosen = place_nodes(theta, count)
    light = samples.level[good] ** 2
    return chosen, int(np.argmax(hats(chosen, theta).T @ light))


def _check_bounds(
    model: LightModel, unknowns: LightUnknowns, spread: dict[str, float]
) -> None:
    """Refuse a fit that has run away."""
    low, high = LIGHT_FIT.gamma_bounds
    if unknowns.k < 0:
        ran = f"k ran to {unknowns.k:.3f} ± {spread['k']:.3f}, below 0"
        raise NotIdentifiableError(
            "k", f"{ran}: these samples show no fall-off off the axis"
        )
    if not low < unknowns.gamma < high:
        ran = f"gamma ran to {unknowns.gamma:.2f}, out of {low:g} to {high:g}"
        raise NotIdentifiableError("gamma", f"{ran}; check the distances, or give gamma")
    if model.free_light:
        _check_place(spread)
    error = unknowns.gamma * spread["k/gamma"]
    most = identifiability.EVIDENCE.largest_k_error
    if error > most:
        why = f"these samples do not determine k: it is {unknowns.k:.2f} ± {error:.2f}"
        raise NotIdentifiableError("k", f"{why}, of which at most ± {most:g} is of use")


def _check_place(spread: dict[str, float]) -> None:
    """Refuse a light whose place or direction the samples do not tell."""
    place = max(spread[f"light {axis}"] for axis in "xyz")
    tilt = max(spread["light tilt x"], spread["light tilt y"])
    if place > LIGHT_FIT.largest_place_error or tilt > LIGHT_FIT.largest_tilt_error:
        why = "these samples do not determine the light's place and direction"
        errors = f"their standard errors are {place:.2g} mm and {np.rad2deg(tilt):.2g}°"
        ways = (
            'vary the distance and the tilt, or take the light as centred (light="centred")'
        )
        raise NotIdentifiableError("light", f"{why}: {errors}; {ways}")


def _standard_errors(
    unknowns: LightUnknowns, spread: dict[str, float], covariance: FloatArray
) -> dict[str, float]:
    """Standard errors of the values themselves, by those of the unknowns; 0 for what was given."""
    slope = np.zeros(len(spread))  # of k/γ
    slope[0] = 1 / unknowns.gamma
    if "gamma" in spread:
        slope[1] = -unknowns.k / unknowns.gamma**2
    errors = {"k": spread["k"], "gamma": spread.get("gamma", 0.0)}
    errors["k/gamma"] = float(np.sqrt(slope @ covariance @ slope))
    for name, logs in (
        ("brdf", unknowns.log_brdf),
        ("reflectance", unknowns.log_reflectance),
    ):
        for i, value in enumerate(np.exp(logs)):
            errors[f"{name} {i}"] = value * spread.get(f"{name} {i}", 0.0)
    errors |= {name: error for name, error in spread.items() if name.startswith("light")}
    return {name: float(error) for name, error in errors.items()}


def _result(
    model: LightModel, frames: IntArray, expected: dict[str, Strength], fitted: Fit
) -> PhotometricFit:
    """Check a fit and put it into words."""
    last = fitted.iterate
    used = fitted.iterate.used
    samples = model.samples
    unknowns: LightUnknowns = last.unknowns
    covariance = fitted.covariance.common
    deviation = np.sqrt(np.diag(covariance))
    spread = dict(zip(model.names, deviation.tolist(), strict=True))
    errors = _standard_errors(unknowns, spread, covariance)
    remarks = identifiability.judge_light(model, unknowns, used, last.sigma)
    _check_bounds(model, unknowns, errors)
    f = np.exp(unknowns.log_brdf)
    gains = np.exp(unknowns.log_gain)
    gain_errors = gains * np.sqrt(fitted.covariance.own[:, 0, 0])
    locked = len(gains) == 1 and len(frames) > 1
    matt = len(f) == 1
    surface: BRDF = (
        Lambertian(float(np.pi * f[0]))
        if matt
        else TabulatedBRDF(tuple(model.nodes), tuple(f))
    )
    place = unknowns.light[:3].tolist()
    tilt = unknowns.light[3:].tolist()
    lights = (
        (SpotLight(tuple(place), (*tilt, 1.0), unknowns.k),) if model.free_light else ()
    )
    k = 0.0 if lights else unknowns.k
    gain = float(gains[0]) if locked else None
    alpha = np.arccos(np.minimum(samples.cos_alpha[used], 1.0))
    theta = model.geometry(unknowns)[0].theta[used]
    seen = {"alpha": alpha, "theta": theta, "distance": samples.distance[used]}
    ranges = {
        name: (float(values.min()), float(values.max())) for name, values in seen.items()
    }
    known = np.isfinite(gain_errors)
    jumps = [] if locked else identifiability.gain_jumps(frames[known], gains[known])
    verdict = identifiability.describe_verdict(
        model, unknowns, expected, errors, last.sigma, ranges, jumps
    )
    verdict += remarks
    if fitted.status is not Status.CONVERGED:
        verdict.insert(0, f"The fit did not end as it should: {fitted.status.value}")
    residuals = last.residual[:, 0]
    return PhotometricFit(
        photometry=Photometry(k, unknowns.gamma, gain, surface, lights),
        frames=frames,
        gains=np.repeat(gains, len(frames)) if locked else gains,
        gain_errors=np.repeat(gain_errors, len(frames)) if locked else gain_errors,
        reflectance=np.exp(unknowns.log_reflectance),
        names=model.names,
        covariance=covariance,
        correlation=covariance / np.outer(deviation, deviation),
        standard_errors=errors,
        ratio=unknowns.k / unknowns.gamma,
        residuals=residuals,
        used=used,
        sigma=last.sigma,
        mean=float(residuals[used].mean()),
        **{f"{name}_range": ends for name, ends in ranges.items()},
        verdict=verdict,
        status=fitted.status,
    )
