"""What is on the tuner's board: the outcome of now, A, or several λ; drawn whenever one of them changes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from endolab.tuning.board_view import BoardView
from endolab.tuning.boards import ROOM, Board, fitting, of_one, of_several, of_two
from endolab.tuning.engine import Outcome
from endolab.tuning.panels import FIRST, FIRST_WITH_TRUTH, PANELS, Cut, View, limits_of
from endolab.tuning.pictures import Picture, jpeg
from endolab.tuning.sentences import contrast, error_of

NOW, KEPT, BESIDE = "B (now)", "A", "A beside B"  # what is shown, if A is kept
LEAST_ROOM = 300.0, 260.0  # px


class Screen:
    """A board in the page, and what is on it.

    `shown` is the outcome of now, `kept` is A; `shows` says which of them are drawn; `several` are outcomes
    by name, a strip, if there are any. `cut` tells where the section lies.
    """

    def __init__(self, cut: Callable[[], Cut], count: Callable[[], int]) -> None:
        self.view = BoardView()
        self.shown: Outcome | None = None
        self.kept: Outcome | None = None
        self.shows = NOW
        self.several: list[tuple[str, Outcome | None]] = []
        self.board: Board | None = None
        self._cut, self._count = cut, count
        self._room, self._ratio = ROOM, 1.0
        self._drawing = self.view.lock  # the solver's thread shows, the kernel's moves the section

    def show(self, outcome: Outcome, said: Callable[[], object] | None = None) -> None:
        """Draw an outcome; `said` is called when it is drawn, before it is sent."""
        with self._drawing:
            self.shown = outcome
            self._redraw(said)

    def redraw(self) -> None:
        """Draw what there is again."""
        with self._drawing:
            self._redraw(None)

    def keep(self) -> Outcome:
        """Make A of what is shown; ValueError if nothing is."""
        with self._drawing:
            if self.shown is None:
                raise ValueError("there is no result to keep yet")
            self.kept, self.shows = self.shown, BESIDE
            self._redraw(None)
            return self.kept

    def drop(self) -> None:
        """Forget A."""
        with self._drawing:
            self.kept, self.shows = None, NOW
            self._redraw(None)

    def measured(self, room: Sequence[Any]) -> None:
        """Take the size of the page, and send it the board whatever it has."""
        with self._drawing:
            numbers = [float(one) for one in room[:3]]
            if len(numbers) < 3 or not all(math.isfinite(one) and one > 0 for one in numbers):
                raise ValueError(f"the room of a board is three positive numbers, got {list(room)}")
            width, height, ratio = numbers
            self._ratio = min(max(ratio, 1.0), 3.0)
            free = max(width, LEAST_ROOM[0]), max(height, LEAST_ROOM[1])
            self._room = free[0] * self._ratio, free[1] * self._ratio
            self._redraw(None)
            # It may have been made while a picture was on its way, and have missed that.
            self.view.send_state(["value", "size", "ratio", "boxes", "spots", "panels", "choices", "caption"])

    def say(self, where: Sequence[Any]) -> None:
        """Tell what all panels say of a point of their maps."""
        board = self.board
        if board is None or len(where) != 2:
            self.view.said = []
            return
        x, y = (min(max(float(one), 0.0), 1.0) for one in where)
        self.view.said = [place.at(x, y) for place in board.places]

    def names(self) -> list[str]:
        """What the panels show, by name."""
        known = self.shown is not None and self.shown.truth is not None
        usual = FIRST_WITH_TRUTH if known else FIRST
        chosen = [name for name in self.view.panels if name in PANELS]
        chosen = [name for name in chosen if known or not PANELS[name].needs_truth]
        more = [name for name in (*usual, *PANELS) if name not in chosen]
        return [*chosen, *more][: self._count()]

    def picture(self) -> Picture:
        """What the board shows, as pixels."""
        if self.board is None:
            raise ValueError("there is no result to show yet")
        return self.board.picture

    def _composed(self) -> Board | None:
        cut, kept, now = self._cut(), self.kept, self.shown
        if self.several:
            count = len(self.several)
            return of_several(self.several, fitting(2 * count, self._room, count, bars=False)[1])
        if now is None:
            return None
        names = self.names()
        if kept is not None and self.shows == BESIDE:
            return of_two(kept, now, names, View(cut, fitting(6, self._room, 3)[1]))
        columns, look = fitting(len(names), self._room)
        limits = None
        if kept is not None:
            limits = limits_of(kept) if kept.settings.scene == now.settings.scene else None
        outcome = kept if kept is not None and self.shows == KEPT else now
        return of_one(outcome, names, View(cut, look, limits), columns)

    def _redraw(self, said: Callable[[], object] | None) -> None:
        board = self._composed()
        if board is None:
            return
        content = jpeg(board.picture)
        self.board = board
        if said is not None:
            said()
        view, alone = self.view, not self.several and self.shows != BESIDE
        with view.hold_sync():
            view.caption = self._caption()
            view.ratio = self._ratio
            view.size = [board.picture.shape[1], board.picture.shape[0]]
            view.boxes, view.spots = (
                [list(one) for one in board.boxes],
                [one and list(one) for one in board.spots],
            )
            view.choices = self._choices() if alone else []
            if alone:
                view.panels = self.names()
            view.value = content
        if view.hover:
            self.say(view.hover)

    def _choices(self) -> list[str]:
        known = self.shown is not None and self.shown.truth is not None
        return [name for name, one in PANELS.items() if known or not one.needs_truth]

    def _caption(self) -> str:
        """Say what A and B are, and how they differ."""
        now, kept = self.shown, self.kept
        if self.several or now is None or kept is None:
            return ""
        a = f"A: {contrast(kept.settings, now.settings)} · {error_of(kept)}"
        b = f"B (now): {contrast(now.settings, kept.settings)} · {error_of(now)}"
        return {KEPT: a, NOW: b}.get(self.shows, f"{a}   |   {b}")
