"""Panels that fill a board: of one answer, of two to be compared, of several in columns on one scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from endolab.numerics.arrays import FloatArray
from endolab.workbench.tuning.engine import Answer
from endolab.workbench.tuning.panels import PANELS, Panel, View, ratio_of
from endolab.workbench.tuning.pictures import DRAWING, Chart, Map, Picture, scale_bar

COMPARED_PANELS = ("distance", "model - frame", "section")
Box = list[float]  # left, top, right, bottom
Rows = Sequence[Sequence[tuple[Panel, Answer] | None]]


@dataclass(frozen=True)
class Place:
    """A panel on a board."""

    answer: Answer
    box: Box  # of the panel, and ...
    spot: Box | None  # ... of its map, if it is one, as shares of the board
    panel: Panel
    dots: FloatArray  # of a chart, (n, 2), to the right and down, shares of the board

    def says(self, x: float, y: float) -> str:
        """What it says at a point of its map: shares to the right and down, in [0, 1]."""
        if not isinstance(self.panel, Map) or self.panel.says is None:
            return ""
        mask = self.answer.result.mask
        i, j = (
            min(int(share * size), size - 1)
            for share, size in zip((y, x), mask.shape, strict=True)
        )
        return self.panel.says(i, j) if mask[i, j] else "left out"


@dataclass(frozen=True)
class Board:
    """A picture of panels, and where they are in it; points of it are shares to the right and down."""

    picture: Picture
    places: list[Place]

    def at(self, x: float, y: float) -> Place | None:
        """The panel at a point."""
        for place in self.places:
            left, top, right, bottom = place.box
            if left <= x < right and top <= y < bottom:
                return place
        return None

    def cells(self, names: Sequence[str]) -> list[dict[str, Any]]:
        """What the page is told of the panels, which may have names."""
        names = names or [""] * len(self.places)
        places = zip(self.places, names, strict=True)
        return [
            {"box": place.box, "spot": place.spot, "name": name} for place, name in places
        ]


def _board(rows: Rows, room: tuple[int, int], text: int, margin: int = 0) -> Board:
    """Panels in cells of one size; on the right `margin` px with the scales that rows of maps share."""
    width = (room[0] - margin) // len(rows[0])
    height = room[1] // len(rows)
    size = np.array([width * len(rows[0]) + margin, height * len(rows)])
    paper = np.full((size[1], size[0], 3), 255, np.uint8)

    def to_shares(box: Sequence[int]) -> Box:
        """A box in a cell as shares of the board."""
        moved: Box = (np.add(np.reshape(box, (2, 2)), (left, top)) / size).ravel().tolist()
        return moved

    places = []
    for i, row in enumerate(rows):
        for j, cell in enumerate(row):
            if cell is None:
                continue
            panel, answer = cell
            left = j * width
            top = i * height
            if margin and isinstance(panel, Map) and panel.limits is not None:
                strip = paper[top + 2 * text : top + height - text // 2, -margin:]
                strip[:] = 255  # as the column before drew it too
                scale_bar(strip, 0, panel.limits, panel.palette, text)
                panel = replace(panel, limits=None)
            spot, dots = panel.draw(paper[top : top + height, left : left + width], text)
            at = np.add(np.reshape(dots, (-1, 2)), (left, top)) / size
            places.append(
                Place(
                    answer,
                    to_shares((0, 0, width, height)),
                    spot and to_shares(spot),
                    panel,
                    at,
                )
            )
    return Board(paper, places)


def draw_answer(
    answer: Answer, names: Sequence[str], view: View, room: tuple[int, int], text: int = 12
) -> Board:
    """The panels of an answer, three in a row."""
    panels = [(PANELS[name](answer, view), answer) for name in names]
    rows = [panels[i : i + 3] for i in range(0, len(panels), 3)]
    return _board(rows, room, text)


def are_comparable(a: Answer, b: Answer) -> bool:
    """Whether both are of the same frame, and of one size."""
    return (
        a.result.mask.shape == b.result.mask.shape and a.settings.scene == b.settings.scene
    )


def _name_panel(name: str, panel: Panel) -> Panel:
    return replace(panel, title=f"{name}: {panel.title}")


def draw_pair(
    a: Answer, b: Answer, view: View, room: tuple[int, int], text: int = 12
) -> Board:
    """A beside B with the same scales, their ratio and their sections."""
    thirds = ratio_of(a, b), PANELS["section"](b, replace(view, like=a, beside=a))
    rows = []
    for name, third in zip(COMPARED_PANELS[:2], thirds, strict=True):
        left, right = (PANELS[name](answer, replace(view, like=a)) for answer in (a, b))
        rows.append([(_name_panel("A", left), a), (_name_panel("B", right), b), (third, b)])
    return _board(rows, room, text)


def draw_columns(
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
        shown = PANELS[name](answer, replace(view, like=like))
        title = shown.title.split(",")[0]
        if name == COMPARED_PANELS[0]:
            title = f"{label}: {title.lower()}"
        if isinstance(shown, Chart):  # no room for the names of its curves
            shown = replace(shown, curves=[("", *curve[1:]) for curve in shown.curves])
            title = (
                title
                if answer.median_error is None
                else f"Section, error {answer.median_error:.1f} %"
            )
        return replace(shown, title=title), answer

    return _board(
        [[panel(name, *labelled) for labelled in answers] for name in COMPARED_PANELS],
        room,
        text,
        DRAWING.scale_width * text,
    )
