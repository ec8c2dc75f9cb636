"""The tuner: knobs under a hand, the surface under its eyes.

`tune` makes a widget for JupyterLab. Its `engine` solves in a thread of its own; pictures are drawn
and sent from there, so that neither a slow solve nor a running cell freezes the page. What goes
wrong is said in one line above the board.
"""

from __future__ import annotations

import html
import math
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
from endolab.io.settings import SolvingSettings, write_settings
from endolab.model.endoscope import Endoscope
from endolab.model.schema import unknown_name
from endolab.numerics.arrays import FloatArray
from endolab.preprocessing.frame import Frame
from endolab.reports.result import save_result
from endolab.synthetic.scenes import SCENES
from endolab.tuning.clicks import SECTION, Clicks
from endolab.tuning.controls import button, choice, close_parts, group, line, log_slider, numbers, slider
from endolab.tuning.engine import Outcome, Tuner, sentence_of
from endolab.tuning.panels import PANELS, Cut, map_alone, pixel_at
from endolab.tuning.pictures import Look, png
from endolab.tuning.saving import saved
from endolab.tuning.screen import BESIDE, KEPT, NOW, Screen
from endolab.tuning.sentences import NAMES, summary
from endolab.tuning.source import Settings
from endolab.tuning.surface_view import SurfaceView
from endolab.tuning.uploads import read_upload

IMPORTS = "from dataclasses import replace\n\nimport endolab as el\n"
VIEWS = ("section", "across", "count")  # knobs that change what is seen and not what is solved
ROUNDED = 2  # digits of what a slider says: the number that is shown is the one that counts
KEEP = "show this beside what comes, to compare; key A"
STRIPS: dict[str, tuple[str, Sequence[Any]]] = {
    "λ": ("lam", (0.1, 10**-0.5, 1.0, 10**0.5, 10.0)),  # times the slider's, on its own steps
    "ξ": ("xi", ("1/d", "1/z", "d")),
    "order": ("regulariser", REGULARISERS),
}
MASK_FILE = "mask.png"
LENGTHS = ("median_distance", "known_distance", "known_diameter")
OFF = "off"
COLOURS = ("frame", "distance", "model - frame", "error", "normals", "σ", "bounced light")  # in 3D


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

    `engine` solves what the `knobs` say, by the names of `Settings`, and "section", "across", "count".
    `screen` shows what there is now, and A. `status` is one line: how the solve went, or what went wrong.
    """

    def __init__(
        self, frame: Frame | None, calibration: Calibration, truth: FloatArray | None, scene: str, width: int
    ) -> None:
        self.engine = Tuner(calibration, self._on_outcome, frame=frame, truth=truth)
        self._quiet = False
        self._answered = False
        self._calibration, self._frame, self._truth = calibration, frame, truth
        self._whole = None if frame is None else frame.mask  # as it was given
        self.screen = Screen(self._cut, lambda: self.knobs["count"].value)
        self.clicks = Clicks(self._guarded, self._mark, self._use_mask, self.ask, self._forget, self._answer)
        self._make_knobs(scene, width)
        self._reset_light()
        self.status = w.HTML("solving ...", layout=w.Layout(width="100%", min_height="28px"))
        self.surface = SurfaceView(height=440)
        self.code = w.Textarea(layout=w.Layout(width="100%", height="150px", display="none"))
        self._make_buttons()
        self._observe_page()
        knobs = w.VBox(self._groups(), layout=w.Layout(flex="0 0 286px", min_width="0"))
        knobs.add_class("endolab-knobs")
        board = w.VBox([self.screen.view], layout=w.Layout(flex="1 1 600px", min_width="0"))
        self._turned = w.VBox([self.surface], layout=w.Layout(flex="1 1 380px", display="none"))
        both = w.HBox([board, self._turned], layout=w.Layout(flex_flow="row wrap", width="100%"))
        shown = w.VBox(
            [self.buttons, self.status, self.code, both], layout=w.Layout(flex="1 1 0", min_width="0")
        )
        row = w.HBox([knobs, shown], layout=w.Layout(width="100%", align_items="flex-start"))
        super().__init__([w.HTML(f"<style>{STYLE}</style>", layout=w.Layout(display="none")), row])
        self.add_class("endolab-tuner")
        self.ask()

    # Knobs -------------------------------------------------------------------------------

    def _make_knobs(self, scene: str, width: int) -> None:
        named = ("auto", "separated", "red", "green", "blue", "grey")
        channels = [("green or grey", ""), *((name, name) for name in named)]
        mine = self._frame is not None
        auto = [("auto", "")]
        self.knobs: dict[str, Any] = {
            "lam": log_slider("λ", 1.0, -4, 2, "weight of the regulariser: more is smoother"),
            "epsilon": log_slider("ε", 1e-3, -5, -1, "below it a derivative costs its square"),
            "xi": choice("ξ", ["1/d", "1/z", "d"], "the map that is smoothed"),
            "regulariser": choice("order", ["auto", *REGULARISERS], "what of it is smoothed"),
            "solver": choice("solver", [(called, name) for name, called in NAMES.items()]),
            "max_iterations": line("iterations", "as many as it takes", "the most steps of the solver"),
            "channel": choice("channel", channels, value="auto" if mine else ""),
            "highlights": choice("highlights", auto + [(one, one) for one in ("keep", "ignore", "inpaint")]),
            "contours": choice("contours", [*auto, ("torn", True), ("not torn", False)]),
            "smooth": line("smooth, px", "by the noise", "blur of the light before it is explained, σ in px"),
            "k": slider("k", 2.5, 0, 8, 0.1, "light spread that the solver believes in"),
            "gamma": slider("γ", 2.2, 1, 3, 0.05, "response that the solver believes in"),
            "gain": log_slider("gain ×", 1.0, -1, 1, "gain that the solver believes in, over the true one"),
            "albedo": line("albedo", "red, green, blue", "of the wall, that the solver believes in, 0 to 1"),
            "scene": choice("scene", self._scenes(), value="" if mine else scene),
            "noise": slider("noise", 0.0, 0, 8, 0.5, "of a rendered frame, grey levels of 255"),
            "width": choice("width, px", sorted({160, 320, 480, 640, width}), value=width),
            "section": slider("section", 50, 0, 100, 0.5, "where the cross-section lies, % of the picture"),
            "across": choice("along", ["column", "row"]),
            "count": choice("panels", [1, 2, 3, 4, 6, 8, 9], value=6),
        }
        for name, knob in self.knobs.items():
            follow = self._look if name in VIEWS else self.ask
            knob.observe(self._guarded(lambda _, follow=follow: follow()), "value")

    def _groups(self) -> list[w.Widget]:
        """The knobs below their headings."""
        parts = {
            "Solve": ("lam", "epsilon", "xi", "regulariser", "solver", "max_iterations"),
            "Picture": ("channel", "highlights", "contours", "smooth"),
            "Light as believed": ("k", "gamma", "gain", "albedo"),
            "Frame": ("scene", "noise", "width"),
            "Look": ("count", "section", "across"),
        }
        groups = [group(name, [self.knobs[one] for one in ones]) for name, ones in parts.items()]
        return [*groups[:-1], group("A click", self.clicks.knobs), groups[-1]]

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
        """Return what the knobs say; ValueError, in one sentence, if a line cannot be read."""
        values = {name: knob.value for name, knob in self.knobs.items() if name not in VIEWS}
        light = self._calibration.photometry
        for name in ("lam", "epsilon", "gain"):
            values[name] = float(f"{values[name]:.{ROUNDED}g}")
        for name in ("k", "gamma"):
            close = abs(values[name] - getattr(light, name)) < 1e-9
            values[name] = None if close else float(f"{values[name]:.6g}")
        values["albedo"] = numbers(values["albedo"], "albedo", 3)
        smooth = numbers(values["smooth"], "smooth", 1)
        most = numbers(values["max_iterations"], "iterations", 1)
        values["smooth"] = None if smooth is None else smooth[0]
        if most is not None and most[0] != round(most[0]):
            raise ValueError(f"iterations: expected a whole number, found {most[0]:g}")
        values["max_iterations"] = None if most is None else int(most[0])
        for name in ("scene", "channel", "highlights", "contours"):
            values[name] = None if values[name] == "" else values[name]
        return Settings(**values | (self.clicks.lengths if values["scene"] is None else {}))

    def ask(self) -> None:
        """Ask the engine for what the knobs say; returns at once."""
        if not self._quiet:
            self._answered = False
            settings = self.settings()
            rendered = settings.scene is not None
            self.knobs["noise"].disabled = not rendered
            self.knobs["gain"].disabled = not rendered and self._calibration.photometry.gain is None
            self.screen.several = []
            self.strip.value = ""
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
            self.screen.show(outcome, summarise)
            self._show_surface(outcome)
        except Exception as error:
            self._say(sentence_of(error), bad=True)
            raise

    def _look(self) -> None:
        """Draw what is to be seen, and have found what it needs."""
        seen = self.screen.names() + ([] if self.turning.value == OFF else [self.turning.value])
        needs = {PANELS[name].besides for name in seen}
        self.engine.look_at(*(one for one in ("trust",) if one in needs))
        self.screen.redraw()

    def _turn(self, what: str) -> None:
        """Show the surface in 3D, or no longer."""
        self._turned.layout.display = "none" if what == OFF else None
        self._look()
        if self.screen.shown is not None:
            self._show_surface(self.screen.shown)

    def _show_surface(self, outcome: Outcome) -> None:
        what, result = self.turning.value, outcome.result
        if what == OFF or result is None:
            return
        problem, framed = result.problem, what == "frame"
        lies = problem.shown if framed else map_alone(outcome, what, Look(2.0))
        how = {"cuts": problem.cuts, "unit": problem.unit, "lift": framed}
        self.surface.show(result.distance, problem.field.rays, lies, **how)

    def _cut(self) -> Cut:
        return Cut(self.knobs["section"].value / 100, self.knobs["across"].value == "row")

    def _observe_page(self) -> None:
        """Follow what the page tells."""
        view = self.screen.view
        for name, action in (
            ("point", lambda change: self._point(change["new"])),
            ("hover", lambda change: self.screen.say(change["new"])),
            ("room", lambda change: self.screen.measured(change["new"])),
            ("panels", lambda change: self._look()),
            ("key", lambda change: self._press(change["new"])),
        ):
            view.observe(self._guarded(action), name)

    def _point(self, where: Sequence[Any]) -> None:
        """Take a point of a map: to the right, down, which map, whether just pressed, and when."""
        if len(where) != 5 or not all(isinstance(one, int | float) and math.isfinite(one) for one in where):
            raise ValueError(f"a point of a map is five numbers, got {where}")
        x, y, index, pressed, _ = where
        x, y = min(max(x, 0.0), 1.0), min(max(y, 0.0), 1.0)
        if self.screen.several:
            if pressed:
                self._take_over(int(index))
        elif self.clicks.kind.value == SECTION:
            knob = self.knobs["section"]
            share = y if self.knobs["across"].value == "row" else x
            knob.value = knob.step * round(knob.max * share / knob.step)
        elif pressed:
            frame = None if self.knobs["scene"].value else self._frame
            self.clicks.press(x, y, frame, self._is_seen(x, y))

    def _is_seen(self, x: float, y: float) -> bool:
        """Whether the surface that is shown has a point there."""
        shown = self.screen.shown
        if shown is None or shown.result is None:
            return False
        mask = shown.result.mask
        return bool(mask[pixel_at(x, y, mask.shape)])

    def _mark(self, points: Sequence[tuple[float, float]]) -> None:
        self.screen.view.marks = [list(one) for one in points]

    def _use_mask(self, mask: Any) -> None:
        assert self._frame is not None
        frame = replace(self._frame, mask=mask)
        self.engine.use(self._calibration, frame, self._truth)
        self._frame = frame
        self.clicks.restart()
        self.ask()

    def _forget(self) -> None:
        """Forget what was clicked: mask and length."""
        self.clicks.lengths = {}
        self.clicks.restart()
        if self._frame is not None and self._whole is not None and self._frame.mask is not self._whole:
            self._use_mask(self._whole)
        else:
            self.ask()

    # Buttons -----------------------------------------------------------------------------

    def _make_buttons(self) -> None:
        def made(label: str, tip: str, action: Callable[[], object]) -> w.Button:
            return button(label, tip, self._guarded(lambda _: action()))

        self.keeper = made("keep as A", KEEP, lambda: (self.drop if self.screen.kept else self.keep)())
        self.shows = w.ToggleButtons(
            options=[KEPT, NOW, BESIDE],
            value=NOW,
            style={"button_width": "auto"},
            tooltips=["", "key B", "D"],
        )
        self.shows.layout.display = "none"
        self.shows.observe(self._guarded(lambda change: self._show_which(change["new"])), "value")
        self.strip = w.Dropdown(
            options=[("strip of ...", ""), *((f"strip of {one}", one) for one in STRIPS)],
            tooltip="several values side by side; a click takes one over",
            layout=w.Layout(width="120px"),
        )
        self.strip.observe(self._guarded(lambda change: self._try_out(change["new"])), "value")
        self.turning = w.Dropdown(
            options=[("3D: off", OFF), *((f"3D: {one}", one) for one in COLOURS)],
            tooltip="a surface to turn with the mouse, and what lies on it",
            layout=w.Layout(width="130px"),
        )
        self.turning.observe(self._guarded(lambda change: self._turn(change["new"])), "value")
        self.folder = w.Text("tuned", description="into", layout=w.Layout(width="190px"))
        self.folder.style.description_width = "34px"
        accepted = ".png,.jpg,.jpeg,.tif,.tiff,.json"
        self.upload = w.FileUpload(accept=accepted, multiple=True, description="frame, mask, endoscope.json")
        self.upload.layout.width = "auto"
        self.upload.observe(self._guarded(lambda _: self._take_upload()), "value")
        self.buttons = w.HBox(
            [
                *(self.keeper, self.shows, self.strip, self.turning),
                made("show code", "the lines of Python that make this", self.show_code),
                made("export", "what is shown: pictures, cloud, depth and recording", self._export_aside),
                *(self.folder, self.upload),
            ],
            layout=w.Layout(flex_flow="row wrap", align_items="center"),
        )

    def _press(self, key: Sequence[Any]) -> None:
        """Do what a key is for: A keeps, B blinks between A and now, D shows both, X drops A."""
        name, kept = (key[0] if key else ""), self.screen.kept is not None
        if name == "a":
            self.keep()
        elif kept and name == "b":
            self.shows.value = NOW if self.shows.value == KEPT else KEPT
        elif kept and name == "d":
            self.shows.value = BESIDE
        elif kept and name == "x":
            self.drop()

    def keep(self) -> None:
        """Keep what is shown as A, to compare; from now on it stands beside what is shown."""
        kept = self.screen.keep()
        self.shows.layout.display, self.shows.value = None, BESIDE
        self.keeper.description, self.keeper.tooltip = "drop A", "back to one picture; key X"
        self._answer(f"kept as A: {summary(kept)}")

    def drop(self) -> None:
        """Forget A."""
        self.screen.drop()
        self.shows.layout.display, self.shows.value = "none", NOW
        self.keeper.description, self.keeper.tooltip = "keep as A", KEEP

    def _show_which(self, which: str) -> None:
        if self.screen.kept is not None and self.screen.shows != which:
            self.screen.shows = which
            self.screen.redraw()

    def _try_out(self, what: str) -> None:
        """Solve several values of a knob, to be seen side by side."""
        if not what:
            if self.screen.several:
                self.screen.several = []
                self.screen.redraw()
            return
        name, values = STRIPS[what]
        now = self.settings()
        if name == "lam":
            values = [float(f"{now.lam * factor:.{ROUNDED}g}") for factor in values]
        if name == "regulariser":
            values = [one for one in values if one != "curvature" or now.xi == "1/d"]
        others = [replace(now, **{name: value}) for value in values]
        if name == "xi":
            others = [replace(one, regulariser="auto") for one in others]
        labels = [f"{what} = {value:g}" if name == "lam" else f"{what} = {value}" for value in values]
        self._others = others
        self.screen.several = [(label, None) for label in labels]
        self.screen.redraw()

        def tell(number: int, outcome: Outcome) -> None:
            if outcome.result is None:
                self._say(f"{labels[number]}: {outcome.error}", bad=True)
            elif self.screen.several:
                self.screen.several[number] = labels[number], outcome
                self.screen.redraw()

        self.engine.try_out(others, tell)
        self._answer(f"{', '.join(labels)}: click on one to take it over")

    def _take_over(self, index: int) -> None:
        """Take the settings of a strip's outcome over."""
        board = self.screen.board
        if board is None or not 0 <= index < len(board.places):
            return
        taken = board.places[index].outcome.settings
        with self._unasked():
            for name in ("lam", "xi", "regulariser"):
                self.knobs[name].value = getattr(taken, name)
        self.ask()

    def python(self) -> str:
        """Return the Python that makes what the knobs say, imports included."""
        source = 'calibration = el.Calibration.load("endoscope.json")  # the one given to the tuner'
        for name, known in datasets.CALIBRATIONS.items():
            if known == self._calibration:
                source = f"calibration = datasets.load_calibration({name!r})"
        settings = self.settings()
        lines = [IMPORTS + ("from endolab import datasets\n" if "datasets" in source else ""), source]
        if settings.scene is None and self._frame is not None:
            mask = f", mask={MASK_FILE!r}" if self._masked else ""
            lines.append(f"frame = el.read_frame({self._frame.name!r}, calibration{mask})")
        grey = self._frame is not None and self._frame.image.ndim == 2
        return "\n".join([*lines, settings.code(self._calibration, grey), ""])

    @property
    def _masked(self) -> bool:
        """Whether the frame's mask is not all of it."""
        return self._frame is not None and not bool(self._frame.mask.all())

    def show_code(self) -> None:
        """Show these lines, or hide them."""
        hidden = self.code.layout.display == "none"
        self.code.value = self.python()
        self.code.layout.display = None if hidden else "none"

    def export(self, folder: str | Path, *, overwrite: bool = False, timeout: float = 600.0) -> Path:
        """Write all there is about the answer that is shown into a folder; one on its way is waited for.

        That is `board.png`, `result.py`, `settings.json`, `recording.rrd`, the mask of a frame, and what
        `save_result` writes; all or none. The folder is new, empty, or holds results of endolab's; else
        `overwrite`.
        """
        from endolab.recording.recorder import record

        outcome = self.engine.wait(timeout)
        if outcome.result is None:
            raise ValueError(outcome.error or "there is no result to export")
        code, grey = self.python(), self._frame is not None and self._frame.image.ndim == 2
        settings = saved(
            outcome.settings, outcome.subject.calibration if outcome.subject else self._calibration, grey
        )
        masks = (MASK_FILE,) if self._masked and outcome.settings.scene is None else ()
        with staged_folder(folder, overwrite=overwrite) as staging:
            with record(staging / "recording.rrd") as recorder:
                for iterate in outcome.path:
                    recorder(iterate)
                if outcome.trust is not None:
                    recorder.add_trust(outcome.trust, outcome.result)
            save_result(outcome.result, staging, trust=outcome.trust, overwrite=True)
            write_atomically(staging / "board.png", png(self.screen.picture()))
            write_atomically(staging / "result.py", code.encode())
            write_settings(settings, staging / "settings.json")
            for mask in masks:
                assert self._frame is not None
                content = np.where(self._frame.mask, np.uint8(255), np.uint8(0))
                write_atomically(staging / mask, png(np.repeat(content[..., None], 3, axis=-1)))
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

        A picture whose name ends with "mask" is that of the other, alone that of the frame that is looked
        at. A calibration without a picture that it fits renders scenes. A file of settings, as an export
        leaves it, sets the knobs. An OSError or ValueError says in one sentence what cannot be used; then
        nothing changes.
        """
        found = read_upload(files, self._calibration)
        if found.mask is not None and (self._frame is None or found.calibration is not None):
            raise ValueError("there is no frame that this could be the mask of")
        if found.mask is not None:
            self._use_mask(found.mask)
        elif found.frame is not None or found.calibration is not None:
            self.look_at(found.frame, found.calibration)
        if found.settings is not None:
            self.use(found.settings)

    def look_at(
        self, frame: Frame | None, calibration: Calibration | None = None, truth: FloatArray | None = None
    ) -> None:
        """Look at another frame, or at scenes; the knobs stay, but for those of another calibration's light.

        Raises ValueError if they are not of one size; then nothing changes.
        """
        known = self._calibration if calibration is None else calibration
        self.engine.use(known, frame, truth)
        other = known != self._calibration
        self._calibration, self._frame, self._truth = known, frame, truth
        self._whole, self.clicks.lengths = None if frame is None else frame.mask, {}
        self.clicks.restart()
        if other:
            self._reset_light()
        knob = self.knobs["scene"]
        now = "" if frame is not None else knob.value or "colon"
        with self._unasked():
            knob.options, knob.value = self._scenes(), now
        self.ask()

    def use(self, settings: SolvingSettings) -> None:
        """Set the knobs to what a file of settings says; what it does not say stays."""
        said, light = dict(settings.keywords), dict(settings.photometry)
        lengths = {name: said.pop(name) for name in LENGTHS if name in said}
        gain, known = light.pop("gain", None), self._calibration.photometry.gain
        if gain is not None and known is None:
            raise ValueError(
                "the settings have a gain, and the calibration has none that it could be compared to"
            )
        if gain is not None and known is not None:
            light["gain"] = gain / known
        said |= light
        unknown = [name for name in said if name not in self.knobs]
        if unknown or isinstance(said.get("lam"), str):
            raise ValueError(f"the tuner has no knob for {unknown[0] if unknown else 'lam = auto'}")
        with self._unasked():
            for name, value in said.items():
                knob = self.knobs[name]
                if isinstance(knob, w.Text):
                    value = ", ".join(f"{one:g}" for one in np.atleast_1d(value))
                elif name == "width":
                    knob.options = sorted({*knob.options, value})
                elif isinstance(knob, w.FloatSlider):
                    knob.min, knob.max = min(knob.min, value), max(knob.max, value)
                knob.value = value
        self.clicks.lengths = lengths
        self.ask()

    def close(self) -> None:
        """Close the widget and end its thread."""
        if hasattr(self, "engine"):  # not if it was refused
            self.engine.close()
            self.surface.close()
        close_parts(self)
        super().close()


# In a page that is lower than they are, knobs scroll by themselves; a wide one, a projector's maybe, has
# larger letters.
STYLE = """
.endolab-knobs { max-height: calc(100vh - 130px); overflow-y: auto; overflow-x: hidden; }
.endolab-knobs .widget-inline-hbox { margin: 1px 2px; }
.endolab-knobs .widget-readout { min-width: 54px; }
.endolab-tuner .endolab-status { white-space: normal; line-height: 1.4; }
.endolab-app .endolab-knobs { max-height: calc(100vh - 24px); }
@media (min-width: 1700px) {
  .endolab-knobs { zoom: 1.2; max-height: calc(83vh - 110px); }
  .endolab-app .endolab-knobs { max-height: calc(83vh - 24px); }
  .endolab-tuner .endolab-status, .endolab-tuner .endolab-caption { font-size: 16px; }
}
"""
