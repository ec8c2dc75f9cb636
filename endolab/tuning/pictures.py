"""Fast pictures: maps, a section and a curve drawn into one board of pixels, in milliseconds.

For what follows a hand on a slider; `plots` draws the same better and ten times more slowly.
Pictures are (H, W, 3) arrays of bytes, R, G, B.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from endolab.numerics.arrays import FloatArray
from endolab.plots.scales import blue_white_red, in_colour

Picture = NDArray[np.uint8]
Limits = tuple[float, float]
Curve = tuple[str, FloatArray, FloatArray]  # name, x, y

INK, LEFT_OUT = (34, 34, 34), (184, 184, 184)
COLOURS = {  # Okabe and Ito's, as in `plots`
    "truth": (0, 0, 0),
    "start": (86, 180, 233),
    "result": (213, 94, 0),
    "energy": (0, 0, 0),
    "data": (0, 114, 178),
    "regulariser": (213, 94, 0),
    "noise": (128, 128, 128),
    "A": (0, 158, 115),
    "B": (213, 94, 0),
}
MAPS = {"viridis": cv2.COLORMAP_VIRIDIS, "magma": cv2.COLORMAP_MAGMA}
QUALITY = 88  # of a JPEG


@dataclass(frozen=True)
class Look:
    """How large panels are: multiples of a map of 320 x 240 px with text of 12 px."""

    scale: float = 1.0
    bars: bool = True  # whether there is room for colour bars

    @property
    def width(self) -> int:
        """Of a map, px."""
        return round(320 * self.scale)

    @property
    def height(self) -> int:
        """Of a map, px."""
        return round(240 * self.scale)

    @property
    def text(self) -> int:
        """Size of letters, px: a small panel's remain readable."""
        return max(11, round(12 * self.scale))

    @property
    def edge(self) -> int:
        """Around a map, px."""
        return round(8 * self.scale)

    @property
    def bar(self) -> int:
        """For a map's colour bar, px."""
        return round(64 / 12 * self.text) if self.bars else self.edge

    @property
    def top(self) -> int:
        """For a title, px."""
        return round(26 / 12 * self.text)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of a panel, px."""
        return self.edge + self.width + self.bar, self.top + self.height + self.edge

    def fitted(self, shape: tuple[int, ...]) -> tuple[int, int]:
        """Width and height in its panel of a picture of so many rows and columns."""
        scale = min(self.width / shape[1], self.height / shape[0])
        return max(1, round(shape[1] * scale)), max(1, round(shape[0] * scale))


PLAIN = Look()


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
    picture: Picture, text: str, x: int, y: int, size: int, align: float = 0.0, colour: Sequence[int] = INK
) -> None:
    """Write a line of text into a picture; column x is its left end, or its right one for `align` 1."""
    ink = _written(text, size)
    x = max(0, int(x - align * ink.shape[1]))
    place = picture[max(0, y) : y + ink.shape[0], x : x + ink.shape[1]]
    ink = ink[: place.shape[0], : place.shape[1], None]
    place[:] = np.round(place * (1 - ink) + np.array(colour) * ink)


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


def ticks(low: float, high: float, count: int = 4) -> list[float]:
    """Round numbers in [low, high], about `count` of them."""
    span = high - low
    if not (np.isfinite(span) and span > 0):
        return [low]
    power = 10.0 ** np.floor(np.log10(span / count))
    step = min((factor * power for factor in (1, 2, 5, 10)), key=lambda step: abs(span / step - count))
    return [float(k * step) for k in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1)]


def panel(title: str, look: Look = PLAIN) -> Picture:
    """Return an empty panel with a title; the map's place begins at (look.top, look.edge)."""
    width, height = look.size
    paper = np.full((height, width, 3), 255, np.uint8)
    write(paper, title, look.edge, look.top // 13, look.text + 2)
    return paper


def map_panel(
    title: str,
    picture: Picture,
    limits: Limits | None = None,
    palette: str = "viridis",
    look: Look = PLAIN,
) -> Picture:
    """A picture of any size, fitted in under a title, and with a colour bar if there are limits."""
    paper, (width, height) = panel(title, look), picture.shape[1::-1]
    size = look.fitted(picture.shape)
    if size != (width, height):
        how = cv2.INTER_AREA if size[0] < width else cv2.INTER_LINEAR
        picture = cv2.resize(picture, size, interpolation=how).astype(np.uint8)
    top, text = look.top, look.text
    paper[top : top + size[1], look.edge : look.edge + size[0]] = picture
    if limits is not None:
        left, bottom, wide = look.edge + size[0] + text // 2, top + size[1], text
        scale_ = _palette(palette)[np.linspace(255, 0, size[1]).astype(int)]
        paper[top:bottom, left : left + wide] = scale_[:, None]
        for value in ticks(*limits):
            y = round(bottom - 1 - (value - limits[0]) / (limits[1] - limits[0]) * (size[1] - 1))
            paper[y, left + wide : left + wide + text // 3] = INK
            write(paper, f"{value:g}", left + wide + text // 2, y - text + 1, text)
    return paper


def key_panel(
    title: str,
    names: Sequence[str],
    picture: Picture,
    colours: Sequence[Sequence[int]],
    look: Look = PLAIN,
) -> Picture:
    """A picture of few colours, fitted in under a title, with what they mean in its lower left corner."""
    paper, height, text = map_panel(title, picture, look=look), look.fitted(picture.shape)[1], look.text
    line = round(20 / 12 * text)
    top, left = look.top + height - line * len(names) - text // 2, look.edge + text // 3
    for i, (name, colour) in enumerate(zip(names, colours, strict=True)):
        ink = _written(name, text).shape[1]
        y = top + line * i
        paper[y : y + line, left : left + 2 * text + ink] = 255
        paper[y + text // 3 : y + text // 3 + text, left + text // 3 : left + text // 3 + text] = colour
        write(paper, name, left + round(1.6 * text), y - 2, text)
    return paper


def cut_panel(paper: Picture, shape: tuple[int, ...], index: int, is_row: bool, look: Look = PLAIN) -> None:
    """Draw the line of a section into a panel that `map_panel` made of a picture of that shape."""
    width, height = look.fitted(shape)
    at = round((index + 0.5) * (height / shape[0] if is_row else width / shape[1]))
    ends = ((0, at), (width - 1, at)) if is_row else ((at, 0), (at, height - 1))
    (x0, y0), (x1, y1) = ((x + look.edge, y + look.top) for x, y in ends)
    cv2.line(paper, (x0, y0), (x1, y1), (0, 0, 0), 3, cv2.LINE_AA)
    cv2.line(paper, (x0, y0), (x1, y1), (255, 255, 255), 1, cv2.LINE_AA)


def _polyline(paper: Picture, x: FloatArray, y: FloatArray, colour: Sequence[int], thick: int) -> None:
    known = np.isfinite(x) & np.isfinite(y)
    for run in np.ma.clump_unmasked(np.ma.masked_array(known, ~known)):
        points = np.round(16 * np.stack([x[run], y[run]], axis=-1)).astype(np.int32)
        if len(points) == 1:
            cv2.circle(paper, tuple(map(int, points[0])), 48, tuple(colour), -1, cv2.LINE_AA, shift=4)
        cv2.polylines(paper, [points], False, tuple(colour), thick, cv2.LINE_AA, shift=4)


def curve_panel(
    title: str,
    curves: Sequence[Curve],
    x_label: str,
    y_label: str,
    *,
    log: bool = False,
    down: bool = False,
    x_limits: Limits | None = None,
    y_limits: Limits | None = None,
    look: Look = PLAIN,
) -> Picture:
    """Lines on axes with units; the names of `COLOURS` have colours of their own.

    `log` puts y on a logarithmic axis, without what is not positive; `down` lets it grow downwards,
    as in a picture. The limits are by default what the curves need.
    """
    paper, text = panel(title, look), look.text
    left, right = look.edge + round(3.8 * text), look.edge + look.width + round(3.3 * text)
    top, bottom = look.top + text // 3, look.top + look.height - round(2.7 * text)
    shown = [(name, np.asarray(x, float), np.asarray(y, float)) for name, x, y in curves]
    if log:
        shown = [(name, x, np.log10(np.where(y > 0, y, np.nan))) for name, x, y in shown]
    x_low, x_high = x_limits or _limits([x for _, x, _ in shown])
    y_low, y_high = y_limits or _limits([y for _, _, y in shown])
    if log:  # room for the names
        y_high += 0.15 * (y_high - y_low)

    def column(x: FloatArray | float) -> FloatArray:
        return np.asarray(left + (np.asarray(x) - x_low) / (x_high - x_low) * (right - left))

    def row(y: FloatArray | float) -> FloatArray:
        share = (np.asarray(y) - y_low) / (y_high - y_low)
        return np.asarray(top + (share if down else 1 - share) * (bottom - top))

    for value in ticks(x_low, x_high):
        at = int(column(value))
        paper[top:bottom, at] = 225
        write(paper, f"{value:g}", at, bottom, text, 0.5)
    for value in ticks(y_low, y_high):
        at = int(row(value))
        paper[at, left:right] = 225
        write(paper, f"{10**value:.2g}" if log else f"{value:g}", left - text // 3, at - text + 1, text, 1.0)
    cv2.rectangle(paper, (left, top), (right, bottom), (120, 120, 120), 1)
    write(paper, x_label, right, bottom + round(1.2 * text), text, 1.0)
    inner = paper[top : bottom + 1, left : right + 1]
    x_at = right - left - text // 3
    for name, x, y in shown:
        colour = COLOURS.get(name, INK)
        _polyline(inner, np.clip(column(x) - left, -4e3, 4e3), np.clip(row(y) - top, -4e3, 4e3), colour, 2)
    label = _written(y_label, text).shape[1]
    cv2.rectangle(inner, (1, 1), (label + text // 2, round(1.6 * text)), (255, 255, 255), -1)
    write(inner, y_label, text // 3, 0, text)
    at = 0 if log else bottom - top - round(1.8 * text)
    for name, _, _ in reversed(shown):
        ends = x_at - _written(name, text).shape[1] - 2, x_at + 2
        cv2.rectangle(inner, (ends[0], at + 2), (ends[1], at + round(1.6 * text)), (255, 255, 255), -1)
        write(inner, name, x_at, at, text, 1.0, COLOURS.get(name, INK))
        x_at -= _written(name, text).shape[1] + round(0.7 * text)
    return paper


def _limits(values: Sequence[FloatArray]) -> Limits:
    """Least and greatest, with a margin."""
    seen = np.concatenate([np.ravel(value) for value in values]) if values else np.zeros(1)
    seen = seen[np.isfinite(seen)]
    low, high = (float(seen.min()), float(seen.max())) if seen.size else (0.0, 1.0)
    margin = 0.05 * (high - low) or max(abs(low), 1.0) * 0.05
    return low - margin, high + margin


def board(rows: Sequence[Sequence[Picture]]) -> Picture:
    """Join panels of one size, row by row; missing ones are left white."""
    columns = max(len(row) for row in rows)
    blank = np.full_like(rows[0][0], 255)
    return np.concatenate([np.concatenate([*row, *[blank] * (columns - len(row))], axis=1) for row in rows])
