"""Checks for notebook 04: a march of one's own, how wide to see into a tube, what is left at folds."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Any

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.optimize import brentq

from endolab.course.verdict import Wrong, verdict
from endolab.io.descriptions import Calibration
from endolab.model.cameras import KannalaBrandt
from endolab.model.photometry import Photometry
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.preprocessing.frame import Frame
from endolab.reconstruction.reconstruct import reconstruct
from endolab.synthetic.rendering import Rendered, render
from endolab.synthetic.scenes import SCENES

# A lens with h(ϑ) = 2 tan(ϑ/2), which keeps circles circles: its pixels are as wide in every direction.
STEREOGRAPHIC = (1 / 12, 1 / 120, 17 / 20160, 31 / 725760)
MOST_LINES = 300_000  # of Python, for the small landscape; a march takes a tenth of that
SAME = 1e-6  # share by which two solutions of one equation may differ


def pixel_angle(lens: KannalaBrandt) -> FloatArray:
    """Angle that each pixel of a lens of `STEREOGRAPHIC` is wide, and high, (H, W), rad."""
    return lens.field.inverse_metric[..., 0] ** -0.5


def _root(lower: Sequence[Any], y0: Any, delta: Any, sign: int = 1, factor: int = 4) -> Any:
    """Larger (1) or smaller (-1) root of Σ (y - lower)² = 4 Δ² (y0² - y²); nan if there is none."""
    right, total = factor * delta**2, sum(lower)
    with np.errstate(invalid="ignore"):
        inside = total**2 - (len(lower) + right) * (sum(y**2 for y in lower) - right * y0**2)
        return (total + sign * np.sqrt(inside)) / (len(lower) + right)


def _neighbours(y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Left, right, upper and lower neighbour of each pixel; infinite outside the picture."""
    padded = np.pad(y, 1, constant_values=np.inf)
    return padded[1:-1, :-2], padded[1:-1, 2:], padded[:-2, 1:-1], padded[2:, 1:-1]


def first_order(d0: FloatArray, delta: FloatArray) -> FloatArray:
    """Distance (H, W) that a march of first order finds: all pixels are asked until nothing changes.

    Parameters
    ----------
    d0 : (H, W) float array, distance if the wall faced the camera
    delta : (H, W) float array, angle of a pixel, rad; see `pixel_angle`
    """
    y0 = y = np.asarray(d0) ** 2
    while True:
        left, right, above, below = _neighbours(y)
        y1, y2 = np.minimum(left, right), np.minimum(above, below)
        low, high = np.minimum(y1, y2), np.maximum(y1, y2)
        both, one = _root((low, high), y0, delta), _root((low,), y0, delta)
        found = np.where(both >= high, both, np.where(one >= low, one, np.inf))
        if np.all(found >= y * (1 - 1e-14)):
            return np.sqrt(y)
        y = np.minimum(y, found)


def _landscape() -> tuple[FloatArray, FloatArray]:
    """A small d₀ with hollows inside and at the border, and pixels of different widths."""
    row, column = np.indices((12, 16))
    d0 = 50 + 6 * np.sin(0.8 * column) + 5 * np.cos(0.9 * row + 0.3 * column) + 0.1 * row
    return d0, 0.04 + 0.001 * column + 0.002 * row


def _in_lines(most: int, function: Callable[..., Any], *arguments: Any) -> Any:
    """What a function returns; Wrong once it has run more lines of Python than that."""
    left = most

    def count(frame: FrameType, event: str, argument: Any) -> Any:
        nonlocal left
        left -= event == "line"
        if left < 0:
            raise Wrong(
                "It does not end. Each pixel is final once: one that comes off the heap again is skipped, "
                "and one that is final is not updated."
            )
        return count

    before = sys.gettrace()
    sys.settrace(count)
    try:
        return function(*arguments)
    finally:
        sys.settrace(before)


def _check_form(found: Any, d0: FloatArray) -> FloatArray:
    """Return the distances of a march as an array."""
    if found is None:
        raise Wrong("It returns nothing. The last line of `march` returns the distances.")
    values = np.asarray(found, dtype=np.float64)
    if values.shape == tuple(size + 2 for size in d0.shape):
        raise Wrong(
            "The frame of one pixel around the picture is still there: cut it off again, `[1:-1, 1:-1]`."
        )
    if values.shape != d0.shape:
        raise Wrong(f"It returns shape {values.shape}. Wanted is a distance for each pixel, {d0.shape}.")
    if np.isfinite(values).any() and values.min() > 5 * d0.max():
        raise Wrong("These are y = d², in mm². Distances are wanted: take the root.")
    return values


def _is_lowest(values: FloatArray) -> BoolArray:
    """Where none of the four neighbours is lower."""
    return np.all([values <= side for side in _neighbours(values)], axis=0)


def _check_arrived(found: FloatArray, d0: FloatArray) -> None:
    """Say why pixels have no value, or all have kept d₀, or lie below all their neighbours."""
    if np.allclose(found, d0):
        raise Wrong(
            "Every pixel has kept d₀. One that is no local minimum must not be final from the start: it "
            "takes its value from a neighbour that became final before."
        )
    lost, lowest = ~np.isfinite(found), _is_lowest(d0)
    if lost.flat[np.argmin(d0)]:
        raise Wrong(
            "The lowest pixel of all, where the march starts, has no value in the end. A final pixel stays "
            "as it is, and no pixel takes a value that is not lower than the one it has."
        )
    if np.any(_is_lowest(np.where(lost, np.inf, found)) & ~lost & ~lowest):
        raise Wrong(
            "Some pixels lie below all their neighbours where d₀ has no minimum: the march runs downhill. "
            "The larger root of the quadratic climbs."
        )
    if np.any(lost & lowest):
        raise Wrong("The march starts at every local minimum of d₀, not at the lowest pixel alone.")
    if lost.mean() > 0.75:
        raise Wrong(
            f"{lost.sum()} of {lost.size} pixels never got a value: the front hardly leaves its starts. Are "
            "the four neighbours of a final pixel updated, and put into the heap? Is it the lower one of two "
            "that counts, and the larger root? Does one alone do where the other has no value yet?"
        )
    if lost.any():
        raise Wrong(
            f"{lost.sum()} of {lost.size} pixels never got a value. Where the root of two neighbours lies "
            "below one of them, or one has no value yet, take the root of the lower one alone."
        )


def _reason(yours: float, y0: float, delta: float, sides: list[float]) -> str:
    """What is wrong with y at a pixel whose lower neighbours, `sides`, are right; others are infinite."""
    y1, y2 = min(sides[:2]), min(sides[2:])
    low, high = min(y1, y2), max(y1, y2)
    lower = (low, high) if np.isfinite(high) else (low,)
    pairs = ([y for y in pair if np.isfinite(y)] for pair in (sides[:2], sides[2:]))
    larger = sorted(max(pair) for pair in pairs if pair)
    slope = "the equation is Σ (y - neighbour)² = 4 Δ² (y₀² - y²)"
    told = {
        "It is d₀ still. Only local minima keep d₀; here a lower neighbour is final.": [y0],
        f"The 4 is missing: {slope}.": [_root(part, y0, delta, factor=1) for part in (lower, (low,))],
        f"Δ is not squared: {slope}.": [_root(part, y0, delta**0.5) for part in (lower, (low,))],
        f"y² is missing on the right: {slope}.": [
            low + 2 * delta * y0,
            (low + high + np.sqrt(max(8 * (delta * y0) ** 2 - (high - low) ** 2, 0))) / 2,
        ],
        "The lower neighbour alone was asked. Where the front comes in at an angle two count: the lower one "
        "of left and right, and the lower one of above and below.": [_root((low,), y0, delta)],
        "The larger neighbour was taken. The front comes from the lower one: of left and right, and of above "
        "and below.": [_root(larger, y0, delta), _root(larger[-1:], y0, delta)],
    }
    for reason, values in told.items():
        if any(abs(yours / value - 1) < SAME for value in values):
            return reason
    if yours > y0 * (1 + SAME):
        return "It lies above y₀, which no wall can. Are y₀ and Δ those of the pixel that is updated?"
    if yours > _root(lower, y0, delta):
        return "It is too high. Are y₀ and Δ those of the pixel that is updated?"
    return (
        "It is too low. Where the root of two neighbours lies below one of them, the lower one alone counts; "
        "and y₀ and Δ are those of the pixel that is updated."
    )


def _check_values(found: FloatArray, d0: FloatArray, delta: FloatArray) -> None:
    """Say what is wrong at the first pixel, in the order of the march, that is."""
    y, right = found**2, first_order(d0, delta) ** 2
    wrong = np.abs(y / right - 1) > SAME
    if not wrong.any():
        return
    at = tuple(int(i) for i in np.unravel_index(np.argmin(np.where(wrong, right, np.inf)), d0.shape))
    sides = [float(side[at]) if side[at] < right[at] else np.inf for side in _neighbours(right)]
    place = f"All is right up to pixel {at}, where d = {found[at]:.3f} mm. "
    if min(sides) == np.inf:
        raise Wrong(
            f"{place}There d₀ has a local minimum, a start: y = y₀ = d₀², until a lower front comes in."
        )
    low = np.min(_neighbours(y), axis=0)
    alone = np.abs(y / _root((low,), d0**2, delta) - 1) < SAME
    reason = _reason(float(y[at]), float(d0[at] ** 2), float(delta[at]), sides)
    if "alone was asked" in reason and not np.all(alone | _is_lowest(d0)):
        reason = "It was final before its neighbours were. Of all that are not final the lowest comes next."
    raise Wrong(place + reason)


@verdict
def march(answer: Callable[[FloatArray, FloatArray], FloatArray]) -> str:
    """Check `march(d0, delta)`, which returns distances: on a small landscape, then inside a ball."""
    d0, delta = _landscape()
    found = _check_form(_in_lines(MOST_LINES, answer, d0.copy(), delta.copy()), d0)
    _check_arrived(found, d0)
    _check_values(found, d0, delta)
    lens = KannalaBrandt(80, 60, 50.0, 50.0, 39.5, 29.5, STEREOGRAPHIC)
    seen = render(SCENES["curved"], lens, Photometry())
    facing = seen.distance / np.sqrt(-np.einsum("hwi,hwi->hw", seen.normals, lens.field.rays))
    off = 100 * np.mean(np.abs(answer(facing, pixel_angle(lens)) / seen.distance - 1))
    start = 100 * np.mean(facing / seen.distance - 1)
    return f"It marches. On the inside of a ball d₀ errs by {start:.2f} %, your march by {off:.2f} %."


def _law(beta: float) -> float:
    """Relative error at 20° off the axis of a tube that is seen up to β, rad."""
    return (np.sin(beta) ** -0.5 - 1) * (np.tan(np.deg2rad(20)) / np.tan(beta)) ** 2


@verdict
def exercise_1(half_angle: float) -> str:
    """Check the half-angle, degrees, at which a tube's error is 1 % at 20° off the axis."""

    def solved(law: Callable[[float], float]) -> float:
        return float(np.rad2deg(brentq(lambda beta: law(beta) - 0.01, np.deg2rad(20.1), np.deg2rad(89.9))))

    wanted = solved(_law)
    tangent = np.tan(np.deg2rad(20))
    told = {
        "That is in radians. Degrees, please.": np.deg2rad(wanted),
        "That is the whole field of view. β is the angle between the axis and the border: half of it.": 2
        * wanted,
        "The tangents are squared in the law.": solved(
            lambda beta: (np.sin(beta) ** -0.5 - 1) * tangent / np.tan(beta)
        ),
        "The march starts with d₀ = d/√sin β at the border: mind the root.": solved(
            lambda beta: (1 / np.sin(beta) - 1) * (tangent / np.tan(beta)) ** 2
        ),
        "That is where the error at the border itself is 1 %. It falls on its way to 20°.": float(
            np.rad2deg(np.arcsin(1.01**-2))
        ),
    }
    for reason, value in told.items():
        if abs(half_angle / value - 1) < 0.015:
            raise Wrong(reason)
    if abs(half_angle - wanted) > 1.0:
        side = "larger" if _law(np.deg2rad(min(max(half_angle, 1.0), 89.9))) > 0.01 else "smaller"
        raise Wrong(f"By the law of section 7 the error at 20° would be {side} than 1 %.")
    return f"By the law it is {wanted:.1f}°."


def _told(seen: Rendered, where: BoolArray) -> FloatArray:
    """Errors of the march, %, told the true distance there."""
    inflow = np.where(where, np.log(seen.distance), np.nan)
    frame, calibration = Frame(seen.image, seen.mask), Calibration(seen.camera, seen.photometry)
    found = reconstruct(frame, calibration, solver="fast_marching", smooth=0, inflow=inflow)
    return 100 * np.abs(found.distance / seen.distance - 1)


@verdict
def exercise_2(error_told: Callable[[float], float], seen: Rendered) -> str:
    """Check the mean error, %, of a march told border and all that lies behind jumps of more than a share."""
    log_d = np.log(seen.distance)
    border = np.ones(log_d.shape, dtype=bool)
    border[1:-1, 1:-1] = False

    def edges(jump: float) -> BoolArray:
        return log_d - minimum_filter(log_d, 3) > jump

    found, wanted = {}, {}
    for jump in (0.08, 0.02):
        found[jump], off = error_told(jump), _told(seen, border | edges(jump))
        wanted[jump] = float(off.mean())
        if abs(found[jump] / wanted[jump] - 1) < 0.02:
            continue
        if abs(found[jump] / wanted[jump] - 0.01) < 2e-4:
            raise Wrong("That is a share. Per cent, please.")
        if abs(found[jump] / np.median(off) - 1) < 0.02:
            raise Wrong("That is the median. The few pixels that are left are far off: take the mean.")
        told = {
            "The border is missing: there the march needs the truth, too.": edges(jump),
            "The edges are missing: this is the border alone.": border,
            "Those are the near sides of the edges. The front loses its way on the far side, which is where "
            "it must be told.": border | (maximum_filter(log_d, 3) - log_d > jump),
            "A jump is a share of the distance: take differences of log d, not of d in mm.": border
            | (seen.distance - minimum_filter(seen.distance, 3) > jump),
        }
        for reason, where in told.items():
            if abs(found[jump] / _told(seen, where).mean() - 1) < 0.02:
                raise Wrong(reason)
        if not found[jump] < 20:
            raise Wrong(
                "That is worse than being told nothing. `inflow` takes log d, and nan where it is not known."
            )
        raise Wrong(f"With a jump of {jump} the mean error is not {found[jump]:.3g} %.")
    return f"From {wanted[0.08]:.2f} % to {wanted[0.02]:.3f} %: edges fade out, and the front slips through."
