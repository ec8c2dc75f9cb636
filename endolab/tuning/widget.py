"""The tuner: knobs under a hand, the surface under its eyes.

`tune` makes a widget for JupyterLab. Its `engine` solves in a thread of its own; pictures are drawn
and sent from there, so that neither a slow solve nor a running cell freezes the page. There is one answer,
`TunerBox.answer`, that all which is shown, written and exported is of.
"""

from __future__ import annotations

import html
import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import ipywidgets as w
import numpy as np

from endolab import datasets
from endolab.io.atomic import staged_folder, write_atomically
from endolab.io.descriptions import Calibration
from endolab.io.images import read_frame
from endolab.io.settings import write_settings
from endolab.model.endoscope import Endoscope
from endolab.model.schema import unknown_name
from endolab.numerics.arrays import FloatArray
from endolab.preprocessing.frame import Frame
from endolab.reports.result import write_files
from endolab.synthetic.scenes import SCENES
from endolab.tuning.board_view import BoardView
from endolab.tuning.boards import Board, comparable, of_one, of_several, of_two
from endolab.tuning.controls import SIGHT, VIEWS, Knobs, button
from endolab.tuning.engine import FINAL, Answer, Tuner, sentence_of
from endolab.tuning.panels import NEED_TRUST, PANELS, USUAL, Dot, View
from endolab.tuning.pictures import Map, jpeg, png
from endolab.tuning.sentences import summary, warnings
from endolab.tuning.source import Settings
from endolab.tuning.surface_view import SurfaceView, show_on

IMPORTS = "from dataclasses import replace\n\nimport endolab as el\n"
A, B, BESIDE = "A", "B", "A beside B"  # what is shown, if A is kept
LAMS = (0.1, 10**-0.5, 1.0, 10**0.5, 10.0)  # times the present λ, to be compared
REMEMBERED = 12  # final answers that come back without a solve
MOST_DOTS = 200
NEAR = 12  # px around a dot in which a click takes it
ROOM = (1176.0, 620.0)  # px, before the page tells its own
LEAST_ROOM, TALLEST = (420.0, 300.0), 0.75  # px; height over width
TEXT, LARGE_TEXT, LARGE = 12, 14, 1500.0  # px: of letters, and of a page that has larger ones


def tune(
    frame: Frame | None = None,
    calibration: Calibration | None = None,
    truth: FloatArray | None = None,
    scene: str = "colon",
    width: int = 320,
) -> TunerBox:
    """Make the tuner, a widget for the last line of a cell: sliders and choices, and linked panels.

    Parameters
    ----------
    frame : Frame, optional
        To look at; without one, a scene is rendered.
    calibration : Calibration, optional
        Of the frame; scenes are rendered by it. The paper's endoscope by default.
    truth : (H, W) float array, optional
        True distance of the frame, mm; nan where unknown.
    scene : {"plane", "curved", "tube", "colon"}
        To begin with if there is no frame.
    width : int
        Columns to begin with, px.

    Raises
    ------
    ValueError
        If frame, calibration and truth do not go together, or if there is no such scene.
    """
    for name, given, kind in (("frame", frame, Frame), ("calibration", calibration, Endoscope)):
        if given is not None and not isinstance(given, kind):
            raise ValueError(f"{name} must be an endolab {kind.__name__}, got {given!r}")
    if not isinstance(scene, str) or scene not in SCENES:
        raise unknown_name("scene", scene, SCENES)
    if not isinstance(width, int) or width < 1:
        raise ValueError(f"width must be a whole number of pixels, got {width!r}")
    truth = None if truth is None else np.asarray(truth)
    return TunerBox(frame, calibration or datasets.load_calibration("paper"), truth, scene, width)


class TunerBox(w.VBox):
    """The tuner's widget; `tune` makes it.

    `engine` solves what the `knobs` say. `now` is the last answer, B if A was kept, `kept` is A, and `answer`
    the one of them that is shown. `pictures` are frames to choose among, of which `frame` is the first.
    """

    def __init__(
        self,
        frame: Frame | None,
        calibration: Calibration,
        truth: FloatArray | None = None,
        scene: str = "colon",
        width: int = 320,
        pictures: Sequence[Path] = (),
    ) -> None:
        self.now: Answer | None = None
        self.kept: Answer | None = None
        self.shows = B
        self.columns: list[tuple[str, Answer | None]] = []  # answers that are compared
        self.visited: list[Settings] = []  # for undo
        self.dots: list[Dot] = []
        self.names = list(USUAL)  # of the panels
        self.board: Board | None = None
        self._last: Answer | None = None  # the last final answer, ...
        self._before: Answer | None = None  # ... and the one before it
        self._calibration, self._pictures = calibration, list(pictures)
        self.view, self.surface, self._lock = BoardView(), SurfaceView(0), threading.RLock()
        self._lock = self.view.lock  # the solver's thread shows, the kernel's moves the section
        self._said = ""  # a word on what was done last, until something else is
        self._room, self._ratio = ROOM, 1.0
        self.engine = Tuner(calibration, self._take, self._refuse, frame=frame, truth=truth)
        names = [path.name for path in self._pictures] or ([frame.name] if frame is not None else [])
        scenes = [*((name, i) for i, name in enumerate(names)), *((name, name) for name in SCENES)]
        self.knobs = Knobs(scenes, width, self._guarded(self._turned))
        self.knobs.reset_light(calibration.photometry.k, calibration.photometry.gamma)
        with self.knobs.quiet():
            self.knobs["scene"].value = 0 if names else scene
            self.knobs["channel"].value = "auto" if names else ""
        self._first = self.knobs.settings()
        super().__init__([self._make_bars(), self._make_stack()])
        self.add_class("endolab-tuner")
        for name, action in (
            ("point", self._point),
            ("hover", self._say),
            ("room", self._measured),
            ("chosen", self._choose),
            ("key", self._press),
        ):
            follow = self._guarded(lambda change, action=action: action(change["new"]))
            self.view.observe(follow, name)
        self.ask()

    def _make_bars(self) -> w.VBox:
        made = lambda name, tip, action: button(name, tip, self._guarded(action))  # noqa: E731
        row = {"flex_flow": "row wrap", "align_items": "center", "width": "100%"}
        sight = [self.knobs.named[name] for name in SIGHT]
        reset = made("reset", "All knobs as they were at first.", self.reset)
        more = made("advanced", "All other knobs, the code, and the export.", self._unfold)
        self.status = w.HTML("solving ...", layout={"flex": "1 1 0", "min_width": "300px"})
        self.shown = w.ToggleButtons(options=[A, B, BESIDE], value=B, style={"button_width": "auto"})
        self.shown.layout.display = "none"
        self.shown.observe(self._guarded(lambda change: self.show(change["new"])), "value")
        self.keeper = made(
            "keep as A", "Keep this answer, to compare it with what comes; key A, and X drops it.", self.keep
        )
        self.comparing = w.Dropdown(
            options=[("compare ...", ""), ("five λ", "lam"), ("regularisers", "regulariser")],
            tooltip="Answers side by side on one scale; a click takes one over.",
            layout={"width": "120px"},
        )
        self.comparing.observe(self._guarded(lambda change: self.compare(change["new"])), "value")
        undo = made("undo", "Back to the answer before; Ctrl-Z.", self.undo)
        actions = [self.status, undo, self.keeper, self.shown, self.comparing, more]
        self.code = w.Textarea(layout={"width": "calc(100% - 8px)", "height": "110px"}, disabled=True)
        self.folder = w.Text("tuned", tooltip="The folder that is exported into.", layout={"width": "130px"})
        others = [knob for name, knob in self.knobs.named.items() if name not in SIGHT]
        exported = made(
            "export",
            "Write what is shown: pictures, cloud, depth, settings, code and recording.",
            self._export_aside,
        )
        trusted = made("find σ", "Find how far this answer can be trusted, pixel by pixel.", self.find_trust)
        knobs = [
            w.HBox([*sight, reset], layout=row),
            w.HBox([*others, trusted, exported, self.folder], layout=row),
        ]
        for box in knobs:
            box.add_class("endolab-knobs")
        self.advanced = w.VBox([knobs[1], self.code], layout={"display": "none"})
        bars = w.VBox([knobs[0], w.HBox(actions, layout=row), self.advanced])
        bars.add_class("endolab-bars")
        return bars

    def _make_stack(self) -> w.Box:
        self.surface.layout.display = "none"
        self.surface.add_class("endolab-3d")
        stack = w.VBox([self.view, self.surface], layout={"width": "100%"})
        stack.add_class("endolab-stack")
        return stack

    # What is solved ----------------------------------------------------------------------

    @property
    def answer(self) -> Answer | None:
        """The one answer that is shown."""
        return self.kept if self.shows == A else self.now

    def settings(self) -> Settings:
        """Return what the knobs say; ValueError, in one sentence, if a line cannot be read."""
        return self.knobs.settings()

    def ask(self) -> None:
        """Ask the engine for what the knobs say; returns at once."""
        settings = self.settings()
        with self._lock:
            self.columns = []
            if self.shows == A:
                self._set_shown(B)
        self.comparing.value = ""
        self.engine.ask(settings)

    def _turned(self, name: str) -> None:
        """Follow a knob."""
        if name in VIEWS:
            self.redraw()
            return
        index = self.knobs["scene"].value
        if name == "scene" and self._pictures and isinstance(index, int) and index != self.knobs.frame:
            self._open(index)
        self.ask()

    def _open(self, index: int) -> None:
        """Look at another frame; one that cannot be used is passed by with a sentence, and the last stays."""
        try:
            frame = read_frame(self._pictures[index], self._calibration)
        except (OSError, ValueError, MemoryError) as error:
            with self.knobs.quiet():
                self.knobs["scene"].value = self.knobs.frame
            raise ValueError(f"{sentence_of(error)}: the frame before is still shown") from error
        self.look_at(frame)
        self.knobs.frame = index

    def look_at(self, frame: Frame, truth: FloatArray | None = None) -> None:
        """Look at another frame of the same endoscope; the knobs stay.

        Raises ValueError if it is not of the calibration's size; then nothing changes.
        """
        self.engine.use(self._calibration, frame, truth)
        self.visited, self.dots, self._last = [], [], None
        self.drop()

    def _take(self, answer: Answer) -> None:
        """Show an answer; in the engine's thread."""
        try:
            with self._lock:
                self._said = ""
                if answer.trust is not None:
                    self._replace(answer)
                else:
                    self.now = answer
                    if answer.stage == FINAL:
                        self._remember(answer)
                self._show()
        except Exception as error:
            self._refuse(sentence_of(error))

    def _replace(self, answer: Answer) -> None:
        """Have an answer in place of the one of the same settings, of which less was known."""
        both = (self.kept, self.now)
        self.kept, self.now = (
            answer if one is not None and one.settings == answer.settings else one for one in both
        )

    def _remember(self, answer: Answer) -> None:
        """Have an answer among those to come back to."""
        if not self.visited or self.visited[-1] != answer.settings:
            self.visited.append(answer.settings)
        self._before, self._last = self._last, answer
        self._dot(answer, answer)

    def _dot(self, answer: Answer, kept: Answer | None) -> None:
        """Have an answer among the dots of the λ curve; `kept` is what a click on it brings back."""
        one = answer.settings
        others = [dot for dot in self.dots if dot.settings != one][-MOST_DOTS:]
        forgotten = [replace(dot, answer=None) for dot in others[:-REMEMBERED]]
        new = Dot(kept, one, answer.data, answer.roughness, _picture_of(one))
        self.dots = [*forgotten, *others[-REMEMBERED:], new]

    def bring_back(self, settings: Settings) -> None:
        """Show the answer of these settings, if it is remembered, or else ask for it."""
        self.knobs.take(settings)
        known = next((dot.answer for dot in self.dots if dot.settings == settings), None)
        if known is None:
            self.ask()
            return
        with self._lock:
            self.columns = []
            self._set_shown(B)
            self.engine.recall(known)
            self._said = ""
            self._before, self._last, self.now = None, known, known
            if self.visited[-1:] != [settings]:
                self.visited.append(settings)
            self._show()
        self.comparing.value = ""

    def undo(self) -> None:
        """Go back to the answer before."""
        if self.visited and self.settings() == self.visited[-1]:
            self.visited.pop()
        if self.visited:
            self.bring_back(self.visited[-1])

    def reset(self) -> None:
        """All knobs as they were at first."""
        self.knobs.take(self._first)
        self.ask()

    def find_trust(self) -> None:
        """Find how far the answer that is shown can be trusted."""
        self.engine.find_trust(self._final())
        self._word("finding σ ...")

    def _final(self) -> Answer:
        if self.answer is None or self.answer.stage != FINAL:
            raise ValueError("the last answer is still to come")
        return self.answer

    # What is compared --------------------------------------------------------------------

    def compare(self, what: str) -> None:
        """Solve five λ around this one ("lam") or each "regulariser", and show them in columns."""
        if not what:
            with self._lock:
                if self.columns:
                    self.columns = []
                    self._show()
            return
        now = self._final()
        if what == "lam":
            values: list[Any] = [float(f"{now.settings.lam * times:.2g}") for times in LAMS]
            labels = [f"λ {value:g}" for value in values]
        else:
            values = labels = ["first", "second", *(["curvature"] if now.settings.xi == "1/d" else [])]
        several = [replace(now.settings, **{what: value}) for value in values]
        self.columns = [
            (label, now if one == now.settings else None) for label, one in zip(labels, several, strict=True)
        ]

        def tell(number: int, answer: Answer) -> None:
            with self._lock:
                if self.columns:
                    self.columns[number] = labels[number], answer
                    if all(dot.settings != answer.settings for dot in self.dots):
                        self._dot(answer, None)
                    self._show()

        self.engine.compare(now, several, tell)
        self._show()

    def keep(self) -> None:
        """Keep what is shown as A, to compare; from now on it stands beside what is shown."""
        self.kept = self._final()
        self.keeper.description = "drop A"
        self.shown.layout.display = None
        self.shown.value = BESIDE

    def drop(self) -> None:
        """Forget A."""
        self.shown.value, self.kept = B, None
        self.keeper.description, self.shown.layout.display = "keep as A", "none"
        self.redraw()

    def show(self, which: str) -> None:
        """Show A, B, or both; knobs, code and export are of the one that is shown, of both of B."""
        with self._lock:
            self._said = ""
            self._set_shown(which)
            if self.answer is not None:
                self.knobs.take(self.answer.settings)
                self._show()

    def _set_shown(self, which: str) -> None:
        self.shows = which
        self.shown.value = which

    def _press(self, key: Sequence[Any]) -> None:
        """Do what a key is for."""
        frames, kept = len(self._pictures), self.kept is not None
        name = str(key[0]) if key else ""
        if name in ("n", "p") and frames > 1:
            index = self.knobs.frame + (1 if name == "n" else -1)
            self.knobs["scene"].value = min(max(index, 0), frames - 1)
        elif name in ("b", "d", "x") and kept:
            {
                "b": lambda: self.show(A if self.shows == B else B),
                "d": lambda: self.show(BESIDE),
                "x": self.drop,
            }[name]()
        elif name in ("a", "c", "r", "u", "z"):
            {"a": self.keep, "c": self._press_compare, "r": self.reset, "u": self.undo, "z": self.undo}[
                name
            ]()

    def _press_compare(self) -> None:
        self.comparing.value = "" if self.columns else "lam"

    # What is shown -----------------------------------------------------------------------

    def _guarded(self, action: Callable[..., object]) -> Callable[..., None]:
        """Say what goes wrong in the status line."""

        def guarded(*given: Any) -> None:
            try:
                action(*given)
            except Exception as error:
                self._refuse(sentence_of(error))

        return guarded

    def _refuse(self, sentence: str) -> None:
        self._word(sentence, "endolab-wrong")

    def _word(self, text: str, kind: str = "") -> None:
        self._said = f'<span class="endolab-status {kind}">{html.escape(text)}</span>'
        self.status.value = self._said

    def _view(self) -> View:
        knobs, answer = self.knobs, self.answer
        picture = None if answer is None else _picture_of(answer.settings)
        dots = [dot for dot in self.dots if dot.picture == picture]
        return View(knobs["across"].value == "row", knobs["section"].value / 100, dots=dots)

    def picture(self) -> Any:
        """The six panels of the one answer, (H, W, 3) bytes."""
        if self.answer is None:
            raise ValueError("there is no answer to show yet")
        return self._of_one(self.answer).picture

    def _pixels(self) -> tuple[tuple[int, int], int]:
        wide, tall = (int(one * self._ratio) for one in self._room)
        return (wide, tall), round(self._ratio * (LARGE_TEXT if self._room[0] > LARGE else TEXT))

    def _of_one(self, answer: Answer) -> Board:
        return of_one(answer, self.names, self._view(), *self._pixels())

    def _composed(self, answer: Answer) -> tuple[Board, bool]:
        """What is on the board, and whether that is the one answer alone."""
        if self.columns:
            return of_several(self.columns, answer, self._view(), *self._pixels()), False
        if self.kept is not None and self.shows == BESIDE and comparable(self.kept, answer):
            return of_two(self.kept, answer, self._view(), *self._pixels()), False
        return self._of_one(answer), True

    def redraw(self) -> None:
        """Draw what there is again."""
        with self._lock:
            self._show()

    def _show(self) -> None:
        """Show the one answer: panels, surface, code and status line."""
        answer = self.answer
        if answer is None:
            return
        self.board, alone = self._composed(answer)
        said = [html.escape(f"{self.shows}: " * (self.kept is not None) + summary(answer))]
        said += [
            f'<span class="endolab-warning">{html.escape(one)}</span>'
            for one in warnings(answer, self._before)
        ]
        self.status.value = self._said or f'<span class="endolab-status">{" ".join(said)}</span>'
        self.code.value = self.python()
        self._send_board(self.board, alone)
        self._show_surface(answer, alone)

    def _send_board(self, board: Board, alone: bool) -> None:
        height, width = board.picture.shape[:2]
        cells = []
        for number, place in enumerate(board.places):
            boxes = {"box": place.box, "spot": place.spot}
            shares = {
                name: box and [box[0] / width, box[1] / height, box[2] / width, box[3] / height]
                for name, box in boxes.items()
            }
            cells.append({**shares, "name": self.names[number] if alone else ""})
        known = self.answer is not None and self.answer.truth is not None
        with self.view.hold_sync():
            self.view.ratio, self.view.size, self.view.cells = self._ratio, [width, height], cells
            self.view.choices = [name for name in PANELS if known or name != "error"] if alone else []
            self.view.value = jpeg(board.picture)
        self._say(self.view.hover)

    def _show_surface(self, answer: Answer, alone: bool) -> None:
        layout = self.surface.layout
        if not alone or "3D" not in self.names or self.board is None:
            layout.display = "none"
            return
        spot = self.board.places[self.names.index("3D")].box
        text, ratio = self._pixels()[1], self._ratio
        with layout.hold_sync():
            layout.left, layout.top = f"{spot[0] / ratio:.0f}px", f"{(spot[1] + 2 * text) / ratio:.0f}px"
            layout.width = f"{(spot[2] - spot[0]) / ratio:.0f}px"
            layout.height = f"{(spot[3] - spot[1] - 2 * text) / ratio:.0f}px"
            layout.display = None
        name = self.knobs["texture"].value
        panel = PANELS[name](answer, View())
        lies = panel.picture if name != "frame" and isinstance(panel, Map) else answer.result.problem.shown
        show_on(self.surface, answer.result, lies, name == "frame")

    def _unfold(self) -> None:
        self.advanced.layout.display = None if self.advanced.layout.display == "none" else "none"

    # What the page says ------------------------------------------------------------------

    def _measured(self, room: Sequence[Any]) -> None:
        """Take the size of the page, and send it the board whatever it has."""
        values = [float(one) for one in room[:3]]
        if len(values) < 3 or not all(math.isfinite(one) and one > 0 for one in values):
            raise ValueError(f"the room of a board is three positive numbers, got {list(room)}")
        wide = max(values[0], LEAST_ROOM[0])
        with self._lock:
            self._room = wide, min(max(values[1], LEAST_ROOM[1]), TALLEST * wide)
            self._ratio = min(max(values[2], 1.0), 3.0)
            self._show()
            # It may have been made while a picture was on its way, and have missed that.
            self.view.send_state(["value", "size", "ratio", "cells", "choices"])

    def _say(self, where: Sequence[Any]) -> None:
        """Tell what all panels say of a point of their maps."""
        if self.board is None or len(where) != 2:
            self.view.said = []
            return
        x, y = (min(max(float(one), 0.0), 1.0) for one in where)
        self.view.said = [place.says(x, y) for place in self.board.places]

    def _choose(self, chosen: Sequence[Any]) -> None:
        """Show something else in a panel."""
        index, name = int(chosen[0]), str(chosen[1])
        if name not in PANELS or not 0 <= index < len(self.names):
            raise ValueError(f"there is no panel {name!r}")
        self.names[index] = name
        self.redraw()
        if name in NEED_TRUST and self.answer is not None and self.answer.trust is None:
            self.find_trust()

    def _point(self, where: Sequence[Any]) -> None:
        """Lay the section through a point of a map, take a dot of the λ curve, or one of what is compared."""
        x, y, pressed, _ = (float(one) for one in where)
        if self.board is None or not (math.isfinite(x) and math.isfinite(y)):
            return
        height, width = self.board.picture.shape[:2]
        at = x * width, y * height
        place = self.board.at(*at)
        if place is None:
            return
        if self.columns:
            if pressed:
                self.knobs.take(place.answer.settings)
                self.ask()
        elif place.spot is not None:
            left, top, right, bottom = place.spot
            share = (
                (at[1] - top) / (bottom - top)
                if self.knobs["across"].value == "row"
                else (at[0] - left) / (right - left)
            )
            knob = self.knobs["section"]
            knob.value = min(max(knob.step * round(100 * share / knob.step), 0.0), 100.0)
        elif pressed and place.dots:
            away = [
                math.hypot(at[0] - dot[0], at[1] - dot[1]) for dot in place.dots[: len(self._view().dots)]
            ]
            if away and min(away) < NEAR * self._ratio:
                self.bring_back(self._view().dots[int(np.argmin(away))].settings)

    # What is written ---------------------------------------------------------------------

    def python(self) -> str:
        """Return the Python that makes the one answer, imports included."""
        source = 'calibration = el.Calibration.load("endoscope.json")  # the one given to the tuner'
        imports = IMPORTS
        for name, known in datasets.CALIBRATIONS.items():
            if known == self._calibration:
                source = f"calibration = datasets.load_calibration({name!r})"
                imports = f"{IMPORTS}from endolab import datasets\n"
        if self.answer is None:
            raise ValueError("there is no answer to write yet")
        settings, frame, lines = self.answer.settings, self.answer.subject.frame, [imports, source]
        if settings.scene is None:
            lines.append(f"frame = el.read_frame({frame.name!r}, calibration)")
        return "\n".join([*lines, settings.code(self._calibration, frame.image.ndim == 2), ""])

    def export(self, folder: str | Path, *, overwrite: bool = False, timeout: float = 600.0) -> Path:
        """Write all there is about the one answer into a folder; one on its way is waited for.

        That is `board.png`, `result.py`, `settings.json`, `recording.rrd`, and what `save_result` writes;
        all or none. It is solved once more, to be recorded. A folder that holds files of others is written
        into only if `overwrite`.
        """
        from endolab.recording.recorder import record

        if self.answer is None or self.answer.stage != FINAL:
            self.engine.wait(timeout)
        answer = self._final()
        calibration = self._calibration if answer.settings.scene is None else answer.subject.calibration
        with staged_folder(folder, overwrite=overwrite) as staging:
            with record(staging / "recording.rrd") as recorder:
                self.engine.cold(answer.settings, [recorder])
                if answer.trust is not None:
                    recorder.add_trust(answer.trust, answer.result)
            write_files(answer.result, staging, trust=answer.trust)
            write_atomically(staging / "board.png", png(self._of_one(answer).picture))
            write_atomically(staging / "result.py", self.python().encode())
            write_settings(answer.settings.saved(calibration, answer.subject.grey), staging / "settings.json")
        return Path(folder)

    def _export_aside(self) -> None:
        """Export in a thread of its own."""
        if not self.folder.value.strip():
            raise ValueError("name a folder to export into")
        folder = Path(self.folder.value.strip()).expanduser()
        self._word(f"exporting into {folder} ...")
        work = self._guarded(lambda: self._word(f"exported into {self.export(folder).resolve()}"))
        threading.Thread(target=work, name="endolab export", daemon=True).start()

    def close(self) -> None:
        """Close the widget and end its thread."""
        if hasattr(self, "engine"):  # not if it was refused
            self.engine.close()
            self.surface.close()
        close_parts(self)
        super().close()


def _picture_of(one: Settings) -> tuple[Any, ...]:
    """What was explained: data terms of the same can be compared."""
    return one.scene, one.noise, one.width, one.channel, one.smooth, one.highlights


def close_parts(widget: w.Widget) -> None:
    """Close all that a widget is made of: Jupyter keeps what is open, and with it all that it knows."""
    parts = [
        *getattr(widget, "children", ()),
        getattr(widget, "layout", None),
        getattr(widget, "style", None),
    ]
    for part in parts:
        if isinstance(part, w.Widget):
            close_parts(part)
            part.close()
