"""Panels that fill a board: of one answer, of two to be compared, of several in columns on one scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from endolab.numerics.arrays import FloatArray
from endolab.workbench.tuning.engine import Answer
from endolab.workbench.tuning.panels import PANELS, Panel, View, ratio_of
from endolab.workbench.tuning.pictures import DRAWING, Chart, Map, Picture, scale_bar

Box = list[float]  # left, top, right, bottom
Cell = tuple[Panel, Answer]


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
        height, width = mask.shape
        i = min(int(y * height), height - 1)
        j = min(int(x * width), width - 1)
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
        return [
            {"box": place.box, "spot": place.spot, "name": name}
            for place, name in zip(
                self.places, names or [""] * len(self.places), strict=True
            )
        ]


def _board(rows: Sequence[Sequence[Cell | None]], view: View, margin: int = 0) -> Board:
    """Panels in cells of one size; on the right `margin` px with the scales that rows of maps share."""
    text = view.text
    width = (view.room[0] - margin) // len(rows[0])
    height = view.room[1] // len(rows)
    size = np.array([width * len(rows[0]) + margin, height * len(rows)])
    paper = np.full((size[1], size[0], 3), 255, np.uint8)
    places = []
    for i, row in enumerate(rows):
        for j, cell in enumerate(row):
            if cell is None:
                continue
            panel, answer = cell
            left = j * width
            top = i * height
            if margin and isinstance(panel, Map) and panel.limits is not None:
                bottom = top + height - text // 2
                strip = paper[top + 2 * text : bottom, -margin:]
                strip[:] = 255  # as the column before drew it too
                scale_bar(strip, panel.limits, panel.palette, text)
                panel = replace(panel, limits=None)
            place = paper[top : top + height, left : left + width]
            spot, dots = panel.draw(place, text)
            corner = (left, top)
            places.append(
                Place(
                    answer,
                    box=_shares([0, 0, width, height], corner, size).ravel().tolist(),
                    spot=spot and _shares(spot, corner, size).ravel().tolist(),
                    panel=panel,
                    dots=_shares(dots, corner, size),
                )
            )
    return Board(paper, places)


def _shares(points: Any, corner: tuple[int, int], size: FloatArray) -> FloatArray:
    """Points in a cell, px from its corner, as shares of the board, (n, 2)."""
    return (np.reshape(points, (-1, 2)) + corner) / size


def draw_answer(answer: Answer, names: Sequence[str], view: View) -> Board:
    """The panels of an answer, three in a row."""
    panels = [(PANELS[name](answer, view), answer) for name in names]
    return _board([panels[i : i + 3] for i in range(0, len(panels), 3)], view)


def are_comparable(a: Answer, b: Answer) -> bool:
    """Whether both are of the same frame, and of one size."""
    return (
        a.result.mask.shape == b.result.mask.shape and a.settings.scene == b.settings.scene
    )


def draw_pair(a: Answer, b: Answer, view: View) -> Board:
    """A beside B with the same scales, their ratio and their sections."""
    view = replace(view, like=a)

    def row(name: str, third: Panel) -> list[Cell]:
        left = PANELS[name](a, view)
        right = PANELS[name](b, view)
        return [
            (replace(left, title=f"A: {left.title}"), a),
            (replace(right, title=f"B: {right.title}"), b),
            (third, b),
        ]

    section = PANELS["section"](b, replace(view, beside=a))
    return _board([row("distance", ratio_of(a, b)), row("model - frame", section)], view)


def draw_columns(columns: Mapping[str, Answer | None], like: Answer, view: View) -> Board:
    """Answers in columns, all on the scales of one of them; those to come are left white."""
    view = replace(view, like=like)

    def cell(name: str, label: str, answer: Answer | None) -> Cell | None:
        if answer is None:
            return None
        panel = PANELS[name](answer, view)
        title = panel.title.split(",")[0]
        if name == "distance":
            title = f"{label}: {title.lower()}"
        if isinstance(panel, Chart):  # no room for the names of its curves
            curves = [("", *curve[1:]) for curve in panel.curves]
            panel = replace(panel, curves=curves)
            if answer.median_error is not None:
                title = f"Section, error {answer.median_error:.1f} %"
        return replace(panel, title=title), answer

    rows = [
        [cell(name, *column) for column in columns.items()]
        for name in ("distance", "model - frame", "section")
    ]
    return _board(rows, view, DRAWING.scale_width * view.text)
