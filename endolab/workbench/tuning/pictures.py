"""Fast pictures: maps and charts drawn into cells of pixels, in milliseconds.

For what follows a hand on a slider; `plots` draws the same better and ten times more slowly.
Pictures are (H, W, 3) arrays of bytes, R, G, B.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

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
    isoline_levels,
)

Picture = NDArray[np.uint8]
Limits = tuple[float, float]
Box = tuple[int, int, int, int]  # left, top, right, bottom, px
Curve = tuple[str, FloatArray, FloatArray, Colour]  # its name, x, y
Given = TypeVar("Given")
Made = TypeVar("Made")
Window = tuple[float, float, float, float]  # the same, as shares of a picture
WHOLE: Window = (0.0, 0.0, 1.0, 1.0)


@dataclass(frozen=True)
class Drawing:
    """How fast pictures look; colours beside Okabe and Ito's, chosen by eye."""

    paper: int = 255
    ink: Colour = (34, 34, 34)
    grid: Colour = (225, 225, 225)
    frame: Colour = (120, 120, 120)
    left_out: Colour = (160, 160, 160)
    below_noise: Colour = (236, 236, 236)  # of residuals that noise explains
    jpeg_quality: int = 88
    scale_width: int = 5  # of a colour bar with its numbers, in letters
    font_weight: int = 400


DRAWING = Drawing()
DARK = Drawing(paper=25, ink=(224, 224, 224), grid=(58, 60, 64), frame=(130, 130, 130))
LEFT_OUT: Any = tuple(np.divide(DRAWING.left_out, 255))
FONT = cv2.FontFace("sans")


def jpeg(picture: Picture) -> bytes:
    """Encode as JPEG."""
    options = [cv2.IMWRITE_JPEG_QUALITY, DRAWING.jpeg_quality]
    encoded = cv2.imencode(".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), options)[1]
    return encoded.tobytes()


def write(
    picture: Picture,
    text: str,
    x: int,
    y: int,
    size: int,
    colour: Colour,
    align: float = 0.0,
    paper: int | None = None,
) -> int:
    """Write a line of text below y, and return its width; x is its left end, or its right for `align` 1.

    If a colour of paper is given, the text covers what is below it.
    """
    weight = DRAWING.font_weight
    wide: int = cv2.getTextSize((0, 0), text, (0, 0), FONT, size, weight)[2]
    left = max(0, int(x - align * wide))
    if paper is not None:
        bottom = y + round(1.6 * size)
        picture[max(0, y + 2) : bottom, left : left + wide + 2] = paper
    base = left, y + int(1.4 * size)
    cv2.putText(picture, text, base, colour, FONT, size, weight)
    return wide


def to_colours(
    values: FloatArray, limits: Limits, palette: str = "viridis", log: bool = False
) -> Picture:
    """Colour a map, (H, W): Matplotlib's colours between the limits, grey where it is nan."""
    colours = colormaps[palette].with_extremes(bad=LEFT_OUT)
    low, high = limits
    if log:
        values, low, high = np.log(values), np.log(low), np.log(high)
    shares = (values - low) / (high - low)
    return np.ascontiguousarray(colours(shares, bytes=True)[..., :3])


def remember(make: Callable[[Given], Made]) -> Callable[[Given], Made]:
    """Make a function give again what it made of the same array the last time."""
    last: list[tuple[Given, Made]] = []

    def give(array: Given) -> Made:
        for known, made in last:
            if known is array:
                return made
        last[:] = [(array, make(array))]
        return last[0][1]

    return give


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


def _room(paper: Picture, title: str, text: int, look: Drawing) -> Box:
    """Write a title into a cell, and tell what is left below it."""
    edge = text // 2
    write(paper, title, edge, 0, text + 1, look.ink)
    return edge, 2 * text, paper.shape[1] - edge, paper.shape[0] - edge


def pixels(window: Window, shape: Sequence[int]) -> tuple[slice, slice]:
    """Rows and columns that a window touches."""
    left, top, right, bottom = window

    def part(low: float, high: float, size: int) -> slice:
        return slice(int(low * size + 1e-6), int(np.ceil(high * size - 1e-6)))

    return part(top, bottom, shape[0]), part(left, right, shape[1])


@dataclass(frozen=True)
class Drawn:
    """What was drawn, where it lies in its cell, px to the right and down."""

    spot: Box | None = None  # of a map
    dots: Sequence[tuple[int, int]] = ()  # of a chart
    # From what a chart's axes measure, (..., 2), to its place.
    place: Callable[[FloatArray], FloatArray] | None = None


@dataclass(frozen=True)
class Map:
    """A picture with a title, which fills its cell, with a colour bar if there are limits.

    `keys` say what colours mean, `line` is a row (True) or column and its share of the picture, and `says`
    tells what is known of a pixel. `distance`, (H, W), gives the map isolines, and a logarithmic colour bar
    with their numbers. Without a picture, its place is left free.
    """

    title: str
    picture: Picture | None
    limits: Limits | None = None
    palette: str = "viridis"
    keys: Sequence[tuple[str, Colour]] = ()
    line: tuple[bool, float] | None = None
    says: Callable[[int, int], str] | None = None
    distance: FloatArray | None = None
    window: Window = WHOLE  # the part that is asked for
    has_scale: bool = True  # beside it

    def draw(self, paper: Picture, text: int, look: Drawing = DRAWING) -> Drawn:
        """Draw it into an empty cell with letters of so many px."""
        left, top, right, bottom = _room(paper, self.title, text, look)
        if self.picture is None:
            return Drawn((left, top, right, bottom))
        part = pixels(self.window, self.picture.shape)
        picture = self.picture[part]
        height, width = picture.shape[:2]
        room = right - left
        scaled = self.limits is not None and self.has_scale
        if scaled:
            room -= look.scale_width * text
        scale = min(room / width, (bottom - top) / height)
        wide = max(1, round(width * scale))
        tall = max(1, round(height * scale))
        left += (room - wide) // 2
        interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_NEAREST
        if 1 < scale < 4:  # larger pixels are looked at one by one
            interpolation = cv2.INTER_LINEAR
        place = paper[top : top + tall, left : left + wide]
        place[:] = cv2.resize(picture, (wide, tall), interpolation=interpolation)
        if self.distance is not None and self.limits is not None:
            _draw_isolines(place, self.distance[part], isoline_levels(*self.limits))
        if self.line is not None:
            self._draw_line(place, *self.line)
        for number, (name, colour) in enumerate(reversed(self.keys)):
            y = place.shape[0] - round(1.6 * text) * (number + 1)
            write(place, name, round(1.6 * text), y, text, look.ink, paper=look.paper)
            place[max(0, y + 4) : y + text + 2, 3 : text + 1] = colour
        if scaled:
            self.draw_scale(paper[top : top + tall, left + wide + text // 2 :], text, look)
        return Drawn((left, top, left + wide, top + tall))

    def draw_scale(self, paper: Picture, text: int, look: Drawing) -> None:
        """Draw the colour bar with its numbers at the left of the paper, as high as it is."""
        assert self.limits is not None
        tall = len(paper)
        low, high = self.limits
        marks = ticks(low, high)
        shares = np.linspace(1, 0, tall)[:, None]
        scale = low + shares * (high - low)
        if self.distance is not None:
            marks = [(value, f"{value:g}") for value in isoline_levels(low, high).tolist()]
            scale = low * (high / low) ** shares
        paper[:, :text] = to_colours(
            scale, self.limits, self.palette, self.distance is not None
        )
        above = tall
        for value, label in marks:
            y = int(np.argmin(np.abs(scale - value)))
            paper[y, text : text + text // 3] = look.ink
            middle = max(0, min(y - text + 1, tall - 2 * text))
            if middle + text < above:
                write(paper, label, text + text // 2, middle, text, look.ink)
                above = middle

    def _draw_line(self, place: Picture, is_row: bool, share: float) -> None:
        """Draw where the section lies, in the colour of its curve."""
        low, high = self.window[1::2] if is_row else self.window[::2]
        lines = place if is_row else place.swapaxes(0, 1)
        at = int((share - low) / (high - low) * len(lines))
        if 0 <= at <= len(lines):
            at = min(at, len(lines) - 1)
            lines[max(0, at - 2) : at + 3] = 255
            lines[max(0, at - 1) : at + 2] = OKABE_ITO.vermilion


def _draw_isolines(place: Picture, distance: FloatArray, levels: FloatArray) -> None:
    """Draw where a map, which the place shows, crosses levels."""
    known = np.isfinite(distance)
    size = place.shape[1::-1]
    filled = np.where(known, distance, 0).astype(np.float32)
    fine = cv2.resize(filled, size, interpolation=cv2.INTER_LINEAR)
    inside = cv2.resize(known.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    reach = (
        2 * round(size[0] / distance.shape[1]) + 1
    )  # px, of what is interpolated with nothing
    inside = cv2.erode(inside, np.ones((reach, reach), np.uint8), borderValue=1)
    band = np.searchsorted(levels, fine)
    crossed = np.zeros(band.shape, bool)
    crossed[:, 1:] = band[:, 1:] != band[:, :-1]
    crossed[1:] |= band[1:] != band[:-1]
    crossed &= inside > 0
    place[crossed] = (0.35 * place[crossed] + 0.65 * 255).astype(np.uint8)


@dataclass(frozen=True)
class Dot:
    """A dot of a chart: where, its colour, what is written beside it, and what a click brings."""

    x: float
    y: float
    colour: Colour
    label: str = ""
    brings: Any = None


@dataclass(frozen=True)
class Chart:
    """Curves, (name, x, y, colour), and dots, on axes with units.

    `log` says which axes, x and y, are logarithmic, `down` lets y grow downwards, as in a picture, and
    `equal` gives both axes one scale, so that angles are angles. Limits are what is drawn needs, or `fitted`.
    `y_ticks` say which numbers stand at the left and where, `right` which at the right. `locate` tells where
    the point of a pixel lies.
    """

    title: str
    x_label: str
    y_label: str
    curves: Sequence[Curve] = ()
    guides: Sequence[tuple[FloatArray, FloatArray]] = ()  # thin lines, x and y
    dots: Sequence[Dot] = ()
    log: tuple[bool, bool] = (False, False)
    down: bool = False
    equal: bool = False
    fitted: tuple[FloatArray, FloatArray] | None = None  # x and y that set the limits
    y_ticks: Sequence[tuple[float, str]] | None = None
    right: Sequence[tuple[float, str]] | None = None
    locate: Callable[[int, int], FloatArray] | None = None

    def draw(self, paper: Picture, text: int, look: Drawing = DRAWING) -> Drawn:
        """Draw it into an empty cell with letters of so many px."""
        left, top, right, bottom = _room(paper, self.title, text, look)
        left += round(3.6 * text)
        right -= text // 2 if self.right is None else 3 * text
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

        end = 0.0
        for value, label in ticks(low[0], high[0], self.log[0]):
            at = round(float(place(np.array([value, low[1]]))[0]))
            inner[:, at] = look.grid
            half = 0.3 * text * (len(label) + 1)
            if left + at - half > end:
                write(paper, label, left + at, bottom, text, look.ink, 0.5)
                end = left + at + half
        marks = self.y_ticks
        if marks is None:
            marks = ticks(low[1], high[1], self.log[1])

        def number(marks: Sequence[tuple[float, str]], x: int, align: float) -> list[int]:
            """Write the numbers of an axis, but for those that would overlap; return where they are."""
            rows: list[int] = []
            for value, label in marks:
                at = round(float(place(np.array([low[0], value]))[1]))
                if 0 <= at <= size[1] and all(abs(at - row) > 1.2 * text for row in rows):
                    write(paper, label, x, top + at - text + 1, text, look.ink, align)
                    rows.append(at)
            return rows

        inner[number(marks, left - text // 3, 1.0)] = look.grid
        if self.right is not None:
            number(self.right, right + text // 3, 0.0)
        cv2.rectangle(paper, (left, top), (right, bottom), look.frame, 1)
        below = bottom + round(1.1 * text)
        write(paper, self.x_label, right, below, text, look.ink, 1.0)
        for x, y in self.guides:
            _draw_curve(inner, place(self._points(x, y)), OKABE_ITO.green, 1)
        at = right - left - 2
        for name, x, y, colour in reversed(self.curves):
            shown = look.ink if colour == OKABE_ITO.black else colour
            _draw_curve(inner, place(self._points(x, y)), shown)
            if name:
                at -= write(inner, name, at, 0, text, shown, 1.0, look.paper) + text
        write(inner, self.y_label, 3, 0, text, look.ink, paper=look.paper)
        dots = []
        for dot in self.dots:
            x, y = place(self._points(dot.x, dot.y)).astype(int).tolist()
            cv2.circle(inner, (x, y), text // 2, dot.colour, -1, cv2.LINE_AA)
            if dot.label:
                write(inner, dot.label, x, y + text // 4, text, look.ink, 0.5)
            dots.append((left + x, top + y))
        corner = np.array([left, top])
        return Drawn(None, dots, lambda points: place(points) + corner)

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
            shown += [(dot.x, dot.y) for dot in self.dots]
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


def _draw_curve(
    picture: Picture, points: FloatArray, colour: Colour, width: int = 2
) -> None:
    """Join points, (n, 2), px to the right and down, but for those that are nan."""
    known = np.isfinite(points).all(axis=-1)
    for run in np.ma.clump_unmasked(np.ma.masked_array(known, ~known)):
        sixteenths = np.round(16 * points[run]).astype(np.int32)
        cv2.polylines(picture, [sixteenths], False, colour, width, cv2.LINE_AA, shift=4)
