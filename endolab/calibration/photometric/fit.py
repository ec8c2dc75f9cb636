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

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from endolab.calibration.least_squares import Covariance, Fit, fit
from endolab.calibration.photometric import identifiability
from endolab.calibration.photometric.identifiability import NotIdentifiableError, Strength
from endolab.calibration.photometric.model import (
    FIRST_GAMMA,
    GAMMA_BOUNDS,
    GREY_LEVELS,
    LEAST_DEVIATION,
    LEAST_REFLECTANCE,
    LEAST_SAMPLES,
    LEVELS,
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
from endolab.model.photometry import Photometry
from endolab.numerics.arrays import FloatArray, IntArray
from endolab.numerics.checks import check_int, number, unknown_name
from endolab.numerics.iteration import Status

LOG_MATT = -float(np.log(np.pi))  # log f_r of a perfectly white sheet


def _check_known(
    name: str, value: float | tuple[float, float], low: float, high: float = np.inf
) -> float | tuple[float, float]:
    """Return a number, or its mean and standard deviation; else ValueError."""
    if np.size(value) != 2:
        return number(name, value, low, high)
    mean, deviation = np.asarray(value).tolist()
    sd = number(f"the standard deviation of {name}", deviation, LEAST_DEVIATION)
    return number(name, mean, low, high), sd


def _check_gamma(gamma: float | tuple[float, float] | str) -> Known:
    """Return what is known of γ, None if it is free; ValueError if it can be none."""
    if isinstance(gamma, str):
        if gamma != "free":
            raise unknown_name("gamma", gamma, ["free"], "a number")
        return None
    return _check_known("gamma", gamma, *GAMMA_BOUNDS)


def _log_reflectance(reflectance: Known) -> Known:
    """Return what is known of the logarithm of a reflectance; ValueError if it can be none."""
    if reflectance is None:
        return None
    known = _check_known("reflectance", reflectance, LEAST_REFLECTANCE)
    if isinstance(known, float):
        return float(np.log(known))
    return float(np.log(known[0])), known[1] / known[0]


def check_options(
    gamma: float | tuple[float, float] | str = 2.2,
    brdf: str = "tabulated",
    nodes: int = 15,
    gain: str = "free",
    reflectance: Sequence[Known] = (),
    levels: tuple[float, float] = LEVELS,
) -> None:
    """Refuse options of `calibrate_light` that no samples could make right."""
    for name, value, choices in (
        ("brdf", brdf, ("tabulated", "lambertian")),
        ("gain", gain, ("free", "locked")),
    ):
        if value not in choices:
            raise unknown_name(name, value, choices)
    check_int("nodes", nodes, 2)
    if not 0 <= levels[0] < levels[1]:
        raise ValueError(f"levels must ascend from 0 or above, got {levels}")
    _check_gamma(gamma)
    for known in reflectance:
        _log_reflectance(known)


def _start(model: LightModel) -> tuple[LightUnknowns, float]:
    """Solve in the logarithm of the light, where all but γ is linear; return σ in grey levels too.

    Noise of σ grey levels is γσ/I in log I^γ, hence weights I². Outliers fade by a few
    reweightings. What is saturated is told from the measured level here, for want of a better one.
    """
    samples = model.samples
    low, high = model.levels
    good = model.geometry.valid & (samples.level > low) & (samples.level < high)
    vector = model.known_vector
    vector[1] = gamma = vector[1] or FIRST_GAMMA
    loose = np.array([known is None for known in model.known])
    loose[1] = False
    # The gain of a frame whose samples are all out of range is read from these all the same.
    level = np.maximum(samples.level, 1e-3)
    target = gamma * np.log(level) - model.geometry.falloff - model.given_log_reflectance
    weight = level**2 * good
    for _ in range(5):
        solved, constant, residual = identifiability.regress(
            model.columns[:, loose], target, np.maximum(weight, 1e-9), model.group
        )
        grey = GREY_LEVELS * level * residual / gamma
        sigma = 1.4826 * float(np.median(np.abs(grey[good]))) + 1e-12
        weight = level**2 * good / (1 + (grey / (3 * sigma)) ** 2) ** 2
    vector[loose] = np.clip(solved, -10, 10)
    vector[2 : 2 + len(model.nodes)] += LOG_MATT * loose[2 : 2 + len(model.nodes)]
    own = np.zeros((len(constant), model.own_columns.shape[1]))
    own[:, 0] = constant - LOG_MATT
    return model.unknowns(vector, own), sigma


def calibrate_light(
    samples: Samples,
    *,
    gamma: float | tuple[float, float] | str = 2.2,
    brdf: str = "tabulated",
    nodes: int = 15,
    gain: str = "free",
    reflectance: Sequence[Known] = (),
    levels: tuple[float, float] = LEVELS,
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
    levels : (low, high)
        Stored values between which a sample's *predicted* value must lie for it to count; choose
        them 4 standard deviations of the noise inside the sensor's range, which is 0 to 1.

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
    check_options(gamma, brdf, nodes, gain, reflectance, levels)
    numbers = np.column_stack([samples.level, samples.points, samples.normals])
    finite = np.isfinite(numbers).all(axis=1)
    if not finite.all():
        raise ValueError(f"samples must be finite, got {np.sum(~finite)} that are not")
    theta, pinned = _nodes(samples, 1 if brdf == "lambertian" else nodes, levels)
    materials = np.unique(samples.material)
    if materials[0] < 0 or materials[-1] != len(reflectance):
        each = f"each of materials 1 to {materials[-1]} of the samples"
        raise ValueError(f"reflectance must have an entry for {each}, got {reflectance}")
    frames, group = np.unique(samples.frame, return_inverse=True)
    if gain == "locked":  # then the frames have no unknowns of their own
        group = np.zeros(len(samples), int)
        samples = replace(samples, slack=np.zeros((0, 0)))
    known: list[Known] = [None, _check_gamma(gamma), *[None] * len(theta), 0.0]
    known[2 + pinned] = LOG_MATT
    known += [_log_reflectance(value) for value in reflectance]
    model = LightModel(samples, group, theta, tuple(known), levels)
    begin, sigma = _start(model)
    expected = identifiability.strengths(model, begin, sigma)
    identifiability.refuse(model, expected)
    stiff = identifiability.hold_unknowns(model, expected)
    fitted = fit(stiff, begin)
    covariance = identifiability.widen(fitted.covariance.common, model, stiff)
    fitted = replace(fitted, covariance=Covariance(covariance, fitted.covariance.own))
    return _result(model, frames, expected, fitted)


def _nodes(
    samples: Samples, count: int, levels: tuple[float, float]
) -> tuple[FloatArray, int]:
    """Choose the nodes of the BRDF, rad, and the pinned one, which has the most light."""
    geometry = SampleGeometry.of(samples)
    good = geometry.valid & (samples.level > levels[0]) & (samples.level < levels[1])
    if good.sum() < LEAST_SAMPLES:
        lit = f"{good.sum()} of {len(good)} samples are lit and neither dark nor saturated"
        ways = "change the exposure, or bring the sheet nearer: white paper must show"
        needed = f"{LEAST_SAMPLES} are needed"
        raise NotIdentifiableError("light", f"{lit}, {needed}; {ways}")
    theta = geometry.theta[good]
    chosen = np.zeros(1)
    if count > 1:
        if np.ptp(theta) < 1e-3:
            why = "samples that all lie at one incidence angle do not determine the BRDF"
            ways = "tilt the sheet, or assume a matt sheet (lambertian BRDF)"
            angle = f"{np.rad2deg(theta[0]):.1f}°"
            raise NotIdentifiableError("brdf", f"{why}, {angle}; {ways}")
        chosen = place_nodes(theta, count)
    light = samples.level[good] ** 2
    return chosen, int(np.argmax(hats(chosen, theta).T @ light))


def _check_bounds(unknowns: LightUnknowns, errors: dict[str, float]) -> None:
    """Refuse a fit that has run away."""
    low, high = GAMMA_BOUNDS
    if unknowns.k < 0:
        ran = f"k ran to {unknowns.k:.3f} ± {errors['k']:.3f}, below 0"
        why = "these samples show no fall-off off the axis"
        raise NotIdentifiableError("k", f"{ran}: {why}")
    if not low <= unknowns.gamma <= high:
        ran = f"gamma ran to {unknowns.gamma:.2f}, out of {low:g} to {high:g}"
        raise NotIdentifiableError("gamma", f"{ran}; check the distances, or give gamma")
    error = unknowns.gamma * errors["k/gamma"]
    most = identifiability.LARGEST_K_ERROR
    if error > most:
        why = f"these samples do not determine k: it is {unknowns.k:.2f} ± {error:.2f}"
        raise NotIdentifiableError("k", f"{why}, of which at most ± {most:g} is of use")


def _standard_errors(
    model: LightModel, unknowns: LightUnknowns, covariance: FloatArray
) -> dict[str, float]:
    """Standard errors of the values themselves, by those of the unknowns; 0 for what was given."""
    unit = np.ones(len(model.known))
    unit[2:] = np.exp(unknowns.vector[2:])
    errors = np.zeros(len(model.known))
    errors[model.free] = unit[model.free] * np.sqrt(np.diag(covariance))
    slope = np.zeros(len(model.known))  # of k/γ
    slope[:2] = 1 / unknowns.gamma, -unknowns.k / unknowns.gamma**2
    slope = slope[model.free]
    ratio = {"k/gamma": float(np.sqrt(slope @ covariance @ slope))}
    return dict(zip(model.names, errors.tolist(), strict=True)) | ratio


def _range(values: FloatArray) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def _result(
    model: LightModel, frames: IntArray, expected: dict[str, Strength], fitted: Fit
) -> PhotometricFit:
    """Check a fit and put it into words."""
    used = fitted.used
    sigma = fitted.sigma
    unknowns: LightUnknowns = fitted.unknowns
    covariance = fitted.covariance.common
    deviation = np.sqrt(np.diag(covariance))
    errors = _standard_errors(model, unknowns, covariance)
    remarks = identifiability.judge_light(model, unknowns, used, sigma)
    _check_bounds(unknowns, errors)
    f = np.exp(unknowns.log_brdf)
    surface: BRDF = Lambertian(1.0)
    if len(f) > 1:
        surface = TabulatedBRDF(tuple(model.nodes), tuple(f))
    # One for each frame, though it may be the same for all.
    alike = len(frames) // len(unknowns.own)
    gains = np.repeat(np.exp(unknowns.own[:, 0]), alike)
    gain_errors = gains * np.repeat(np.sqrt(fitted.covariance.own[:, 0, 0]), alike)
    residuals = fitted.residual[:, 0]
    names = [name for name, free in zip(model.names, model.free, strict=True) if free]
    result = PhotometricFit(
        photometry=Photometry(
            unknowns.k, unknowns.gamma, float(gains[0]) if alike > 1 else None, surface
        ),
        frames=frames,
        gains=gains,
        gain_errors=gain_errors,
        reflectance=np.exp(unknowns.log_reflectance),
        names=names,
        covariance=covariance,
        correlation=covariance / np.outer(deviation, deviation),
        standard_errors=errors,
        ratio=unknowns.k / unknowns.gamma,
        residuals=residuals,
        used=used,
        sigma=sigma,
        mean=float(residuals[used].mean()),
        alpha_range=_range(np.arccos(np.minimum(model.samples.cos_alpha[used], 1.0))),
        theta_range=_range(model.geometry.theta[used]),
        distance_range=_range(model.samples.distance[used]),
        verdict=[],
        status=fitted.status,
    )
    verdict = identifiability.describe_verdict(model, result, expected) + remarks
    if fitted.status is not Status.CONVERGED:
        verdict.insert(0, f"The fit did not end as it should: {fitted.status.value}")
    return replace(result, verdict=verdict)
