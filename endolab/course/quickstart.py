"""Checks of notebook 00: a scale that is lost and found again, and three colours."""

from __future__ import annotations

from collections.abc import Mapping
from math import isclose
from typing import Any

import numpy as np

from endolab.course.verdict import Wrong, verdict
from endolab.depth.result import Result
from endolab.synthetic.rendering import Rendered

COLOURS = ("red", "green", "blue")


@verdict
def exercise_1(free: Any, factor: Any, result: Result) -> str:
    """Look at a result that has lost its gain, and at the number that brings mm back.

    Parameters
    ----------
    free : Result
        The answer: the same frame without a gain.
    factor : float
        The answer: mm in one of its units.
    result : Result
        That of the frame with the gain.
    """
    _result("free", free)
    if free.distance.shape != result.distance.shape:
        raise Wrong("`free` is not as large as `result`: reconstruct the same frame, without `width=`.")
    if free.metric:
        raise Wrong(
            "`free` is still in mm: it was told a gain, or a length. A gain of `None` (`null`) tells none."
        )
    each = result.distance / free.distance
    right, known, lost = (float(np.nanmedian(one)) for one in (each, result.distance, free.distance))
    mistakes = (
        (1 / right, "That takes mm to relative units. Asked is the way back."),
        (right**2, "That is its square: with four times the gain all is twice as far."),
        (right**0.5, "That is its root. The number multiplies distances, not brightness."),
        (known, "That is the median in mm, of `result`. How many units is that of `free`?"),
        (lost, "That is the median of `free` itself. How many mm is that of `result`?"),
    )
    if not isclose(factor, right, rel_tol=0.01):
        for wrong, sentence in mistakes:
            if isclose(factor, wrong, rel_tol=0.01):
                raise Wrong(sentence)
        raise Wrong(f"With it the median becomes {lost * factor:.1f} mm; with the gain it is {known:.1f} mm.")
    apart = float(np.nanquantile(np.abs(each / right - 1), 0.95))
    return f"One unit is {right:.1f} mm. The shape is the same: to {apart:.1%}, for 95 % of the pixels."


@verdict
def exercise_2(by_channel: Any, best: Any, in_tissue: Any, seen: Rendered) -> str:
    """Look at which colour is best in a rendered frame, and which where light bounces.

    Parameters
    ----------
    by_channel : mapping of str to Result
        The answer: results of "red", "green" and "blue".
    best, in_tissue : str
        The answer: the best of these results; the colour of which least light bounces.
    seen : Rendered
        The frame with its truth.
    """
    if not isinstance(by_channel, Mapping) or set(by_channel) != set(COLOURS):
        raise Wrong('`by_channel` is to be a dict of three results, named "red", "green" and "blue".')
    for name, one in by_channel.items():
        _result(f"by_channel[{name!r}]", one)
        solved = one.problem.settings.get("channel")
        if solved != name:
            raise Wrong(f'What is named {name} was solved from {solved!r}: say `channel="{name}"`.')
    off = {
        name: float(100 * np.nanmedian(np.abs(one.distance / seen.distance - 1)))
        for name, one in by_channel.items()
    }
    told = ", ".join(f"{name} {value:.2f} %" for name, value in off.items())
    if best not in COLOURS or in_tissue not in COLOURS:
        raise Wrong("`best` and `in_tissue` are each one of red, green and blue.")
    if best != min(off, key=lambda name: off[name]):
        raise Wrong(f"Best is what errs least, and {best} errs by {off[best]:.2f} %. Look at the other two.")
    brdf: Any = seen.photometry.brdf
    albedo = dict(zip(COLOURS, brdf.albedo, strict=True))
    back = f"Of {in_tissue} light the wall gives back {albedo[in_tissue]:.0%}"
    if in_tissue == max(albedo, key=lambda name: albedo[name]):
        raise Wrong(
            f"{back}, more than of any other: most of it goes on to other walls, which look nearer by it."
        )
    if in_tissue != min(albedo, key=lambda name: albedo[name]):
        raise Wrong(f"{back}. Is there a colour of which it gives back less?")
    return (
        f"{told} (medians): the noise is the same in all three, and {best} is brightest. Where light bounces "
        f"{in_tissue} suffers least, since the wall swallows it."
    )


def _result(name: str, answer: Any) -> None:
    if not isinstance(answer, Result):
        raise Wrong(
            f"`{name}` is to be what `el.reconstruct` returns; here it is of type {type(answer).__name__}."
        )
