"""The tuner: knobs under a hand, the surface under its eyes.

`tune` makes a widget for JupyterLab and for `endolab tune`. Its `engine` answers in a thread of its own; the
page (`tuner.js`) is sent numbers, and draws. One picture is under way at a time: the next one waits until the
page says that it has painted the last. `TunerBox.answer` is what is shown, written and exported.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import anywidget
import numpy as np
import traitlets as t
from matplotlib import colormaps
from numpy.typing import NDArray

from endolab.frames.frame import Frame
from endolab.io import datasets
from endolab.io.atomic import read_bytes, stage_folder, write_atomically
from endolab.io.descriptions import write_calibration
from endolab.io.held import save_held
from endolab.io.images import write_image
from endolab.io.settings import write_settings
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import check_int, check_kinds, unknown_name
from endolab.reconstruction.contrast import suggest_lam
from endolab.reconstruction.pipeline import reconstruct
from endolab.reconstruction.report import advice, describe, what_changed
from endolab.reconstruction.settings import Settings
from endolab.solvers.problem import REGULARISERS
from endolab.synthetic.scenes import SCENES
from endolab.workbench.reports.result import save_result
from endolab.workbench.tuning.controls import knob_specs
from endolab.workbench.tuning.engine import (
    Answer,
    AnswerKind,
    Engine,
    shown_as,
)
from endolab.workbench.tuning.maps import (
    NEED_UNCERTAINTY,
    PANELS,
    as_buffers,
    map_of,
    rgba,
    still_of,
)
from endolab.workbench.tuning.player import pack, write_page
from endolab.workbench.tuning.source import Knobs, Source
from endolab.workbench.tuning.surface_view import page_script

WIDTHS = (160, 320, 480, 640)  # px, to choose among
PAPER = {"channel": "green", "solver": "primal_dual", "regulariser": "second"}
# Options beside the defaults, by what the page calls them.
PRESETS: dict[str, dict[str, Any]] = {
    "default": {},
    "paper": PAPER | {"contours": False, "highlights": "keep"},
    "fastest": {"channel": "green", "solver": "fast_marching"},
}
# What an export makes its answer again by.
RESULT = """from pathlib import Path

import endolab as el
from endolab.io.settings import read_settings

here = Path(__file__).parent
calibration = el.load_calibration(here / "endoscope.json")
calibration = read_settings(here / "settings.json").apply(calibration)  # what is believed
frame = el.read_frame(here / "{picture}", calibration{mask})
result = el.reconstruct(frame, calibration, {given})
"""
# What the page makes by itself.
OWN_PANELS = {"frame", "section", "3D", "λ curve", "error", "B / A - 1", "energy"}
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
    calibration = calibration or datasets.load_calibration("paper")
    return TunerBox(frame, calibration, truth, scene, width)


class TunerBox(anywidget.AnyWidget):
    """The tuner's widget; `tune` makes it.

    `knobs` are what the page's controls say, `answer` is what is shown. Each action of the page is a method.
    """

    _esm = page_script("tuner.js")
    _css = Path(__file__).with_name("tuner.css")
    facts: t.Dict[str, Any] = t.Dict().tag(sync=True)  # specs, palettes, presets, panels

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
        self._settled: Answer | None = None  # the last that was final
        self.panels: Sequence[str] = PANELS[:6]
        self._visited: list[Knobs] = []  # for undo
        self._limits: dict[
            str, tuple[float, float]
        ] = {}  # of maps, held until all is asked anew
        self._number = 0  # of the last picture
        self._said = ""  # what the last answer that was asked anew has changed
        self._elsewhere = 0.0  # % of the pixels that were elsewhere before
        self._free = threading.Event()  # the page has painted it
        self._free.set()
        source = Source(calibration, frame, truth, pictures)
        scenes: list[tuple[str, str | int]] = [(name, name) for name in SCENES]
        start = Knobs(scene=scene, width=width)
        if frame is not None:
            start = Knobs(scene=0, width=width, channel="auto")
            names = [frame.name, *(path.name for path in pictures[1:])]
            scenes = [(name, number) for number, name in enumerate(names)] + scenes
        self._first = vars(start) | {"texture": "frame"}
        self.knobs = dict(self._first)
        # What the knobs cannot know: the choices, and what None stands for.
        known: dict[str, dict[str, Any]] = {
            "scene": {"options": scenes},
            "width": {"options": sorted({*WIDTHS, width})},
            "k": {"first": calibration.photometry.k},
            "gamma": {"first": calibration.photometry.gamma},
        }
        camera = calibration.evidence.get("camera", {})
        if camera.get("nominal"):
            known["fov"] = {"first": camera["fov"]}
        self._specs = [
            spec | known.get(spec["name"], {})
            for spec in knob_specs()
            if spec["name"] != "fov" or "fov" in known
        ]
        super().__init__(facts=self._facts())
        self.on_msg(self._hear)
        self.engine = Engine(source, self._show, self._note, self._refuse)
        self.engine.ask(self.settings())

    def _facts(self) -> dict[str, Any]:
        palettes = {
            name: colormaps[name](np.arange(256), bytes=True).view(np.uint32)[:, 0].tolist()
            for name in ("viridis", "magma", "RdBu_r")
        }
        return {
            "specs": self._specs,
            "palettes": palettes,
            "presets": [*PRESETS],
            "panels": [*PANELS],
        }

    # What the page asks for --------------------------------------------------------------

    def _hear(self, _: object, content: dict[str, Any], buffers: list[Any]) -> None:
        """Do what the page asks for, and say what goes wrong in the status line."""
        actions: dict[str, Callable[..., object]] = {
            "anew": self.ask_anew,
            "export": self._export_aside,
            "iterate": self.show_iterate,
            "painted": lambda number: self._free.set(),
            "panels": self._choose,
            "preset": self.preset,
            "ready": self._send_all,
            "reset": self.reset,
            "sigma": self.find_uncertainty,
            "step": self.step,
            "turn": self.turn,
            "undo": self.undo,
        }
        try:
            actions[content["do"]](*content["given"], *map(bytes, buffers))
        except Exception as error:
            self._say_wrong((str(error).strip() or type(error).__name__).splitlines()[0])

    def settings(self) -> Knobs:
        """Return what the knobs say."""
        return Knobs(
            **{name: value for name, value in self.knobs.items() if name != "texture"}
        )

    def turn(self, values: dict[str, Any], anew: bool = False) -> None:
        """Turn some knobs, and ask for what they say; returns at once."""
        before = self.knobs
        self.knobs = before | values
        if self.knobs["texture"] != before["texture"]:
            self._send_all()
        self.engine.ask(self.settings(), anew)

    def set_knobs(self, values: dict[str, Any]) -> None:
        """Turn some knobs on the page as well."""
        self.turn(values)
        self.send({"knobs": self.knobs})

    def ask_anew(self) -> None:
        """Have light and contours found again, with the knobs as they are."""
        self.send({"line": "asking anew ..."})
        self.turn({}, anew=True)

    def undo(self) -> None:
        """Go back to the knobs before."""
        if len(self._visited) > 1 and self.settings() == self._visited[-1]:
            self._visited.pop()
        if self._visited:
            self.set_knobs(vars(self._visited[-1]))

    def reset(self) -> None:
        """All knobs as they were at first; a picture stays."""
        scene = self.knobs["scene"]
        self.set_knobs(self._first | ({"scene": scene} if isinstance(scene, int) else {}))

    def preset(self, name: str) -> None:
        """Set all options of a reconstruction at once; the frame and what is believed stay."""
        options = {part.name for part in fields(Settings)} - {"width"}
        first = {key: value for key, value in self._first.items() if key in options}
        self.set_knobs(first | PRESETS[name])

    def step(self, by: int) -> None:
        """Look at the next frame, or the one before."""
        scene = self.knobs["scene"]
        if isinstance(scene, int) and 0 <= scene + by < len(self.engine.source.pictures):
            self.set_knobs({"scene": scene + by})

    def _choose(self, names: list[str]) -> None:
        """Show other panels."""
        added = {*names} - {*self.panels}
        self.panels = [name for name in names if name in PANELS]
        if added.intersection(NEED_UNCERTAINTY):
            self.find_uncertainty()
        if added - OWN_PANELS:
            self._send_all()

    def show_iterate(self, place: int) -> None:
        """Show an iterate of the last run, from 1; the last one is the answer again."""
        answer = self._final()
        if not 1 <= place <= len(answer.path):
            raise ValueError(f"there are {len(answer.path)} iterates, got {place}")
        shown = answer
        if place < len(answer.path):
            passed = shown_as(answer.path[place - 1])
            shown = replace(
                answer, kind=AnswerKind.ITERATE, result=passed, uncertainty=None
            )
        self._send_answer(shown, path=self._path(answer, place))

    def find_uncertainty(self) -> None:
        """Find how far the answer that is shown can be trusted."""
        answer = self._final()
        if answer.uncertainty is None:
            self.send({"line": "finding σ ..."})
            self.engine.do(lambda: self.engine.find_uncertainty(answer))

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
        if answer is not None and answer.settings.scene != self.knobs["scene"]:
            sentence += ": the frame before is still shown"
            self.knobs["scene"] = answer.settings.scene
            self.send({"knobs": self.knobs})
        self._say_wrong(sentence)

    def _show(self, answer: Answer) -> None:
        """Show an answer, once the page has painted the one before; in the engine's thread.

        What is old by then is passed over: a look at the newest wish takes less than painting does.
        """
        if not answer.is_final and not self._free.is_set():
            self._free.wait(PAINTING)
            if self.engine.is_stale():
                return
        is_new = self.answer is None or answer.still is not self.answer.still
        self.answer = answer
        if is_new:
            self._limits = {}
            if answer.is_final:
                self._compare(self._settled, answer)
        if answer.is_final:
            self._settled = answer
            if self._visited[-1:] != [answer.settings]:
                self._visited.append(answer.settings)
        self._send_answer(answer, still=is_new)

    def _compare(self, before: Answer | None, answer: Answer) -> None:
        """Note what asking anew has changed."""
        self._said = ""
        self._elsewhere = 0.0
        if before is None or before.still.subject is not answer.still.subject:
            return
        old = before.result
        new = answer.result
        if old.mask.shape != new.mask.shape:
            return
        self._said = what_changed(old, new, answer.contours - before.contours)
        if before.settings == answer.settings:
            change = 100 * np.abs(old.distance / new.distance - 1)[new.mask]
            self._elsewhere = 100 * float(np.mean(change > ELSEWHERE))

    def _send_all(self) -> None:
        """Send all there is, to a page that was opened, or that shows something else now."""
        self._free.set()
        answer = self.answer
        if answer is not None:
            self._send_answer(answer, still=True, knobs=self.knobs)
        else:
            self._send_frame()

    def _send_frame(self) -> None:
        """Show the frame, as there is no answer yet."""
        subject = self.engine.source.subject(self.settings())
        image = subject.frame.image
        step = -(-image.shape[1] // self.knobs["width"])
        picture = image[::step, ::step]
        height, width = picture.shape[:2]
        still = {"width": width, "height": height, "unit": "mm", "metric": True}
        still["window"] = [0, 0, width, height]
        content = {"still": still, "line": "solving ...", "knobs": self.knobs}
        self._send_arrays(content, {"picture": rgba(picture)})

    def _send_arrays(self, message: dict[str, Any], arrays: dict[str, NDArray]) -> None:
        names, buffers = as_buffers(arrays)
        self.send(message | {"names": names}, buffers)

    def _send_answer(self, answer: Answer, still: bool = False, **more: Any) -> None:
        """Send an answer in one message: words, maps, and with `still` what stays meanwhile."""
        message = more | self._words(answer)
        arrays: dict[str, NDArray] = {}
        if answer.is_final:
            message["chips"] = self._chips(answer)
            message |= {"path": self._path(answer, len(answer.path))}
            columns = ("k", "data", "regulariser", "energy")
            rows = answer.result.history
            message["energy"] = {name: [row[name] for row in rows] for name in columns}
        if still:
            facts, arrays = still_of(answer.result.problem, answer.still.truth)
            message |= {"still": facts, "anew": not self._limits}
        maps = {}
        wanted = {"distance", "model - frame", *self.panels, self.knobs["texture"]}
        for name in wanted - OWN_PANELS:
            maps[name], array = map_of(name, answer, self.engine, self._limits)
            if array is not None:
                arrays[name] = array
        self._number += 1
        self._free.clear()
        message |= {
            "maps": maps,
            "number": self._number,
            "asked": vars(answer.settings),
            "moving": not answer.is_final,
        }
        self._send_arrays(message, arrays)

    def _words(self, answer: Answer) -> dict[str, Any]:
        """What is said of an answer: its line, badge and label, and the λ curve."""
        order = answer.result.problem.regulariser
        name = answer.settings.solver.replace("_", " ")
        if answer.uses_lam:
            name = f"λ {answer.settings.lam:.3g}, {order}"
        line = describe(answer.result, answer.explained, answer.kind, answer.errors)
        if answer.kind == AnswerKind.ANEW and self._said:
            line = f"{self._said} · {line}"
        return {
            "label": f"{name}, {100 * answer.explained:.1f} % explained",
            "badge": "" if answer.held is None else "held",
            "line": line,
            "tone": "",
            "curve": self._curve(answer),
        }

    def _chips(self, answer: Answer) -> list[dict[str, Any]]:
        """What asks for something: advice, warnings, and where the surface is not unique."""
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
        if answer.kind == AnswerKind.ANEW and self._elsewhere >= LEAST_ELSEWHERE:
            share = f"{self._elsewhere:.2g} %"
            text = f"{share} of the pixels moved by more than {ELSEWHERE:g} % as all was asked anew."
            chip = f"not unique: {share} of pixels"
            chips.append({"chip": chip, "text": text, "panel": "spread over λ"})
        return chips

    def _note(self) -> None:
        """Send what is known of λ now."""
        answer = self.answer
        if answer is not None:
            self.send({"curve": self._curve(answer), "chips": self._chips(answer)})

    def _curve(self, answer: Answer) -> dict[str, Any]:
        """What each λ explains that was tried with the solver, the light and the contours of an answer."""
        if not answer.uses_lam:
            return {"title": f"{answer.settings.solver.replace('_', ' ')} has no λ"}
        tried = self.engine.curve_of(answer)
        if not tried:
            return {"title": ""}
        best, at_least = self.engine.best_lam(answer)
        tells = len(tried) > 3  # of fewer nothing follows
        errors = [one.errors for one in tried]
        return {
            "title": _curve_title(best, at_least) if tells else "",
            "lams": [one.settings.lam for one in tried],
            "explained": [one.explained for one in tried],
            "errors": [None if one is None else one[0] for one in errors],
            "best": best if tells else None,
            "now": answer.settings.lam,
        }

    def _path(self, answer: Answer, place: int) -> dict[str, Any]:
        """Which iterate of the last run is shown."""
        count = len(answer.path)
        text = ""
        if count:
            text = f"iterate {answer.path[place - 1].k} of {answer.path[-1].k}"
            text += "" if place == count else ", still falls"
        return {"count": count, "place": place, "text": text}

    # What is written ---------------------------------------------------------------------

    def python(self) -> str:
        """Return the Python that makes the one answer; it runs where its export lies."""
        answer = self._final()
        subject = answer.still.subject
        saved = answer.settings.solving_settings(subject)
        given = [f"{name}={value!r}" for name, value in saved.keywords.items()]
        if answer.held is not None:
            given.insert(0, 'held=el.load_held(here / "held.npz")')
        mask = "" if subject.frame.mask.all() else ', mask=here / "mask.png"'
        picture = "frame.png" if subject.path is None else subject.path.name
        return RESULT.format(picture=picture, mask=mask, given=", ".join(given))

    def export(
        self, folder: str | Path, *, overwrite: bool = False, board: bytes | None = None
    ) -> Path:
        """Write all there is about the one answer into a folder.

        That is `result.py`, `settings.json`, `endoscope.json`, the frame, `recording.rrd`, `held.npz` unless
        all was asked anew, and what `save_result` writes; from the page also `board.png`, as it is seen. All
        or none. A folder that holds files of others is written into only if `overwrite`.
        """
        from endolab.workbench.recording.recorder import record

        answer = self._final()
        subject = answer.still.subject
        saved = answer.settings.solving_settings(subject)
        known = answer.settings.calibration_of(subject)
        with stage_folder(folder, overwrite=overwrite) as staging:
            with record(staging / "recording.rrd") as recorder:
                reconstruct(
                    subject.frame,
                    known,
                    held=answer.held,
                    observers=[recorder],
                    **saved.keywords,
                )
                if answer.uncertainty is not None:
                    recorder.add_uncertainty(answer.uncertainty, answer.result)
            found = answer.uncertainty
            save_result(answer.result, staging, uncertainty=found, overwrite=True)
            if board is not None:
                write_atomically(staging / "board.png", board)
            if answer.held is not None:
                save_held(answer.held, staging / "held.npz")
                saved = replace(saved, held="held.npz")
            if subject.path is not None:
                write_atomically(staging / subject.path.name, read_bytes(subject.path))
            else:
                write_image(staging / "frame.png", subject.frame.image, bits=16)
            if not subject.frame.mask.all():
                write_image(staging / "mask.png", subject.frame.mask.astype(float))
            known = answer.settings.endoscope(subject.calibration)
            write_calibration(known, staging / "endoscope.json")
            write_settings(saved, staging / "settings.json")
            write_atomically(staging / "result.py", self.python().encode())
        return Path(folder)

    def _export_aside(self, name: str, board: bytes) -> None:
        """Export, in the engine's thread, whatever is asked for meanwhile."""
        if not name.strip():
            raise ValueError("name a folder to export into")
        self._final()
        folder = Path(name.strip()).expanduser()
        self.send({"line": f"exporting into {folder} ..."})

        def job() -> None:
            self.export(folder, board=board)
            self.send({"line": f"exported into {folder.resolve()}", "tone": ""})

        self.engine.do(job)

    def export_html(self, path: str | Path) -> Path:
        """Write a tuner that needs no Python: one page, λ × regulariser, with what is held now."""
        self.engine.wait()
        answer = self._final()
        if answer.settings.solver != "gauss_newton":
            raise ValueError("only Gauss-Newton's answers are played over λ")
        lams = [float(f"{lam:.3g}") for lam in PLAYED_LAMS]
        answers = []
        for order in REGULARISERS:
            for lam in lams:
                played: dict[str, Any] = {"lam": lam, "regulariser": order}
                answers.append(self.engine.solve_held(replace(answer.settings, **played)))
        held = self._limits
        residual, _ = map_of("model - frame", answer, self.engine, held)
        distance, _ = map_of("distance", answer, self.engine, held)
        rows = []
        for one in answers:
            errors = one.errors
            words = self._words(one)
            settings = {"lam": one.settings.lam, "regulariser": one.settings.regulariser}
            found = {"explained": one.explained, "error": errors and errors[0]}
            rows.append(settings | found | {"line": words["line"], "label": words["label"]})
        for order in REGULARISERS:
            some = [row for row in rows if row["regulariser"] == order]
            best = suggest_lam(lams, [row["explained"] for row in some])
            for row in some:
                row["curve"] = {"title": _curve_title(*best), "best": best[0]}
        still, arrays = still_of(answer.result.problem, answer.still.truth)
        knobs = {"lam": answer.settings.lam, "regulariser": "second", "texture": "frame"}
        specs = [spec for spec in self._specs if spec["name"] in ("lam", "regulariser")]
        specs[1] = specs[1] | {"options": [*REGULARISERS]}
        alone = {"specs": specs, "alone": True, "panels": [*PANELS[:8]], "presets": []}
        first = {"still": still, "knobs": knobs, "anew": True}
        first["maps"] = {"distance": distance, "model - frame": residual}
        maps = pack(answers, max(residual["high"], 5.0))
        title = f"{answer.still.subject.frame.name} · endolab"
        page = write_page(self._facts() | alone, first, arrays, rows, maps, title)
        write_atomically(path, page.encode())
        return Path(path)

    def close(self) -> None:
        """Close the widget and end its thread."""
        if hasattr(self, "engine"):  # not if it was refused
            self.engine.close()
        super().close()


def _curve_title(best: float | None, at_least: bool) -> str:
    """What the λ curve says."""
    if best is None:
        return "no λ tried explains 99 %: wet or noisy walls, or another light"
    return f"99 % explained up to {'≥ ' if at_least else ''}{best:.2g}"
