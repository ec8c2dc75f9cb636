"""The tuner: knobs under a hand, the surface under its eyes.

`tune` makes a widget for JupyterLab. Its `engine` solves in a thread of its own; pictures are drawn
and sent from there, so that neither a slow solve nor a running cell freezes the page. There is one answer,
`TunerBox.answer`, that all which is shown, written and exported is of.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

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
from endolab.model.schema import unknown_name
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import check_int, excerpt
from endolab.synthetic.scenes import SCENES
from endolab.workbench.reports.result import write_files
from endolab.workbench.tuning.boards import (
    Board,
    are_comparable,
    draw_answer,
    draw_columns,
    draw_pair,
)
from endolab.workbench.tuning.controls import knob_specs
from endolab.workbench.tuning.engine import Answer, Stage, Tuner, sentence_of
from endolab.workbench.tuning.panels import (
    NEED_UNCERTAINTY,
    PANELS,
    USUAL_PANELS,
    Dot,
    View,
)
from endolab.workbench.tuning.pictures import jpeg
from endolab.workbench.tuning.sentences import summary, warnings
from endolab.workbench.tuning.source import Knobs, Source
from endolab.workbench.tuning.surface_view import SurfaceView


@dataclass(frozen=True)
class BoardLook:
    """The tuner's board and what it remembers, chosen by hand on a laptop's screen and a large one."""

    room: tuple[float, float] = (1176.0, 620.0)  # px, before the page tells its own
    least_room: tuple[float, float] = (420.0, 300.0)
    tallest: float = 0.75  # of a board, over its width
    text: int = 12  # px, of letters
    click_radius: int = 12  # px around a dot in which a click takes it
    widths: tuple[int, ...] = (160, 320, 480, 640)  # px, to choose among
    # Times the present λ, to be compared.
    lam_factors: tuple[float, ...] = (0.1, 0.32, 1.0, 3.2, 10.0)


BOARD = BoardLook()
# Knobs that change what is seen and not what is solved.
VIEW_KNOBS = {"section": 50.0, "across": False, "texture": "frame"}
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
    "press",
    "reset",
    "show",
    "step",
    "undo",
}


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
    # "text", "warnings", and whether it is "wrong".
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
    # From the page: where the cursor is in its map, or nothing; a point of the board to which it was dragged.
    hover: t.List[float] = t.List().tag(sync=True)
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
        self.columns: dict[str, Answer | None] = {}  # what is compared
        self.visited: list[Knobs] = []  # for undo
        self.dots: list[Dot] = []
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
        take = self._guard(self._take)
        self.engine = Tuner(calibration, take, self._refuse, frame=frame, truth=truth)
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
        self.observe(self._guard(lambda change: self._cut(*change["new"])), "drag")
        self.ask()

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
        """The one answer that is shown."""
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
        self.dots = []
        self._wish = None
        self.drop()

    def step(self, by: int) -> None:
        """Look at the next frame, or the one before."""
        index = self.frame + by
        if 0 <= index < len(self._pictures):
            self.knobs = self.knobs | {"scene": index}

    def _take(self, answer: Answer) -> None:
        """Show an answer; in the engine's thread. Of one that is there already, more is known now."""
        if answer not in (self.now, self.kept):
            self.now = answer
            if answer.stage == Stage.FINAL:
                self._add_dot(answer)
                if self.visited[-1:] != [answer.settings]:
                    self.visited.append(answer.settings)
        self._show()

    def _add_dot(self, answer: Answer) -> None:
        """Have an answer among the dots of the λ curve, the last one."""
        others = [dot for dot in self.dots if dot.settings != answer.settings]
        dot = Dot(answer.settings, answer.data, answer.roughness, answer.cut_count)
        self.dots = [*others, dot]

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
        """Solve five λ around this ("lam") or each "regulariser", and show them in columns; "" ends that."""
        now = self._final_alone() if what else None
        self.columns = {}
        self.compared = what
        if now is not None:
            several = {
                label: replace(now.settings, **{what: value})
                for label, value in _compared_values(now.settings, what).items()
            }
            self.columns = {
                label: now if settings == now.settings else None
                for label, settings in several.items()
            }
            self.engine.compare(now, several, self._guard(self._take_compared))
        self._show()

    def _take_compared(self, label: str, answer: Answer) -> None:
        if label in self.columns:
            self.columns[label] = answer
            if all(dot.settings != answer.settings for dot in self.dots):
                self._add_dot(answer)
            self._show()

    def keep(self) -> None:
        """Keep what is shown as A, to compare; from now on it stands beside what is shown."""
        self.kept = self._final()
        self.show("A beside B")

    def drop(self) -> None:
        """Forget A."""
        self.kept = None
        self.shows = ""
        self._show()

    def show(self, which: str) -> None:
        """Show A, B, or both; knobs, code and export are of the one that is shown, of both of B."""
        if self.kept is None:
            return
        self._leave_comparison()
        self.shows = which
        if self.answer is not None:
            self._set_knobs(self.answer.settings)
        self._show()

    def blink(self) -> None:
        """Show the other of A and B."""
        self.show("A" if self.shows == "B" else "B")

    def _leave_comparison(self) -> None:
        """From columns, or from A, to the present answer."""
        self.columns = {}
        self.compared = ""
        if self.shows == "A":
            self.shows = "B"

    # What is shown -----------------------------------------------------------------------

    def _refuse(self, sentence: str) -> None:
        self._tell(sentence, wrong=True)

    def _tell(self, text: str, wrong: bool = False) -> None:
        with self._lock:
            self.line = {"text": text, "wrong": wrong}

    def _view(self, answer: Answer) -> View:
        """How an answer is looked at, among the dots whose data terms can be compared with its own."""
        explained = answer.settings.explained_picture
        dots = [dot for dot in self.dots if dot.settings.explained_picture == explained]
        wide, tall = (int(side * self._ratio) for side in self._room)
        return View(
            line=(self.knobs["across"], self.knobs["section"] / 100),
            dots=dots,
            room=(wide, tall),
            text=round(self._ratio * BOARD.text),
        )

    def _show(self) -> None:
        """Show the one answer, alone or beside others: panels, surface, code and status line."""
        answer = self.answer
        if answer is None:
            return
        view = self._view(answer)
        names: list[str] = []
        kept = self.kept
        if self.columns:
            self.board = draw_columns(self.columns, answer, view)
        elif self.shows == "A beside B" and kept and are_comparable(kept, answer):
            self.board = draw_pair(kept, answer, view)
        else:
            names = self.names
            self.board = draw_answer(answer, names, view)
        before = [dot for dot in self.dots if dot.settings != answer.settings]
        height, width = self.board.picture.shape[:2]
        with self.hold_sync():
            self.line = {
                "text": f"{self.shows}: " * bool(self.shows) + summary(answer),
                "warnings": warnings(answer, before[-1] if before else None),
            }
            self.code = self.python()
            self.size = [width, height, self._ratio]
            self.cells = self.board.cells(names)
            self.picture = jpeg(self.board.picture)
        self._say(self.hover)
        if "3D" in names:
            name = self.knobs["texture"]
            lies = None if name == "frame" else PANELS[name](answer, view).picture
            moving = answer.stage == Stage.LOOK
            self.surface.show(answer.result, lies, moving)

    # What the page says ------------------------------------------------------------------

    def measure(self, width: float, height: float, ratio: float) -> None:
        """Take the size of the page, px, and the screen's ratio to it; send it the board whatever it has."""
        wide = max(width, BOARD.least_room[0])
        self._room = wide, min(max(height, BOARD.least_room[1]), BOARD.tallest * wide)
        self._ratio = min(max(ratio, 1.0), 3.0)
        self._show()
        # It may have been made while a picture was on its way, and have missed that.
        self.send_state(["picture", "size", "cells"])

    def _say(self, where: Sequence[float]) -> None:
        """Tell what all panels say of a point of their maps, [] of none."""
        self.cursor_texts = [place.says(*where) for place in self.board.places if where]

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
        if self.columns:
            self.bring_back(place.answer.settings)
        elif len(place.dots):
            height, width = self.board.picture.shape[:2]
            away = np.linalg.norm((place.dots - (x, y)) * (width, height), axis=1)
            dots = self._view(
                place.answer
            ).dots  # after them the chart marks the answer's own
            nearest = int(away[: len(dots)].argmin())
            if away[nearest] < BOARD.click_radius * self._ratio:
                self.bring_back(dots[nearest].settings)
        else:
            self._cut(x, y)

    def _cut(self, x: float, y: float) -> None:
        """Lay the section through a point of a map."""
        place = self.board.at(x, y)
        if place is None or place.spot is None or self.columns:
            return
        left, top, right, bottom = place.spot
        share = (x - left) / (right - left)
        if self.knobs["across"]:
            share = (y - top) / (bottom - top)
        percent = min(max(round(200 * share) / 2, 0.0), 100.0)
        self.knobs = self.knobs | {"section": percent}

    # What is written ---------------------------------------------------------------------

    def python(self) -> str:
        """Return the Python that makes the one answer, imports included."""
        if self.answer is None:
            raise ValueError("there is no answer to write yet")
        source = 'calibration = el.load_calibration("endoscope.json")  # the one given to the tuner'
        for name, known in datasets.CALIBRATIONS.items():
            if known == self._calibration:
                source = f"calibration = el.load_calibration({name!r})"
        settings = self.answer.settings
        subject = self.answer.subject
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
        from endolab.workbench.recording.recorder import record

        with self._lock:
            answer = self._final()
            code = self.python()
            board = draw_answer(answer, self.names, self._view(answer))
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
        self._final_alone()
        self._tell(f"exporting into {folder} ...")

        def job(is_stale: object) -> None:
            self._tell(f"exported into {self.export(folder).resolve()}")

        self.engine.do(job, f"the export into {folder}")

    def close(self) -> None:
        """Close the widget and end its thread."""
        if hasattr(self, "engine"):  # not if it was refused
            self.engine.close()
            self.surface.close()
            self.layout.close()
        super().close()


def _compared_values(settings: Knobs, knob: str) -> dict[str, Any]:
    """Values of a knob to be compared, by what their columns are called: "lam" or "regulariser"."""
    if knob == "lam":
        values = [float(f"{settings.lam * times:.2g}") for times in BOARD.lam_factors]
        return {f"λ {value:g}": value for value in values}
    orders = ["first", "second"] + ["curvature"] * (settings.xi == "1/d")
    return {order: order for order in orders}
