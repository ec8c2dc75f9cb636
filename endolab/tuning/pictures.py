"""Fast pictures: maps and charts drawn into cells of pixels, in milliseconds.

For what follows a hand on a slider; `plots` draws the same better and ten times more slowly.
Pictures are (H, W, 3) arrays of bytes, R, G, B.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from endolab.numerics.arrays import FloatArray
from endolab.plots.scales import blue_white_red, in_colour, round_length

Picture = NDArray[np.uint8]
Limits = tuple[float, float]
Box = tuple[int, int, int, int]  # left, top, right, bottom, px
Colour = Sequence[int]

INK, PALE, LEFT_OUT = (34, 34, 34), (225, 225, 225), (184, 184, 184)
# Okabe and Ito's, as in `plots`.
BLACK, SKY, VERMILION, BLUE, GREEN = (0, 0, 0), (86, 180, 233), (213, 94, 0), (0, 114, 178), (0, 158, 115)
MAPS = {"viridis": cv2.COLORMAP_VIRIDIS, "magma": cv2.COLORMAP_MAGMA}
QUALITY = 88  # of a JPEG


def jpeg(picture: Picture) -> bytes:
    """Encode as JPEG."""
    return bytes(cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1])


def png(picture: Picture) -> bytes:
    """Encode as PNG."""
    return bytes(cv2.imencode(".png", picture[..., ::-1])[1])


@lru_cache(maxsize=512)
def _written(text: str, size: int) -> FloatArray:
    """How much ink each pixel of a text has, in [0, 1]; a text is drawn once."""
    face = cv2.FontFace("sans")
    canvas = np.zeros((2 * size, size * (len(text) + 2)), np.uint8)
    cv2.putText(canvas, text, (2, int(1.4 * size)), (255, 255, 255), face, size, 400)
    used = np.flatnonzero(canvas.any(axis=0))
    return canvas[:, : used[-1] + 2 if used.size else 1] / 255.0


def write(
    picture: Picture, text: str, x: int, y: int, size: int, align: float = 0.0, colour: Colour = INK
) -> None:
    """Write a line of text into a picture; column x is its left end, or its right one for `align` 1."""
    ink = _written(text, size)
    x = max(0, int(x - align * ink.shape[1]))
    place = picture[max(0, y) : y + ink.shape[0], x : x + ink.shape[1]]
    ink = ink[: place.shape[0], : place.shape[1], None]
    place[:] = np.round(place * (1 - ink) + np.array(colour) * ink)


def labelled(
    picture: Picture, text: str, x: int, y: int, size: int, align: float = 0.0, colour: Colour = INK
) -> int:
    """Write a line on white, and return its width, px."""
    wide = _written(text, size).shape[1]
    left = max(0, int(x - align * wide))
    picture[max(0, y + 2) : y + round(1.6 * size), left : left + wide + 2] = 255
    write(picture, text, x, y, size, align, colour)
    return wide


@lru_cache(maxsize=4)
def _palette(name: str) -> Picture:
    if name in MAPS:
        scale = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], MAPS[name])
        return np.ascontiguousarray(scale[:, 0, ::-1])
    return blue_white_red(np.linspace(-1, 1, 256))


def coloured(values: FloatArray, limits: Limits, palette: str = "viridis") -> Picture:
    """Colour a map, (H, W): "viridis", "magma" or "diverging" between the limits, grey where it is nan."""
    low, high = limits
    known = np.isfinite(values)
    share = (np.where(known, values, low) - low) / max(high - low, 1e-12)
    colours = _palette(palette)[np.clip(255 * share, 0, 255).astype(np.uint8)]
    colours[~known] = LEFT_OUT
    return colours


def grey_or_colour(image: FloatArray) -> Picture:
    """Show values in [0, 1], (H, W) or (H, W, 3); nan is grey."""
    shown = in_colour(image)
    known = np.isfinite(shown).all(axis=-1, keepdims=True)
    bytes_ = np.round(255 * np.clip(np.where(known, shown, 0), 0, 1)).astype(np.uint8)
    return np.where(known, bytes_, np.array(LEFT_OUT, np.uint8))


def ticks(low: float, high: float) -> list[float]:
    """Round numbers in [low, high], three to eight of them."""
    if not (np.isfinite(high - low) and high > low):
        return [low]
    step = round_length((high - low) / 3)
    return [float(k * step) for k in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1)]


def log_ticks(low: float, high: float) -> list[float]:
    """Logarithms, in [low, high], of 1, 2 and 5 times powers of ten, or of round numbers if they are few."""
    powers = range(int(np.floor(low)), int(np.ceil(high)))
    found = [float(np.log10(factor) + power) for power in powers for factor in (1, 2, 5)]
    found = [one for one in found if low <= one <= high]
    return found if len(found) > 1 else [float(np.log10(one)) for one in ticks(10**low, 10**high)]


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
        room = right - left - (5 * text if self.limits else 0)
        scale = max(min(room / width, (bottom - top) / height), 1 / min(width, height))
        wide, tall = max(1, round(width * scale)), max(1, round(height * scale))
        left += (room - wide) // 2
        how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        shown = cv2.resize(self.picture, (wide, tall), interpolation=how)
        place = paper[top : top + tall, left : left + wide]
        place[:] = shown[: place.shape[0], : place.shape[1]]
        if self.line is not None:
            _cut(place, *self.line)
        for number, (name, colour) in enumerate(reversed(self.keys)):
            y = place.shape[0] - round(1.6 * text) * (number + 1)
            labelled(place, name, round(1.6 * text), y, text)
            place[max(0, y + 4) : y + text + 2, 3 : text + 1] = colour
        if self.limits is not None:
            scale_bar(paper[top : top + tall], left + wide + text // 2, self.limits, self.palette, text)
        return (left, top, left + wide, top + tall), []


def scale_bar(paper: Picture, left: int, limits: Limits, palette: str, text: int) -> None:
    """Draw a colour bar with its numbers, as high as the paper."""
    tall = paper.shape[0]
    paper[:, left : left + text] = _palette(palette)[np.linspace(255, 0, tall).astype(int)][:, None]
    for value in ticks(*limits):
        y = round((1 - (value - limits[0]) / (limits[1] - limits[0])) * (tall - 1))
        paper[y, left + text : left + text + text // 3] = INK
        write(paper, f"{value:g}", left + text + text // 2, max(0, min(y - text + 1, tall - 2 * text)), text)


def _cut(picture: Picture, is_row: bool, share: float) -> None:
    """Draw where the section lies."""
    lines = picture if is_row else picture.swapaxes(0, 1)
    at = min(int(share * len(lines)), len(lines) - 1)
    lines[max(0, at - 1) : at + 2] = BLACK
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
    dots: Sequence[tuple[float, float, Colour, bool]] = ()
    log: tuple[bool, bool] = (False, False)
    down: bool = False
    equal: bool = False
    fitted: tuple[FloatArray, FloatArray] | None = None  # x and y that set the limits

    def draw(self, paper: Picture, text: int) -> tuple[None, list[tuple[int, int]]]:
        """Draw it into a white cell with letters of so many px, and tell where in the cell the dots are."""
        left, top, right, bottom = _room(paper, self.title, text)
        left, right, bottom = left + round(3.6 * text), right - text // 2, bottom - round(2.4 * text)
        limits = self._limits((right - left) / max(bottom - top, 1))
        (x_low, x_high), (y_low, y_high) = limits

        def place(x: FloatArray | float, y: FloatArray | float) -> tuple[FloatArray, FloatArray]:
            x, y = self._scaled(x, y)
            share = (y - y_low) / (y_high - y_low)
            column = (x - x_low) / (x_high - x_low) * (right - left)
            row = (share if self.down else 1 - share) * (bottom - top)
            return np.clip(column, -4e3, 4e3), np.clip(row, -4e3, 4e3)

        inner = paper[top : bottom + 1, left : right + 1]
        for value in (log_ticks if self.log[0] else ticks)(x_low, x_high):
            at = round((value - x_low) / (x_high - x_low) * (right - left))
            inner[:, at] = PALE
            write(paper, _number(value, self.log[0]), left + at, bottom, text, 0.5)
        for value in (log_ticks if self.log[1] else ticks)(y_low, y_high):
            share = (value - y_low) / (y_high - y_low)
            at = round((share if self.down else 1 - share) * (bottom - top))
            inner[at] = PALE
            write(paper, _number(value, self.log[1]), left - text // 3, top + at - text + 1, text, 1.0)
        cv2.rectangle(paper, (left, top), (right, bottom), (120, 120, 120), 1)
        write(paper, self.x_label, right, bottom + round(1.1 * text), text, 1.0)
        at = right - left - 2
        for name, x, y, colour in reversed(self.curves):
            _polyline(inner, *place(x, y), colour)
            if name:
                at -= labelled(inner, name, at, 0, text, 1.0, colour) + text
        labelled(inner, self.y_label, 3, 0, text)
        dots = []
        for x_of, y_of, colour, filled in self.dots:
            spot = tuple(int(one) for one in place(x_of, y_of))
            cv2.circle(inner, spot, text // 2, tuple(colour), -1 if filled else 2, cv2.LINE_AA)
            dots.append((left + spot[0], top + spot[1]))
        return None, dots

    def _scaled(self, x: FloatArray | float, y: FloatArray | float) -> tuple[FloatArray, FloatArray]:
        """What the axes measure: the values, or their logarithms."""
        pair = [np.asarray(value, float) for value in (x, y)]
        for number, log in enumerate(self.log):
            if log:
                pair[number] = np.log10(np.where(pair[number] > 0, pair[number], np.nan))
        return pair[0], pair[1]

    def _limits(self, shape: float) -> tuple[Limits, Limits]:
        """Ends of both axes, of which one may be `shape` times as long as the other."""
        curves: list[tuple[Any, Any]] = [(x, y) for _, x, y, _ in self.curves]
        if self.fitted is not None:
            curves = [self.fitted]
        dots: list[tuple[Any, Any]] = [(x, y) for x, y, _, _ in self.dots]
        pairs = [self._scaled(x, y) for x, y in curves + dots]
        ends = []
        for axis in (0, 1):
            values = np.concatenate([np.empty(0), *(np.ravel(pair[axis]) for pair in pairs)])
            values = values[np.isfinite(values)]
            low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
            half = 0.58 * (high - low) or 0.05 * max(abs(low), 1.0)
            half = max(half, 0.1) if self.log[axis] else half
            ends.append(((low + high) / 2, half))
        (x, wide), (y, tall) = ends
        if self.equal:
            tall = max(tall, wide / shape)
            wide = tall * shape
        return (x - wide, x + wide), (y - tall, y + tall)


def _number(value: float, log: bool) -> str:
    return f"{10**value:.2g}" if log else f"{value:g}"


def _polyline(paper: Picture, x: FloatArray, y: FloatArray, colour: Colour) -> None:
    known = np.isfinite(x) & np.isfinite(y)
    for run in np.ma.clump_unmasked(np.ma.masked_array(known, ~known)):
        points = np.round(16 * np.stack([x[run], y[run]], axis=-1)).astype(np.int32)
        cv2.polylines(paper, [points], False, tuple(colour), 2, cv2.LINE_AA, shift=4)
