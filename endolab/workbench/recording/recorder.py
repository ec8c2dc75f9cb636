"""Recordings for the Rerun viewer: of runs on the timeline "iteration", of videos on "frame", of sweeps on λ.

`record` makes an observer for `run`; what it logs, and under which names, is in `Recorder`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Self

import cv2
import numpy as np
import rerun as rr

from endolab.io.atomic import PathLike
from endolab.model.cameras import Camera
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import check_int
from endolab.reconstruction.report import notes
from endolab.reconstruction.uncertainty import Uncertainty
from endolab.solvers.result import SOLUTION, Iterate, Result
from endolab.workbench.plots.scales import OKABE_ITO, limits
from endolab.workbench.recording.layouts import FRAMES, ITERATIONS, LAMBDAS, Shown
from endolab.workbench.recording.pictures import (
    ENDS,
    LINE,
    Ends,
    Painted,
    all_names,
    box_of,
    class_map,
    error_percent,
    found_in,
    in_steps,
    looks_along,
    names,
    paint,
    paint_frame,
    paint_surface,
    paint_truth,
    scalars,
)
from endolab.workbench.recording.stream import Sink

# Stages that search, whether there is anything or not, and the colours of their curves.
SEARCHES = {"bounced light": OKABE_ITO.sky, "contours": OKABE_ITO.orange}
# Curves of a video.
COLUMNS = ("energy", "median_distance", "gain", "iterations", "seconds")
# A row of ``frames.csv``, the picture, (h, w) or (h, w, 3) in [0, 1], distance and normals by their names.
Done = tuple[Mapping[str, Any], FloatArray, Mapping[str, FloatArray]]


def record(
    path: PathLike,
    *,
    truth: FloatArray | None = None,
    max_width: int = 480,
) -> Recorder:
    """Make an observer that records a run.

    Parameters
    ----------
    path : path
        The recording to write, ``.rrd``. An old one is replaced when the recording is closed.
    truth : (H, W) float array, optional
        True distance, mm, to show beside the result, with the error and a section; nan where unknown.
        It is resampled if the frame is shrunk, and takes the scale of a result that has no unit.
    max_width : int
        Pictures and point clouds wider than this, px, are thinned.

    Returns
    -------
    Recorder
        Give it to ``run`` or call it with each iterate, then `Recorder.close` it. As a context manager it
        stays open until the block ends, for `Recorder.add_uncertainty` or for several runs, which are
        shown side by side; if the block fails there is no file. What cannot be drawn costs no run:
        `Recorder.undrawn` says why there is no recording::

            with el.record("run.rrd") as recorder:
                result = el.reconstruct(frame, calibration, observers=[recorder])
                recorder.add_uncertainty(el.uncertainty_of(result, calibration), result)

            with el.record("both.rrd") as both:
                for solver in ("gauss_newton", "primal_dual"):
                    el.reconstruct(frame, calibration, solver=solver, observers=[both.run(solver)])

    Raises
    ------
    ValueError
        If the name does not end in ``.rrd``.
    OSError
        If the file cannot be written.
    """
    check_int("max_width", max_width, 1)
    return Recorder(Sink(path), truth, max_width, {})


def record_lambda(path: PathLike, truth: FloatArray | None) -> Recorder:
    """Make an observer of answers for several λ, which are the timeline; in other things as `record`."""
    return Recorder(Sink(path, LAMBDAS), truth, 480, {})


class Recorder:
    """An observer that logs iterates to a recording, as they come; see `record`.

    When a stage of the run begins: ``stage`` (its name), ``input``, ``found`` (highlights, saturated
    pixels, contours, what is left out), ``world/camera``. Per iterate: ``depth``, ``distance`` (the same in
    logarithmic colours, with lines where it is round), ``normals`` ((n + 1)/2), ``residual`` (model - image),
    ``section/estimate`` (of the middle column), ``world/cloud``, ``plots/<name>``, and
    ``log10/energy/<stage>`` and ``log10/change/<stage>``. With a truth also ``error`` (%), the mean of
    its size, ``plots/error``, ``section/truth`` and ``world/truth``. Scalars are logged for every iterate,
    pictures for the first 20 of the solution, its last, and between them each time k has grown by half; of
    the stages before it only for the first and the last, as there may be a dozen. The timeline "iteration"
    runs on over all stages. At the end, static: ``settings`` (and what was done about indirect light and
    contours). Of how far the end can be trusted, if that is added: ``sigma`` (% of the distance) and
    ``dominant_source``. Of several runs all names begin with the run's. The first surface chooses the colours
    of the distances of one unit, in all stages and runs.
    """

    def __init__(
        self,
        sink: Sink,
        truth: FloatArray | None,
        max_width: int,
        ends: dict[str, Ends],
        run: str = "",
    ) -> None:
        self.path = sink.path
        self.undrawn = sink.undrawn  # in a sentence, if there can be no recording
        self._sink = sink
        self._truth = truth
        self._max_width = max_width
        self._ends = ends  # of the colours of distances, by their unit
        self._run = run
        self._is_sweep = sink.along == LAMBDAS  # each iterate is a stage of its own
        self._runs: dict[str, Recorder] = {}  # beside each other in this recording
        self._within = bool(run)  # a block at whose end it is closed
        self._last: Iterate | None = None
        self._place = -1  # of that on the timeline
        self._begun = 0  # that of its stage's first
        self._pictured = 0  # the last k of this stage with pictures

    def run(self, name: str) -> Recorder:
        """Make the observer of one of several runs; its entities begin with its name."""
        if not name.isidentifier() or name in self._runs:
            raise ValueError(f"expected a new word such as gauss_newton, got {name!r}")
        one = Recorder(self._sink, self._truth, self._max_width, self._ends, name)
        self._runs[name] = one
        return one

    def __call__(self, iterate: Iterate) -> None:
        """Log one iterate."""
        if self.undrawn:
            return
        with self._sink.drawing():
            last = self._last
            stage = (iterate.stage, iterate.round)
            goes_on = last is not None and (last.stage, last.round) == stage
            begins = self._is_sweep or not goes_on
            if last is not None and begins:
                self._end_stage(last)
            self._last = iterate
            self._place += 1
            self._at(self._place, iterate)
            if last is None:
                self._log({"world": rr.ViewCoordinates.RDF, **all_names()}, static=True)
            if begins:
                self._begin_stage(iterate)
            numbers = {"energy": iterate.energy, **iterate.terms, "change": iterate.change}
            numbers |= iterate.scalars
            if self._truth is not None:
                off = np.abs(error_percent(iterate, self._truth))
                numbers["error"] = float(np.nanmean(off))
            curves = {f"plots/{name}": value for name, value in numbers.items()}
            # The viewer knows no logarithmic axis, and on another one all but the first steps are flat.
            self._log(scalars(curves | _logarithms(iterate)))
            # Ever fewer, that a recording stays small.
            often = iterate.k <= 20 or iterate.k >= 1.5 * self._pictured
            if begins or (often and iterate.stage == SOLUTION):
                self._log_pictures(iterate)

    def add_uncertainty(self, uncertainty: Uncertainty, result: Result | Iterate) -> None:
        """Show how far the run's end can be trusted, before the recording is closed.

        Parameters
        ----------
        uncertainty : Uncertainty
            As `endolab.uncertainty_of` tells.
        result : Result or Iterate
            What it was told of.

        Raises
        ------
        ValueError
            If the recording is closed, nothing was recorded, or what was is not of the same size.
        """
        if self.undrawn:
            return
        shape = uncertainty.sigma.shape
        last = self._last
        recorded = None if last is None else last.mask.shape
        if last is None or shape != recorded:
            raise ValueError(f"uncertainty has shape {shape}, what was recorded {recorded}")
        with self._sink.drawing():
            step = self._step
            percent = (100 * uncertainty.sigma / result.distance)[::step, ::step]
            source = uncertainty.dominant_source[::step, ::step]
            sources = np.where(source > 0, source + LINE, 0)
            maps = {"sigma": in_steps(percent, ENDS["σ"]), "dominant_source": sources}
            self._at(self._place, last)
            self._log({name: class_map(codes) for name, codes in maps.items()})

    def __enter__(self) -> Self:
        self._within = True
        return self

    def __exit__(self, failure: object, *_: object) -> None:
        self._within = False
        if failure is not None:
            self._sink.close(failed=True)
        self.close()

    def close(self) -> None:
        """End the recording and write the file, or raise an OSError and leave none; once is enough.

        In a block of its own (``with record(...) as recorder:``) this is done at the block's end.
        """
        if self._within or not self._sink.open:
            return
        shown = []
        with self._sink, self._sink.drawing():
            for one in (self, *self._runs.values()):
                last = one._last
                if last is not None:
                    one._end_stage(last)
                    one._log({"settings": _settings(last)}, static=True)
                    unit = last.problem.unit
                    shown.append(
                        Shown(one._run, unit, self._ends[unit], box_of(last.points))
                    )
            self._sink.arrange(shown)

    # Stages ---------------------------------------------------------------------------
    def _begin_stage(self, iterate: Iterate) -> None:
        """Log what stays for a stage."""
        problem = iterate.problem
        stage = iterate.stage
        unit = problem.unit
        self._step = -(-problem.camera.width // self._max_width)
        self._begun = self._place
        if unit not in self._ends:
            # As if it faced the camera, a wall at 60° starts 1.4 times as far away as it is.
            near, far = limits("distance", iterate.distance)
            self._ends[unit] = near / 1.4, far
        # Where there are several runs, each has colours of its own.
        colour = None if self._run else SEARCHES.get(stage, OKABE_ITO.vermilion)
        title = f"{stage}?" if stage in SEARCHES else stage
        round = f", round {iterate.round}" if iterate.round else ""
        look = rr.SeriesLines(names=f"{self._run} {title}".strip(), colors=colour)
        curves = _logarithms(iterate)
        self._log(dict.fromkeys(curves, look), static=True)
        words = title + round
        if self._is_sweep:
            words = f"λ {problem.lam:g}"
        else:
            self._log(dict.fromkeys(curves, rr.Scalars(np.nan)))  # a gap between rounds
        self._log(paint_frame(problem.shown, found_in(problem), self._step))
        painted: Painted = {
            "stage": rr.TextLog(words, color=colour),
            "world/camera": looks_along(iterate.distance),
            "distance": names("distance", self._ends[unit], unit),
        }
        self._log(painted)

    def _log_pictures(self, iterate: Iterate) -> None:
        """Log the pictures of the last iterate, there."""
        self._at(self._place, iterate)
        ends = self._ends[iterate.problem.unit]
        self._log(paint(iterate, self._truth, ends, self._step))
        self._pictured = iterate.k

    def _end_stage(self, last: Iterate) -> None:
        """Log the pictures of a stage's last iterate, and the truth in its unit."""
        if self._pictured != last.k:
            self._log_pictures(last)
        if self._truth is not None:
            self._at(self._begun, last)
            self._log(paint_truth(last, self._truth, self._step))

    def _at(self, place: int, iterate: Iterate) -> None:
        """Log at this place of "iteration" from now on, and at the iterate's λ."""
        self._sink.at(ITERATIONS, place)
        if self._is_sweep:
            lam = max(iterate.problem.lam, 1e-12)  # as 0 has no logarithm
            self._sink.at(LAMBDAS, round(1000 * np.log10(lam)))

    def _log(self, painted: Painted, static: bool = False) -> None:
        self._sink.log(painted, self._run, static)


def _logarithms(iterate: Iterate) -> dict[str, float]:
    """Energy and change by the names of their curves, which are each stage's own."""
    stage = iterate.stage.replace(" ", "_")
    values = {"energy": iterate.energy, "change": iterate.change}
    return {
        f"log10/{name}/{stage}": np.log10(value) if value > 0 else np.nan
        for name, value in values.items()
    }


def _settings(last: Iterate) -> rr.TextDocument:
    """What was solved and how, and what was done about indirect light and contours."""
    problem = last.problem
    photometry = problem.photometry
    rows = {
        "distances": problem.unit,
        "camera": problem.camera.model,
        "k": photometry.k,
        "γ": photometry.gamma,
        "gain": photometry.gain,
        **last.report.settings,
    }
    text = "| | |\n|---|---|\n"
    for name, value in rows.items():
        words = f"{value:.4g}" if isinstance(value, float) else value
        text += f"| {name} | {words} |\n"
    text += "".join(f"\n- {note}" for note in notes(last))
    return rr.TextDocument(text, media_type="text/markdown")


def record_sequence(
    path: PathLike, unit: str, calibration: Calibration, frames: Iterable[Done]
) -> None:
    """Record frames and what was made of them, in any order, whole or not at all.

    Per frame, at its row's index: ``input``, ``distance``, ``found``, ``normals`` ((n + 1)/2),
    ``section/estimate``, ``world/cloud`` and ``plots/<name>``. Distances are in `unit`. The picture is shrunk
    to the size of the maps; what is wider than 320 px is thinned.
    """
    with Sink(path, FRAMES) as sink:
        shown: list[Shown] = []
        camera: Camera = calibration.camera
        for row, picture, maps in frames:
            distance = maps["distance"]
            height, width = distance.shape
            step = -(-width // 320)
            known = calibration.for_size(picture.shape[1], picture.shape[0])
            seen = known.camera.resize(width, height)
            camera = camera if seen == camera else seen  # whose rays are kept
            points = distance[..., None] * camera.field.rays
            if not shown:
                ends = limits("distance", distance)
                shown.append(Shown("", unit, ends, box_of(points)))
                still: Painted = {
                    "world": rr.ViewCoordinates.RDF,
                    "world/camera": looks_along(distance),
                    "distance": names("distance", ends, unit),
                    **all_names(),
                }
                sink.log(still, static=True)
            sink.at(FRAMES, row["index"])
            small: Any = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
            sink.log(paint_frame(small, 1 * np.isfinite(distance), step))
            sink.log(paint_surface(points, maps["normals"], ends, step))
            sink.log({"stage": rr.TextLog(row["frame"])})
            sink.log(scalars({f"plots/{name}": row[name] for name in COLUMNS}))
        sink.arrange(shown)
