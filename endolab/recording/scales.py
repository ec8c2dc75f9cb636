"""Colour scales and keys beside the maps of a recording: the viewer draws none of its own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from endolab.numerics.arrays import FloatArray
from endolab.plots.scales import blue_white_red

BANDS = 40  # of a scale: more are not told apart
APART, BROAD, RIGHT = 0.04, 0.05, 0.27  # of a map's width: to its scale, the scale, and all that they take
WORDS = (0.0, 0.45, 0.9)  # of a map's height: below these, what the scale's ends and middle mean
BELOW = 0.2  # of a map's height, that the key below it takes
KEY, EDGE = 0.27, 0.06  # of a section's size: how far its key is above it, and what is free around it
INK = (110, 110, 110)  # of words: legible on a light viewer and on a dark one
NO_DOT = rr.Radius.ui_points(0.0)


@dataclass(frozen=True)
class Limits:
    """What the colours of a run reach, by the iterate that it ended with."""

    near: float  # distance, in the run's unit
    far: float
    grey_levels: float  # of 255: model - frame

    @staticmethod
    def of(distance: NDArray[np.float32], misfit: NDArray[np.float32]) -> Limits:
        """Percentiles of a distance and a misfit, (h, w) each, grey levels; nan where left out."""
        near, far = np.percentile(distance[np.isfinite(distance)], [1, 99])
        worst = np.percentile(np.abs(misfit[np.isfinite(misfit)]), 98)
        return Limits(float(near), float(far), max(float(f"{worst:.2g}"), 1.0))  # less is but rounding

    @staticmethod
    def common(limits: Iterable[Limits]) -> Limits:
        """Limits that suit several runs."""
        near, far, grey_levels = zip(*((one.near, one.far, one.grey_levels) for one in limits), strict=True)
        return Limits(min(near), max(far), max(grey_levels))


def sequential(name: str) -> NDArray[np.uint8]:
    """Colours of the viewer's "viridis" or "magma" from low to high, (`BANDS`, 3)."""
    table = {"viridis": cv2.COLORMAP_VIRIDIS, "magma": cv2.COLORMAP_MAGMA}[name]
    steps = np.linspace(0, 255, BANDS).round().astype(np.uint8)
    return np.ascontiguousarray(cv2.applyColorMap(steps, table).reshape(BANDS, 3)[:, ::-1], np.uint8)


def diverging() -> NDArray[np.uint8]:
    """Colours of the residual from too dark to too bright, (`BANDS`, 3)."""
    return blue_white_red(np.linspace(-1, 1, BANDS))


def scale(
    shape: tuple[int, ...], colours: NDArray[np.uint8], low: float, high: float
) -> dict[str, rr.AsComponents]:
    """Draw a colour scale to the right of a map of that shape, with what its ends and its middle mean."""
    height, width = shape[:2]
    middle = width * (1 + APART + BROAD / 2)
    ends = pairwise(np.linspace(height, 0, len(colours) + 1))
    strips = [[[middle, first], [middle, second]] for first, second in ends]
    names = [f"{value:.3g}" for value in (high, (low + high) / 2, low)]
    places = [[width * (1 + RIGHT - 0.09), height * at] for at in WORDS]
    return {
        "bar": rr.LineStrips2D(strips, colors=colours, radii=width * BROAD / 2),
        "words": words(places, names),
    }


def key(shape: tuple[int, ...], colours: Mapping[str, tuple[int, int, int]]) -> dict[str, rr.AsComponents]:
    """Draw what the colours of a map of that shape mean, below it."""
    height, width = shape[:2]
    across = width * (np.arange(len(colours)) + 0.5) / len(colours)
    strips = [[[x - 0.1 * width, 1.05 * height], [x + 0.1 * width, 1.05 * height]] for x in across]
    bar = rr.LineStrips2D(strips, colors=list(colours.values()), radii=0.02 * height)
    return {"bar": bar, "words": words([[x, 1.07 * height] for x in across], list(colours))}


def words(places: Sequence[Sequence[float]], names: Sequence[str]) -> rr.Points2D:
    """Words, each below its place."""
    return rr.Points2D(places, labels=names, colors=INK, radii=NO_DOT, show_labels=True)


def box_of(lines: Iterable[FloatArray]) -> FloatArray:
    """Least and greatest of the points (m, 2) of lines, and of the camera at 0: (2, 2)."""
    points = np.concatenate([np.zeros((1, 2)), *lines])
    return np.stack([points.min(axis=0), points.max(axis=0)])


def cut(lines: Iterable[FloatArray], box: FloatArray) -> list[FloatArray]:
    """What of lines, (m, 2) each, lies within a box (2, 2) and what is free around it."""
    kept, box = [], box + EDGE * (box[1] - box[0]) * [[-1], [1]]
    for line in lines:
        inside = np.zeros(len(line) + 2, bool)
        inside[1:-1] = ((line >= box[0]) & (line <= box[1])).all(axis=1)
        ends = np.flatnonzero(inside[1:] != inside[:-1]).reshape(-1, 2)
        kept += [line[first:end] for first, end in ends if end - first > 1]
    return kept


def lines_key(box: FloatArray, colours: Mapping[str, tuple[int, ...]]) -> dict[str, rr.AsComponents]:
    """Name lines of these colours above the box (2, 2) of a section."""
    low, high = box
    width, height = high - low
    across, up = low[0] + width * (np.arange(len(colours)) + 0.1) / 3, low[1] - KEY * height
    strips = [[[x, up], [x + 0.1 * width, up]] for x in across]
    lines = rr.LineStrips2D(strips, colors=list(colours.values()), radii=rr.Radius.ui_points(2.0))
    return {"key": lines, "names": words([[x + 0.05 * width, up] for x in across], list(colours))}
