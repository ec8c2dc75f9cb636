"""Panels that fill a board: of one answer, of two to be compared, of several in columns on one scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from endolab.tuning.engine import Answer
from endolab.tuning.panels import PANELS, Panel, View, ratio_of
from endolab.tuning.pictures import Box, Cell, Chart, Map, Picture, scale_bar

COLUMNS = 3
ROWS = ("distance", "model - frame", "section")  # of answers that are compared
SCALE = 6  # width of a column of colour bars, in sizes of letters


@dataclass(frozen=True)
class Place:
    """A panel on a board."""

    answer: Answer
    box: Box  # of the panel
    spot: Box | None  # of its map, if it is one
    panel: Panel
    dots: Sequence[tuple[int, int]] = ()  # of a chart

    def says(self, x: float, y: float) -> str:
        """What it says at a point of its map: shares to the right and down, in [0, 1]."""
        mask = self.answer.result.mask
        i, j = (min(int(share * size), size - 1) for share, size in zip((y, x), mask.shape, strict=True))
        says = self.panel.says if isinstance(self.panel, Map) else None
        if says is None:
            return ""
        return says(i, j) if mask[i, j] else "left out"


@dataclass(frozen=True)
class Board:
    """A picture of panels, and where they are in it."""

    picture: Picture
    places: list[Place]

    def at(self, x: float, y: float) -> Place | None:
        """The panel at a point of the board, px."""
        for place in self.places:
            left, top, right, bottom = place.box
            if left <= x < right and top <= y < bottom:
                return place
        return None


def _board(
    panels: Sequence[Sequence[tuple[Panel, Answer] | None]], room: tuple[int, int], text: int
) -> Board:
    """Rows of panels in cells of one size."""
    width, height = room[0] // len(panels[0]), room[1] // len(panels)
    paper = np.full((height * len(panels), width * len(panels[0]), 3), 255, np.uint8)
    places = []
    for i, row in enumerate(panels):
        for j, one in enumerate(row):
            if one is None:
                continue
            panel, answer = one
            left, top = j * width, i * height
            box = left, top, left + width, top + height
            if isinstance(panel, Chart):
                picture, dots = panel.draw(Cell(width, height, text))
                places.append(Place(answer, box, None, panel, [(left + x, top + y) for x, y in dots]))
            else:
                picture, (x0, y0, x1, y1) = panel.draw(Cell(width, height, text))
                spot = (left + x0, top + y0, left + x1, top + y1) if panel.says else None
                places.append(Place(answer, box, spot, panel))
            paper[top : top + height, left : left + width] = picture
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
    last = [(ratio_of(a, b), b), (PANELS["section"](b, replace(view, like=a, beside=a)), b)]
    rows = []
    for name, third in zip(ROWS[:2], last, strict=True):
        pair = [
            (PANELS[name](one, replace(view, like=a, name=who)), one) for one, who in ((a, "A"), (b, "B"))
        ]
        rows.append([*pair, third])
    return _board(rows, room, text)


def of_several(
    answers: Sequence[tuple[str, Answer | None]],
    like: Answer,
    view: View,
    room: tuple[int, int],
    text: int = 12,
) -> Board:
    """Answers in columns, all on the scales of one of them; those to come are left white."""
    wide = room[0] - SCALE * text
    rows = []
    for name in ROWS:
        row: list[tuple[Panel, Answer] | None] = []
        for label, answer in answers:
            if answer is None:
                row.append(None)
                continue
            panel = PANELS[name](answer, replace(view, like=like))
            said = "" if answer.median_error is None else f", error {answer.median_error:.1f} %"
            title = f"{label}{said}" if name == ROWS[0] else ""
            if isinstance(panel, Map):
                panel = replace(panel, barred=False)
            row.append((replace(panel, title=title), answer))
        rows.append(row)
    board = _board(rows, (wide, room[1]), text)
    strip = np.full((len(board.picture), SCALE * text, 3), 255, np.uint8)
    for number, name in enumerate(ROWS[:2]):
        panel = PANELS[name](like, replace(view, like=like))
        top, height = number * len(strip) // len(ROWS), len(strip) // len(ROWS)
        if isinstance(panel, Map) and panel.limits is not None:
            unit = like.result.problem.unit.split()[0] if number == 0 else "grey"
            strip[top : top + height] = Cell(SCALE * text, height, text).paper(f"[{unit}]")[0]
            bar = strip[top + 2 * text : top + height - text // 2]
            scale_bar(bar, text // 2, panel.limits, panel.palette, text)
    return Board(np.concatenate([board.picture, strip], axis=1), board.places)
