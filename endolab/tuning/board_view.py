"""The page's side of a board: a JPEG whose maps share a cursor, and whose titles open a list."""

import threading
from pathlib import Path
from typing import Any

import anywidget
import traitlets as t

HERE = Path(__file__).parent


class BoardView(anywidget.AnyWidget):
    """A board in the page; places in it are shares of it, places in a map shares of the map, in [0, 1].

    Who changes several things at once, in whatever thread, holds `lock` meanwhile: what the page says then is
    heard after.
    """

    _esm, _css = HERE / "board_view.js", HERE / "tuner.css"
    value = t.Bytes().tag(sync=True)  # JPEG
    size: t.List[Any] = t.List([0, 0]).tag(sync=True)  # of it, px of the screen
    ratio = t.Float(1.0).tag(sync=True)  # px of the screen for one of the page
    cells: t.List[Any] = t.List().tag(sync=True)  # of each panel "box", "spot" of its map or None, "name"
    choices: t.List[Any] = t.List().tag(sync=True)  # what panels can show
    said: t.List[Any] = t.List().tag(sync=True)  # of each panel, at the cursor
    # From the page, each with the time: where the cursor is in its map, or nothing; a point of the board and
    # whether it was just pressed; a key; a panel and what it is to show; width, height, and `ratio`.
    hover: t.List[Any] = t.List().tag(sync=True)
    point: t.List[Any] = t.List().tag(sync=True)
    key: t.List[Any] = t.List().tag(sync=True)
    chosen: t.List[Any] = t.List().tag(sync=True)
    room: t.List[Any] = t.List().tag(sync=True)

    def __init__(self) -> None:
        self.lock = threading.RLock()
        super().__init__()
        self.add_class("endolab-board")

    def set_state(self, sync_data: dict[str, Any]) -> None:
        """Hear what the page says, not while a board is being sent: part of that would be lost."""
        with self.lock:
            super().set_state(sync_data)
