"""What a click on a map is for: the section, a mask's corner, or a length that is known."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import cv2
import ipywidgets as w
import numpy as np

from endolab.numerics.arrays import BoolArray
from endolab.preprocessing.frame import Frame
from endolab.tuning.controls import STYLE, button, choice

SECTION, MASK, DISTANCE, DIAMETER = (
    "lays the section",
    "draws the mask",
    "knows a distance",
    "knows a diameter",
)
NEEDED = {DISTANCE: 1, DIAMETER: 2}  # points
CLOSE = 0.03  # share of a map's width from a mask's first point, at which a click closes it


class Clicks:
    """The knobs that say what a click is for, and what was clicked.

    `lengths` are keywords of `reconstruct`; `changed` is called when there are others, `drawn` with a mask,
    `marked` with the points so far, shares of the map, and `said` with what is still to be done. `guarded`
    wraps what a knob does.
    """

    def __init__(
        self,
        guarded: Callable[[Callable[..., object]], Callable[..., None]],
        marked: Callable[[Sequence[tuple[float, float]]], object],
        drawn: Callable[[BoolArray], object],
        changed: Callable[[], object],
        forget: Callable[[], object],
        said: Callable[[str], object],
    ) -> None:
        self.lengths: dict[str, Any] = {}
        self._points: list[tuple[float, float]] = []
        self._frame: Frame | None = None  # that was clicked last
        self._marked, self._drawn, self._changed, self._said = marked, drawn, changed, said
        self.kind = choice("click", [SECTION, *(MASK, DISTANCE, DIAMETER)], "what a click on a map does")
        self.kind.observe(guarded(lambda _: self.restart()), "value")
        self.mm = w.BoundedFloatText(
            10.0, min=1e-3, max=1e4, description="mm", tooltip="the length that is known", style=STYLE
        )
        self.mm.layout.width = "auto"
        self.mm.observe(guarded(lambda _: self._measure()), "value")
        self.forget = button("forget mask and length", "as the frame came", guarded(lambda _: forget()))

    @property
    def knobs(self) -> list[w.Widget]:
        """All of them."""
        return [self.kind, self.mm, self.forget]

    def restart(self) -> None:
        """Forget the points, not what came of them."""
        self._points = []
        self._marked(self._points)

    def press(self, x: float, y: float, frame: Frame | None, is_seen: bool) -> None:
        """Take a point: shares of the map, and whether the surface is seen there."""
        if frame is None:
            raise ValueError("that is for a frame of your own: a scene knows its size and its mask")
        if self.kind.value != MASK and not is_seen:
            raise ValueError("no surface is seen there: click within the mask")
        self._frame = frame
        self._points.append((x, y))
        self._marked(self._points)
        if self.kind.value == MASK:
            first = self._points[0]
            if len(self._points) > 3 and math.hypot(x - first[0], y - first[1]) < CLOSE:
                self._drawn(frame.mask & _within(self._points[:-1], frame))
            else:
                self._said(f"{len(self._points)} points of the mask; click on the first to close it")
        elif len(self._points) < NEEDED[self.kind.value]:
            self._said("one end of the diameter; click on the other")
        else:
            self._measure()

    def _measure(self) -> None:
        """Take the length of what was clicked."""
        frame, needed = self._frame, NEEDED.get(self.kind.value, 0)
        if frame is None or not needed or len(self._points) < needed:
            return
        self._points = self._points[-needed:]
        pixels = [
            (round(x * frame.width - 0.5, 1), round(y * frame.height - 0.5, 1)) for x, y in self._points
        ]
        if self.kind.value == DISTANCE:
            self.lengths = {"known_distance": (self.mm.value, *pixels[0])}
        else:
            self.lengths = {"known_diameter": (self.mm.value, *pixels)}
        self._marked(self._points)
        self._changed()


def _within(corners: Sequence[tuple[float, float]], frame: Frame) -> BoolArray:
    """Pixels of a frame within these corners, shares of it."""
    inside = np.zeros(frame.mask.shape, np.uint8)
    pixels = np.array(corners) * (frame.width, frame.height) - 0.5
    cv2.fillPoly(inside, [np.round(pixels).astype(np.int32)], 1)
    return inside > 0
