"""Recordings of a run for the Rerun viewer: every iterate on the timeline "iteration", as it comes.

`record` makes an observer for `run`; what it logs, and under which names, is in `Recorder`.
"""

from __future__ import annotations

from typing import Self

import numpy as np
import rerun as rr

from endolab.io.atomic import PathLike
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import check_int
from endolab.reconstruction.report import notes
from endolab.reconstruction.uncertainty import Uncertainty
from endolab.solvers.result import SOLUTION, Iterate, Result
from endolab.workbench.plots.scales import OKABE_ITO, limits
from endolab.workbench.recording.layouts import ITERATIONS, Shown, layout
from endolab.workbench.recording.pictures import (
    LINE,
    Ends,
    all_names,
    class_map,
    error_percent,
    found_in,
    in_steps,
    looks_along,
    names,
    paint,
    paint_frame,
    paint_truth,
)
from endolab.workbench.recording.stream import Painted, Sink, scalars

# Stages that search, whether there is anything or not, and the colours of their curves.
SEARCHES = {"bounced light": OKABE_ITO.sky, "contours": OKABE_ITO.orange}


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
        shown side by side; if the block fails there is no file::

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
    return Recorder(Sink(path), truth, max_width)


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
    ``dominant_source``. Of several runs all names begin with the run's.
    """

    def __init__(
        self, sink: Sink, truth: FloatArray | None, max_width: int, run: str = ""
    ) -> None:
        self.path = sink.path
        self._sink = sink
        self._truth = truth
        self._max_width = max_width
        self._run = run
        self._runs: dict[str, Recorder] = {}  # beside each other in this recording
        self._within = False  # a block at whose end it is closed
        self._last: Iterate | None = None
        self._place = 0  # of that on the timeline
        self._begun = 0  # that of its stage's first
        self._pictured = 0  # the last k of this stage with pictures

    def run(self, name: str) -> Recorder:
        """Make the observer of one of several runs; its entities begin with its name."""
        if not name.isidentifier() or name in self._runs:
            raise ValueError(f"expected a new word such as gauss_newton, got {name!r}")
        self._runs[name] = Recorder(self._sink, self._truth, self._max_width, name)
        return self._runs[name]

    def __call__(self, iterate: Iterate) -> None:
        """Log one iterate."""
        last = self._last
        begins = last is None or (last.stage, last.round) != (iterate.stage, iterate.round)
        if last is not None and begins:
            self._end_stage(last, limits("distance", last.distance))
        self._place = iterate.k if last is None else self._place + 1
        self._sink.at(ITERATIONS, self._place)
        if last is None:
            self._log({"world": rr.ViewCoordinates.RDF, **all_names()}, static=True)
        if begins:
            self._begin_stage(iterate)
        self._last = iterate
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
        shape = uncertainty.sigma.shape
        recorded = None if self._last is None else self._last.mask.shape
        if shape != recorded:
            raise ValueError(f"uncertainty has shape {shape}, what was recorded {recorded}")
        step = self._step
        percent = (100 * uncertainty.sigma / result.distance)[::step, ::step]
        source = uncertainty.dominant_source[::step, ::step]
        sources = np.where(source > 0, source + LINE, 0)
        maps = {"sigma": in_steps("σ", percent), "dominant_source": sources}
        self._sink.at(ITERATIONS, self._place)
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
        if self._within or self._run or not self._sink.open:
            return
        runs = [self, *self._runs.values()]
        ends = [(one, one._last) for one in runs if one._last is not None]
        shown = []
        with self._sink:
            for one, last in ends:
                unit = last.problem.unit
                alike = [end.distance for _, end in ends if end.problem.unit == unit]
                seen = limits("distance", *alike)
                one._end_stage(last, seen)
                one._log({"settings": _settings(last)}, static=True)
                shown.append(Shown(one._run, unit, seen))
            if shown:
                self._sink.arrange(layout(shown, self._sink.entities, ITERATIONS))

    # Stages ---------------------------------------------------------------------------
    def _begin_stage(self, iterate: Iterate) -> None:
        """Log what stays for a stage."""
        problem = iterate.problem
        self._step = -(-problem.camera.width // self._max_width)
        self._begun = self._place
        # Where there are several runs, each has colours of its own.
        colour = None if self._run else SEARCHES.get(iterate.stage, OKABE_ITO.vermilion)
        title = f"{iterate.stage}?" if iterate.stage in SEARCHES else iterate.stage
        round = f", round {iterate.round}" if iterate.round else ""
        look = rr.SeriesLines(names=f"{self._run} {title}".strip(), colors=colour)
        curves = _logarithms(iterate)
        self._log(dict.fromkeys(curves, look), static=True)
        self._log(dict.fromkeys(curves, rr.Scalars(np.nan)))  # a gap between rounds
        self._log(paint_frame(problem.shown, found_in(problem), self._step))
        camera = looks_along(iterate.distance)
        self._log(
            {"stage": rr.TextLog(title + round, color=colour), "world/camera": camera}
        )

    def _log_pictures(self, iterate: Iterate) -> None:
        """Log the pictures of the last iterate, there."""
        self._sink.at(ITERATIONS, self._place)
        self._log(paint(iterate, self._truth, self._step))
        self._pictured = iterate.k

    def _end_stage(self, last: Iterate, limits: Ends) -> None:
        """Log the pictures of a stage's last iterate, and where the colours of its distances end."""
        if self._pictured != last.k:
            self._log_pictures(last)
        self._sink.at(ITERATIONS, self._begun)
        self._log({"distance": names("distance", limits, last.problem.unit)})
        if self._truth is not None:
            self._log(paint_truth(last, self._truth, self._step))

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
