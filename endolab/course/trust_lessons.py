"""Checks of notebook 10: what one known distance is worth, and which λ noise calls for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from endolab.course.verdict import Wrong, numbers, verdict
from endolab.depth.result import Result
from endolab.io.descriptions import Calibration
from endolab.numerics.arrays import FloatArray
from endolab.preprocessing.frame import Frame
from endolab.reconstruction.reconstruct import reconstruct
from endolab.uncertainty.trust import Trust

CLOSE = 0.02  # what is the same answer; a reconstruction anew is that far from a prediction
EXACT = 1e-3  # the same of a mistake, which nobody makes but by the same sums
MORE, LESS = "more", "less"


def _close(answer: FloatArray, other: FloatArray, share: float = CLOSE) -> bool:
    return bool(np.allclose(answer, other, rtol=share, atol=1e-9))


@verdict
def exercise_1(scales: tuple[float, float], trust: Trust, result: Result) -> str:
    """Look at how sure the scale is said to be once one pixel's distance is known.

    Parameters
    ----------
    scales : two floats
        σ of the scale, as a share: after the pixel was touched whose shape is surest, and after the one whose
        shape is least sure.
    trust : Trust
        That of the result.
    result : Result
        The surface, its scale by the gain.

    Returns
    -------
    Verdict
    """
    answer = numbers(scales, 2, "Two numbers: by the surest pixel, and by the least sure.")
    if not np.isfinite(answer).all():
        raise Wrong("Outside the mask there is no surface, but nan: np.nanmin, np.nanargmin leave it out.")
    shape = np.where(result.mask, trust.sigma_shape, np.nan)
    share, by_gain = shape / result.distance, trust.sigma_scale
    ends = [np.nanargmin(share), np.nanargmax(share)]
    right = share.ravel()[ends]
    if _close(answer, right):
        return (
            f"{right[0]:.1%} by the surest pixel, {right[1]:.0%} by the least sure, {by_gain:.1%} by the "
            f"gain: a touch helps at {np.nanmean(share < by_gain):.0%} of the pixels."
        )
    slips = {
        "A share, please, and yours are in per cent.": 100 * right,
        "Those are mm: a scale has none. Divide by the distance.": shape.ravel()[ends],
        "You have the two the wrong way round: the surest pixel comes first.": right[::-1],
        "That is the scale by the gain, which the touch has replaced.": np.full(2, by_gain),
        "Nothing is left at the touched pixel. At all others there is: what *its* shape was wrong by.": (
            np.zeros(2)
        ),
        "You add the doubt of the scale by the gain, which no longer counts: the touch gives the scale.": (
            np.hypot(right, by_gain)
        ),
        "That is `sigma`, which has the doubt of the gain in it: that of the shape is asked for.": (
            (trust.sigma / result.distance).ravel()[ends]
        ),
        "Surest is meant as a share of the distance, and you chose the pixels by their mm.": share.ravel()[
            [np.nanargmin(shape), np.nanargmax(shape)]
        ],
    }
    for said, wrong in slips.items():
        if _close(answer, wrong, EXACT):
            raise Wrong(said)
    which = int(np.argmax(np.abs(np.log(np.maximum(answer, 1e-9) / right))))
    much = "large" if answer[which] > right[which] else "small"
    raise Wrong(
        f"Not yet: the {('first', 'second')[which]} is too {much}."
        " All pixels are now measured by the touched one: which of its doubts do they inherit?"
    )


@verdict
def exercise_2(
    prediction: str, off: tuple[float, float], frame: Frame, calibration: Calibration, true: FloatArray
) -> str:
    """Look at which λ a noisy frame is said to call for, and at what it is said to be worth.

    Parameters
    ----------
    prediction : {"more", "less"}
        Whether the λ that is chosen is above 1 or below.
    off : two floats
        Mean errors of the distance, %: with λ = 1, and with the λ that is chosen.
    frame : Frame
    calibration : Calibration
    true : (H, W) float array
        True distances, mm.

    Returns
    -------
    Verdict
    """
    if prediction not in (MORE, LESS):
        raise Wrong(f"The prediction is {MORE!r} or {LESS!r}, not {prediction!r}.")
    answer = numbers(off, 2, "Two errors: with λ = 1, and with the λ that is chosen.")
    runs = [reconstruct(frame, calibration, channel="green", lam=lam) for lam in (1.0, "auto")]  # type: ignore[arg-type]
    shares = [run.distance / true - 1 for run in runs]
    sizes = [np.abs(one) for one in shares]
    right = np.array([100 * np.nanmean(one) for one in sizes])
    if not _close(answer, right):
        _say_what_is_wrong(answer, right, shares, [run.distance - true for run in runs])
    chosen = runs[1].problem.lam
    if prediction != (MORE if chosen > 1 else LESS):
        raise Wrong(
            "The errors are right, the prediction is not: what does `run.problem.lam` say? Noise is what is "
            "to be left unexplained, and this wall is smooth."
        )
    return f"λ = {chosen:.3g}, and the error goes from {right[0]:.1f} % to {right[1]:.1f} %."


def _say_what_is_wrong(
    answer: FloatArray, right: FloatArray, shares: list[FloatArray], apart: list[FloatArray]
) -> None:
    """Raise what is wrong with two mean errors, from the maps of the errors, in shares and in mm."""

    def each(measure: Callable[[FloatArray], Any], maps: list[FloatArray]) -> FloatArray:
        return np.array([measure(one) for one in maps])

    slips = {
        "Per cent, please: yours are shares.": right / 100,
        "You have the two the wrong way round: λ = 1 comes first.": right[::-1],
        "Too near here and too far there cancel: take sizes before the mean.": 100 * each(np.nanmean, shares),
        "That is the median; the mean is asked for.": 100 * each(lambda e: np.nanmedian(np.abs(e)), shares),
        "That is the root of a mean of squares; the plain mean of the sizes is asked for.": (
            100 * each(lambda e: np.sqrt(np.nanmean(e**2)), shares)
        ),
        "That is the largest error; the mean is asked for.": 100
        * each(lambda e: np.nanmax(np.abs(e)), shares),
        "Those are mm: divide by the true distance.": each(lambda e: np.nanmean(np.abs(e)), apart),
        "Both are the error with λ = 1: is `lam` given?": np.full(2, right[0]),
    }
    for said, wrong in slips.items():
        if _close(answer, wrong, EXACT):
            raise Wrong(said)
    which = "the chosen λ" if _close(answer[:1], right[:1]) else "λ = 1"
    raise Wrong(f"Not yet: the error with {which}. Is it green alone, and the frame as it is?")
