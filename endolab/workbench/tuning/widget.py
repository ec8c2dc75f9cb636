"""The tuner: knobs under a hand, the surface under its eyes.

`tune` makes a widget for JupyterLab and for `endolab tune`. Its `engine` answers in a thread of its own; the
page (`page/tuner.js`) is sent numbers, and draws. One picture is under way at a time: the next one waits until the
page says that it has painted the last. `TunerBox.answer` is what is shown, written and exported.
"""

from __future__ import annotations

import base64
import json
import re
import threading
from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import anywidget
import numpy as np
import traitlets as t
from numpy.typing import NDArray

from endolab.frames.frame import Frame
from endolab.frames.nominal import nominal_calibration
from endolab.io import datasets
from endolab.io.atomic import read_bytes, stage_folder, write_atomically
from endolab.io.descriptions import write_calibration
from endolab.io.found import save_found
from endolab.io.images import write_image
from endolab.io.settings import write_settings
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import check_int, check_kinds, unknown_name
from endolab.numerics.iteration import Status
from endolab.reconstruction.pipeline import reconstruct, solve_found
from endolab.reconstruction.report import advice, describe, what_changed
from endolab.reconstruction.settings import Settings
from endolab.reconstruction.uncertainty import Progress, uncertainty_of
from endolab.solvers.problem import REGULARISERS
from endolab.synthetic.scenes import SCENES
from endolab.workbench.plots.scales import MAPS, palette
from endolab.workbench.tuning.engine import (
    WITH_ENERGY,
    Answer,
    AnswerKind,
    Engine,
    shown_as,
)
from endolab.workbench.tuning.maps import PANELS, as_buffers, map_of, rgba, still_of
from endolab.workbench.tuning.player import write_page
from endolab.workbench.tuning.source import Knobs, Source
from endolab.workbench.tuning.script import page_script

# The page's controls, in order: how they are labelled, what they offer and how far they reach.
KNOBS: list[dict[str, Any]] = json.loads(
    Path(__file__).with_name("knobs.json").read_text(encoding="utf-8")
)
WIDTHS = (160, 320, 480, 640)  # px, to choose among
# Options beside the defaults, by what the page calls them.
PRESETS: dict[str, dict[str, Any]] = {
    "default": {},
    "paper": {
        "channel": "green",
        "solver": "primal_dual",
        "regulariser": "second",
        "contours": False,
        "highlights": "keep",
    },
    "fastest": {"channel": "green", "solver": "fast_marching"},
}
# What an export makes its answer again by.
RESULT = """from pathlib import Path

import endolab as el
from endolab.io.settings import read_settings

here = Path(__file__).parent
saved = read_settings(here / "settings.json")
calibration = saved.apply(el.load_calibration(here / "endoscope.json"))  # what is believed
found = el.load_found(saved.found)  # light and contours
result = el.solve_found(found, calibration, **saved.keywords)
"""
# Of random fields, for an uncertainty that somebody waits for: σ is off by a quarter or less.
DRAWS = 8
PAINTING = 0.5  # s; then the next picture is sent though the page has not said that the last is painted
ELSEWHERE = 10.0  # %; two surfaces that differ by more are not the same
LEAST_ELSEWHERE = 1.0  # % of the pixels, of which it is said
PLAYED_LAMS = 10 ** np.linspace(-2, 2, 21)  # of the tuner without Python


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
        """Do what the page asks for, and say what goes wrong in the status line."""
        actions: dict[str, Callable[..., object]] = {
            "export": self._export_aside,
            "iterate": self.show_iterate,
            "painted": self._free.set,
            "panels": self._choose,
            "ready": self._open,
            "sigma": self.find_uncertainty,
            "turn": self.turn,
        }
        try:
            actions[content["do"]](*content["given"])
        except Exception as error:
            self._say_wrong((str(error).strip() or type(error).__name__).splitlines()[0])

    def turn(
        self, values: dict[str, Any], anew: bool = False, found: int | None = None
    ) -> None:
        """Turn some knobs, and ask for what they say; returns at once.

        Light and contours stay as they are shown, if they can; or they are found `anew`; or are those of an
        answer before, whose message had the number `found`.
        """
        self.knobs = knobs = replace(self.knobs, **values)
        self.engine.ask(knobs, anew, found)

    def _choose(self, names: list[str]) -> None:
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
            shown = replace(
                answer, kind=AnswerKind.ITERATE, result=passed, uncertainty=None
            )
        self._post(*self._message(shown, self._maps))

    def find_uncertainty(self, state: int | None = None) -> None:
        """Find how far the answer that is shown can be trusted; a newer wish ends it.

        Nothing, likewise.
        """
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
            self._change = _change(before, answer) if is_found else ("", 0.0)
            self._finds = len(self.engine.finds)
        self._send_answer(answer, still=is_new or not has_unit, anew=is_new)

    def _open(self) -> None:
        """Send all there is, to a page that was opened, or that shows something else now."""
        self._is_open = True
        answer = self.answer
        if answer is not None:
            self._send_answer(answer, still=True, knobs=vars(self.knobs))
            self._note()
            return
        subject = self.engine.source.subject(self.knobs)
        image = subject.frame.image
        step = -(-image.shape[1] // self.knobs.width)
        picture = rgba(image[::step, ::step])
        height, width = picture.shape[:2]
        still = {"width": width, "height": height, "window": [0, 0, width, height]}
        still["has_gain"] = subject.calibration.photometry.gain is not None
        message = {"still": still, "line": "solving ...", "knobs": vars(self.knobs)}
        self._post(message, {"picture": picture})

    def _send_answer(self, answer: Answer, still: bool = False, **more: Any) -> None:
        """Send an answer, with its run if that has ended, and with `still` what stays meanwhile."""
        message, arrays = self._message(answer, self._maps)
        message |= more
        if answer.is_final:
            message["path"] = [one.k for one in answer.path]
            columns = ("k", "data", "regulariser", "energy")
            rows = answer.result.history
            message["energy"] = {name: [row[name] for row in rows] for name in columns}
        if still:
            truth = answer.still.truth_in(answer.result)
            message["still"], fixed = still_of(answer.result.problem, truth)
            gain = answer.still.subject.calibration.photometry.gain
            message["still"]["has_gain"] = gain is not None
            arrays |= fixed
        self._post(message, arrays)

    def _post(self, message: dict[str, Any], arrays: dict[str, NDArray]) -> None:
        names, buffers = as_buffers(arrays)
        if self._is_open:
            self._free.clear()
        self.send(message | {"names": names}, buffers)

    def _message(
        self, answer: Answer, names: Iterable[str]
    ) -> tuple[dict[str, Any], dict[str, NDArray]]:
        """What is said of an answer and of some of its maps, and these."""
        order = answer.result.problem.regulariser
        name = answer.settings.solver.replace("_", " ")
        if answer.uses_lam:
            name = f"λ {answer.settings.lam:.3g}, {order}"
        line = describe(answer.result, answer.explained, answer.kind, answer.errors)
        if answer.is_final and answer.is_anew and self._change[0]:
            line = f"{self._change[0]} · {line}"
        several = self.engine.curve_of(answer)
        maps = {name: map_of(name, answer, several) for name in names}
        message = {
            "label": f"{name}, {100 * answer.explained:.1f} % explained",
            "badge": "" if answer.is_anew else "held",
            "state": answer.state,
            "found": self.engine.number_of(answer),
            "line": line,
            "tone": "",
            "curve": self._curve(answer),
            "asked": vars(answer.settings),
            "moving": not answer.is_final,
            "maps": {name: words for name, (words, _) in maps.items()},
        }
        return message, {name: a for name, (_, a) in maps.items() if a is not None}

    def _note(self) -> None:
        """Send what is known of λ now, and what asks for something: advice, warnings, what is not unique."""
        answer = self.answer
        if answer is None:
            return
        chips: list[dict[str, Any]] = []
        best, _ = self.engine.best_lam(answer)
        advised = advice(answer.explained, best)
        if advised:
            text = "A smaller λ follows the picture more closely; click to take it."
            chips.append({"chip": advised, "text": text, "lam": float(f"{best:.2g}")})
        chips += [
            {"chip": re.split("[:;,]", text)[0].rstrip("."), "text": text}
            for text in answer.doubts
        ]
        moved = self._change[1]
        if answer.is_anew and moved >= LEAST_ELSEWHERE:
            share = f"{moved:.2g} %"
            text = f"{share} of the pixels moved by more than {ELSEWHERE:g} % as all was asked anew."
            chip = f"not unique: {share} of pixels"
            chips.append({"chip": chip, "text": text, "panel": "spread over λ"})
        curve = self._curve(answer)
        self.send({"curve": curve, "chips": chips, "state": answer.state})

    def _curve(self, answer: Answer) -> dict[str, Any]:
        """What each λ explains that was tried with the solver, the light and the contours of an answer."""
        if not answer.uses_lam:
            return {"title": f"{answer.settings.solver.replace('_', ' ')} has no λ"}
        tried = self.engine.curve_of(answer)
        errors = [one.errors for one in tried]
        curve = {
            "title": "",
            "lams": [one.settings.lam for one in tried],
            "explained": [one.explained for one in tried],
            "errors": [None if one is None else one[0] for one in errors],
            "now": answer.settings.lam,
        }
        if len(tried) > 3:  # of fewer nothing follows
            best, at_least = self.engine.best_lam(answer)
            title = "no λ tried explains 99 %: wet or stained walls, or another light"
            if best is not None:
                title = f"99 % explained up to {'≥ ' if at_least else ''}{best:.2g}"
            curve |= {"title": title, "best": best}
        return curve

    # What is written ---------------------------------------------------------------------

    def export(
        self, folder: str | Path, *, overwrite: bool = False, board: bytes | None = None
    ) -> Path:
        """Write all there is about the one answer into a folder.

        That is `result.py`, `settings.json`, `endoscope.json`, `found.npz`, the frame, `recording.rrd`, and
        what `save_result` writes; from the page also `board.png`, as it is seen. All or none. A folder that
        holds files of others is written into only if `overwrite`.
        """
        # These draw: who waits for a first surface need not wait for them.
        from endolab.workbench.recording.recorder import record
        from endolab.workbench.reports.result import save_result

        answer = self._final()
        subject = answer.still.subject
        found = answer.still.found
        assert found is not None
        trusted = answer.uncertainty
        saved = replace(answer.settings.solving_settings(subject), found="found.npz")
        known = answer.settings.endoscope(subject.calibration)
        with stage_folder(folder, overwrite=overwrite) as staging:
            with record(staging / "recording.rrd", truth=subject.truth) as recorder:
                anew = partial(reconstruct, subject.frame)
                solve = anew if answer.is_anew else partial(solve_found, found)
                believed = answer.settings.calibration_of(subject)
                solve(believed, observers=[recorder], **saved.keywords)
                if trusted is not None:
                    recorder.add_uncertainty(trusted, answer.result)
            undrawn = recorder.undrawn
            save_result(
                answer.result,
                staging,
                uncertainty=trusted,
                overwrite=True,
                undrawn=undrawn,
            )
            if board is not None:
                write_atomically(staging / "board.png", board)
            # The camera that is believed in now is the one beside it.
            beside = replace(found.believed, camera=known.camera)
            save_found(replace(found, believed=beside), staging / "found.npz")
            picture = "frame.png" if subject.path is None else subject.path.name
            if subject.path is None:
                write_image(staging / picture, subject.frame.image, bits=16)
            else:
                write_atomically(staging / picture, read_bytes(subject.path))
            if not subject.frame.mask.all():
                write_image(staging / "mask.png", subject.frame.mask.astype(float))
                saved = replace(saved, mask="mask.png")
            write_calibration(known, staging / "endoscope.json")
            write_settings(saved, staging / "settings.json")
            write_atomically(staging / "result.py", RESULT.encode())
        line = "; ".join([f"exported into {Path(folder).resolve()}", *undrawn])
        self.send({"line": line, "tone": "endolab-wrong" if undrawn else ""})
        return Path(folder)

    def _export_aside(self, name: str, board: str) -> None:
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

    def export_html(self, path: str | Path) -> Path:
        """Write a tuner that needs no Python: one page, λ × regulariser, with what is held now."""
        engine = self.engine
        engine.wait()
        answer = self._final()
        if answer.settings.solver != "gauss_newton":
            raise ValueError("only Gauss-Newton's answers are played over λ")
        lams = [float(f"{lam:.3g}") for lam in PLAYED_LAMS]
        orders: Any = REGULARISERS
        wishes = [
            replace(answer.settings, lam=lam, regulariser=order)
            for order in orders
            for lam in lams
        ]
        answers = [engine.solve(wish, answer.still) for wish in wishes]
        messages = [self._message(one, PANELS[:2])[0] for one in answers]
        truth = answer.still.truth_in(answer.result)
        still, arrays = still_of(answer.result.problem, truth)
        specs = [
            spec for spec in self.facts["specs"] if spec["name"] in ("lam", "regulariser")
        ]
        specs[1] = specs[1] | {"options": [*REGULARISERS]}
        alone = {"specs": specs, "panels": [*PANELS[:2]], "alone": True}
        knobs = {"lam": answer.settings.lam, "regulariser": "second"}
        first = {"still": still, "knobs": knobs, "anew": True}
        title = f"{answer.still.subject.frame.name} · endolab"
        page = write_page(self.facts | alone, first, arrays, messages, answers, title)
        write_atomically(path, page.encode())
        return Path(path)

    def close(self) -> None:
        """Close the widget and end its thread."""
        if hasattr(self, "engine"):  # not if it was refused
            self.engine.close()
        super().close()


def _change(before: Answer | None, answer: Answer) -> tuple[str, float]:
    """Say what asking anew has changed, and what share of the pixels is elsewhere now, %."""
    if before is None or before.still.subject is not answer.still.subject:
        return "", 0.0
    old = before.result
    new = answer.result
    if old.mask.shape != new.mask.shape:
        return "", 0.0
    sentence = what_changed(old, new, answer.contours - before.contours)
    if before.settings != answer.settings:
        return sentence, 0.0
    change = 100 * np.abs(old.distance / new.distance - 1)[new.mask]
    return sentence, 100 * float(np.mean(change > ELSEWHERE))
