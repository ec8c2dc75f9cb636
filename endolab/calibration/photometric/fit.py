r"""Photometric calibration: k, γ, the gain of each frame and the paper's BRDF, from samples.

    camera and light          I = 255 · exp(L/γ)
        o-------> axis        L = k log cos α             how light and lens fall off: k
         \ α                    - 2 log d + log cos θ    where the sample lies: known
        d \   ^ n               + log f(θ)               the BRDF, at nodes of θ
           \ / θ                + log a + log g          the patch, and the frame's gain
      ------x------ sheet

    `signals` (what can be told) -> `_start` -> `fit` -> `choose_lamps` -> `_result` (checks)

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

from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from endolab.calibration import constants
from endolab.calibration.least_squares import Fit, fit, jackknife
from endolab.calibration.photometric.identifiability import (
    one_sided,
    power_of_lamp,
    signals,
)
from endolab.calibration.photometric.lamps import Lamps, choose_lamps
from endolab.calibration.photometric.model import LightModel, hats, place_nodes
from endolab.calibration.photometric.result import PhotometricFit
from endolab.calibration.photometric.samples import Samples
from endolab.calibration.refusals import Doubt, Refusal
from endolab.model.brdf import BRDF, Lambertian, TabulatedBRDF
from endolab.model.photometry import Photometry
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checked_types import Whole, checked
from endolab.numerics.iteration import Status

LOG_MATT = -float(np.log(np.pi))  # log f_r of a perfectly white sheet

Gamma = Annotated[float, Field(ge=constants.GAMMA_BOUNDS[0], le=constants.GAMMA_BOUNDS[1])]
Reflectance = Annotated[float, Field(ge=1e-6)]
Deviation = Annotated[float, Field(ge=1e-9)]
Known = Reflectance | tuple[Reflectance, Deviation] | None


@checked
class LightOptions:
    """How a light is calibrated.

    Parameters
    ----------
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
    lamps : {"auto", "centre", "one", "two"}
        Lamps whose places beside the lens are sought; auto: the fewest that explain frames held out.
    """

    gamma: Gamma | tuple[Gamma, Deviation] | Literal["free"] = 2.2
    brdf: Literal["tabulated", "lambertian"] = "tabulated"
    nodes: Annotated[Whole, Field(ge=2)] = 15
    gain: Literal["free", "locked"] = "free"
    reflectance: tuple[Known, ...] = ()
    lamps: Lamps = "auto"


def _belief(known: Any, first: float) -> tuple[float, float]:
    """Mean and standard deviation of what is known: the latter 0 if it is given, inf if it is free."""
    if isinstance(known, tuple):
        return known
    return (first, np.inf) if known in (None, "free") else (known, 0.0)


def calibrate_light(samples: Samples, **options: Any) -> PhotometricFit:
    """Calibrate light, response and gains from samples of known place and normal.

    Parameters
    ----------
    samples : Samples
        Of a calibration sheet, or of any surface that is known.
    **options
        Of `LightOptions`: gamma, brdf, nodes, gain, reflectance, lamps.

    Returns
    -------
    PhotometricFit
        Light, gains, residuals and standard errors; `doubts` say what may be wrong with them.

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
    how = LightOptions(**options)
    if samples.material.max(initial=0) != len(how.reflectance):
        each = f"each of materials 1 to {samples.material.max()} of the samples"
        given = f"got {len(how.reflectance)}"
        raise ValueError(f"reflectance must have an entry for {each}, {given}")
    good = (
        samples.lit
        & (samples.level > constants.LEVELS[0])
        & (samples.level < constants.LEVELS[1])
    )
    few = good.sum() < constants.LEAST_SAMPLES
    Refusal.FEW.if_(few, good=good.sum(), count=len(good))
    model = _model(samples, good, how)
    of_k, of_gamma, of_lamp = signals(model, good)
    is_free = np.isinf(model.sd[1])
    Refusal.FACING.if_(len(model.nodes) > 1 and of_k < constants.LEAST_K_SIGNAL)
    is_flat = is_free and of_gamma < constants.LEAST_GAMMA_SIGNAL
    Refusal.FLAT.if_(is_flat, share=100 * of_gamma)
    # What is roughly known is held at its value: a γ that the samples cannot tell, and beside a γ that is
    # sought reflectances. Left to the fit, they would follow the error of interpolating the BRDF between few
    # nodes, and would seem to be known.
    held = (model.sd > 0) & np.isfinite(model.sd) & (model.sd[1] > 0)
    held[1] &= of_gamma < constants.LEAST_GAMMA_SIGNAL
    stiff = replace(model, sd=np.where(held, 1e-3 * model.sd, model.sd))
    fitted = fit(stiff, model.mean, _start(model, good))
    determined = how.lamps == "centre" or of_lamp >= constants.LEAST_LAMP_SIGNAL
    untold = not (determined or how.lamps == "auto")
    near = samples.distance[good].min()
    Refusal.AFAR.if_(untold, share=100 * of_lamp, near=near)
    power = np.nan, np.nan
    # A free γ would make up for another light, and run out of its bounds.
    if not is_free:
        power = power_of_lamp(model, fitted.common[1], fitted.used & (samples.level > 0))
    is_room = power[0] + 2 * power[1] < constants.LEAST_POWER
    Refusal.LIT_ROOM.if_(is_room, power=power[0], error=power[1])
    Refusal.UNLIKE.if_(fitted.sigma > constants.LARGEST_SIGMA, sigma=fitted.sigma)
    wanted = how.lamps if determined else "centre"
    stiff, fitted, held_out = choose_lamps(stiff, fitted, wanted)
    model = model.with_lamps(stiff.lamps)
    return _result(model, stiff, fitted, held_out, power, determined)


def _model(samples: Samples, good: BoolArray, how: LightOptions) -> LightModel:
    """Put what is known and what is sought into a model; the node with the most light is pinned."""
    _, group = np.unique(samples.frame, return_inverse=True)
    if how.gain == "locked":  # then the frames have no unknowns of their own
        group = np.zeros(len(samples), int)
    theta = samples.theta[good]
    nodes = place_nodes(theta, 1 if how.brdf == "lambertian" else how.nodes)
    pinned = int(np.argmax(hats(nodes, theta).T @ samples.level[good] ** 2))
    known = {
        "k": (2.0, np.inf),
        "gamma": _belief(how.gamma, 2.2),
    }
    known |= {f"brdf {node}": (LOG_MATT, np.inf) for node in range(len(nodes))}
    known |= {f"brdf {pinned}": (LOG_MATT, 0.0), "reflectance 0": (0.0, 0.0)}
    for material, one in enumerate(how.reflectance, 1):
        value, sd = _belief(one, 1.0)
        known[f"reflectance {material}"] = float(np.log(value)), sd / value
    mean, sds = np.array(list(known.values())).T
    return LightModel(group, mean, sds, samples, nodes, list(known))


def _start(model: LightModel, good: BoolArray) -> FloatArray:
    """Begin with the gains that the good samples of each frame show if all else is as on the mean."""
    level = np.maximum(model.samples.level, 1e-3)
    own = np.zeros((int(model.group[-1]) + 1, 1))
    light, _ = model.shine(model.mean, own)
    # The gain of a frame without good samples is read from the others.
    weight = level**2 * np.maximum(good, 1e-9)
    missing = np.bincount(model.group, weight * (model.mean[1] * np.log(level) - light))
    own[:, 0] = missing / np.bincount(model.group, weight)
    return own


def _range(values: FloatArray) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def _result(
    model: LightModel,
    stiff: LightModel,
    fitted: Fit,
    held_out: dict[str, float],
    power: tuple[float, float],
    determined: bool,
) -> PhotometricFit:
    """Check a fit of the model with some unknowns held, and name what it found."""
    frames, frame = np.unique(model.samples.frame, return_inverse=True)
    # Those that were held get their uncertainty back, and with it what hangs on them.
    covariance, of_gains = jackknife(stiff, fitted, frame, model.sd)
    vector = fitted.common
    k, gamma = vector[:2].tolist()
    # Of the values themselves, by those of the unknowns; 0 for what was given.
    slopes = np.eye(len(vector) + 1, len(vector))
    start = model.of_brdf.start
    slopes[:, start:] *= np.exp(vector[start:])  # of logarithms
    slopes[-1, :2] = 1 / gamma, -k / gamma**2  # of k/γ
    deviations = np.sqrt(np.einsum("ip,pq,iq->i", slopes, covariance, slopes))
    errors = dict(zip([*model.names, "k/gamma"], deviations.tolist(), strict=True))
    error = gamma * errors["k/gamma"]
    is_sure = k >= 0 and error <= constants.LARGEST_K_ERROR
    count = {"samples": len(model.samples), "frames": len(frames)}
    Refusal.UNSURE_K.if_(not is_sure, k=k, error=error, **count)
    low, high = constants.GAMMA_BOUNDS
    error = errors["gamma"]
    is_sure = low <= gamma <= high and error <= constants.LARGEST_GAMMA_ERROR * gamma
    is_free = np.isinf(model.sd[1])
    Refusal.UNSURE_GAMMA.if_(is_free and not is_sure, gamma=gamma, error=error)
    doubts = {
        Doubt.UNFINISHED: fitted.status is not Status.CONVERGED,
        Doubt.OTHER_LIGHT: power[0] + 2 * power[1] < constants.USUAL_POWER,
        Doubt.UNTOLD_PLACE: not determined,
        Doubt.OTHER_PLACE: one_sided(model, fitted) > constants.LARGEST_SIDE,
        Doubt.MATT: len(model.nodes) == 1,
    }
    f = tuple(np.exp(vector[model.of_brdf]).tolist())
    surface: BRDF = Lambertian(1.0)
    if len(f) > 1:
        surface = TabulatedBRDF(tuple(model.nodes), f)
    # One gain for each frame, though it may be the same for all.
    alike = len(frames) // len(fitted.own)
    gains = np.repeat(np.exp(fitted.own[:, 0]), alike)
    locked = float(gains[0]) if alike > 1 else None
    counted = model.samples[fitted.used]
    free = np.flatnonzero(model.sd)
    light = Photometry(k, gamma, locked, surface)
    places = vector[model.of_lamps].reshape(-1, 2).tolist()
    return PhotometricFit(
        photometry=light.with_lamps(places) if places else light,
        frames=frames,
        gains=gains,
        gain_errors=gains * np.repeat(np.sqrt(of_gains[:, 0, 0]), alike),
        reflectance=np.exp(vector[model.of_brdf.stop :]),
        names=[model.names[i] for i in free],
        covariance=covariance[np.ix_(free, free)],
        standard_errors=errors,
        residuals=fitted.residual[:, 0],
        used=fitted.used,
        sigma=fitted.sigma,
        alpha_range=_range(np.arccos(np.minimum(counted.cos_alpha, 1.0))),
        theta_range=_range(counted.theta),
        held_out=held_out,
        doubts=[doubt for doubt, is_so in doubts.items() if is_so],
        status=fitted.status,
    )
