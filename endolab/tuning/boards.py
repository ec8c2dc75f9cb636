"""Panels that fill a board: of one answer, of two to be compared, of several in columns on one scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from endolab.tuning.engine import Answer
from endolab.tuning.panels import PANELS, Panel, View, ratio_of
from endolab.tuning.pictures import Box, Map, Picture

COLUMNS = 3
ROWS = ("distance", "model - frame", "section")  # of answers that are compared
Rows = Sequence[Sequence[tuple[Panel, Answer] | None]]


@dataclass(frozen=True)
class Place:
    """A panel on a board."""

    answer: Answer
    box: Box  # of the panel, px
    spot: Box | None  # of its map, if it is one
    panel: Panel
    dots: Sequence[tuple[int, int]] = ()  # of a chart, px

    def says(self, x: float, y: float) -> str:
        """What it says at a point of its map: shares to the right and down, in [0, 1]."""
        if not isinstance(self.panel, Map) or self.panel.says is None:
            return ""
        mask = self.answer.result.mask
        i, j = (min(int(share * size), size - 1) for share, size in zip((y, x), mask.shape, strict=True))
        return self.panel.says(i, j) if mask[i, j] else "left out"


@dataclass(frozen=True)
class Board:
    """A picture of panels, and where they are in it; points of it are shares to the right and down."""

    picture: Picture
    places: list[Place]

    def shares(self, box: Box) -> list[float]:
        """A box as shares of the board."""
        height, width = self.picture.shape[:2]
        return [one / size for one, size in zip(box, (width, height) * 2, strict=True)]

    def at(self, x: float, y: float) -> Place | None:
        """The panel at a point."""
        height, width = self.picture.shape[:2]
        for place in self.places:
            left, top, right, bottom = place.box
            if left <= x * width < right and top <= y * height < bottom:
                return place
        return None

    def cells(self, names: Sequence[str]) -> list[dict[str, Any]]:
        """What the page is told of the panels, which may have names."""
        names = names or [""] * len(self.places)
        return [
            {"box": self.shares(place.box), "spot": place.spot and self.shares(place.spot), "name": name}
            for place, name in zip(self.places, names, strict=True)
        ]


def _board(rows: Rows, room: tuple[int, int], text: int) -> Board:
    """Panels in cells of one size."""
    width, height = room[0] // len(rows[0]), room[1] // len(rows)
    paper = np.full((height * len(rows), width * len(rows[0]), 3), 255, np.uint8)
    places = []
    for i, row in enumerate(rows):
        for j, one in enumerate(row):
            if one is None:
                continue
            panel, answer = one
            left, top = j * width, i * height
            cell = paper[top : top + height, left : left + width]
            spot, dots = panel.draw(cell, text)
            if spot is not None:
                spot = left + spot[0], top + spot[1], left + spot[2], top + spot[3]
            box = left, top, left + width, top + height
            places.append(Place(answer, box, spot, panel, [(left + x, top + y) for x, y in dots]))
    return Board(paper, places)


def of_one(answer: Answer, names: Sequence[str], view: View, room: tuple[int, int], text: int = 12) -> Board:
    """The panels of an answer, three in a row."""
    panels = [(PANELS[name](answer, view), answer) for name in names]
    return _board([panels[i : i + COLUMNS] for i in range(0, len(panels), COLUMNS)], room, text)


def comparable(a: Answer, b: Answer) -> bool:
    """Whether both are of the same frame, and of one size."""
    return a.result.mask.shape == b.result.mask.shape and a.settings.scene == b.settings.scene


def of_two(a: Answer, b: Answer, view: View, room: tuple[int, int], text: int = 12) -> Board:
    """A beside B with the same scales, their ratio and their sections."""
    thirds = ratio_of(a, b), PANELS["section"](b, replace(view, like=a, beside=a))
    rows = []
    for name, third in zip(ROWS[:2], thirds, strict=True):
        both = ((a, "A"), (b, "B"))
        left, right = (PANELS[name](one, replace(view, like=a, name=who)) for one, who in both)
        rows.append([(left, a), (right, b), (third, b)])
    return _board(rows, room, text)


def of_several(
    answers: Sequence[tuple[str, Answer | None]],
    like: Answer,
    view: View,
    room: tuple[int, int],
    text: int = 12,
) -> Board:
    """Answers in columns, all on the scales of one of them; those to come are left white."""

    def panel(name: str, label: str, answer: Answer | None) -> tuple[Panel, Answer] | None:
        if answer is None:
            return None
        said = "" if answer.median_error is None else f", error {answer.median_error:.1f} %"
        named = f"{label}{said}" if name == ROWS[0] else ""
        return PANELS[name](answer, replace(view, like=like, name=named)), answer

    return _board([[panel(name, *one) for one in answers] for name in ROWS], room, text)
