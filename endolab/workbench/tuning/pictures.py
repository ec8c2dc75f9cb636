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
from endolab.workbench.plots.scales import (
    OKABE_ITO,
    Colour,
    blue_white_red,
    in_colour,
    round_length,
)

Picture = NDArray[np.uint8]
Limits = tuple[float, float]
Box = tuple[int, int, int, int]  # left, top, right, bottom, px


@dataclass(frozen=True)
class Drawing:
    """How fast pictures look; colours beside Okabe and Ito's, chosen by eye."""

    ink: Colour = (34, 34, 34)
    grid: Colour = (225, 225, 225)
    left_out: Colour = (184, 184, 184)
    below_noise: Colour = (236, 236, 236)  # of residuals that noise explains
    jpeg_quality: int = 88
    scale_width: int = 5  # of a colour bar with its numbers, in letters
    font_weight: int = 400


DRAWING = Drawing()
FONT = cv2.FontFace("sans")


def jpeg(picture: Picture) -> bytes:
    """Encode as JPEG."""
    return bytes(
        cv2.imencode(
            ".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, DRAWING.jpeg_quality]
        )[1]
    )


def png(picture: Picture) -> bytes:
    """Encode as PNG."""
    return bytes(cv2.imencode(".png", picture[..., ::-1])[1])


def write(
    picture: Picture,
    text: str,
    x: int,
    y: int,
    size: int,
    align: float = 0.0,
    colour: Colour = DRAWING.ink,
) -> int:
    """Write a line of text below y, and return its width; x is its left end, or its right for `align` 1."""
    wide: int = cv2.putText(
        np.zeros((1, 1, 3), np.uint8),
        text,
        (0, 0),
        DRAWING.ink,
        FONT,
        size,
        DRAWING.font_weight,
    )[0][0]
    left = max(0, int(x - align * wide))
    cv2.putText(
        picture, text, (left, y + int(1.4 * size)), colour, FONT, size, DRAWING.font_weight
    )
    return wide


def draw_label(
    picture: Picture,
    text: str,
    x: int,
    y: int,
    size: int,
    align: float = 0.0,
    colour: Colour = DRAWING.ink,
) -> int:
    """Write a line on white, and return its width, px."""
    wide = write(np.zeros((1, 1, 3), np.uint8), text, 0, 0, size)
    left = max(0, int(x - align * wide))
    picture[max(0, y + 2) : y + round(1.6 * size), left : left + wide + 2] = 255
    return write(picture, text, left, y, size, colour=colour)


@lru_cache(maxsize=4)
def _palette(name: str) -> Picture:
    if name == "diverging":
        return blue_white_red(np.linspace(-1, 1, 256))
    of_opencv = getattr(cv2, f"COLORMAP_{name.upper()}")
    scale = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], of_opencv)
    return np.ascontiguousarray(scale[:, 0, ::-1])


def to_colours(values: FloatArray, limits: Limits, palette: str = "viridis") -> Picture:
    """Colour a map, (H, W): "viridis", "magma" or "diverging" between the limits, grey where it is nan."""
    low, high = limits
    known = np.isfinite(values)
    share = (np.where(known, values, low) - low) / (high - low)
    colours = _palette(palette)[np.clip(255 * share, 0, 255).astype(np.uint8)]
    colours[~known] = DRAWING.left_out
    return colours


def grey_or_colour(image: FloatArray) -> Picture:
    """Show values in [0, 1], (H, W) or (H, W, 3); nan is grey."""
    shown = in_colour(image)
    known = np.isfinite(shown).all(axis=-1, keepdims=True)
    bytes_ = np.round(255 * np.clip(np.where(known, shown, 0), 0, 1)).astype(np.uint8)
    return np.where(known, bytes_, np.array(DRAWING.left_out, np.uint8))


def ticks(low: float, high: float) -> list[float]:
    """Round numbers in [low, high], three to eight of them."""
    step = round_length((high - low) / 3)
    return [
        float(k * step)
        for k in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1)
    ]


def log_ticks(low: float, high: float) -> list[float]:
    """Logarithms, in [low, high], of 1, 2 and 5 times powers of ten, or of round numbers if they are few."""
    powers = range(int(np.floor(low)), int(np.ceil(high)))
    values = [float(np.log10(factor) + power) for power in powers for factor in (1, 2, 5)]
    values = [value for value in values if low <= value <= high]
    return (
        values
        if len(values) > 1
        else [float(np.log10(value)) for value in ticks(10**low, 10**high)]
    )


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
        room = right - left - (DRAWING.scale_width * text if self.limits else 0)
        scale = max(min(room / width, (bottom - top) / height), 1 / min(width, height))
        wide = max(1, round(width * scale))
        tall = max(1, round(height * scale))
        left += (room - wide) // 2
        interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        shown = cv2.resize(self.picture, (wide, tall), interpolation=interpolation)
        place = paper[top : top + tall, left : left + wide]
        place[:] = shown[: place.shape[0], : place.shape[1]]
        if self.line is not None:
            _cut(place, *self.line)
        for number, (name, colour) in enumerate(reversed(self.keys)):
            y = place.shape[0] - round(1.6 * text) * (number + 1)
            draw_label(place, name, round(1.6 * text), y, text)
            place[max(0, y + 4) : y + text + 2, 3 : text + 1] = colour
        if self.limits is not None:
            scale_bar(
                paper[top : top + tall],
                left + wide + text // 2,
                self.limits,
                self.palette,
                text,
            )
        return (left, top, left + wide, top + tall), []


def scale_bar(paper: Picture, left: int, limits: Limits, palette: str, text: int) -> None:
    """Draw a colour bar with its numbers, as high as the paper."""
    tall = paper.shape[0]
    paper[:, left : left + text] = _palette(palette)[np.linspace(255, 0, tall).astype(int)][
        :, None
    ]
    for value in ticks(*limits):
        y = round((1 - (value - limits[0]) / (limits[1] - limits[0])) * (tall - 1))
        paper[y, left + text : left + text + text // 3] = DRAWING.ink
        write(
            paper,
            f"{value:g}",
            left + text + text // 2,
            max(0, min(y - text + 1, tall - 2 * text)),
            text,
        )


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
        left = left + round(3.6 * text)
        right = right - text // 2
        bottom = bottom - round(2.4 * text)
        size = np.array([right - left, max(bottom - top, 1)])
        middle, half = self._limits(size[0] / size[1])
        low = middle - half
        high = middle + half

        def place(points: FloatArray) -> FloatArray:
            """To the right and down, px."""
            share = (points - low) / (high - low)
            if not self.down:
                share[..., 1] = 1 - share[..., 1]
            return np.clip(share * size, -4e3, 4e3)

        inner = paper[top : bottom + 1, left : right + 1]
        for axis, log in enumerate(self.log):
            for value in (log_ticks if log else ticks)(float(low[axis]), float(high[axis])):
                at = round(float(place(np.where(np.arange(2) == axis, value, low))[axis]))
                label = f"{10**value:.2g}" if log else f"{value:g}"
                if axis == 0:
                    inner[:, at] = DRAWING.grid
                    write(paper, label, left + at, bottom, text, 0.5)
                else:
                    inner[at] = DRAWING.grid
                    write(paper, label, left - text // 3, top + at - text + 1, text, 1.0)
        cv2.rectangle(paper, (left, top), (right, bottom), (120, 120, 120), 1)
        write(paper, self.x_label, right, bottom + round(1.1 * text), text, 1.0)
        at = right - left - 2
        for name, x, y, colour in reversed(self.curves):
            points = place(self._points(x, y))
            known = np.isfinite(points).all(axis=-1)
            for run in np.ma.clump_unmasked(np.ma.masked_array(known, ~known)):
                whole = np.round(16 * points[run]).astype(np.int32)
                cv2.polylines(inner, [whole], False, tuple(colour), 2, cv2.LINE_AA, shift=4)
            if name:
                at -= draw_label(inner, name, at, 0, text, 1.0, colour) + text
        draw_label(inner, self.y_label, 3, 0, text)
        dots = []
        for x_of, y_of, colour in self.dots:
            right_of, down_of = (int(pixel) for pixel in place(self._points(x_of, y_of)))
            cv2.circle(
                inner, (right_of, down_of), text // 2, tuple(colour), -1, cv2.LINE_AA
            )
            dots.append((left + right_of, top + down_of))
        return None, dots

    def _points(self, x: FloatArray | float, y: FloatArray | float) -> FloatArray:
        """What the axes measure, (..., 2): the values, or their logarithms."""
        points = np.stack([np.asarray(x, float), np.asarray(y, float)], axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.log, np.log10(points), points)

    def _limits(self, shape: float) -> tuple[FloatArray, FloatArray]:
        """Middle of both axes and half of their lengths, of which one may be `shape` times the other."""
        curves: list[tuple[Any, Any]] = [(x, y) for _, x, y, _ in self.curves]
        given = curves if self.fitted is None else [self.fitted]
        dots = [self._points(x, y)[None] for x, y, _ in self.dots]
        points = np.concatenate(
            [np.empty((0, 2)), *(self._points(x, y) for x, y in given), *dots]
        )
        points = points[np.isfinite(points).all(axis=-1)]
        low, high = (
            (points.min(axis=0), points.max(axis=0))
            if len(points)
            else (np.zeros(2), np.ones(2))
        )
        half = 0.58 * (high - low)
        half = np.where(half > 0, half, 0.05 * np.maximum(np.abs(low), 1))
        half = np.where(self.log, np.maximum(half, 0.1), half)
        if self.equal:
            half[1] = max(half[1], half[0] / shape)
            half[0] = half[1] * shape
        return (low + high) / 2, half
