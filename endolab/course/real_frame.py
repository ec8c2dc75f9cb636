"""Checks of notebook 08: what highlights and γ do to a surface."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from endolab.course.verdict import Wrong, numbers, verdict
from endolab.depth.result import Result
from endolab.io.descriptions import Calibration
from endolab.numerics.arrays import FloatArray
from endolab.preprocessing.frame import Frame
from endolab.reconstruction.reconstruct import reconstruct

WIDTH, MEDIAN = 160, 40.0  # px, mm, in both exercises
CLOSE = 0.01  # what is the same answer, of ratios
TINY = 1e-9  # a share that is none
LARGER = 1.1  # γ in the second exercise, over the calibration's
NEAR, FAR = 5, 95  # percentiles


def _apart(surfaces: dict[str, FloatArray], way: str) -> dict[str, float]:
    """Mean difference of a surface from the inpainted one, at "", and what slips make of it."""
    one, other = surfaces[way], surfaces["inpaint"]
    share = one / other - 1
    return {
        "": float(np.nanmean(np.abs(share))),
        "Shares, please, and yours are in per cent.": float(100 * np.nanmean(np.abs(share))),
        "Too near here and too far there cancel: take sizes before the mean.": float(np.nanmean(share)),
        "Those are mm: divide by the distance.": float(np.nanmean(np.abs(one - other))),
        "That is the root of a mean of squares; the plain mean of the sizes is asked for.": float(
            np.sqrt(np.nanmean(share**2))
        ),
        "That is the largest difference; the mean is asked for.": float(np.nanmax(np.abs(share))),
    }


@verdict
def exercise_1(apart: tuple[float, float], frame: Frame, calibration: Calibration) -> str:
    """Look at how far apart surfaces are said to be that treat highlights differently.

    Parameters
    ----------
    apart : two floats
        Mean share by which `keep` differs from `inpaint`, and `ignore` from `inpaint`.
    frame : Frame
    calibration : Calibration
        Those of the exercise.

    Returns
    -------
    Verdict
    """
    answer = numbers(apart, 2, "Two numbers, of `keep` and of `ignore`, both from `inpaint`.")
    if not np.all(np.isfinite(answer)):
        raise Wrong("Outside the mask there is no surface, but nan: take means that leave it out.")

    def solved(way: str, median: float | None) -> FloatArray:
        return reconstruct(
            frame, calibration, channel="green", width=WIDTH, highlights=way, median_distance=median
        ).distance

    surfaces = {way: solved(way, MEDIAN) for way in ("keep", "ignore", "inpaint")}
    told = [_apart(surfaces, way) for way in ("keep", "ignore")]
    right = np.array([one[""] for one in told])
    for said in told[0]:
        if np.allclose(answer, [one[said] for one in told], rtol=CLOSE, atol=TINY):
            if said:
                raise Wrong(said)
            return f"`keep` moves the surface by {right[0]:.2%} in the mean, `ignore` by {right[1]:.4%}."
    if np.allclose(answer, right[::-1], rtol=CLOSE, atol=TINY):
        raise Wrong("You have the two the wrong way round: `keep` comes first.")
    if np.allclose(answer[0], _unlike(surfaces), rtol=CLOSE, atol=TINY):
        raise Wrong("You compared `keep` with `ignore`; compare each with `inpaint`.")
    which = "ignore" if np.isclose(answer[0], right[0], rtol=CLOSE, atol=TINY) else "keep"
    raise Wrong(
        f"Not yet: `{which}` is wrong. All three in green, at {WIDTH} columns and scaled to a median of "
        f"{MEDIAN:g} mm, or else the scale differs, too?"
    )


def _unlike(surfaces: dict[str, FloatArray]) -> float:
    """Mean share by which `keep` differs from `ignore`."""
    return float(np.nanmean(np.abs(surfaces["keep"] / surfaces["ignore"] - 1)))


def _far_over_near(distance: FloatArray) -> float:
    near, far = np.nanpercentile(distance, [NEAR, FAR])
    return float(far / near)


@verdict
def exercise_2(
    ratios: tuple[float, float, float], with_gamma: Callable[[float], Result], usual: float
) -> str:
    """Look at what a larger γ is said to do to the far distance over the near one.

    Parameters
    ----------
    ratios : three floats
        Far over near with the calibration's γ, what is predicted for one that is 10 % larger, and what is
        measured then.
    with_gamma : callable
        Reconstructs the frame with some γ.
    usual : float
        The calibration's.

    Returns
    -------
    Verdict
    """
    answer = numbers(ratios, 3, "Three numbers: as it is, predicted, with the larger γ.")
    surface = with_gamma(usual).distance
    before, after = _far_over_near(surface), _far_over_near(with_gamma(LARGER * usual).distance)

    def same(one: float, other: float) -> bool:
        return bool(np.isclose(one, other, rtol=CLOSE / 5))

    first, predicted, last = (float(one) for one in answer)
    if same(first, 1 / before):
        raise Wrong("That is near over far: turn it round.")
    if same(first, np.nanmax(surface) / np.nanmin(surface)):
        raise Wrong(
            f"Those are the extremes, of single pixels: take the percentiles {NEAR} and {FAR} instead."
        )
    if not same(first, before):
        raise Wrong(f"The first number, far over near as it is, should be another one than {first:.3g}.")
    if same(predicted, LARGER * before):
        raise Wrong("You predicted that the ratio grows with γ, but γ stands in an exponent.")
    if same(predicted, before ** (1 / LARGER)):
        raise Wrong("Your prediction goes the wrong way: the larger γ, the more a grey level means.")
    if same(predicted, before ** (LARGER / 2)) or same(predicted, before ** (usual * LARGER / 2)):
        raise Wrong("γ/2 is already in the first ratio: only how much larger it has become is new.")
    if not same(predicted, before**LARGER):
        raise Wrong("Not yet: the prediction. $d$ goes like $I^{-γ/2}$; what becomes of a ratio of two $d$?")
    if same(last, before):
        raise Wrong("The last number is the first one: was γ changed?")
    if same(last, _far_over_near(with_gamma(usual / LARGER).distance)):
        raise Wrong("The last number is that of a smaller γ.")
    if not same(last, after):
        raise Wrong(f"The last number, measured with γ = {LARGER * usual:.3g}, is not {last:.3g}.")
    return (
        f"Predicted {before**LARGER / before - 1:+.0%}, measured {after / before - 1:+.0%}: "
        "walls that are tilted answer with tilt."
    )
