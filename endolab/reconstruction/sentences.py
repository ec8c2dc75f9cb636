"""What the numbers of a result mean and what they rest on, in sentences."""

from collections.abc import Iterator

import numpy as np

from endolab.reconstruction.scale import pixel_name, scale_of
from endolab.solvers.problem import LOWER_BOUND, NONE
from endolab.solvers.provenance import (
    ContourOutcome,
    ContourReport,
    LightOutcome,
    LightReport,
    Provenance,
)
from endolab.solvers.result import Iterate, Result

GAMMA_STEP = 0.1  # error of γ whose effect is told


def meaning(result: Result | Iterate) -> tuple[str, ...]:
    """Say in a sentence each what the numbers of a result mean and what they rest on.

    The unit and what fixes it; the wall's albedo; light that bounced; γ; pixels that are saturated or
    say nothing; what was noted on the way.
    """
    return (
        *_of_scale(result),
        *_of_albedo(result),
        _of_bounces(result),
        _of_gamma(result),
        *of_evidence(result),
        *notes(result),
    )


def notes(result: Result | Iterate) -> tuple[str, ...]:
    """Say what was done about indirect light and contours, and why, in a sentence each."""
    return (*_of_light(result.provenance), *_of_contours(result.provenance.contours))


def _of_light(provenance: Provenance) -> Iterator[str]:
    light = provenance.light
    if light is None:
        return
    if light.outcome is LightOutcome.GREY:
        yield (
            "The picture is grey, so that light which came by way of other walls cannot be told from the "
            "lamp's: it was left in."
        )
    elif light.outcome is LightOutcome.NO_COLOUR:
        why = f"The colours tell nothing of bounced light ({light.reason})"
        yield f"{why}, so {provenance.channel} is taken as it is."
    elif light.outcome is LightOutcome.NONE_BOUNCED:
        yield "The colours show no indirect light, and none was removed."
    else:
        yield _of_removed_light(light)


def _of_removed_light(light: LightReport) -> str:
    albedos = ", ".join(f"{value:.2f}" for value in light.albedo)
    red, green, blue = light.percent
    removed = f"red {red:.0f} %, green {green:.0f} %, blue {blue:.0f} % of the direct light"
    if light.outcome is LightOutcome.COMPUTED:
        whose = "given albedos" if light.given else "albedos of tissue"
        why = f"The colours do not tell how much there is ({light.reason})"
        return f"Indirect light removed: {removed}. {why}, so it was computed with {whose}: {albedos}."
    whose = "given" if light.given else "estimated"
    return (
        f"Indirect light removed: {removed} (medians). By the colours it is {light.factor:.2f} times "
        f"what the surface predicts with {whose} albedos {albedos}; {100 * light.lamp:.0f} % of k is the "
        "lamp's."
    )


def _of_contours(contours: ContourReport | None) -> Iterator[str]:
    if contours is None or contours.outcome in (
        ContourOutcome.NOT_ASKED,
        ContourOutcome.GIVEN,
    ):
        return
    if contours.steps:
        yield f"Contours: the surface is cut over {contours.steps:,} px ({contours.outcome.value})."
    else:
        yield "Contours: none is cut, as no line of the picture gives clear evidence."


def _of_scale(result: Result | Iterate) -> Iterator[str]:
    scale = result.provenance.scale
    kind = scale_of(result)
    if kind == "gain":
        yield "Distances are in mm, because the gain of the endoscope is known."
    elif kind == "median distance" and scale:
        yield f"Distances are in mm, because their median was given as {scale.length:g} mm."
    elif kind == "known distance" and scale:
        mm, *pixel = scale.length
        where = pixel_name(pixel)
        yield f"Distances are in mm, because the surface at {where} was given as {mm:g} mm away."
    elif kind == "known diameter" and scale:
        mm, start, end = scale.length
        where = f"{pixel_name(start)} and {pixel_name(end)}"
        yield f"Distances are in mm, because the points at {where} were given as {mm:g} mm apart."
    elif result.problem.metric:
        yield "Distances are in mm, and the scale is carried over from the frame before."
    elif kind == "none":
        yield "The gain is unknown: distances show the shape, and their unit is arbitrary."
    else:
        yield "The gain is unknown: distances have an arbitrary unit, nearly that of the frame before."
    if scale is not None and scale.by_gain is not None:
        yield f"By the gain of the calibration that length would be {scale.by_gain:.3g} mm."


def _of_albedo(result: Result | Iterate) -> Iterator[str]:
    yield (
        "The wall is assumed to reflect the same everywhere; a patch that reflects 10 % more comes out "
        "5 % too near."
    )
    if scale_of(result) == "gain":  # else the value cancels
        yield (
            "Distances go with the square root of albedo times gain: "
            "if that product is really 10 % higher, every distance is 5 % too short."
        )


def _of_bounces(result: Result | Iterate) -> str:
    albedo = result.provenance.albedo
    if albedo is None:
        return (
            "Indirect light, which bounced from wall to wall, counts as direct; in simulated colons it adds "
            "about 120 % to red, 30 % to green and 20 % to blue."
        )
    values = ", ".join(f"{value:.2g}" for value in albedo)
    return f"Indirect light was computed with albedos {values} (R, G, B) and removed."


def _of_gamma(result: Result | Iterate) -> str:
    """Tell what an error of γ does: d goes with I^(-γ/2), and the scale keeps the median."""
    problem = result.problem
    informative = problem.mask & (problem.image > 0)
    if problem.evidence is not None:
        informative = informative & (problem.evidence != NONE)
    image = problem.image[informative]
    low, middle, high = np.percentile(image, [5, 50, 95]) if image.size else np.ones(3)
    dark, bright = (abs(GAMMA_STEP / 2 * np.log(limit / middle)) for limit in (low, high))
    gamma = problem.photometry.gamma
    return (
        f"If γ were {gamma + GAMMA_STEP:.4g} instead of {gamma:.4g}, the brightest twentieth of the pixels "
        f"would come out at least {-100 * np.expm1(-bright):.2g} % nearer and the darkest at least "
        f"{100 * np.expm1(dark):.2g} % farther, with the same median."
    )


def of_evidence(result: Result | Iterate) -> Iterator[str]:
    """Say how many pixels are saturated, and how many say nothing."""
    problem = result.problem
    if problem.evidence is None:
        return
    known = problem.evidence[problem.mask]

    def share(what: int) -> str:
        count = int((known == what).sum())
        return f"{count} of {known.size} pixels ({100 * count / known.size:.2g} %)"

    if LOWER_BOUND in known:
        yield f"The sensor is saturated in {share(LOWER_BOUND)}, which count as 'at least this bright'."
    if NONE in known:
        yield f"Highlights and overlays hide {share(NONE)}, where the surface is interpolated."
