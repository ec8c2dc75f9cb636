"""The tuner: knobs under a hand, the surface under its eyes.

`tune` makes a widget for JupyterLab and for `endolab tune`. Its `engine` answers in a thread of its own; the
page (`page/tuner.js`) is sent numbers, and draws. One picture is under way at a time: the next one waits
until the page says that it has painted the last. `TunerBox.answer` is what is shown, written and exported.
"""

from __future__ import annotations

import base64
import json
import threading
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import anywidget
import numpy as np
import traitlets as t
from numpy.typing import NDArray

from endolab.frames.frame import Frame
from endolab.frames.nominal import nominal_calibration
from endolab.io import datasets
from endolab.io.atomic import write_atomically
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import check_int, check_kinds, unknown_name
from endolab.numerics.iteration import Status
from endolab.reconstruction.settings import Settings
from endolab.reconstruction.uncertainty import Progress, uncertainty_of
from endolab.synthetic.scenes import SCENES
from endolab.workbench.plots.scales import MAPS, palette
from endolab.workbench.tuning.engine import (
    WITH_ENERGY,
    Answer,
    Engine,
    shown_as,
)
from endolab.workbench.tuning.export import export
from endolab.workbench.tuning.maps import PANELS, as_buffers
from endolab.workbench.tuning.messages import (
    ACTIONS,
    change_of,
    chips_of,
    curve_of,
    message_of,
    picture_said,
    run_of,
    still_said,
)
from endolab.workbench.tuning.player import page_of
from endolab.workbench.tuning.script import page_script
from endolab.workbench.tuning.source import PRESETS, Knobs, Source

# The page's controls, in order: how they are labelled, what they offer and how far they reach.
KNOBS: list[dict[str, Any]] = json.loads(
    Path(__file__).with_name("knobs.json").read_text(encoding="utf-8")
)
WIDTHS = (160, 320, 480, 640)  # px, to choose among
DRAWS = 8  # of random fields, for a σ that is off by a quarter or less
PAINTING = 0.5  # s; then the next picture is sent though the page has not said that the last is painted


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
        Of the frame; scenes are rendered by it. By default a nominal fisheye, as in the app, and without a
        frame the paper's endoscope.
    truth : (H, W) float array, optional
        True distance of the frame, mm; nan where unknown.
    scene : {"plane", "curved", "tube", "colon"}
        To begin with if there is no frame.
    width : int
        Columns to begin with, px.

    Returns
    -------
    TunerBox
        The widget; `box.answer` is what is on the screen, `box.export(folder)` writes it, and
        `box.export_html(path)` makes a tuner that needs no Python.

    Raises
    ------
    ValueError
        If frame, calibration and truth do not go together, or if there is no such scene.
    """
    if scene not in SCENES:
        raise unknown_name("scene", scene, SCENES)
    check_int("width", width, 1)
    truth = None if truth is None else np.asarray(truth)
    if calibration is None:
        paper = datasets.load_calibration("paper")
        calibration = paper if frame is None else nominal_calibration(frame)
    return TunerBox(frame, calibration, truth, scene, width)


class TunerBox(anywidget.AnyWidget):
    """The tuner's widget; `tune` makes it.

    `knobs` are what the page's controls say, `answer` is what is shown. Each action of the page is a method.
    """

    _esm = page_script("tuner") + "export default { render };"
    _css = Path(__file__).with_name("tuner.css")
    facts: t.Dict[str, Any] = t.Dict().tag(sync=True)  # what the page needs from the start

    def __init__(
        self,
        frame: Frame | None,
        calibration: Calibration,
        truth: FloatArray | None = None,
        scene: str = "colon",
        width: int = 320,
        pictures: Sequence[Path] = (),
    ) -> None:
        self.answer: Answer | None = None
        self._maps = set(PANELS[:2])  # that the page is sent
        self._change = ("", 0.0)  # by asking anew: a sentence, and % of the pixels
        self._turned: set[str] = set()  # the knobs that were turned last
        self._finds = 0  # so many times all was found anew
        self._is_open = False  # whether there is a page
        self._free = threading.Event()  # the page has painted what it was sent
        self._free.set()
        source = Source(calibration, frame, truth, pictures)
        scenes: list[tuple[str, str | int]] = [(name, name) for name in SCENES]
        self.knobs = Knobs(scene=scene, width=width)
        if frame is not None:
            self.knobs = Knobs(scene=0, width=width, channel="auto")
            names = [frame.name, *(path.name for path in pictures[1:])]
            scenes = [(name, number) for number, name in enumerate(names)] + scenes
        # What the knobs cannot know: the choices, and what None stands for.
        known: dict[str, dict[str, Any]] = {
            "scene": {"options": scenes},
            "width": {"options": sorted({*WIDTHS, width})},
            "k": {"first": calibration.photometry.k},
            "gamma": {"first": calibration.photometry.gamma},
        }
        lights = calibration.photometry.lights
        place = lights[0].position if len(lights) == 1 else (0.0, 0.0)
        known |= {"lamp_x": {"first": place[0]}, "lamp_y": {"first": place[1]}}
        camera = calibration.evidence.get("camera", {})
        if camera.get("nominal"):
            known["fov"] = {"first": camera["fov"]}
        specs = [spec for spec in KNOBS if spec["name"] != "fov" or "fov" in known]
        options = {part.name: getattr(self.knobs, part.name) for part in fields(Settings)}
        del options["width"]
        super().__init__(
            facts={
                "html": Path(__file__).with_name("tuner.html").read_text(encoding="utf-8"),
                "specs": [spec | known.get(spec["name"], {}) for spec in specs],
                "first": vars(self.knobs),
                "presets": {name: options | more for name, more in PRESETS.items()},
                "with_energy": WITH_ENERGY,
                "panels": [*PANELS],
                "scales": {name: vars(scale) for name, scale in MAPS.items()},
                "palettes": {
                    scale.palette: palette(name).view(np.uint32)[:, 0].tolist()
                    for name, scale in MAPS.items()
                },
            }
        )
        self.on_msg(self._hear)
        self.engine = Engine(source, self._show, self._note, self._refuse)
        self.engine.ask(self.knobs)

    # What the page asks for --------------------------------------------------------------

    def _hear(self, _: object, content: dict[str, Any], buffers: object) -> None:
        """Do what the page asks for, a row of `ACTIONS`; say what goes wrong in the status line."""
        try:
            method, names = ACTIONS[content["do"]]
            getattr(self, method)(**dict(zip(names, content["given"], strict=False)))
        except Exception as error:
            self._say_wrong((str(error).strip() or type(error).__name__).splitlines()[0])

    def go_on(self) -> None:
        """Send the next picture: the page has painted the last."""
        self._free.set()

    def turn(
        self, values: dict[str, Any], anew: bool = False, found: int | None = None
    ) -> None:
        """Turn some knobs by code, on the page too, and ask for what they say; returns at once.

        Light and contours stay as they are shown, if they can; or they are found `anew`; or are those of an
        answer before, whose message had the number `found`.
        """
        self.send({"knobs": vars(replace(self.knobs, **values))})
        self.follow(values, anew, found)

    def follow(
        self, values: dict[str, Any], anew: bool = False, found: int | None = None
    ) -> None:
        """Do as `turn`, where the page has turned them."""
        before = vars(self.knobs)
        self.knobs = replace(self.knobs, **values)
        self._turned = {name for name, value in values.items() if value != before[name]}
        self.engine.ask(self.knobs, anew, found)

    def choose(self, names: list[str]) -> None:
        """Send these maps from now on."""
        self._maps = {"distance", *names}.intersection(PANELS)
        if self.answer is not None:
            self._send_answer(self.answer)

    def show_iterate(self, place: int, state: int | None = None) -> None:
        """Show an iterate of the last run, from 1; the last one is the answer again.

        Nothing, if what is shown is not the `state` any more in which the page asked.
        """
        answer = self._final()
        if state not in (None, answer.state):
            return
        if not 1 <= place <= len(answer.path):
            raise ValueError(f"there are {len(answer.path)} iterates, got {place}")
        shown = answer
        if place < len(answer.path):
            passed = shown_as(answer.path[place - 1], answer.settings)
            shown = replace(answer, kind="iterate", result=passed, uncertainty=None)
        self._post(*message_of(shown, self._maps, self.engine, self._change[0]))

    def open_page(self) -> None:
        """Send all there is, to a page that was opened, or that shows something else now."""
        self._is_open = True
        answer = self.answer
        if answer is not None:
            self._send_answer(answer, still=True, knobs=vars(self.knobs))
            self._note()
            return
        subject = self.engine.source.subject(self.knobs)
        self._post(*picture_said(subject, self.knobs))

    def find_uncertainty(self, state: int | None = None) -> None:
        """Find how far the answer of that `state`, which is shown, can be trusted; a newer wish ends it."""
        answer = self._final()
        if state not in (None, answer.state):
            return
        known = answer.settings.calibration_of(answer.still.subject)

        def follow(progress: Progress) -> bool:
            done = {"done": progress.done, "of": progress.of}
            self.send({"sigma": done, "state": answer.state})
            return self.engine.is_stale()

        def job() -> None:
            if self.engine.is_stale() or self.engine.shown is not answer:
                return
            found = uncertainty_of(answer.result, known, draws=DRAWS, observers=[follow])
            if found.status is not Status.STOPPED:
                answer.uncertainty = found
                self._show(answer)

        self.engine.do(job)

    def _final(self) -> Answer:
        answer = self.answer
        if answer is None or not answer.is_final:
            raise ValueError("the answer is still to come")
        return answer

    # What is shown -----------------------------------------------------------------------

    def _say_wrong(self, sentence: str) -> None:
        self.send({"line": sentence, "tone": "endolab-wrong"})

    def _refuse(self, sentence: str) -> None:
        """Say what the engine cannot answer; of a picture that cannot be read the one before stays."""
        answer = self.answer
        if answer is not None and answer.settings.scene != self.knobs.scene:
            sentence += ": the frame before is still shown"
            self.knobs = replace(self.knobs, scene=answer.settings.scene)
            self.send({"knobs": vars(self.knobs)})
        self._say_wrong(sentence)

    def _show(self, answer: Answer) -> None:
        """Show an answer, once the page has painted the one before; in the engine's thread."""
        self._free.wait(PAINTING)
        before = self.answer
        is_new = before is None or answer.still is not before.still
        has_unit = before is not None and before.result.metric == answer.result.metric
        self.answer = answer
        if answer.is_final and is_new:
            is_found = len(self.engine.finds) > self._finds
            before = self.engine.settled
            self._change = change_of(before, answer) if is_found else ("", 0.0)
            self._finds = len(self.engine.finds)
        self._send_answer(answer, still=is_new or not has_unit, anew=is_new)

    def _send_answer(self, answer: Answer, still: bool = False, **more: Any) -> None:
        """Send an answer, with its run if that has ended, and with `still` what stays meanwhile."""
        message, arrays = message_of(answer, self._maps, self.engine, self._change[0])
        message |= more
        if answer.is_final:
            message |= run_of(answer)
        if still:
            words, fixed = still_said(answer)
            message |= words
            arrays |= fixed
        self._post(message, arrays)

    def _post(self, message: dict[str, Any], arrays: dict[str, NDArray]) -> None:
        names, buffers = as_buffers(arrays)
        if self._is_open:
            self._free.clear()
        self.send(message | {"names": names}, buffers)

    def _note(self) -> None:
        """Send what is known of λ now, and what asks for something: advice, warnings, what is not unique."""
        answer = self.answer
        if answer is None or not answer.is_final:
            return
        if "spread over λ" in self._maps:  # a map of all of them
            self._send_answer(answer)
        curve = curve_of(answer, self.engine.curve_of(answer))
        chips = chips_of(answer, curve.get("best"), self._change[1], self._turned)
        self.send({"curve": curve, "chips": chips, "state": answer.state})

    # What is written ---------------------------------------------------------------------

    def export(
        self, folder: str | Path, *, overwrite: bool = False, board: bytes | None = None
    ) -> Path:
        """Write all there is about the one answer into a folder.

        That is `result.py`, `settings.json`, `endoscope.json`, `found.npz`, the frame, `recording.rrd`, and
        what `save_result` writes; from the page also `board.png`, as it is seen. All or none. A folder that
        holds files of others is written into only if `overwrite`.
        """
        undrawn = export(self._final(), folder, overwrite, board)
        line = "; ".join([f"exported into {Path(folder).resolve()}", *undrawn])
        self.send({"line": line, "tone": "endolab-wrong" if undrawn else ""})
        return Path(folder)

    def export_aside(self, name: str, board: str) -> None:
        """Export, in the engine's thread, whatever is asked for meanwhile; `board` is a data link, PNG."""
        folder = Path(name).expanduser()
        content = base64.b64decode(board.partition(",")[2])

        def job() -> None:
            try:
                self.export(folder, board=content)
            except FileExistsError:  # whose own words are for who calls by code
                text = f"{folder} is there already: export under another name"
                raise ValueError(text) from None

        self.engine.do(job)

    def export_html(
        self,
        path: str | Path,
        progress: Callable[[int, int], object] = lambda done, total: None,
    ) -> Path:
        """Write a tuner that needs no Python: one page, λ × regulariser, with what is held now.

        ``progress(done, total)`` is called after each answer.
        """
        self.engine.wait()
        page = page_of(self._final(), self.engine, self.facts, progress)
        write_atomically(path, page.encode())
        return Path(path)

    def close(self) -> None:
        """Close the widget and end its thread."""
        if hasattr(self, "engine"):  # not if it was refused
            self.engine.close()
        super().close()
