"""Panels side by side: of one outcome, of two to be compared, of several λ; and how large they may be."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from endolab.numerics.arrays import FloatArray
from endolab.tuning.engine import Outcome
from endolab.tuning.panels import PANELS, View, end_of, limits_of, pixel_at
from endolab.tuning.pictures import Look, Picture, coloured, map_panel, panel
from endolab.tuning.sentences import error_of

Box = tuple[float, float, float, float]  # left, top, right, bottom, as shares of the board, in [0, 1]
SCALES = 0.6, 2.0  # of panels: smaller ones are not read, larger ones take too long to draw
STEP = 0.05  # of scales, so that a page which moves by a pixel is not drawn again
ROOM = (1176.0, 548.0)  # px, before the page tells its own
DIFFERENCE = "difference"
SAME = ("frame", "mask and highlights", "section", "energy")  # panels that are not compared map by map


@dataclass(frozen=True)
class Place:
    """A panel on a board."""

    name: str
    outcome: Outcome
    picture: Picture
    says: Callable[[int, int], str] | None = None  # of a pixel, if it is a map

    def at(self, x: float, y: float) -> str:
        """What it says at a point of its map: shares to the right and down, in [0, 1]."""
        assert self.outcome.result is not None
        mask = self.outcome.result.mask
        i, j = pixel_at(x, y, mask.shape)
        if self.says is None:
            return ""
        return self.says(i, j) if mask[i, j] else "left out"


@dataclass(frozen=True)
class Board:
    """A picture of panels, and where they are in it."""

    picture: Picture
    places: tuple[Place, ...]
    boxes: tuple[Box, ...]  # of the panels
    spots: tuple[Box | None, ...]  # of their maps, if they are maps


def fitting(
    count: int, room: tuple[float, float], columns: int | None = None, bars: bool = True
) -> tuple[int, Look]:
    """Columns, unless they are given, and size of so many panels that fill a room, px, as they can."""
    best = (0.0, 1)
    for wide in range(1, count + 1) if columns is None else (columns,):
        scale = SCALES[1]
        while scale > SCALES[0]:
            width, height = Look(scale, bars).size
            if wide * width <= room[0] and -(-count // wide) * height <= room[1]:
                break
            scale = round(scale - STEP, 2)
        best = max(best, (scale, wide))
    return best[1], Look(best[0], bars)


def _joined(places: Sequence[Place | None], columns: int, look: Look) -> Board:
    """A board of places, row by row; None is left white."""
    rows = -(-len(places) // columns)
    wide, tall = look.size
    paper = np.full((rows * tall, columns * wide, 3), 255, np.uint8)
    boxes: list[Box] = []
    spots: list[Box | None] = []
    for index, place in enumerate(places):
        if place is None:
            continue
        row, column = divmod(index, columns)
        left, top = column * wide, row * tall
        paper[top : top + tall, left : left + wide] = place.picture
        boxes.append(_shares((left, top, left + wide, top + tall), paper))
        assert place.outcome.result is not None
        width, height = look.fitted(place.outcome.result.mask.shape)
        x, y = left + look.edge, top + look.top
        spots.append(None if place.says is None else _shares((x, y, x + width, y + height), paper))
    return Board(paper, tuple(place for place in places if place is not None), tuple(boxes), tuple(spots))


def _shares(box: tuple[int, int, int, int], paper: Picture) -> Box:
    height, width = paper.shape[:2]
    return box[0] / width, box[1] / height, box[2] / width, box[3] / height


def _place(name: str, outcome: Outcome, view: View, who: str = "") -> Place:
    one = PANELS[name]
    reader = one.read
    says = None if reader is None else lambda i, j: reader(outcome, i, j)
    return Place(name, outcome, one.draw(outcome, replace(view, who=who)), says)


def of_one(outcome: Outcome, names: Sequence[str], view: View, columns: int) -> Board:
    """The panels of an outcome."""
    return _joined([_place(name, outcome, view) for name in names], columns, view.look)


def of_two(a: Outcome, b: Outcome, names: Sequence[str], view: View) -> Board:
    """A beside B with the same limits, their difference, and their sections: three columns, two rows or more.

    Compared are the distance and the first other map that is chosen.
    """
    view = replace(view, limits=limits_of(a) if comparable(a, b) else None)
    others = [name for name in names if name not in (*SAME, "distance") and PANELS[name].read] or ["normals"]
    last = [_difference(a, b, view), _place("section", b, replace(view, beside=a))]
    places: list[Place | None] = []
    for name, third in zip(("distance", others[0]), last, strict=True):
        places += [
            _place(name, a, view, "A"),
            _place(name, b, view, "B"),
            third if comparable(a, b) else None,
        ]
    return _joined(places, 3, view.look)


def comparable(a: Outcome, b: Outcome) -> bool:
    """Whether both are of the same frame, and of one size."""
    assert a.result is not None
    assert b.result is not None
    return a.settings.scene == b.settings.scene and a.result.mask.shape == b.result.mask.shape


def _difference(a: Outcome, b: Outcome, view: View) -> Place | None:
    """B over A, in %, without what is common if one of them has no unit."""
    if not comparable(a, b):
        return None
    assert a.result is not None
    assert b.result is not None
    ratio = b.result.distance / a.result.distance
    title = "B / A - 1 [%]"
    if not (a.result.metric and b.result.metric):
        ratio, title = ratio / np.nanmedian(ratio), "B / A - 1 [%], but for the scale"
    change: FloatArray = 100 * (ratio - 1)
    end = end_of(change, 98)
    picture = map_panel(
        title, coloured(change, (-end, end), "diverging"), (-end, end), "diverging", view.look
    )
    return Place(DIFFERENCE, b, picture, lambda i, j: f"{change[i, j]:+.1f} %")


def of_several(outcomes: Sequence[tuple[str, Outcome | None]], look: Look) -> Board:
    """A strip of outcomes by name: their distances, and normals below; those to come are left white."""
    known = [outcome for _, outcome in outcomes if outcome is not None]
    if not known:
        return Board(panel("solving ...", look), (), (), ())
    view = View(look=look, limits=limits_of(known[len(known) // 2]))
    assert view.limits is not None
    rows: list[list[Place | None]] = [[], []]
    for label, outcome in outcomes:
        if outcome is None or outcome.result is None:
            rows[0].append(None)
            rows[1].append(None)
            continue
        error = "" if outcome.median_error is None else f": {error_of(outcome)}"
        colours = coloured(outcome.result.distance, view.limits.depth)
        one = _place("distance", outcome, view)
        rows[0].append(replace(one, picture=map_panel(f"{label}{error}", colours, look=look)))
        rows[1].append(_place("normals", outcome, view))
    return _joined([*rows[0], *rows[1]], len(outcomes), look)
