r"""Photometric calibration: k, γ, the gain of each frame and the paper's BRDF, from samples.

    camera and light          I = 255 · exp(L/γ)
        o-------> axis        L = k log cos α             how light and lens fall off: k
         \ α                    - 2 log d + log cos θ    where the sample lies: known
        d \   ^ n               + log f(θ)               the BRDF, at nodes of θ
           \ / θ                + log a + log g          the patch, and the frame's gain
      ------x------ sheet

    `signals`, `refuse` (what can be told) -> `_start` -> `fit` -> `choose_lamps` -> `_result` (checks)

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

from endolab.calibration.least_squares import Fit, fit
from endolab.calibration.photometric.identifiability import (
    LEAST_GAMMA_SIGNAL,
    LEAST_K_SIGNAL,
    LEAST_LAMP_SIGNAL,
    one_sided,
    power_of_lamp,
    refuse,
    signals,
)
from endolab.calibration.photometric.lamps import Lamps, choose_lamps
from endolab.calibration.photometric.model import (
    GREY_LEVELS,
    LEVELS,
    LightModel,
    hats,
    place_nodes,
)
from endolab.calibration.photometric.result import Doubt, PhotometricFit
from endolab.calibration.photometric.samples import Samples
from endolab.model.brdf import BRDF, Lambertian, TabulatedBRDF
from endolab.model.photometry import Photometry
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checked_types import Whole, checked
from endolab.numerics.iteration import Status

LOG_MATT = -float(np.log(np.pi))  # log f_r of a perfectly white sheet
# Where the fit begins, and what it may not leave.
FIRST_K = 2.0
FIRST_GAMMA = 2.2
GAMMA_BOUNDS = (0.5, 5.0)
LEAST_SAMPLES = 10
LARGEST_GAMMA_ERROR = 0.05  # relative
LARGEST_K_ERROR = 0.1
# Power of 1/d² cos θ: between a lamp at the lens, 1 (0.67 on the roughest paper), and the light of a
# room, 0. Below the first the light is refused, below the second it is in doubt.
LEAST_POWER = 0.6
USUAL_POWER = 0.85
# Grey levels; an endoscope's own light leaves 3 to 8, of a poor camera 13.
LARGEST_SIGMA = 15.0
LARGEST_SIDE = 0.05  # part of the light by which one side of the picture may be too bright
HELD_TO = 1e-3  # of its standard deviation, to which an unknown is held
# Standard deviations of the noise by which levels should stay inside the sensor's range.
CLEARANCE = 3.5

Gamma = Annotated[float, Field(ge=GAMMA_BOUNDS[0], le=GAMMA_BOUNDS[1])]
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

    gamma: Gamma | tuple[Gamma, Deviation] | Literal["free"] = FIRST_GAMMA
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
    good = samples.lit & (samples.level > LEVELS[0]) & (samples.level < LEVELS[1])
    lit = f"{good.sum()} of {len(good)} samples are lit and neither dark nor saturated"
    ways = "change the exposure, or bring the sheet nearer: white paper must show"
    refuse(
        ("light", good.sum() < LEAST_SAMPLES, f"{lit}, {LEAST_SAMPLES} are needed; {ways}")
    )
    model = _model(samples, good, how)
    of_k, of_gamma, of_lamp = signals(model, good)
    _refuse_untold(model, of_k, of_gamma)
    # What is roughly known is held at its value: a γ that the samples cannot tell, and beside a γ that is
    # sought reflectances. Left to the fit, they would follow the error of interpolating the BRDF between few
    # nodes, and would seem to be known.
    held = (model.sd > 0) & np.isfinite(model.sd) & (model.sd[1] > 0)
    held[1] &= of_gamma < LEAST_GAMMA_SIGNAL
    stiff = replace(model, sd=np.where(held, HELD_TO * model.sd, model.sd))
    fitted = fit(stiff, model.mean, _start(model, good))
    determined = how.lamps == "centre" or of_lamp >= LEAST_LAMP_SIGNAL
    refuse(
        (
            "lamps",
            not (determined or how.lamps == "auto"),
            "these samples do not determine where the lamps are: 1 mm changes the light by "
            f"{100 * of_lamp:.2g} % ({100 * LEAST_LAMP_SIGNAL:g} % is needed), as the sheet was "
            f"{samples.distance[good].min():.0f} mm away or more; bring it nearer, all over the picture, "
            "or take lamps (--lamps) centre",
        )
    )
    power = _refuse_other_light(model, fitted)  # before a search
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
    known = {"k": (FIRST_K, np.inf), "gamma": _belief(how.gamma, FIRST_GAMMA)}
    known |= {f"brdf {node}": (LOG_MATT, np.inf) for node in range(len(nodes))}
    known |= {f"brdf {pinned}": (LOG_MATT, 0.0), "reflectance 0": (0.0, 0.0)}
    for material, one in enumerate(how.reflectance, 1):
        value, sd = _belief(one, 1.0)
        known[f"reflectance {material}"] = float(np.log(value)), sd / value
    mean, sds = np.array(list(known.values())).T
    return LightModel(group, mean, sds, np.array([np.inf]), samples, nodes, list(known))


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


def _refuse_untold(model: LightModel, of_k: float, of_gamma: float) -> None:
    """Refuse samples whose signals do not tell k, or a γ that is to be found from them alone."""
    refuse(
        (
            "k",
            len(model.nodes) > 1 and of_k < LEAST_K_SIGNAL,
            "these samples do not determine k: in all frames the incidence angle goes with the angle off "
            "the axis, as on a sheet that faces the camera, and a free BRDF explains whatever k does; "
            "tilt the sheet, or assume a matt sheet (lambertian BRDF)",
        ),
        (
            "gamma",
            np.isinf(model.sd[1]) and of_gamma < LEAST_GAMMA_SIGNAL,
            "these samples do not determine gamma, only k/gamma: a change of gamma is made up for by "
            f"k, the gains and the BRDF to {100 * of_gamma:.2g} % of the light "
            f"({100 * LEAST_GAMMA_SIGNAL:g} % is needed); fold the sheet, print grey patches of known ratio, "
            "or lock the gain and vary the distance, or give gamma",
        ),
    )


def _refuse_other_light(model: LightModel, fitted: Fit) -> tuple[float, float]:
    """Refuse the light of no endoscope; return the power of a lamp's at the lens that there is, and its ±."""
    power = np.nan, np.nan
    # A free γ would make up for another light, and run out of its bounds.
    if np.isfinite(model.sd[1]):
        seen = fitted.used & (model.samples.level > 0)
        power = power_of_lamp(model, fitted.common[1], seen)
    ways = "use the endoscope's own light, and no other"
    refuse(
        (
            "light",
            power[0] + 2 * power[1] < LEAST_POWER,
            "the brightness hardly falls with distance and tilt, as in a lit room: to the power "
            f"{power[0]:.2f} ± {power[1]:.2f} of what a lamp at the lens does; {ways}",
        ),
        (
            "light",
            fitted.sigma > LARGEST_SIGMA,
            f"residuals of {fitted.sigma:.0f} grey levels are too large for a lamp at the lens; {ways}",
        ),
    )
    return power


def _refuse_run_away(model: LightModel, fitted: Fit, errors: dict[str, float]) -> None:
    """Refuse what was fitted if it is of no use."""
    k, gamma = fitted.common[:2].tolist()
    error = gamma * errors["k/gamma"]
    low, high = GAMMA_BOUNDS
    most = LARGEST_GAMMA_ERROR
    frames = len(np.unique(model.samples.frame))
    refuse(
        (
            "k",
            not (k >= 0 and error <= LARGEST_K_ERROR),
            f"{len(model.samples)} samples of {frames} frames do not determine k: it is {k:.2f} ± "
            f"{error:.2g}, of which ± {LARGEST_K_ERROR:g} at most is of use; take more, over a wider field",
        ),
        (
            "gamma",
            np.isinf(model.sd[1])
            and not (low <= gamma <= high and errors["gamma"] <= most * gamma),
            f"gamma ran to {gamma:.2f} ± {errors['gamma']:.2g}, of {low:g} to {high:g} ± {100 * most:g} % at "
            "most; check the distances, or give gamma",
        ),
    )


def _standard_errors(
    model: LightModel, vector: FloatArray, covariance: FloatArray
) -> dict[str, float]:
    """Standard errors of the values themselves, by those of the unknowns; 0 for what was given."""
    slopes = np.eye(len(vector) + 1, len(vector))
    start = model.of_brdf.start
    slopes[:, start:] *= np.exp(vector[start:])  # of logarithms
    slopes[-1, :2] = 1 / vector[1], -vector[0] / vector[1] ** 2  # of k/γ
    errors = np.sqrt(np.einsum("ip,pq,iq->i", slopes, covariance, slopes))
    return dict(zip([*model.names, "k/gamma"], errors.tolist(), strict=True))


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
    covariance = fitted.covariance
    # Their uncertainty is given back, and with it that of what hangs on them.
    for i in np.flatnonzero(model.sd != stiff.sd):
        along = covariance[i] / covariance[i, i]  # d(all)/d(held)
        wider = model.sd[i] ** 2 - covariance[i, i]
        covariance = covariance + wider * np.outer(along, along)
    fitted = replace(fitted, covariance=covariance)
    vector = fitted.common
    places = vector[model.of_lamps].reshape(-1, 2)
    own = fitted.own
    errors = _standard_errors(model, vector, fitted.covariance)
    _refuse_run_away(model, fitted, errors)
    clear = GREY_LEVELS * min(LEVELS[0], 1 - LEVELS[1])
    doubts = {
        Doubt.UNFINISHED: fitted.status is not Status.CONVERGED,
        Doubt.OTHER_LIGHT: power[0] + 2 * power[1] < USUAL_POWER,
        Doubt.UNTOLD_PLACE: not determined,
        Doubt.OTHER_PLACE: one_sided(model, fitted) > LARGEST_SIDE,
        Doubt.MATT: len(model.nodes) == 1,
        Doubt.CLIPPED: clear < CLEARANCE * fitted.sigma,
    }
    f = tuple(np.exp(vector[model.of_brdf]).tolist())
    surface: BRDF = Lambertian(1.0)
    if len(f) > 1:
        surface = TabulatedBRDF(tuple(model.nodes), f)
    # One gain for each frame, though it may be the same for all.
    frames = np.unique(model.samples.frame)
    alike = len(frames) // len(own)
    gains = np.repeat(np.exp(own[:, 0]), alike)
    locked = float(gains[0]) if alike > 1 else None
    counted = model.samples[fitted.used]
    free = np.flatnonzero(model.sd)
    light = Photometry(float(vector[0]), float(vector[1]), locked, surface)
    return PhotometricFit(
        photometry=light.with_lamps(places.tolist()) if len(places) else light,
        frames=frames,
        gains=gains,
        gain_errors=gains * np.repeat(np.sqrt(fitted.own_covariance[:, 0, 0]), alike),
        reflectance=np.exp(vector[model.of_brdf.stop :]),
        names=[model.names[i] for i in free],
        covariance=fitted.covariance[np.ix_(free, free)],
        standard_errors=errors,
        residuals=fitted.residual[:, 0],
        used=fitted.used,
        sigma=fitted.sigma,
        alpha_range=_range(np.arccos(np.minimum(counted.cos_alpha, 1.0))),
        theta_range=_range(counted.theta),
        power=power,
        held_out=held_out,
        doubts=[doubt for doubt, is_so in doubts.items() if is_so],
        status=fitted.status,
    )
