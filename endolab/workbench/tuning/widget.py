"""The tuner: knobs under a hand, the surface under its eyes.

`tune` makes a widget for JupyterLab. Its `engine` solves in threads of its own; pictures are drawn and sent
from there, those of looks beside them, so that neither a slow solve nor a running cell freezes the page.
There is one answer, `TunerBox.answer`, that all which is shown, written and exported is of.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext, suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any
from weakref import WeakSet

import anywidget
import ipywidgets as w
import numpy as np
import traitlets as t

from endolab.frames.frame import Frame
from endolab.io import datasets
from endolab.io.atomic import stage_folder, write_atomically
from endolab.io.images import read_frame, write_image
from endolab.io.settings import write_settings
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import check_int, check_kinds, excerpt, unknown_name
from endolab.reconstruction.settings import Settings
from endolab.synthetic.scenes import SCENES
from endolab.workbench.reports.result import write_files
from endolab.workbench.tuning.boards import (
    Board,
    are_comparable,
    draw_answer,
    draw_columns,
    draw_frame,
    draw_pair,
)
from endolab.workbench.tuning.controls import knob_specs
from endolab.workbench.tuning.engine import Answer, Stage, Tuner, sentence_of, values_of_lam
from endolab.workbench.tuning.panels import (
    NEED_UNCERTAINTY,
    PANELS,
    USUAL_PANELS,
    View,
)
from endolab.workbench.tuning.pictures import DARK, DRAWING, WHOLE, Chart, Window, jpeg
from endolab.workbench.tuning.sentences import is_too_smooth, summary, warnings
from endolab.workbench.tuning.source import Knobs, Source
from endolab.workbench.tuning.surface_view import SurfaceView
from endolab.workbench.tuning.tried import Tried


@dataclass(frozen=True)
class BoardLook:
    """The tuner's board and what it remembers, chosen by hand on a laptop's screen and a large one."""

    room: tuple[float, float] = (1176.0, 620.0)  # px, before the page tells its own
    least_room: tuple[float, float] = (420.0, 300.0)
    tallest: float = 0.75  # of a board, over its width
    text: int = 12  # px, of letters
    click_radius: int = 12  # px around a dot in which a click takes it
    widths: tuple[int, ...] = (160, 320, 480, 640)  # px, to choose among
    least_zoom: float = 0.02  # share of a map's side that can be looked at


BOARD = BoardLook()
# Knobs that change what is seen and not what is solved.
VIEW_KNOBS = {"section": 50.0, "across": False, "texture": "frame"}
PAPER = {"channel": "green", "solver": "primal_dual", "regulariser": "second"}
# Options beside the defaults, by what the page calls them.
PRESETS: dict[str, dict[str, Any]] = {
    "default": {},
    "paper": PAPER | {"contours": False, "highlights": "keep"},
    "fastest": {"channel": "green", "solver": "fast_marching"},
}
# What the page may ask for, each a method.
ACTIONS = {
    "blink",
    "choose",
    "compare",
    "drop",
    "export_aside",
    "find_uncertainty",
    "keep",
    "measure",
    "preset",
    "press",
    "reset",
    "show",
    "step",
    "undo",
}


@check_kinds(frame=Frame, calibration=Calibration)
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

    Returns
    -------
    TunerBox
        The widget; `box.answer` is what is on the screen.

    Raises
    ------
    ValueError
        If frame, calibration and truth do not go together, or if there is no such scene.
    """
    for name, given, kind in (
        ("frame", frame, Frame),
        ("calibration", calibration, Calibration),
    ):
        if given is not None and not isinstance(given, kind):
            raise ValueError(
                f"{name} must be an endolab {kind.__name__}, got {excerpt(given)}"
            )
    if scene not in SCENES:
        raise unknown_name("scene", scene, SCENES)
    check_int("width", width, 1)
    truth = None if truth is None else np.asarray(truth)
    calibration = calibration or datasets.load_calibration("paper")
    return TunerBox(frame, calibration, truth, scene, width)


class TunerBox(anywidget.AnyWidget):
    """The tuner's widget; `tune` makes it.

    `engine` solves what `knobs` say, of which a dict can be set. `now` is the last answer, B if A was kept,
    `kept` is A, and `answer` the one of them that is shown. `pictures` are frames to choose among, of which
    `frame` is the first.
    """

    _esm = Path(__file__).with_name("tuner.js")
    _css = Path(__file__).with_name("tuner.css")
    specs: t.List[Any] = t.List().tag(sync=True)  # of the knobs
    knobs: t.Dict[str, Any] = t.Dict().tag(sync=True)  # their values
    # "text"; "warnings", each a "chip" and its "text"; whether it is "wrong", and whether too "low" a share
    # of the contrast is explained.
    line: t.Dict[str, Any] = t.Dict().tag(sync=True)
    code = t.Unicode().tag(sync=True)
    shows = t.Unicode().tag(sync=True)  # A, B or both, if A is kept
    compared = t.Unicode().tag(sync=True)  # the knob whose values stand in columns
    surface: t.Instance[SurfaceView] = t.Instance(SurfaceView).tag(
        sync=True, **w.widget_serialization
    )
    # The board: a JPEG; its width and height in px of the screen, and how many of these a px of the page has;
    # of each panel its "box", the "spot" of its map or None, both in shares of the board, and its "name".
    picture = t.Bytes().tag(sync=True)
    size: t.List[Any] = t.List([0, 0, 1]).tag(sync=True)
    cells: t.List[Any] = t.List().tag(sync=True)
    choices = t.List([*PANELS]).tag(sync=True)  # what panels can show
    cursor_texts: t.List[str] = t.List().tag(sync=True)  # of each panel, at the cursor
    cursor_marks: t.List[Any] = t.List().tag(
        sync=True
    )  # where the cursor's point is in each chart, or []
    presets = t.List([*PRESETS]).tag(sync=True)
    # Of the last run: how many iterates can be looked at, which one is (from 1), and what is said of it.
    path = t.Int().tag(sync=True)
    path_place = t.Int().tag(sync=True)
    path_text = t.Unicode().tag(sync=True)
    # From the page: where the cursor is in its map, or nothing; a point of the board to which it was dragged.
    hover: t.List[float] = t.List().tag(sync=True)
    # Likewise: which part of the maps it wants to see, and which iterate of the last run.
    window: t.List[float] = t.List([*WHOLE]).tag(sync=True)
    scrub = t.Int().tag(sync=True)
    drag: t.List[float] = t.List().tag(sync=True)

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
        self.passed: Answer | None = None  # an iterate of the last run that is looked at
        self._told: WeakSet[Answer] = WeakSet()
        self.visited: list[Knobs] = []  # for undo
        self.tried: list[Tried] = []
        self.names = list(USUAL_PANELS)  # of the panels
        self.board = Board(np.zeros((1, 1, 3), np.uint8), [])
        self.frame = 0  # which of `pictures` is looked at
        self._wish: Knobs | None = None  # the last one
        self._calibration = calibration
        self._pictures = list(pictures)
        # The solver's thread shows, the kernel's hears the page: not while several things are being changed.
        self._lock = threading.RLock()
        self._room = BOARD.room
        self._ratio = 1.0
        self._look = DRAWING
        self._keeps_next = False  # whether the answer to come shall be A
        self._drawings = 0  # that were begun
        self._painter = ThreadPoolExecutor(1, "endolab tuner pictures")
        self._to_paint: dict[str, Any] | None = None  # the line that a look replaces
        self.engine = Tuner(calibration, self._take, self._refuse, frame=frame, truth=truth)
        scenes: list[tuple[str, str | int]] = [(name, name) for name in SCENES]
        start = Knobs(scene=scene, width=width)
        shown: str | int = scene
        if frame is not None:
            start = Knobs(scene=None, width=width, channel="auto")
            shown = 0
            names = [frame.name, *(path.name for path in self._pictures[1:])]
            scenes = [(name, number) for number, name in enumerate(names)] + scenes
        self._first = vars(start) | VIEW_KNOBS | {"scene": shown}
        # What the knobs cannot know: the choices, and what None stands for.
        known: dict[str, dict[str, Any]] = {
            "scene": {"options": scenes},
            "width": {"options": sorted({*BOARD.widths, width})},
            "k": {"first": calibration.photometry.k},
            "gamma": {"first": calibration.photometry.gamma},
        }
        specs = [spec | known.get(spec["name"], {}) for spec in knob_specs()]
        super().__init__(specs=specs, knobs=self._first, surface=SurfaceView())
        self.on_msg(lambda _, message, buffers: self._guard(self._act)(*message))
        self.observe(self._guard(self._follow_knobs), "knobs")
        self.observe(self._guard(lambda change: self._say(change["new"])), "hover")
        self.observe(self._guard(lambda change: self._show()), "window")
        self.observe(self._guard(self._follow_scrub), "scrub")
        self.observe(self._guard(lambda change: self._cut(*change["new"])), "drag")
        self.ask()
        with self._lock:
            if self.now is None:
                self._show_frame()

    def set_state(self, sync_data: dict[str, Any]) -> None:
        """Hear what the page says, not while several things are being sent: part of them would be lost."""
        with self._lock:
            super().set_state(sync_data)

    def _guard(self, action: Callable[..., object]) -> Callable[..., None]:
        """Say what goes wrong in the status line."""

        def call(*given: Any) -> None:
            try:
                with self._lock:
                    action(*given)
            except Exception as error:
                self._refuse(sentence_of(error))

        return call

    def _act(self, name: str, *given: Any) -> None:
        if name not in ACTIONS:
            raise ValueError(f"there is no action {name!r}")
        getattr(self, name)(*given)

    # What is solved ----------------------------------------------------------------------

    @property
    def answer(self) -> Answer | None:
        """The one answer that is shown, or whose path is."""
        return self.kept if self.shows == "A" else self.now

    def settings(self) -> Knobs:
        """Return what the knobs say; ValueError, in one sentence, if a line cannot be read."""
        values = {name: self.knobs[name] for name in self.knobs if name not in VIEW_KNOBS}
        if not isinstance(values["scene"], str):
            values["scene"] = None
        return Knobs(**values)

    def ask(self) -> None:
        """Ask the engine for what the knobs say; returns at once."""
        self._wish = self.settings()
        self._leave_comparison()
        self.passed = None
        self.engine.ask(self._wish)

    def _follow_knobs(self, change: dict[str, Any]) -> None:
        """Follow the knobs."""
        scene = self.knobs["scene"]
        if isinstance(scene, int) and scene != self.frame:
            self._open(scene)
        if self.settings() != self._wish:
            self.ask()
        elif any(self.knobs[name] != change["old"][name] for name in VIEW_KNOBS):
            self._show()

    def _set_knobs(self, settings: Knobs) -> None:
        """Have the knobs say what settings do, and ask for nothing; which frame is looked at stays."""
        self._wish = settings
        scene = self.frame if settings.scene is None else settings.scene
        self.knobs = self.knobs | vars(settings) | {"scene": scene}

    def _open(self, index: int) -> None:
        """Look at another frame; one that cannot be used is passed by with a sentence, and the last stays."""
        try:
            frame = read_frame(self._pictures[index], self._calibration)
        except (OSError, ValueError, MemoryError) as error:
            self.knobs = self.knobs | {"scene": self.frame}
            sentence = f"{sentence_of(error)}: the frame before is still shown"
            raise ValueError(sentence) from error
        self.engine.source = Source(self._calibration, frame)
        self.frame = index
        self.visited = []
        self.tried = []
        self._wish = None
        self.window = [*WHOLE]
        self.drop()

    def step(self, by: int) -> None:
        """Look at the next frame, or the one before."""
        index = self.frame + by
        if 0 <= index < len(self._pictures):
            self.knobs = self.knobs | {"scene": index}

    def _take(self, answer: Answer) -> None:
        """Show an answer; in the engine's thread. Of one that is there already, more is known now."""
        try:
            with self._lock:
                is_new = answer not in (self.now, self.kept)
                if is_new and answer in self._told:
                    return  # more is known of an answer that was left
                self._accept(answer, is_new)
                if answer.stage == Stage.FINAL and self._keeps_next:
                    self.keep()
                    return
                line = self.line if is_new else {}
                if answer.stage == Stage.LOOK:
                    if self._to_paint is None:
                        self._painter.submit(self._paint)
                    self._to_paint = line
                    return
            self._show(line, meanwhile=True)
        except Exception as error:
            self._refuse(sentence_of(error))

    def _paint(self) -> None:
        """Show the last look, while the next one is solved; those that came too fast are left out."""
        try:
            with self._lock:
                line = self._to_paint
                self._to_paint = None
            self._show(line, meanwhile=True)
        except Exception as error:
            self._refuse(sentence_of(error))

    def _accept(self, answer: Answer, is_new: bool) -> None:
        """Take an answer as the present one, and note what a final one says of λ."""
        if is_new:
            self.now = answer
            self._told.add(answer)
            if answer.stage == Stage.FINAL and self.visited[-1:] != [answer.settings]:
                self.visited.append(answer.settings)
        if answer.stage == Stage.FINAL:
            for one in (*answer.variants.values(), answer):  # this one at the end
                self._note(Tried.of(one))

    def _note(self, tried: Tried) -> None:
        """Have an answer among those on the λ curve."""
        known = tried.settings, tried.contours
        others = [one for one in self.tried if (one.settings, one.contours) != known]
        self.tried = [*others, tried]

    def bring_back(self, settings: Knobs) -> None:
        """Ask for the answer of these settings once more."""
        self._set_knobs(settings)
        self.ask()

    def undo(self) -> None:
        """Go back to the answer before."""
        if len(self.visited) > 1 and self.settings() == self.visited[-1]:
            self.visited.pop()
        if self.visited:
            self.bring_back(self.visited[-1])

    def reset(self) -> None:
        """All knobs as they were at first."""
        self.knobs = self._first | ({"scene": self.frame} if self._pictures else {})

    def preset(self, name: str) -> None:
        """Set all options of a reconstruction at once; the frame and what is believed stay."""
        options = {part.name for part in fields(Settings)} - {"width"}
        first = {key: value for key, value in self._first.items() if key in options}
        self.knobs = self.knobs | first | PRESETS[name]

    def _follow_scrub(self, change: dict[str, Any]) -> None:
        """Follow the slider of the path; 0 is nobody's wish."""
        if change["new"]:
            self.iterate(change["new"])

    def iterate(self, place: int) -> None:
        """Look at an iterate of the last run, from 1; the last one is the answer again."""
        answer = self._final()
        if not 1 <= place <= len(answer.path):
            raise ValueError(f"there are {len(answer.path)} iterates, got {place}")
        self.passed = None
        if place < len(answer.path):
            self.passed = answer.pass_by(place - 1)
        self._leave_comparison()
        self._show()

    def find_uncertainty(self) -> None:
        """Find how far the answer that is shown can be trusted."""
        answer = self._final_alone()
        if answer.uncertainty is None:
            self.engine.find_uncertainty(answer)
            self._tell("finding σ ...")

    def _final(self) -> Answer:
        if self.answer is None or self.answer.stage != Stage.FINAL:
            raise ValueError("the last answer is still to come")
        return self.answer

    def _final_alone(self) -> Answer:
        """Return the final answer, for a job that would drop a wish: there must be none."""
        if self.engine.waits:
            raise ValueError("the last answer is still to come")
        return self._final()

    # What is compared --------------------------------------------------------------------

    def compare(self, what: str) -> None:
        """Show five λ around this ("lam") or each "regulariser" in columns; "" ends that."""
        if what:
            now = self._final_alone()
            if not now.uses_lam:
                raise ValueError(f"{now.settings.solver} has neither λ nor a regulariser")
            self.passed = None
            several = _compared_settings(now.settings, what)
            self.engine.compare(now, several)
        self.compared = what
        self._show()

    def _columns(self, answer: Answer) -> dict[str, Answer | None]:
        """What is compared, by the names of its columns; None is still to come."""
        several = _compared_settings(answer.settings, self.compared)
        return {
            label: answer if one == answer.settings else answer.variants.get(label)
            for label, one in several.items()
        }

    def keep(self) -> None:
        """Keep what is shown as A, to compare, once it is final; then it stands beside what is shown."""
        is_final = self.answer is not None and self.answer.stage == Stage.FINAL
        self._keeps_next = self.engine.waits or not is_final
        if self._keeps_next:
            self._show()
            return
        self.kept = self._final()
        self.show("A beside B")

    def drop(self) -> None:
        """Forget A."""
        self.kept = None
        self.shows = ""
        self._keeps_next = False
        self._show()

    def show(self, which: str) -> None:
        """Show A, B, or both; knobs, code and export are of the one that is shown, of both of B."""
        if self.kept is None:
            return
        self._leave_comparison()
        self.passed = None
        self.shows = which
        if self.answer is not None:
            self._set_knobs(self.answer.settings)
        self._show()

    def blink(self) -> None:
        """Show the other of A and B."""
        self.show("A" if self.shows == "B" else "B")

    def _leave_comparison(self) -> None:
        """From columns, or from A, to the present answer."""
        self.compared = ""
        if self.shows == "A":
            self.shows = "B"

    # What is shown -----------------------------------------------------------------------

    def _refuse(self, sentence: str) -> None:
        self._tell(sentence, wrong=True)

    def _tell(self, text: str, wrong: bool = False) -> None:
        with self._lock:
            self.line = {"text": text, "wrong": wrong}

    def _view(self) -> View:
        """How an answer is looked at; if A was kept, on its scales."""
        wide, tall = (int(side * self._ratio) for side in self._room)
        return View(
            line=(self.knobs["across"], self.knobs["section"] / 100),
            like=self.kept,
            tried=self.tried,
            room=(wide, tall),
            text=round(self._ratio * BOARD.text),
            zoom=self._zoom(),
            look=self._look,
        )

    def _zoom(self) -> Window:
        """The part of the maps that the page wants to see, but not less than can be looked at."""
        left, top, right, bottom = np.clip(self.window, 0, 1).tolist()
        left, top = (min(low, 1 - BOARD.least_zoom) for low in (left, top))
        return (
            left,
            top,
            max(right, left + BOARD.least_zoom),
            max(bottom, top + BOARD.least_zoom),
        )

    def _show_frame(self) -> None:
        """Show the frame, as there is no answer yet."""
        with suppress(ValueError):  # which the answer will say
            subject = self.engine.source.subject(self.settings())
            board = draw_frame(subject.frame.image, self._view())
            self._send_board(board, [], jpeg(board.picture))

    def _send_board(self, board: Board, names: Sequence[str], picture: bytes) -> None:
        """Have the page show a board."""
        self.board = board
        height, width = board.picture.shape[:2]
        with self.hold_sync():
            self.size = [width, height, self._ratio]
            self.cells = board.cells(names)
            self.picture = picture

    def _draw(self, answer: Answer, view: View) -> tuple[Board, Sequence[str]]:
        """The board, and the names of its panels, if they can be chosen."""
        kept = self.kept
        if self.compared:
            return draw_columns(self._columns(answer), answer, view), []
        if self.shows == "A beside B" and kept and are_comparable(kept, answer):
            return draw_pair(kept, answer, view), []
        names = [*self.names]
        return draw_answer(answer, names, view), names

    def _show(self, line: dict[str, Any] | None = None, meanwhile: bool = False) -> None:
        """Show the one answer, alone or beside others: panels, surface, code and status line.

        Drawing takes longest. `meanwhile` the page is heard, if another thread draws; and if that made
        another picture necessary, this one is dropped. What was refused stays to be read, unless it is the
        `line` that is to be replaced, by default the present one.
        """
        with nullcontext() if meanwhile else self._lock:
            self._draw_and_send(line)

    def _draw_and_send(self, line: dict[str, Any] | None) -> None:
        with self._lock:
            answer = self.passed or self.answer
            if answer is None:
                return
            self._drawings += 1
            number = self._drawings
            replaced = self.line if line is None else line
            view = self._view()
            texture = self.knobs["texture"]
        board, names = self._draw(answer, view)
        picture = jpeg(board.picture)
        lies = None
        if "3D" in names and texture != "frame":
            lies = PANELS[texture](answer, view).picture
        with self._lock:
            if number != self._drawings:
                return
            with self.hold_sync():  # one message, as a page draws anew with each
                if self.line is replaced or not self.line.get("wrong"):
                    self.line = self._line(answer)
                self.code = self.python()
                self._tell_path()
                self._send_board(board, names, picture)
            self._say(self.hover)
        if "3D" in names:
            moving = answer.stage in (Stage.LOOK, Stage.PASSED)
            self.surface.show(answer.result, lies, moving)

    def _line(self, answer: Answer) -> dict[str, Any]:
        """What is said of an answer."""
        text = summary(answer, self.tried)
        if self.compared:
            columns = self._columns(answer).values()
            found = sum(one is not None for one in columns)
            text = f"{found} of {len(columns)} · {text}"
        elif self.shows:
            text = f"{self.shows}: {text}"
        elif self._keeps_next:
            text = f"to be kept as A: {text}"
        before = [one for one in self.tried if one.settings != answer.settings]
        found_out = warnings(answer, before[-1] if before else None)
        return {
            "text": text,
            "low": is_too_smooth(answer),
            "warnings": [{"chip": one.chip, "text": one.sentence} for one in found_out],
        }

    def _tell_path(self) -> None:
        """Tell the page which iterate of the last run is shown."""
        answer = self.answer
        count = (
            len(answer.path) if answer is not None and answer.stage == Stage.FINAL else 0
        )
        self.path = count
        self.path_place = count
        self.path_text = ""
        if self.passed is None:
            self.scrub = 0  # so that the same place is heard again
        else:
            self.path_place = self.passed.place
            self.path_text = f"{self.passed.place} of {count}"

    # What the page says ------------------------------------------------------------------

    def measure(
        self, width: float, height: float, ratio: float, dark: bool = False
    ) -> None:
        """Take the size of the page, px, and the screen's ratio to it; send it the board whatever it has."""
        wide = max(width, BOARD.least_room[0])
        self._room = wide, min(max(height, BOARD.least_room[1]), BOARD.tallest * wide)
        self._ratio = min(max(ratio, 1.0), 3.0)
        self._look = DARK if dark else DRAWING
        if self.answer is None:
            self._show_frame()
        self._show()
        # It may have been made while a picture was on its way, and have missed that.
        self.send_state(["picture", "size", "cells"])

    def _say(self, where: Sequence[float]) -> None:
        """Tell what all panels say of a point of their maps, and show it in the section and in 3D."""
        texts = []
        marks = []
        self.surface.marker = []
        for place in self.board.places if where else []:
            i, j = place.pixel(*where)
            texts.append(place.says(i, j))
            marks.append(place.mark(i, j))
            point = place.answer.result.points[i, j]
            if np.all(np.isfinite(point)):
                self.surface.marker = point.tolist()
        with self.hold_sync():
            self.cursor_texts = texts
            self.cursor_marks = marks

    def choose(self, index: int, name: str) -> None:
        """Show something else in a panel."""
        self.names[index] = name
        self._show()
        if name in NEED_UNCERTAINTY:
            self.find_uncertainty()

    def press(self, x: float, y: float) -> None:
        """Lay the section through a point of a map, take a dot of the λ curve, or one of what is compared."""
        place = self.board.at(x, y)
        if place is None:
            return
        if self.compared:
            self.bring_back(place.answer.settings)
        elif isinstance(place.panel, Chart) and len(place.dots):
            height, width = self.board.picture.shape[:2]
            away = np.linalg.norm((place.dots - (x, y)) * (width, height), axis=1)
            brings = [dot.brings for dot in place.panel.dots]
            away[[one is None for one in brings]] = np.inf
            nearest = int(away.argmin())
            if away[nearest] < BOARD.click_radius * self._ratio:
                self.bring_back(brings[nearest])
        else:
            self._cut(x, y)

    def _cut(self, x: float, y: float) -> None:
        """Lay the section through a point of a map."""
        place = self.board.at(x, y)
        if place is None or place.spot is None or self.compared:
            return
        left, top, right, bottom = place.spot
        row, column = place.pixel((x - left) / (right - left), (y - top) / (bottom - top))
        height, width = place.answer.result.mask.shape
        share = (column + 0.5) / width
        if self.knobs["across"]:
            share = (row + 0.5) / height
        self.knobs = self.knobs | {"section": round(1000 * share) / 10}

    # What is written ---------------------------------------------------------------------

    def python(self) -> str:
        """Return the Python that makes the one answer, imports included."""
        if self.answer is None:
            raise ValueError("there is no answer to write yet")
        return self._code_of(self.answer)

    def _code_of(self, answer: Answer) -> str:
        source = 'calibration = el.load_calibration("endoscope.json")  # the one given to the tuner'
        for name, known in datasets.CALIBRATIONS.items():
            if known == self._calibration:
                source = f"calibration = el.load_calibration({name!r})"
        settings = answer.settings
        subject = answer.subject
        lines = ["from dataclasses import replace\n\nimport endolab as el\n", source]
        if settings.scene is None:
            lines.append(f"frame = el.read_frame({subject.frame.name!r}, calibration)")
        return "\n".join([*lines, settings.code(subject), ""])

    def export(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write all there is about the one answer into a folder.

        That is `board.png`, `result.py`, `settings.json`, `recording.rrd`, and what `save_result` writes;
        all or none. It is solved once more, to be recorded. A folder that holds files of others is written
        into only if `overwrite`.
        """
        with self._lock:
            answer = self._final()
        return self._export(answer, folder, overwrite)

    def _export(self, answer: Answer, folder: str | Path, overwrite: bool = False) -> Path:
        from endolab.workbench.recording.recorder import record

        with self._lock:
            code = self._code_of(answer)
            board = draw_answer(answer, self.names, self._view())
        settings = answer.settings
        subject = answer.subject
        uncertainty = answer.uncertainty
        with stage_folder(folder, overwrite=overwrite) as staging:
            with record(staging / "recording.rrd") as recorder:
                self.engine.solve_cold(settings, [recorder], subject)
                if uncertainty is not None:
                    recorder.add_uncertainty(uncertainty, answer.result)
            write_files(answer.result, staging, uncertainty=uncertainty)
            write_image(staging / "board.png", board.picture / 255)
            write_atomically(staging / "result.py", code.encode())
            write_settings(settings.solving_settings(subject), staging / "settings.json")
        return Path(folder)

    def export_aside(self, name: str) -> None:
        """Export, in the engine's thread, whatever is asked for meanwhile."""
        if not name.strip():
            raise ValueError("name a folder to export into")
        folder = Path(name.strip()).expanduser()
        answer = self._final_alone()  # whatever else is answered before the export begins
        self._tell(f"exporting into {folder} ...")

        def job(is_stale: object) -> None:
            self._tell(f"exported into {self._export(answer, folder).resolve()}")

        self.engine.do(job, f"the export into {folder}")

    def close(self) -> None:
        """Close the widget and end its thread."""
        if hasattr(self, "engine"):  # not if it was refused
            self.engine.close()
            self._painter.shutdown()
            self.surface.close()
            self.layout.close()
        super().close()


def _compared_settings(settings: Knobs, knob: str) -> dict[str, Knobs]:
    """Settings that differ by a knob, "lam" or "regulariser", by what their columns are called."""
    values: dict[str, Any] = {}
    if knob == "lam":
        values |= values_of_lam(settings.lam)
    else:
        values |= {order: order for order in ("first", "second")}
    return {label: replace(settings, **{knob: value}) for label, value in values.items()}
