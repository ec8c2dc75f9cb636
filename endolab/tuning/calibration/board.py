"""The calibration under the hand: a bar for each frame, what it shows, and the fits without it."""

from __future__ import annotations

import html
import math
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import ipywidgets as w
import numpy as np

from endolab.calibration.detection.detect import Detection
from endolab.calibration.geometric.fit import GeometricFit
from endolab.calibration.least_squares import FitIterate
from endolab.calibration.photometric.left_out import places_by_fate
from endolab.calibration.photometric.model import LEVELS
from endolab.calibration.photometric.result import PhotometricFit
from endolab.calibration.photometric.samples import Samples
from endolab.calibration.session import Named, Session
from endolab.calibration.summary import counted
from endolab.calibration.targets import Target
from endolab.io.atomic import PathLike
from endolab.io.video import Frames
from endolab.model.cameras import Camera
from endolab.model.schema import unknown_name
from endolab.numerics.arrays import FloatArray
from endolab.tuning.board_view import BoardView
from endolab.tuning.calibration.drawing import dots_picture, levels_picture, reasons_picture
from endolab.tuning.calibration.judged import LEVELS_OFF, PERCENT, PIXELS, UNITS, Judged
from endolab.tuning.calibration.material import Material, light_options
from endolab.tuning.calibration.parts import Bars, Space
from endolab.tuning.calibration.refit import Refits, State
from endolab.tuning.calibration.report import session_of_report
from endolab.tuning.calibration.space import camera_lines, surroundings
from endolab.tuning.calibration.words import beginning, change, fates, legend, table
from endolab.tuning.controls import close_parts
from endolab.tuning.engine import sentence_of
from endolab.tuning.pictures import jpeg

IN_TIME, WORST_FIRST = "in time", "worst first"
UNKNOWN = 640, 480  # px, of frames that nothing is known of
MOST_BARS = 400  # narrower ones could not be hit
IN_SPACE, LEFT_OUT = "sheets in space", "what is left out, and why"
WAY = "Click a bar (← →): its frame. Double click (space): leave it out, take it back. Click a dot: a detail."


def tune_calibration(
    found: Session | GeometricFit | PhotometricFit | PathLike,
    target: Target | None = None,
    *,
    frames: Mapping[str, FloatArray | None] | Named = (),
    detections: Mapping[str, Detection] | None = None,
    samples: Samples | None = None,
    camera: Camera | None = None,
    **light: Any,
) -> CalibrationBoard:
    """Make a board for a calibration, a widget for the last line of a cell: the fits follow its frames.

    Parameters
    ----------
    found : Session, GeometricFit, PhotometricFit or path
        What `calibrate`, `calibrate_camera` or `calibrate_light` returned; or the folder of a report, which
        is calibrated again from what was detected.
    target : Target, optional
        That a GeometricFit was made of.
    frames : mapping or iterable of (str, image)
        Pictures by the names of the frames, to look at.
    detections : mapping of str to Detection, optional
        Of a GeometricFit; they bring back the views that it left out.
    samples : Samples, optional
        That a PhotometricFit was made of; its frames are called by their numbers.
    camera : Camera, optional
        By which these were read, to show where.
    **light
        Options that `calibrate_light` was given; by default what the fit shows of them.

    Returns
    -------
    CalibrationBoard
        Its `state` holds the fits, `left_out` the names of the frames that they do without.

    Raises
    ------
    ValueError
        If what is needed beside `found` is missing, in one sentence.
    """
    if isinstance(found, str | Path):
        found, frames, told = session_of_report(found)
        light = told | light
    if isinstance(found, Session):
        if found.light is not None:
            light = light_options(found.light) | light
        elif found.geometry is None:
            raise ValueError("this calibration has no fit: its camera was given, its light refused")
        material = Material.of_session(found, light)
        first = State(camera=found.geometry, light=found.light)
    elif isinstance(found, GeometricFit):
        if target is None:
            raise ValueError("a fit of the camera needs its target beside it: tune_calibration(fit, target)")
        material, first = Material.of_camera(found, target, detections), State(camera=found)
    elif isinstance(found, PhotometricFit):
        if samples is None or len(samples) != len(found.used):
            got = "none" if samples is None else str(len(samples))
            raise ValueError(f"a fit of the light needs its {len(found.used)} samples beside it, got {got}")
        material = Material.of_light(samples, camera, light_options(found) | light)
        first = State(light=found)
    else:
        kinds = "a Session, a fit of the camera or of the light, or a report's folder"
        raise ValueError(f"found must be {kinds}, got {type(found).__name__}")
    return CalibrationBoard(material, first, _reader(frames))


def _reader(frames: Mapping[str, FloatArray | None] | Named) -> Callable[[str], FloatArray | None]:
    """Return a function that reads a frame by its name; None for one that is not there."""
    if isinstance(frames, Frames):

        def read(name: str) -> FloatArray | None:
            known = name in frames.names
            return next((image for _, image in frames.read([name])), None) if known else None

        return read
    return dict(frames).get


class CalibrationBoard(w.VBox):
    """The board; `tune_calibration` makes it.

    `bars` shows the error of each frame by the chosen `quantity`, `picture` the chosen frame, `space` the
    sheets, `why` the samples that do not count. `state` holds the fits as they are, `first` as they were.
    """

    def __init__(
        self, material: Material, first: State, image_of: Callable[[str], FloatArray | None]
    ) -> None:
        self.material, self.first, self.image_of = material, first, image_of
        self.left_out: frozenset[str] = frozenset()
        self._drawing = threading.RLock()  # the fits' thread draws, and the kernel's
        self._order: list[str] = []
        self._place: tuple[float, float] | None = None
        self._places = self._fates()
        self._quiet = False
        self._make_knobs()
        self.refits = Refits(material, first, self._on_state, self._on_step)
        self._judged = Judged.of(material, first)
        super().__init__([self.knobs, self.status, self.bars, self.body])
        self.add_class("endolab-calibration")
        self._draw_bars()
        self.bars.chosen = self._worst()
        if not self._of_camera:
            self.beside.value = LEFT_OUT
        self._show()
        self._say(WAY)

    # Parts -----------------------------------------------------------------------------------

    def _make_knobs(self) -> None:
        camera = [PIXELS] if self.first.camera is not None else []
        light = [LEVELS_OFF, PERCENT] if self.first.light is not None else []
        narrow = w.Layout(width="auto")

        def button(label: str, tip: str, action: Callable[[], object]) -> w.Button:
            made = w.Button(description=label, tooltip=tip, layout=narrow)
            made.on_click(self._guarded(lambda _: action()))
            return made

        self.quantity = w.Dropdown(options=camera + light, layout=w.Layout(width="150px"))
        self.order = w.Dropdown(options=[IN_TIME, WORST_FIRST], layout=w.Layout(width="100px"))
        self.frame = w.Dropdown(options=self.material.names, layout=w.Layout(width="120px"))
        self.toggler = button("leave it out", "out of the fits, or back into them", self._toggle_chosen)
        self.restore = button("take all back", "all frames into the fits again", self.take_back)
        self.stopper = button("stop", "keep the best so far", lambda: self.refits.stop())
        self.beside = w.Dropdown(options=self._views(), layout=w.Layout(width="190px"))
        self.stopper.disabled = True
        row = {"flex_flow": "row wrap", "align_items": "center", "grid_gap": "0 4px"}
        self.knobs = w.HBox(
            [
                *(self.quantity, self.order, self.frame, self.toggler, self.restore),
                *(self.beside, self.stopper),
            ],
            layout=w.Layout(**row),
        )
        self.bars, self.picture, self.space, self.why = Bars(), BoardView(), Space(), BoardView()
        self.numbers, self.legend, self.whys, self.status = (w.HTML() for _ in range(4))
        self.picture.spots = [[0.0, 0.0, 1.0, 1.0]]
        self._space_box, self._why_box = w.VBox([self.space]), w.VBox([self.why, self.whys])
        self._left = left = w.VBox([self.picture, self.legend])
        right = w.VBox([self._space_box, self._why_box, self.numbers])
        left.layout = w.Layout(flex="3 1 440px", min_width="0", max_width="1240px")
        right.layout = w.Layout(flex="2 1 360px", min_width="0", max_width="760px")
        self.body = w.HBox([left, right], layout=w.Layout(flex_flow="row wrap", grid_gap="0 8px"))
        for knob in (self.quantity, self.order):
            knob.observe(self._guarded(lambda _: self._change_view()), "value")
        self.beside.observe(self._guarded(lambda _: self._show_beside()), "value")
        self.frame.observe(self._guarded(lambda change: self.choose(change["new"])), "value")
        self.bars.observe(self._guarded(lambda _: self._choose_bar()), "chosen")
        self.bars.observe(self._guarded(lambda change: self._toggle_bar(change["new"])), "toggled")
        self.space.observe(self._guarded(lambda change: self.choose(change["new"])), "chosen")
        self.picture.observe(self._guarded(lambda change: self._point(change["new"])), "point")

    def _views(self) -> list[str]:
        """What can be seen beside the frame."""
        has_sheets = self.material.target is not None
        return [IN_SPACE] * has_sheets + [LEFT_OUT] * (self.first.light is not None)

    def _fates(self) -> dict[str, int]:
        """What became of the places on the sheets; empty where there are none."""
        made = self.material
        if made.samples is None or made.target is None or made.camera is None:
            return {}
        size = made.camera.width, made.camera.height
        return places_by_fate(made.target, made.poses, made.camera, size)

    def _guarded(self, action: Callable[..., object]) -> Callable[..., None]:
        """Say what goes wrong in the line below."""

        def guarded(*given: Any) -> None:
            try:
                action(*given)
            except Exception as error:
                self._say(sentence_of(error), bad=True)

        return guarded

    def _say(self, text: str, bad: bool = False) -> None:
        colour = ' style="color: #C0392B"' if bad else ""
        self.status.value = f'<span class="endolab-status"{colour}>{html.escape(text)}</span>'

    @property
    def state(self) -> State:
        """The fits as they are."""
        return self.refits.state

    @property
    def _of_camera(self) -> bool:
        return bool(self.quantity.value == PIXELS)

    # A hand ----------------------------------------------------------------------------------

    def choose(self, name: str) -> None:
        """Show a frame."""
        if name not in self.material.names:
            raise unknown_name("frame", name, self.material.names)
        with self._drawing:  # else a hand would be overlooked while the fits' thread draws
            if self._quiet:
                return
            if name != self.frame.value:
                self.frame.value = name  # which comes back here
                return
            self._place = None
            self._show()

    def leave_out(self, *names: str) -> None:
        """Leave frames out of the fits; returns at once, `wait` waits for what follows."""
        self._ask(self.left_out | set(names))

    def take_back(self, *names: str) -> None:
        """Take frames back into the fits; all, if none is named."""
        self._ask(self.left_out - set(names) if names else frozenset())

    def _ask(self, left_out: Iterable[str]) -> None:
        wish = frozenset(left_out)
        for name in wish - set(self.material.names):
            raise unknown_name("frame", name, self.material.names)
        counting = {name for name in self.material.names if self.material.is_evidence(name)}
        if not counting - wish:
            raise ValueError("no frame would be left to fit: take another one back first")
        self.left_out = wish
        self.stopper.disabled = False
        self._say("fitting …")
        with self._drawing:
            self._draw_bars()
            self._name_toggler()
        self.refits.ask(wish)

    def wait(self, timeout: float | None = None) -> State:
        """Wait so many seconds for the fits that were asked for; an interrupt keeps the best so far."""
        return self.refits.wait(timeout)

    def _toggle(self, name: str) -> None:
        (self.take_back if name in self.left_out else self.leave_out)(name)

    def _toggle_chosen(self) -> None:
        self._toggle(self.frame.value)

    def _toggle_bar(self, what: Sequence[Any]) -> None:
        if len(what) != 2 or what[0] not in range(len(self._order)):
            raise ValueError(f"a bar is a whole number below {len(self._order)}, and when; got {what}")
        self._toggle(self._order[what[0]])

    def _choose_bar(self) -> None:
        if self.bars.chosen in range(len(self._order)):
            self.choose(self._order[self.bars.chosen])

    def _point(self, where: Sequence[Any]) -> None:
        """Enlarge what lies at a place of the frame, where `BoardView.point` tells it to be."""
        if len(where) != 5 or not all(isinstance(one, int | float) and math.isfinite(one) for one in where):
            raise ValueError(f"a point of a picture is five numbers, got {where}")
        self._place = float(where[0]), float(where[1])
        with self._drawing:
            self._draw_frame()

    # What is seen ----------------------------------------------------------------------------

    def _on_state(self, state: State) -> None:
        """Show new fits; in their thread."""
        with self._drawing:
            try:
                self._judged = Judged.of(self.material, state)
                self._show()
            except Exception as error:
                self._say(sentence_of(error), bad=True)
                raise
        self.stopper.disabled = True
        if state.complaints:
            self._say("; ".join(state.complaints), bad=True)
        else:
            told = change(self.first, state, self.material.names)
            self._say(f"stopped, the best so far: {told}" if state.is_stopped else told)

    def _on_step(self, what: str, step: FitIterate) -> None:
        unit = "px" if what == "camera" else "grey levels"
        self._say(f"fitting the {what}: step {step.k}, σ {step.sigma:.3g} {unit}")

    def _worst(self) -> int:
        """Place of the largest error among the bars."""
        errors = [self._judged.error(name, self.quantity.value) for name in self._order]
        return int(np.argmax(np.nan_to_num(errors, nan=-1.0))) if errors else 0

    def _change_view(self) -> None:
        """Show another quantity, or another order, of the same frame."""
        with self._drawing:
            if LEFT_OUT in self.beside.options:
                self.beside.value = IN_SPACE if self._of_camera else LEFT_OUT
            self._show()

    def _show(self) -> None:
        self._draw_bars()
        self._draw_frame()
        self._show_beside()
        self._name_toggler()
        self.numbers.value = table(self.first, self.refits.state, self._of_camera)

    def _name_toggler(self) -> None:
        out = self.frame.value in self.left_out
        self.toggler.description = "take it back" if out else "leave it out"
        self.restore.disabled = not self.left_out

    def _draw_bars(self) -> None:
        names = list(self.material.names)
        judged, quantity = self._judged, self.quantity.value
        errors = {name: np.nan_to_num(judged.error(name, quantity), nan=-1.0) for name in names}
        worst = sorted(names, key=lambda name: -errors[name])
        if len(names) > MOST_BARS:
            kept = set(worst[:MOST_BARS]) | {self.frame.value}
            names, worst = [name for name in names if name in kept], [n for n in worst if n in kept]
        self._order = worst if self.order.value == WORST_FIRST else names
        common = len(beginning(self.material.names))
        bars = [judged.bar(name, quantity, self.left_out, common) for name in self._order]
        unit, level = UNITS[quantity], judged.overall(quantity)
        above = (
            "; above: how many dots disagree" if self._of_camera else "; above: how many samples do not count"
        )
        missing = len(self.material.names) - len(self._order)
        rest = f"; the {len(self._order)} largest of {len(self.material.names)}" if missing else ""
        with self._still():
            self.bars.title = f"rms error of each frame, {unit}{above}{rest}"
            self.bars.level, self.bars.said = level, f"all that count: {level:.3g} {unit}"
            self.bars.bars = bars
            if self.frame.value in self._order:
                self.bars.chosen = self._order.index(self.frame.value)

    @contextmanager
    def _still(self) -> Iterator[None]:
        """Draw without choosing a frame."""
        before, self._quiet = self._quiet, True
        try:
            yield
        finally:
            self._quiet = before

    def _size(self) -> tuple[int, int] | None:
        """Width and height of the frames, px, if the calibration knows them."""
        fit = self.first.camera
        camera = self.material.camera if fit is None else fit.camera
        return None if camera is None else (camera.width, camera.height)

    def _image(self, name: str) -> FloatArray | None:
        """Read a frame; None, and a sentence, if it cannot be read or is not of the calibration's size."""
        try:
            image = self.image_of(name)
        except (OSError, ValueError) as error:
            self._say(sentence_of(error), bad=True)
            return None
        size = self._size()
        if image is None or size is None or image.shape[1::-1] == size:
            return image
        told = f"{image.shape[1]}x{image.shape[0]} px, and the calibration is for {size[0]}x{size[1]} px"
        self._say(f"the picture of {name} is {told}: it is not shown", bad=True)
        return None

    def _draw_frame(self) -> None:
        name = self.frame.value
        image, size = self._image(name), self._size()
        self._left.layout.display = "none" if image is None and size is None else None
        if size is None:  # there is nothing but the picture to draw on
            size = UNKNOWN if image is None else image.shape[1::-1]
        if self._of_camera:
            assert self.refits.state.camera is not None
            sigma = self.refits.state.camera.sigma
            drawn = dots_picture(image, size, name, self._judged.dots[name], sigma, self._place)
        else:
            levels = self._judged.levels[name]
            pixels = self._pixels(levels.samples)
            drawn = levels_picture(image, size, name, levels, pixels, self._place, self._limits)
        self.picture.caption, self.legend.value = drawn.title, legend(drawn.legend)
        self.picture.value = jpeg(drawn.picture)

    @property
    def _limits(self) -> tuple[float, float]:
        limits: tuple[float, float] = self.material.options.get("levels", LEVELS)
        return limits

    def _pixels(self, samples: Samples) -> FloatArray:
        """Where samples were read, (n, 2); nan without a camera."""
        camera = self.material.camera
        return np.full((len(samples), 2), np.nan) if camera is None else camera.project(samples.points)

    def _show_beside(self) -> None:
        wished = self.beside.value
        self._space_box.layout.display = None if wished == IN_SPACE else "none"
        self._why_box.layout.display = None if wished == LEFT_OUT else "none"
        if wished == IN_SPACE:
            self._draw_space()
        elif wished == LEFT_OUT:
            self._draw_why()

    def _draw_space(self) -> None:
        sheets = self._judged.sheets(self.quantity.value, self.left_out)
        fit = self.refits.state.camera
        camera = self.material.camera if fit is None else fit.camera
        about = surroundings([corners for _, _, corners in sheets])
        with self._still():
            self.space.centre, self.space.reach, self.space.axis = about.centre, about.reach, about.axis
            self.space.camera = [] if camera is None else camera_lines(camera, 0.25 * about.reach)
            self.space.sheets = sheets
            self.space.chosen = self.frame.value
            self.space.title = (
                f"{counted(len(sheets), 'panel')} before the camera: drag to turn, click and wheel to zoom"
            )

    def _draw_why(self) -> None:
        samples = self.material.samples
        assert samples is not None
        expected = self._judged.expected()
        why = self._judged.reasons(expected, self._limits)
        of_frame = np.zeros(len(samples), bool)
        of_frame[self.material.samples_of(self.frame.value)] = True
        pixels, size = self._pixels(samples), self._size() or UNKNOWN
        drawn = reasons_picture(samples.level, expected, why, pixels, size, of_frame, self._limits)
        self.why.caption = drawn.title
        self.why.value = jpeg(drawn.picture)
        self.whys.value = legend(drawn.legend, "<br>") + fates(self._places)

    def close(self) -> None:
        """Close the widget and end its thread."""
        self.refits.close()
        close_parts(self)
        super().close()
