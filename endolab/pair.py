"""Boards in the notebook: one for what is now, and one beside it for what was kept, as A."""

from __future__ import annotations

import threading
from collections.abc import Callable

import ipywidgets as w

from endolab.boards import Cut, Shared, contrast, error_of, limits_of, outcome_board, spots
from endolab.knobs import Pointed
from endolab.pictures import jpeg
from endolab.tuning import Outcome

ALONE = {"flex": "0 1 1176px", "min_width": "0"}
BESIDE = {"flex": "1 1 370px", "min_width": "0", "max_width": "784px"}  # one below the other if narrow
HIDDEN = {"display": "none"}


class Pair(w.HBox):
    """What is shown now and, if there is one, A: side by side, of one size, with the same limits.

    Parameters
    ----------
    cut : callable
        Tells where the section lies.

    Attributes
    ----------
    shown, kept : Outcome or None
        Now, and A.
    picture, picture_kept : Pointed
        Of them.
    """

    def __init__(self, cut: Callable[[], Cut]) -> None:
        self.shown: Outcome | None = None
        self.kept: Outcome | None = None
        self.picture, self.picture_kept = Pointed(), Pointed()
        # The page follows a new layout of a box; a picture of one's own would keep its first.
        self._now, self._a = w.VBox([self.picture], layout=ALONE), w.VBox([self.picture_kept], layout=HIDDEN)
        self._now.add_class("endolab-now")
        self._a.add_class("endolab-kept")
        self._cut = cut
        self._drawing = threading.RLock()  # the solver's thread shows, the kernel's moves the section
        super().__init__([self._a, self._now], layout=w.Layout(flex_flow="row wrap", grid_gap="0 8px"))

    def show(self, outcome: Outcome, said: Callable[[], object] | None = None) -> None:
        """Draw an outcome; `said` is called when it is drawn, before it is sent."""
        with self._drawing:
            content = self._drawn(outcome)
            self.shown = outcome
            if said is not None:
                said()
            self._name()
            self.picture.spots = spots(outcome, self._columns)
            self.picture.value = content

    def redraw(self) -> None:
        """Draw both again, with another section."""
        with self._drawing:
            if self.kept is not None:
                self.picture_kept.spots = spots(self.kept, self._columns)
                self.picture_kept.value = self._drawn(self.kept)
            if self.shown is not None:
                self.show(self.shown)

    def keep(self) -> Outcome:
        """Make A of what is shown.

        Raises
        ------
        ValueError
            If nothing is.
        """
        with self._drawing:
            if self.shown is None:
                raise ValueError("there is no result to keep yet")
            self.kept = self.shown
            self.redraw()
            self._now.layout, self._a.layout = BESIDE, BESIDE
            return self.kept

    def drop(self) -> None:
        """Forget A."""
        with self._drawing:
            self.kept = None
            self._now.layout, self._a.layout = ALONE, HIDDEN
            self.redraw()

    def limits(self, outcome: Outcome) -> Shared | None:
        """Limits of A, if there is one and it shows the same scene."""
        kept = self.kept
        return None if kept is None or kept.settings.scene != outcome.settings.scene else limits_of(kept)

    @property
    def _columns(self) -> int:
        return 3 if self.kept is None else 2  # two boards of half the width remain readable

    def _drawn(self, outcome: Outcome) -> bytes:
        return jpeg(outcome_board(outcome, self._cut(), self.limits(outcome), self._columns))

    def _name(self) -> None:
        """Say what each is, and how they differ."""
        now, kept = self.shown, self.kept
        if now is None or kept is None:
            self.picture.caption = ""
            return
        self.picture_kept.caption = f"A: {contrast(kept.settings, now.settings)} · {error_of(kept)}"
        self.picture.caption = f"B (now): {contrast(now.settings, kept.settings)} · {error_of(now)}"
