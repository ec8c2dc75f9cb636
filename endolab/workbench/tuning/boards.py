"""Panels that fill a board: of one answer, of two to be compared, of several in columns on one scale."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.workbench.tuning.engine import Answer
from endolab.workbench.tuning.panels import (
    PANELS,
    Panel,
    View,
    change_map,
    end_of,
    ratio_of,
    relative_change,
)
from endolab.workbench.tuning.pictures import (
    DRAWING,
    Chart,
    Map,
    Picture,
    Window,
    grey_or_colour,
    pixels,
)

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
    window: Window  # the part of the frame that maps show
    # From what a chart's axes measure to the board.
    project: Callable[[FloatArray], FloatArray] | None = None

    def pixel(self, x: float, y: float) -> tuple[int, int]:
        """Row and column of the answer at a point of a map's window, shares to the right and down."""
        mask = self.answer.result.mask
        left, top, right, bottom = self.window
        i = int((top + y * (bottom - top)) * mask.shape[0])
        j = int((left + x * (right - left)) * mask.shape[1])
        return min(i, mask.shape[0] - 1), min(j, mask.shape[1] - 1)

    def says(self, i: int, j: int) -> str:
        """What it says of a pixel."""
        if isinstance(self.panel, Chart):
            return "" if self.panel.locate is None else f"column {j}, row {i}"
        if self.panel.says is None:
            return ""
        return self.panel.says(i, j) if self.answer.result.mask[i, j] else "left out"

    def mark(self, i: int, j: int) -> list[float]:
        """Where a pixel's point lies in a chart, shares of the board; [] if it does not."""
        if not isinstance(self.panel, Chart) or self.panel.locate is None:
            return []
        if self.project is None or not self.answer.result.mask[i, j]:
            return []
        spot: list[float] = self.project(self.panel.locate(i, j)).tolist()
        return spot


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


def _window(mask: BoolArray, zoom: Window) -> Window:
    """The part of a picture that is shown, of whole pixels: of what the mask holds, what is zoomed to."""
    height, width = mask.shape
    rows = np.flatnonzero(mask.any(axis=1))
    columns = np.flatnonzero(mask.any(axis=0))
    size = (rows[-1] + 1 - rows[0], columns[-1] + 1 - columns[0])
    down, across = pixels(zoom, size)
    return (
        (columns[0] + across.start) / width,
        (rows[0] + down.start) / height,
        (columns[0] + across.stop) / width,
        (rows[0] + down.stop) / height,
    )


def _board(rows: Sequence[Sequence[Cell | None]], view: View, margin: int = 0) -> Board:
    """Panels in cells of one size; on the right `margin` px with the scales that rows of maps share."""
    text = view.text
    width = (view.room[0] - margin) // len(rows[0])
    height = view.room[1] // len(rows)
    size = np.array([width * len(rows[0]) + margin, height * len(rows)])
    paper = np.full((size[1], size[0], 3), view.look.paper, np.uint8)
    places = []
    for i, row in enumerate(rows):
        for j, cell in enumerate(row):
            if cell is None:
                continue
            panel, answer = cell
            left = j * width
            top = i * height
            window = _window(answer.result.mask, view.zoom)
            if isinstance(panel, Map) and panel.picture is not None:
                panel = replace(panel, window=window)
                if margin and panel.limits is not None:
                    bottom = top + height - text // 2
                    strip = paper[top + 2 * text : bottom, -margin:]
                    strip[:] = view.look.paper  # as the column before drew it too
                    panel.draw_scale(strip, text, view.look)
                    panel = replace(panel, has_scale=False)
            place = paper[top : top + height, left : left + width]
            drawn = panel.draw(place, text, view.look)
            shares = partial(_shares, corner=(left, top), size=size)
            places.append(
                Place(
                    answer,
                    box=shares([0, 0, width, height]).ravel().tolist(),
                    spot=drawn.spot and shares(drawn.spot).ravel().tolist(),
                    panel=panel,
                    dots=shares(drawn.dots),
                    window=window,
                    project=drawn.place and partial(_project, drawn.place, shares),
                )
            )
    return Board(paper, places)


def _shares(points: Any, corner: tuple[int, int], size: FloatArray) -> FloatArray:
    """Points in a cell, px from its corner, as shares of the board, (n, 2)."""
    return (np.reshape(points, (-1, 2)) + corner) / size


def _project(
    place: Callable[[FloatArray], FloatArray],
    shares: Callable[[FloatArray], FloatArray],
    point: FloatArray,
) -> FloatArray:
    """A point of a chart, as shares of the board."""
    return shares(place(point))[0]


def draw_frame(image: FloatArray, view: View) -> Board:
    """A frame, before there is an answer."""
    paper = np.full((view.room[1], view.room[0], 3), view.look.paper, np.uint8)
    cell = paper[: view.room[1] // 2, : view.room[0] // 3]
    step = max(
        1, max(image.shape) // max(cell.shape)
    )  # a frame of megapixels is not copied whole
    Map("Frame", grey_or_colour(image[::step, ::step])).draw(cell, view.text, view.look)
    return Board(paper, [])


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
    """Answers in columns, all on the scales of one of them; those to come are left empty.

    Below the normals of each is by what its distance differs from that one's, and the section.
    """
    view = replace(view, like=like)
    changes = {
        label: relative_change(like, answer)
        for label, answer in columns.items()
        if answer is not None
    }
    end = max((end_of(change) for change in changes.values()), default=1.0)
    rows: list[list[Cell | None]] = [[], [], []]
    for label, answer in columns.items():
        if answer is None:
            for row in rows:
                row.append(None)
            continue
        first = replace(
            PANELS["normals"](answer, view),
            title=f"{label}: explains {100 * answer.explained_contrast:.1f} %",
        )
        change = change_map("Change [%]", changes[label], end)
        if answer is like:
            change = replace(PANELS["frame"](answer, view), title="Frame")
        section = PANELS["section"](answer, view)
        title = section.title
        if answer.median_error is not None:
            title = f"Section, error {answer.median_error:.1f} %"
        # There is no room for the names of its curves.
        curves = [("", *curve[1:]) for curve in section.curves]
        section = replace(section, curves=curves, title=title)
        for row, panel in zip(rows, (first, change, section), strict=True):
            row.append((panel, answer))
    return _board(rows, view, DRAWING.scale_width * view.text)
