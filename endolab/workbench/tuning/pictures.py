"""Fast pictures: maps and charts drawn into cells of pixels, in milliseconds.

For what follows a hand on a slider; `plots` draws the same better and ten times more slowly.
Pictures are (H, W, 3) arrays of bytes, R, G, B.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from matplotlib import colormaps
from matplotlib.ticker import Locator, LogLocator, MaxNLocator
from numpy.typing import NDArray

from endolab.numerics.arrays import FloatArray
from endolab.workbench.plots.scales import (
    OKABE_ITO,
    Colour,
    in_colour,
)

Picture = NDArray[np.uint8]
Limits = tuple[float, float]
Box = tuple[int, int, int, int]  # left, top, right, bottom, px


@dataclass(frozen=True)
class Drawing:
    """How fast pictures look; colours beside Okabe and Ito's, chosen by eye."""

    ink: Colour = (34, 34, 34)
    grid: Colour = (225, 225, 225)
    frame: Colour = (120, 120, 120)
    left_out: Colour = (184, 184, 184)
    below_noise: Colour = (236, 236, 236)  # of residuals that noise explains
    jpeg_quality: int = 88
    scale_width: int = 5  # of a colour bar with its numbers, in letters
    font_weight: int = 400


DRAWING = Drawing()
LEFT_OUT: Any = tuple(np.divide(DRAWING.left_out, 255))
FONT = cv2.FontFace("sans")


def jpeg(picture: Picture) -> bytes:
    """Encode as JPEG."""
    options = [cv2.IMWRITE_JPEG_QUALITY, DRAWING.jpeg_quality]
    return bytes(cv2.imencode(".jpg", picture[..., ::-1], options)[1])


def write(
    picture: Picture,
    text: str,
    x: int,
    y: int,
    size: int,
    align: float = 0.0,
    colour: Colour = DRAWING.ink,
    on_white: bool = False,
) -> int:
    """Write a line of text below y, and return its width; x is its left end, or its right for `align` 1."""
    weight = DRAWING.font_weight
    wide: int = cv2.getTextSize((0, 0), text, (0, 0), FONT, size, weight)[2]
    left = max(0, int(x - align * wide))
    if on_white:
        bottom = y + round(1.6 * size)
        picture[max(0, y + 2) : bottom, left : left + wide + 2] = 255
    base = left, y + int(1.4 * size)
    cv2.putText(picture, text, base, colour, FONT, size, weight)
    return wide


def to_colours(values: FloatArray, limits: Limits, palette: str = "viridis") -> Picture:
    """Colour a map, (H, W): Matplotlib's colours between the limits, grey where it is nan."""
    colours = colormaps[palette].with_extremes(bad=LEFT_OUT)
    shares = (values - limits[0]) / (limits[1] - limits[0])
    return np.ascontiguousarray(colours(shares, bytes=True)[..., :3])


def grey_or_colour(image: FloatArray) -> Picture:
    """Show values in [0, 1], (H, W) or (H, W, 3); nan is grey."""
    shown = in_colour(image)
    known = np.isfinite(shown).all(axis=-1, keepdims=True)
    filled = np.where(known, np.clip(shown, 0, 1), LEFT_OUT)
    return np.round(255 * filled).astype(np.uint8)


def ticks(low: float, high: float, log: bool = False) -> list[tuple[float, str]]:
    """Where round numbers lie in [low, high], and how they are written; `log`: of the numbers' logarithms."""
    locator: Locator = MaxNLocator(6, steps=[1, 2, 5, 10])
    if log:
        low = 10**low
        high = 10**high
        if high > 4 * low:
            locator = LogLocator(subs=(1, 2, 5))
    places = []
    for value in locator.tick_values(low, high):
        if low <= value <= high:
            at = np.log10(value) if log else value
            places.append((float(at), f"{value:.4g}"))
    return places


def _room(paper: Picture, title: str, text: int) -> Box:
    """Write a title into a cell, and tell what is left below it."""
    edge = text // 2
    write(paper, title, edge, 0, text + 1)
    return edge, 2 * text, paper.shape[1] - edge, paper.shape[0] - edge


@dataclass(frozen=True)
class Map:
    """A picture with a title, which fills its cell, with a colour bar if there are limits.

    `keys` say what colours mean, `line` is a row (True) or column and its share of the picture, and `says`
    tells what is known of a pixel. Without a picture, its place is left free.
    """

    title: str
    picture: Picture | None
    limits: Limits | None = None
    palette: str = "viridis"
    keys: Sequence[tuple[str, Colour]] = ()
    line: tuple[bool, float] | None = None
    says: Callable[[int, int], str] | None = None

    def draw(self, paper: Picture, text: int) -> tuple[Box, list[tuple[int, int]]]:
        """Draw it into a white cell with letters of so many px, and tell where in the cell the picture is."""
        left, top, right, bottom = _room(paper, self.title, text)
        if self.picture is None:
            return (left, top, right, bottom), []
        height, width = self.picture.shape[:2]
        room = right - left
        if self.limits is not None:
            room -= DRAWING.scale_width * text
        scale = min(room / width, (bottom - top) / height)
        wide = max(1, round(width * scale))
        tall = max(1, round(height * scale))
        left += (room - wide) // 2
        interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        place = paper[top : top + tall, left : left + wide]
        place[:] = cv2.resize(self.picture, (wide, tall), interpolation=interpolation)
        if self.line is not None:
            _cut(place, *self.line)
        for number, (name, colour) in enumerate(reversed(self.keys)):
            y = place.shape[0] - round(1.6 * text) * (number + 1)
            write(place, name, round(1.6 * text), y, text, on_white=True)
            place[max(0, y + 4) : y + text + 2, 3 : text + 1] = colour
        if self.limits is not None:
            strip = paper[top : top + tall, left + wide + text // 2 :]
            scale_bar(strip, self.limits, self.palette, text)
        return (left, top, left + wide, top + tall), []


def scale_bar(paper: Picture, limits: Limits, palette: str, text: int) -> None:
    """Draw a colour bar with its numbers at the left of the paper, as high as it is."""
    tall = len(paper)
    scale = np.linspace(limits[1], limits[0], tall)[:, None]
    paper[:, :text] = to_colours(scale, limits, palette)
    for value, label in ticks(*limits):
        y = round((limits[1] - value) / (limits[1] - limits[0]) * (tall - 1))
        paper[y, text : text + text // 3] = DRAWING.ink
        middle = max(0, min(y - text + 1, tall - 2 * text))
        write(paper, label, text + text // 2, middle, text)


def _cut(picture: Picture, is_row: bool, share: float) -> None:
    """Draw where the section lies."""
    lines = picture if is_row else picture.swapaxes(0, 1)
    at = min(int(share * len(lines)), len(lines) - 1)
    lines[max(0, at - 1) : at + 2] = OKABE_ITO.black
    lines[at] = 255


@dataclass(frozen=True)
class Chart:
    """Curves, (name, x, y, colour), and dots, (x, y, colour, whether filled), on axes with units.

    `log` puts both axes on logarithmic scales, `down` lets y grow downwards, as in a picture, and `equal`
    gives both axes one scale, so that angles are angles. Limits are what is drawn needs, or `fitted`.
    """

    title: str
    x_label: str
    y_label: str
    curves: Sequence[tuple[str, FloatArray, FloatArray, Colour]] = ()
    dots: Sequence[tuple[float, float, Colour]] = ()
    log: tuple[bool, bool] = (False, False)
    down: bool = False
    equal: bool = False
    fitted: tuple[FloatArray, FloatArray] | None = None  # x and y that set the limits

    def draw(self, paper: Picture, text: int) -> tuple[None, list[tuple[int, int]]]:
        """Draw it into a white cell with letters of so many px, and tell where in the cell the dots are."""
        left, top, right, bottom = _room(paper, self.title, text)
        left += round(3.6 * text)
        right -= text // 2
        bottom -= round(2.4 * text)
        inner = paper[top : bottom + 1, left : right + 1]
        size = np.array([right - left, bottom - top])
        low, high = self._limits(size[0] / size[1])

        def place(points: FloatArray) -> FloatArray:
            """To the right and down, px."""
            share = (points - low) / (high - low)
            if not self.down:
                share[..., 1] = 1 - share[..., 1]
            return np.clip(share * size, -4e3, 4e3)

        for value, label in ticks(low[0], high[0], self.log[0]):
            at = round(float(place(np.array([value, low[1]]))[0]))
            inner[:, at] = DRAWING.grid
            write(paper, label, left + at, bottom, text, 0.5)
        for value, label in ticks(low[1], high[1], self.log[1]):
            at = round(float(place(np.array([low[0], value]))[1]))
            inner[at] = DRAWING.grid
            middle = top + at - text + 1
            write(paper, label, left - text // 3, middle, text, 1.0)
        cv2.rectangle(paper, (left, top), (right, bottom), DRAWING.frame, 1)
        write(paper, self.x_label, right, bottom + round(1.1 * text), text, 1.0)
        at = right - left - 2
        for name, x, y, colour in reversed(self.curves):
            _draw_curve(inner, place(self._points(x, y)), colour)
            if name:
                at -= write(inner, name, at, 0, text, 1.0, colour, on_white=True) + text
        write(inner, self.y_label, 3, 0, text, on_white=True)
        dots = []
        for x_of, y_of, colour in self.dots:
            spot = place(self._points(x_of, y_of)).astype(int).tolist()
            cv2.circle(inner, spot, text // 2, colour, -1, cv2.LINE_AA)
            dots.append((left + spot[0], top + spot[1]))
        return None, dots

    def _points(self, x: FloatArray | float, y: FloatArray | float) -> FloatArray:
        """What the axes measure, (..., 2): the values, or their logarithms."""
        points = np.stack([x, y], axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.log, np.log10(points), points)

    def _limits(self, shape: float) -> tuple[FloatArray, FloatArray]:
        """Least and greatest x and y; `shape` is how much longer the axis of x is."""
        shown: list[Any] = [self.fitted]
        if self.fitted is None:
            shown = [curve[1:3] for curve in self.curves]
        shown += [dot[:2] for dot in self.dots]
        parts = [np.empty((0, 2))]
        for x, y in shown:
            parts.append(self._points(x, y).reshape(-1, 2))
        points = np.concatenate(parts)
        points = points[np.isfinite(points).all(axis=-1)]
        if not len(points):
            points = np.array([[0.0, 0.0], [1.0, 1.0]])
        low = points.min(axis=0)
        high = points.max(axis=0)
        least = np.where(self.log, 0.1, 0.05 * np.abs(high) + 1e-3)
        half = np.maximum(0.58 * (high - low), least)
        if self.equal:
            half[1] = max(half[1], half[0] / shape)
            half[0] = half[1] * shape
        middle = (low + high) / 2
        return middle - half, middle + half


def _draw_curve(picture: Picture, points: FloatArray, colour: Colour) -> None:
    """Join points, (n, 2), px to the right and down, but for those that are nan."""
    known = np.isfinite(points).all(axis=-1)
    for run in np.ma.clump_unmasked(np.ma.masked_array(known, ~known)):
        sixteenths = np.round(16 * points[run]).astype(np.int32)
        cv2.polylines(picture, [sixteenths], False, colour, 2, cv2.LINE_AA, shift=4)
