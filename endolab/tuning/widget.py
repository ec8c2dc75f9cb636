"""The tuner: knobs on the left of a hand, the surface under its eyes.

`tune` makes a widget for JupyterLab. Its `engine` solves in a thread of its own; pictures are drawn
and sent from there, so that neither a slow solve nor a running cell freezes the page. What goes
wrong is said in one line below the knobs.
"""

from __future__ import annotations

import html
import math
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import ipywidgets as w
import numpy as np

from endolab import datasets
from endolab.depth.problem import REGULARISERS
from endolab.io.atomic import staged_folder, write_atomically
from endolab.io.descriptions import Calibration
from endolab.io.images import read_frame
from endolab.model.endoscope import Endoscope
from endolab.model.schema import unknown_name
from endolab.numerics.arrays import FloatArray
from endolab.preprocessing.frame import Frame
from endolab.reports.result import result_files, save_result
from endolab.synthetic.scenes import SCENES
from endolab.tuning.controls import Pair, choice, close_parts, log_slider, slider
from endolab.tuning.engine import Outcome, Tuner, sentence_of
from endolab.tuning.panels import BESIDES, NAMES, Cut, outcome_board, summary
from endolab.tuning.pictures import png
from endolab.tuning.source import Settings

IMPORTS = "from dataclasses import replace\n\nimport endolab as el\n"
VIEWS = ("section", "across", "third")  # knobs that change what is seen and not what is solved
KEEP = "show this beside what comes, to compare"


def tune(
    frame: Frame | None = None,
    calibration: Calibration | None = None,
    truth: FloatArray | None = None,
    scene: str = "colon",
    width: int = 320,
) -> TunerBox:
    """Make the tuner, a widget for the last line of a cell: sliders and choices, and six linked views.

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

    `engine` solves what the `knobs` say, by the names of `Settings`, and "section", "across", "third". `pair`
    shows what there is now, and A; its section follows the pointer on input and distance. `status`
    is one line: how the solve went, or what went wrong.
    """

    def __init__(
        self, frame: Frame | None, calibration: Calibration, truth: FloatArray | None, scene: str, width: int
    ) -> None:
        self.engine = Tuner(calibration, self._on_outcome, frame=frame, truth=truth)
        self._quiet = False
        self._answered = False
        self._calibration, self._frame = calibration, frame
        self.pair = Pair(self._cut, lambda: self.knobs["third"].value)
        for picture in (self.pair.picture, self.pair.picture_kept):
            picture.observe(self._guarded(lambda change: self._point(change["new"])), "point")
        self._make_knobs(scene, width)
        self._reset_light()
        self.status = w.HTML("solving ...", layout=w.Layout(width="100%"))
        self.code = w.Textarea(layout=w.Layout(width="100%", height="150px", display="none"))
        self._make_buttons()
        knobs = w.HBox(list(self.knobs.values()), layout=w.Layout(flex_flow="row wrap"))
        super().__init__([knobs, self.buttons, self.status, self.code, self.pair])
        self.add_class("endolab-tuner")
        self.ask()

    # Knobs -------------------------------------------------------------------------------

    def _make_knobs(self, scene: str, width: int) -> None:
        named = ("red", "green", "blue", "grey", "auto", "separated")
        channels = [("green or grey", ""), *((name, name) for name in named)]
        self.knobs: dict[str, Any] = {
            "lam": log_slider("λ", 1.0, -4, 2, "weight of the regulariser: more is smoother"),
            "epsilon": log_slider("ε", 1e-3, -5, -1, "below it a derivative costs its square"),
            "noise": slider("noise", 0.0, 0, 8, 0.5, "of a rendered frame, grey levels of 255"),
            "k": slider("k", 2.5, 0, 8, 0.1, "light spread that the solver believes in"),
            "gamma": slider("γ", 2.2, 1, 3, 0.05, "response that the solver believes in"),
            "gain": log_slider("gain ×", 1.0, -1, 1, "gain that the solver believes in, over the true one"),
            "xi": choice("ξ", ["1/d", "1/z", "d"]),
            "regulariser": choice("order", ["auto", *REGULARISERS]),
            "solver": choice("solver", [(called, name) for name, called in NAMES.items()]),
            "scene": choice("scene", self._scenes(), value="" if self._frame is not None else scene),
            "channel": choice("channel", channels),
            "width": choice("width, px", sorted({160, 320, 480, 640, width}), value=width),
            "section": slider("section", 50, 0, 100, 0.5, "where the cross-section lies, % of the picture"),
            "across": choice("along", ["column", "row"]),
            "third": choice("third view", [*BESIDES]),
        }
        self.knobs["third"].observe(self._guarded(lambda _: self._look()), "value")
        for name, knob in self.knobs.items():
            follow = self.pair.redraw if name in VIEWS else self.ask
            knob.observe(self._guarded(lambda _, follow=follow: follow()), "value")

    def _scenes(self) -> list[tuple[str, str]]:
        scenes = [(name, name) for name in SCENES]
        return scenes if self._frame is None else [(self._frame.name, ""), *scenes]

    def _reset_light(self) -> None:
        """Set k, γ and gain to what the calibration says."""
        light = self._calibration.photometry
        with self._unasked():
            for name, value in (("k", light.k), ("gamma", light.gamma)):
                knob = self.knobs[name]
                knob.min, knob.max = min(knob.min, value), max(knob.max, value)
                knob.value = value
            self.knobs["gain"].value = 1.0

    @contextmanager
    def _unasked(self) -> Iterator[None]:
        """Move knobs without asking the engine."""
        self._quiet = True
        try:
            yield
        finally:
            self._quiet = False

    def settings(self) -> Settings:
        """Return what the knobs say."""
        values = {name: knob.value for name, knob in self.knobs.items() if name not in VIEWS}
        light = self._calibration.photometry
        for name in ("k", "gamma"):
            if abs(values[name] - getattr(light, name)) < 1e-9:
                values[name] = None
        return Settings(**values | {name: values[name] or None for name in ("scene", "channel")})

    def ask(self) -> None:
        """Ask the engine for what the knobs say; returns at once."""
        if not self._quiet:
            self._answered = False
            settings = self.settings()
            rendered = settings.scene is not None
            self.knobs["noise"].disabled = not rendered
            self.knobs["gain"].disabled = not rendered and self._calibration.photometry.gain is None
            self.engine.ask(settings)

    def _guarded(self, action: Callable[..., object]) -> Callable[..., None]:
        """Say what goes wrong in the status line."""

        def guarded(*given: Any) -> None:
            try:
                action(*given)
            except Exception as error:
                self._answer(sentence_of(error), bad=True)

        return guarded

    # Pictures ----------------------------------------------------------------------------

    def _answer(self, text: str, bad: bool = False) -> None:
        """Say what a button did; a solve that was asked for before does not wipe it off."""
        self._answered = True
        self._say(text, bad)

    def _say(self, text: str, bad: bool = False) -> None:
        text = html.escape(text)
        colour = ' style="color: #C0392B"' if bad else ""
        self.status.value = f'<span class="endolab-status"{colour}>{text}</span>'

    def _on_outcome(self, outcome: Outcome) -> None:
        """Show an outcome; in the engine's thread."""
        if outcome.result is None:
            self._say(outcome.error or "there is no result", bad=True)
            return
        started = time.perf_counter()

        def summarise() -> None:
            if not self._answered:
                self._say(summary(outcome, time.perf_counter() - started))

        try:
            self.pair.show(outcome, summarise)
        except Exception as error:
            self._say(sentence_of(error), bad=True)
            raise

    def _look(self) -> None:
        """Have found what the third view needs."""
        self.engine.look_at(BESIDES[self.knobs["third"].value])

    def _cut(self) -> Cut:
        return Cut(self.knobs["section"].value / 100, self.knobs["across"].value == "row")

    def _point(self, where: Sequence[Any]) -> None:
        """Lay the section through a point of the map: to the right, down, and when."""
        knob, down = self.knobs["section"], self.knobs["across"].value == "row"
        if len(where) != 3 or not all(isinstance(one, int | float) and math.isfinite(one) for one in where):
            raise ValueError(f"a point of a map is three numbers, got {where}")
        share = min(max(where[down], 0.0), 1.0)
        knob.value = knob.step * round(knob.max * share / knob.step)

    # Buttons -----------------------------------------------------------------------------

    def _make_buttons(self) -> None:
        def button(label: str, tip: str, action: Callable[[], object]) -> w.Button:
            made = w.Button(description=label, tooltip=tip, layout=w.Layout(width="auto"))
            made.on_click(self._guarded(lambda _: action()))
            return made

        self.keeper = button("keep as A", KEEP, lambda: (self.drop if self.pair.kept else self.keep)())
        self.folder = w.Text("tuned", description="into", layout=w.Layout(width="230px"))
        accepted = ".png,.jpg,.jpeg,.tif,.tiff,.json"
        self.upload = w.FileUpload(accept=accepted, multiple=True, description="frame, endoscope.json")
        self.upload.layout.width = "auto"
        self.upload.observe(self._guarded(lambda _: self._take_upload()), "value")
        self.buttons = w.HBox(
            [
                self.keeper,
                button("show code", "the lines of Python that make this", self.show_code),
                button("export", "pictures, cloud, depth and recording", self._export_aside),
                self.folder,
                self.upload,
            ],
            layout=w.Layout(flex_flow="row wrap", align_items="center"),
        )

    def keep(self) -> None:
        """Keep what is shown as A, to compare; from now on it stands beside what is shown."""
        kept = self.pair.keep()
        self.keeper.description, self.keeper.tooltip = "drop A", "back to one picture"
        self._answer(f"kept as A: {summary(kept)}")

    def drop(self) -> None:
        """Forget A."""
        self.pair.drop()
        self.keeper.description, self.keeper.tooltip = "keep as A", KEEP

    def python(self) -> str:
        """Return the Python that makes what the knobs say, imports included."""
        source = 'calibration = el.Calibration.load("endoscope.json")  # the one given to the tuner'
        for name, known in datasets.CALIBRATIONS.items():
            if known == self._calibration:
                source = f"calibration = datasets.load_calibration({name!r})"
        settings = self.settings()
        lines = [IMPORTS + ("from endolab import datasets\n" if "datasets" in source else ""), source]
        if settings.scene is None and self._frame is not None:
            lines.append(f"frame = el.read_frame({self._frame.name!r}, calibration)")
        grey = self._frame is not None and self._frame.image.ndim == 2
        return "\n".join([*lines, settings.code(self._calibration, grey), ""])

    def show_code(self) -> None:
        """Show these lines, or hide them."""
        hidden = self.code.layout.display == "none"
        self.code.value = self.python()
        self.code.layout.display = None if hidden else "none"

    def export(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Solve what the knobs say from a cold start and write all there is about it into a folder.

        That is `board.png`, `result.py`, `recording.rrd` and what `save_result` writes; all or none. A file
        that endolab did not write there is replaced only if `overwrite`.
        """
        from endolab.recording.recorder import record

        settings, code, cut = self.settings(), self.python(), self._cut()
        files = ("board.png", "result.py", "recording.rrd", *result_files())
        with staged_folder(folder, files, overwrite=overwrite) as staging:
            recorder = record(staging / "recording.rrd")
            outcome = self.engine.cold(settings, observers=[recorder])
            assert outcome.result is not None
            save_result(outcome.result, staging)
            write_atomically(staging / "board.png", png(outcome_board(outcome, cut)))
            write_atomically(staging / "result.py", code.encode())
        return Path(folder)

    def _export_aside(self) -> None:
        """Export in a thread of its own."""
        if not self.folder.value.strip():
            raise ValueError("name a folder to export into")
        folder = Path(self.folder.value.strip()).expanduser()
        self._answer(f"exporting into {folder} ...")
        work = self._guarded(lambda: self._answer(f"exported into {self.export(folder).resolve()}"))
        threading.Thread(target=work, name="endolab export", daemon=True).start()

    def _take_upload(self) -> None:
        if self.upload.value:
            files = {entry["name"]: bytes(entry["content"]) for entry in self.upload.value}
            self.upload.value = ()
            self.take(files)

    def take(self, files: Mapping[str, bytes]) -> None:
        """Look at another frame, or through another endoscope: pictures and calibration files by name.

        A calibration without a picture that it fits renders scenes. An OSError or ValueError says in
        one sentence what cannot be used; then nothing changes.
        """
        descriptions = [name for name in files if name.lower().endswith(".json")]
        pictures = [name for name in files if name not in descriptions]
        for what, names in (("calibration", descriptions), ("picture", pictures)):
            if len(names) > 1:
                raise ValueError(
                    f"expected one {what} at most, found {len(names)}: {', '.join(sorted(names))}"
                )
        calibration, frame = self._calibration, None
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "file"  # not by its name, which can be anything
            for name in descriptions + pictures:
                path.write_bytes(files[name])
                try:
                    if name in descriptions:
                        calibration = Calibration.load(path)
                    else:
                        frame = replace(read_frame(path, calibration), name=name)
                except (OSError, ValueError, MemoryError) as error:
                    raise ValueError(sentence_of(error).replace(str(path), name)) from error
        self.engine.use(calibration, frame)
        self._calibration, self._frame = calibration, frame
        self._reset_light()
        knob = self.knobs["scene"]
        now = "" if frame is not None else knob.value or "colon"
        with self._unasked():
            knob.options, knob.value = self._scenes(), now
        self.ask()

    def close(self) -> None:
        """Close the widget and end its thread."""
        if hasattr(self, "engine"):  # not if it was refused
            self.engine.close()
        close_parts(self)
        super().close()
