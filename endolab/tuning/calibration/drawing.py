"""Pictures of a calibration, drawn into pixels: a frame with its dots or samples, and who does not count."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from endolab.calibration.photometric.left_out import (
    BRIGHTER,
    BY_HAND,
    COUNTS,
    DARK,
    DARKER,
    SATURATED,
    reasons,
)
from endolab.calibration.photometric.model import GREY, LEVELS
from endolab.numerics.arrays import BoolArray, FloatArray, IntArray
from endolab.plots.scales import round_length
from endolab.tuning.calibration import material
from endolab.tuning.calibration.material import Dots, Levels
from endolab.tuning.pictures import INK, Picture, grey_or_colour, ticks, write

RING, CROSS, ARROW, DISC = "○", "+", "→", "●"
FRAME_WIDTH = 960  # px, of a frame
TEXT = 20  # px, of letters in a picture that is shown at two thirds of its size
LOUPE, REACH = 264, 12  # px: side of the enlarged detail; pixels of the frame to each side of its middle
LONGEST = 4.0  # standard deviations that an arrow shows
FOUND, EXPECTED, WRONG = (0, 114, 178), (230, 159, 0), (213, 62, 0)
SHADES = {  # Okabe and Ito's
    COUNTS: (86, 180, 233),
    BY_HAND: (136, 136, 136),
    SATURATED: (213, 94, 0),
    DARK: (0, 0, 0),
    BRIGHTER: (230, 159, 0),
    DARKER: (0, 130, 95),
}


@dataclass(frozen=True)
class Drawn:
    """A picture of a frame, and what is to be said of it."""

    picture: Picture
    title: str
    legend: Sequence[tuple[str, Sequence[int], str]]  # a mark, its colour, R, G, B, and what it means


class _Sheet:
    """A frame, enlarged, to draw on."""

    def __init__(self, image: FloatArray | None, size: tuple[int, int]) -> None:
        width, height = size
        self.scale = min(FRAME_WIDTH / width, 1.1 * FRAME_WIDTH / height)
        self.image = np.full((height, width, 3), 235, np.uint8) if image is None else grey_or_colour(image)
        how = cv2.INTER_AREA if self.scale < 1 else cv2.INTER_LINEAR
        whole = round(width * self.scale), round(height * self.scale)
        self.paper: Picture = np.asarray(cv2.resize(self.image, whole, interpolation=how), np.uint8)

    def at(self, pixels: FloatArray) -> IntArray:
        """Where pixels of the frame, (n, 2), are, in sixteenths of a pixel."""
        return np.round(16 * ((pixels + 0.5) * self.scale - 0.5)).astype(int)

    def detail(
        self,
        middle: FloatArray,
        marks: Sequence[tuple[FloatArray, str, Sequence[int]]],
        others: FloatArray,
    ) -> None:
        """Enlarge what is around a pixel, in the corner that hides fewest of `others`, (n, 2).

        The marks are where they are in truth, without the enlargement of the arrows.
        """
        grown, turn = LOUPE / (2 * REACH), np.array([[1.0, 0, 0], [0, 1.0, 0]])
        turn[:, 2] = grown / 2 - 0.5 + LOUPE / 2 - grown * (middle + 0.5)
        turn[:, :2] *= grown
        how: dict[str, Any] = {"flags": cv2.INTER_NEAREST, "borderValue": (255, 255, 255)}
        near: Picture = np.asarray(cv2.warpAffine(self.image, turn, (LOUPE, LOUPE), **how), np.uint8)
        for pixel, mark, colour in marks:
            place = turn[:, :2] @ pixel + turn[:, 2]
            if not np.isfinite(place).all():
                continue
            x, y = (int(v) for v in np.clip(np.round(16 * place), -1e6, 1e6))
            if mark == RING:
                cv2.circle(near, (x, y), 16 * 9, tuple(colour), 2, cv2.LINE_AA, shift=4)
                continue
            for dx, dy in ((192, 0), (0, 192)):
                ends = ((x - dx, y - dy), (x + dx, y + dy))
                cv2.line(near, *ends, tuple(colour), 2, cv2.LINE_AA, shift=4)
        long = round(2 * grown)
        near[-31:, : long + 58] = 255
        cv2.line(near, (10, LOUPE - 15), (10 + long, LOUPE - 15), (0, 0, 0), 3)
        write(near, "2 px", 16 + long, LOUPE - 32, TEXT - 3)
        near[[0, 1, -2, -1]], near[:, [0, 1, -2, -1]] = 255, 255
        height, width = self.paper.shape[:2]
        tall, wide = min(LOUPE, height), min(LOUPE, width)
        low, right = self.at(others).T[::-1] / 16 > [[height / 2], [width / 2]]
        hidden = [np.sum((low == below) & (right == beside)) for below in (0, 1) for beside in (0, 1)]
        below, beside = divmod(int(np.argmin(hidden)), 2)
        y, x = below * (height - tall), beside * (width - wide)
        self.paper[y : y + tall, x : x + wide] = near[:tall, :wide]


def _nearest(pixels: FloatArray, place: tuple[float, float] | None, size: tuple[int, int]) -> int | None:
    """Which of some pixels is nearest to a place of the frame, shares of it in [0, 1]."""
    apart = np.linalg.norm(pixels + 0.5 - np.array(place or (0, 0)) * size, axis=1)
    return None if place is None or not np.isfinite(apart).any() else int(np.nanargmin(apart))


def _title(name: str, seen: Dots | Levels) -> str:
    return f"{name}: {seen.state}" + (f": {seen.why}" if seen.why else "")


def dots_picture(
    image: FloatArray | None,
    size: tuple[int, int],
    name: str,
    dots: Dots,
    sigma: float,
    place: tuple[float, float] | None = None,
) -> Drawn:
    """Draw a frame with the dots that were found and those that the camera expects.

    Arrows from these to those are enlarged, and say by how much; they end at 4 `sigma`, px, of a coordinate.
    In a corner is a detail around the dot nearest to `place`, shares of the frame, or around the worst.
    """
    known = np.isfinite(dots.residual[:, 0])
    length = np.linalg.norm(dots.residual, axis=1)
    sheet, title = _Sheet(image, size), _title(name, dots)
    if not len(known):
        return Drawn(sheet.paper, title, [])
    magnify = round_length(0.02 * size[0] / max(sigma, 1e-6))
    expected = dots.found - dots.residual
    for (x, y), good in zip(sheet.at(dots.found), dots.inliers | ~known, strict=True):
        cv2.circle(sheet.paper, (x, y), 16 * 6, FOUND if good else WRONG, 1, cv2.LINE_AA, shift=4)
    shorter = np.minimum(1, LONGEST * sigma / np.maximum(length, 1e-12))[:, None]
    tips = sheet.at((expected + magnify * dots.residual * shorter)[known]).tolist()
    crosses = sheet.at(expected[known]).tolist()
    for (x, y), tip, good in zip(crosses, tips, dots.inliers[known], strict=True):
        for dx, dy in ((64, 0), (0, 64)):
            ends = ((x - dx, y - dy), (x + dx, y + dy))
            cv2.line(sheet.paper, *ends, EXPECTED, 1, cv2.LINE_AA, shift=4)
        cv2.line(sheet.paper, (x, y), tip, FOUND if good else WRONG, 2, cv2.LINE_AA, shift=4)
        cv2.circle(sheet.paper, tip, 40, FOUND if good else WRONG, -1, cv2.LINE_AA, shift=4)
    chosen = _nearest(dots.found, place, size)
    if chosen is None:
        chosen = int(np.argmax(np.where(known & dots.inliers, length, -1)))
    marks = [(dots.found[chosen], RING, FOUND if dots.inliers[chosen] else WRONG)]
    marks.append((expected[chosen], CROSS, EXPECTED))
    sheet.detail(dots.found[chosen], marks, dots.found)
    legend: list[tuple[str, Sequence[int], str]] = [
        (RING, FOUND, f"found: {len(known)} dots"),
        (CROSS, EXPECTED, "expected"),
        (ARROW, FOUND, f"found − expected, × {magnify:g}, {LONGEST * sigma:.2g} px at most"),
        (RING, WRONG, f"{int(np.sum(known & ~dots.inliers))} disagree"),
    ]
    if known[chosen]:
        which = "the worst that agrees" if place is None else "this one"
        legend.append(("", INK, f"detail: {which}, {length[chosen]:.3f} px off"))
    if np.isfinite(dots.error):
        legend.append(("", INK, f"rms {dots.error:.3f} px, of all {dots.error_of_all:.3g} px"))
    if dots.state != material.COUNTS and known.any():
        legend.append(("", INK, "by a pose of its own"))
    return Drawn(sheet.paper, title, legend)


def levels_picture(
    image: FloatArray | None,
    size: tuple[int, int],
    name: str,
    levels: Levels,
    pixels: FloatArray,
    place: tuple[float, float] | None = None,
    limits: tuple[float, float] = LEVELS,
) -> Drawn:
    """Draw a frame with its samples, each in the colour of the reason why it does not count.

    `pixels`, (n, 2), are where they were read, nan if that is unknown; a detail is as in `dots_picture`.
    """
    sheet, title, seen = _Sheet(image, size), _title(name, levels), np.isfinite(pixels[:, 0])
    for (x, y), why in zip(sheet.at(pixels[seen]), levels.reason[seen], strict=True):
        cv2.circle(sheet.paper, (x, y), 16 * 6, (255, 255, 255), 3, cv2.LINE_AA, shift=4)
        cv2.circle(sheet.paper, (x, y), 16 * 6, SHADES[why], -1 if why > BY_HAND else 2, cv2.LINE_AA, shift=4)
    said = [reason.split(":")[0] for reason in reasons(limits)]
    counts = np.bincount(levels.reason, minlength=len(SHADES))
    legend: list[tuple[str, Sequence[int], str]] = [
        (DISC, shade, f"{counts[why]} {said[why]}") for why, shade in SHADES.items() if counts[why]
    ]
    residual = levels.residual
    chosen = _nearest(pixels, place, size)
    if chosen is None and np.isfinite(residual).any():
        chosen = int(np.argmax(np.nan_to_num(np.abs(residual), nan=-1.0)))
    if chosen is not None:
        if seen[chosen]:
            mark = (pixels[chosen], RING, SHADES[levels.reason[chosen]])
            sheet.detail(pixels[chosen], [mark], pixels[seen])
        which = "the farthest off" if place is None else "this one"
        measured, expected = GREY * levels.samples.level[chosen], GREY * levels.expected[chosen]
        told = f"measured {measured:.0f}, expected {expected:.0f} grey levels: {said[levels.reason[chosen]]}"
        legend.append(("", INK, f"detail: {which}, {told}"))
    if np.isfinite(levels.error):
        legend.append(("", INK, f"rms {levels.error:.2f} grey levels, {levels.relative_error:.1f} %"))
    return Drawn(sheet.paper, title, legend)


# Why samples do not count ----------------------------------------------------------------------
PLOT = (290, 226)  # px, of each of the two panels
SMALL = 14  # px, of letters there
MOST_DRAWN = 4000  # samples that count; more hide each other


def _dot(paper: Picture, x: float, y: float, colour: Sequence[int], radius: int = 2) -> None:
    cv2.circle(paper, (round(16 * x), round(16 * y)), 16 * radius, tuple(colour), -1, cv2.LINE_AA, shift=4)


def reasons_picture(
    measured: FloatArray,
    expected: FloatArray,
    why: IntArray,
    pixels: FloatArray,
    size: tuple[int, int],
    of_frame: BoolArray,
    limits: tuple[float, float] = LEVELS,
) -> Drawn:
    """Draw which samples of all frames do not count: where they lie, what was expected, and how many.

    `of_frame`, (n,), are those of the chosen frame, which are drawn larger. Of the samples that count some
    are not drawn if there are very many.
    """
    counts, said = np.bincount(why, minlength=len(SHADES)), reasons(limits)
    out = int(counts.sum() - counts[COUNTS])
    paper = np.full((PLOT[1], 2 * PLOT[0], 3), 255, np.uint8)
    good, wrong = np.flatnonzero((why == COUNTS) & ~of_frame), np.flatnonzero((why != COUNTS) | of_frame)
    order = np.concatenate([good[:: 1 + len(good) // MOST_DRAWN], wrong])  # what counts lies below
    _map_of_reasons(paper[:, : PLOT[0]], why, pixels, size, of_frame, order)
    _levels_of_reasons(paper[:, PLOT[0] :], measured, expected, why, order, of_frame, limits)
    legend = [(DISC, shade, f"{counts[one]} {said[one]}") for one, shade in SHADES.items() if counts[one]]
    return Drawn(paper, f"{out} of {len(why)} samples left out", legend)


def _map_of_reasons(
    paper: Picture,
    why: IntArray,
    pixels: FloatArray,
    size: tuple[int, int],
    of_frame: BoolArray,
    order: IntArray,
) -> None:
    """Where in the picture the samples of all frames lie."""
    left, top, wide, tall = 4, 22, PLOT[0] - 12, PLOT[1] - 26
    scale = min(wide / size[0], tall / size[1])
    right, bottom = left + round(size[0] * scale), top + round(size[1] * scale)
    write(paper, "where in the picture, all frames", left, 0, SMALL)
    cv2.rectangle(paper, (left - 1, top - 1), (right, bottom), (120, 120, 120), 1)
    for i in order:
        if np.isfinite(pixels[i]).all() and (why[i] != COUNTS or of_frame[i]):
            x, y = left + (pixels[i] + 0.5) * scale
            _dot(paper, x, y - left + top, SHADES[why[i]], 3 if of_frame[i] else 2)


def _levels_of_reasons(
    paper: Picture,
    measured: FloatArray,
    expected: FloatArray,
    why: IntArray,
    order: IntArray,
    of_frame: BoolArray,
    limits: tuple[float, float],
) -> None:
    """What was measured over what was expected, in grey levels."""
    left, top, right, bottom = 38, 22, PLOT[0] - 16, PLOT[1] - 24
    most = float(np.clip(GREY * np.nanmax(expected, initial=1.0), 260, 400))
    write(paper, "measured over expected, grey levels", left - 30, 0, SMALL)

    def column(value: float) -> float:
        return left + (right - left) * min(value, most) / most

    def row(value: float) -> float:
        return bottom - (bottom - top) * min(max(value, 0), 270) / 270

    low, high = (GREY * limit for limit in limits)
    for a, b in ((0, low), (high, most)):
        paper[top:bottom, round(column(a)) : round(column(b))] = 238
    for value in ticks(0, most):
        write(paper, f"{value:g}", round(column(value)), bottom, SMALL - 1, 0.5)
    for value in ticks(0, 255):
        write(paper, f"{value:g}", left - 4, round(row(value)) - 11, SMALL - 1, 1.0)
    cv2.rectangle(paper, (left, top), (right, bottom), (120, 120, 120), 1)
    for i in order:
        if np.isfinite(expected[i]):
            x, y = column(GREY * expected[i]), row(GREY * measured[i])
            _dot(paper, x, y, SHADES[why[i]], 3 if of_frame[i] and why[i] != COUNTS else 1)
    ends = [(column(v), row(min(v, 255))) for v in (0, 255, most)]
    points = np.round(16 * np.array(ends)).astype(np.int32)
    cv2.polylines(paper, [points], False, (0, 0, 0), 1, cv2.LINE_AA, shift=4)
