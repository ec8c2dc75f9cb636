"""Recordings of a run for the Rerun viewer: every iterate on the timeline "iteration", as it comes.

`record` makes an observer for `run`; what it logs, and under which names, is in `Recorder`.
"""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, Self

import numpy as np
import rerun as rr

from endolab.io.atomic import PathLike
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import check_int
from endolab.reconstruction.report import notes
from endolab.solvers.result import SOLUTION, Iterate, Result
from endolab.workbench.plots.scales import (
    SOURCE_COLOURS,
    common_limit,
    common_limits,
    in_colour,
)
from endolab.workbench.recording.layouts import (
    ITERATIONS,
    Shown,
    comparison,
    reconstruction,
)
from endolab.workbench.recording.pictures import OPAQUE_BLACK, RESIDUAL_COLOURS, Painter
from endolab.workbench.recording.stream import (
    THIN,
    TRUTH_COLOUR,
    Sink,
    as_bytes,
    camera_shape,
    classes,
    depth_map,
    every,
    markdown,
)

if TYPE_CHECKING:
    from endolab.reconstruction.uncertainty import Uncertainty


def record(
    path: PathLike | None = None,
    *,
    spawn: bool = False,
    truth: FloatArray | None = None,
    max_width: int = 480,
) -> Recorder:
    """Make an observer that records a run: to a file, or into a viewer that follows it.

    Parameters
    ----------
    path : path, optional
        The recording to write, ``.rrd``. An old one is replaced when the recording is closed.
    spawn : bool
        Show the run as it goes instead, in the native viewer, which listens on this machine only.
    truth : (H, W) float array, optional
        True distance, mm, to show beside the result; nan where unknown.
    max_width : int
        Pictures and point clouds wider than this, px, are thinned.

    Returns
    -------
    Recorder
        Give it to ``run`` or call it with each iterate, then `Recorder.close` it. As a context manager it
        stays open until the block ends, for `Recorder.add_uncertainty`; if the block fails there is no file::

            with el.record("run.rrd") as recorder:
                result = el.reconstruct(frame, calibration, observers=[recorder])
                recorder.add_uncertainty(el.uncertainty_of(result, calibration), result)

    Raises
    ------
    ValueError
        If it is not one of path and spawn.
    OSError
        If the file cannot be written or the viewer does not start.
    """
    if (path is not None) == spawn:
        raise ValueError("give record() either a path or spawn=True")
    check_int("max_width", max_width, 1)
    return Recorder(Sink(path), truth, max_width)


class Comparison:
    """Several runs in one recording, on the same timeline, side by side.

    ::

        with Comparison("both.rrd") as both:
            el.reconstruct(frame, calibration, observers=[both.run("gauss_newton")])
            el.reconstruct(frame, calibration, solver="primal_dual", observers=[both.run("primal_dual")])

    Parameters
    ----------
    path, truth, max_width
        See `record`, of errors too; the file is written when the comparison is closed.
    """

    def __init__(
        self, path: PathLike, *, truth: FloatArray | None = None, max_width: int = 480
    ) -> None:
        self._sink = Sink(path)
        self._given = (self._sink, truth, max_width)
        self.path = self._sink.path
        self._runs: dict[str, Recorder] = {}

    def run(self, name: str) -> Recorder:
        """Make the observer of one run; its entities begin with the run's name."""
        if not name.isidentifier() or name in self._runs:
            raise ValueError(f"expected a new word such as gauss_newton, got {name!r}")
        self._runs[name] = Recorder(*self._given, run=name)
        return self._runs[name]

    def close(self) -> None:
        """Write the file; a second call does nothing. Without an iterate there is none."""
        if not self._sink.open:
            return
        with self._sink:
            for recorder in self._runs.values():
                recorder.close()
            begun = [one for one in self._runs.values() if one.shown.unit]
            for recorder in begun:
                unit = recorder.shown.unit
                limits = [one.shown.limits for one in begun if one.shown.unit == unit]
                recorder.reach((np.min(limits), np.max(limits)))
            if begun:
                self._sink.arrange(comparison([recorder.shown for recorder in begun]))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, failure: object, *_: object) -> None:
        if failure is not None:
            self._sink.drop()
        self.close()


class Recorder:
    """An observer that logs iterates to a recording, as they come; see `record`.

    When a stage of the run begins: ``stage`` (its name), ``input``, ``mask``, ``prepared`` (highlights,
    saturated pixels and contours), ``settings``, ``world/camera``, ``world/truth``. Per iterate: ``depth``
    (distance), ``normals`` ((n + 1)/2), ``residual`` (model - image), ``world/cloud``, ``plots/<name>``,
    ``log10/<name>`` of energy, terms and change, and ``log10/begins/<stage>`` where one begins. Scalars are
    logged for every iterate, pictures for the first 20 of the solution, its last, and between them each
    time k has grown by half; of the stages before it only for the first and the last, as there may be a
    dozen. The timeline "iteration" runs on over all stages. At the end, static: ``end`` (what was done about
    indirect light and contours), and of how far it can be trusted, if that is added: ``uncertainty/sigma``
    (% of the distance) and ``uncertainty/dominant_source``. In a `Comparison` all names begin with the run's.
    """

    def __init__(
        self, sink: Sink, truth: FloatArray | None, max_width: int, run: str = ""
    ) -> None:
        self.path = sink.path  # None if it goes to a viewer
        self.truth = truth
        self.max_width = max_width
        # What the layout needs to know; without a unit before the first iterate.
        self.shown = Shown(run, "")
        self._sink = sink
        self._run = run
        self._open = True
        self._within = False  # a block at whose end it is closed
        self._last: Iterate | None = None
        self._pictured = -1  # the last k of this stage with pictures
        self._before = 0  # places on the timeline before this stage's k = 0
        self._begun = 0  # place of this stage's first iterate

    def __call__(self, iterate: Iterate) -> None:
        """Log one iterate."""
        if self._sink.is_viewer_closed:
            return  # the run goes on
        last = self._last
        begins = last is None or (last.stage, last.round) != (iterate.stage, iterate.round)
        if begins:
            if last is not None:
                self._end_stage(last)
                self._before += last.k + 1 - iterate.k
            self._begin_stage(iterate)
        self._last = iterate
        self._at(iterate)
        falling = {"energy": iterate.energy, **iterate.terms, "change": iterate.change}
        for name, value in {**falling, **iterate.scalars}.items():
            self._sink.log_scalar(f"{self._run}/plots/{name}", value)
        # The viewer knows no logarithmic axis, and on another one all but the first steps are flat.
        for name, value in falling.items():
            if value > 0:
                self._sink.log_scalar(f"{self._run}/log10/{name}", np.log10(value))
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
        thin = every(shape[1], self.max_width)
        percent = (100 * uncertainty.sigma / result.distance)[thin]
        most = float(f"{common_limit([percent]):.2g}")
        sigma = depth_map(percent, False, (0.0, most), "magma")
        self._log("uncertainty/sigma", sigma, static=True)
        colours = {"left out": OPAQUE_BLACK}
        for name, colour in SOURCE_COLOURS.items():
            colours[name] = (*colour, 255)
        source = classes(uncertainty.dominant_source[thin], colours)
        self._log("uncertainty/dominant_source", *source, static=True)
        self.shown = replace(self.shown, sigma=most)
        self._follow()

    def __enter__(self) -> Self:
        self._within = True
        return self

    def __exit__(self, failure: object, *_: object) -> None:
        self._within = False
        if failure is not None and not self._run:
            self._sink.drop()
        self.close()

    def close(self) -> None:
        """End the recording and write the file, or raise an OSError and leave none; once is enough.

        In a block of its own (``with record(...) as recorder:``) this is done at the block's end.
        """
        if not (self._open and self._sink.open) or self._within:
            return
        self._open = False
        # A comparison goes on.
        with nullcontext() if self._run else self._sink:
            if self._last is None or self._sink.is_viewer_closed:
                return
            self._end_stage(self._last)
            remarks = "\n".join(f"- {note}" for note in notes(self._last))
            self._log("end", markdown(f"## End\n\n{remarks}"), static=True)
            if not self._run:
                self._sink.arrange(reconstruction(self.shown))

    # Stages ---------------------------------------------------------------------------
    def _begin_stage(self, iterate: Iterate) -> None:
        """Log what stays for a stage."""
        problem = iterate.problem
        last = self._last
        self._painter = painter = Painter(problem, self.max_width)
        self._begun = self._before + iterate.k
        self.shown = Shown(self._run, problem.unit)
        if last is None:
            self._log("world", rr.ViewCoordinates.RDF, static=True)
            shades = classes(np.zeros((1, 1)), RESIDUAL_COLOURS)[0]
            self._log("residual", shades, static=True)
        self._at(iterate)
        stage = (
            f"{iterate.stage}, round {iterate.round}" if iterate.round else iterate.stage
        )
        self._log("stage", rr.TextLog(stage))
        # A mark on the curve of the energy.
        mark = f"log10/begins/{iterate.stage.replace(' ', '_')}"
        name = f"{self._run} {iterate.stage} begins".strip()
        look = rr.SeriesPoints(names=name, markers="diamond", marker_sizes=6)
        self._log(mark, look, static=True)
        if iterate.energy > 0:
            self._sink.log_scalar(f"{self._run}/{mark}", np.log10(iterate.energy))
        picture = as_bytes(in_colour(problem.shown))
        if last is None or last.problem.shown is not problem.shown:
            self._log("input", rr.Image(picture[painter.thin]))
        for entity, what in painter.paint_preparation().items():
            self._log(entity, *what)
        self._log("settings", markdown(_settings(iterate)))
        colours = picture[painter.sparse][painter.inside]
        radii = rr.Radius.ui_points(2.5)
        self._log("world/cloud", rr.Points3D.from_fields(colors=colours, radii=radii))
        size = 0.35 * float(np.nanmedian(iterate.distance))
        self._log("world/camera", camera_shape(problem.camera, size))
        if self.truth is not None:
            self._log_truth(iterate, self.truth)
        self.reach(common_limits([iterate.distance]))
        self._follow()

    def _log_truth(self, iterate: Iterate, truth: FloatArray) -> None:
        """Log the true surface, in the unit of an iterate; not on the smaller grid of a stage before."""
        shape = iterate.mask.shape
        if truth.shape != shape:
            if iterate.stage == SOLUTION:
                raise ValueError(f"truth has shape {truth.shape}, the frame {shape}")
            return
        known = iterate.mask & (truth > 0)
        if not iterate.problem.metric:
            truth = truth * np.nanmedian((iterate.distance / truth)[known])
        thin = self._painter.thin
        rays = iterate.problem.field.rays[thin][known[thin]]
        points = (truth[thin][known[thin], None] * rays).astype(np.float32)
        self._log("world/truth", rr.Points3D(points, colors=TRUTH_COLOUR, radii=THIN))

    def _end_stage(self, last: Iterate) -> None:
        """Log the pictures of a stage's last iterate, and let the colours reach what it needs."""
        if self._pictured != last.k:
            self._log_pictures(last)
        self.reach(common_limits([last.distance]))

    def reach(self, limits: tuple[float, float]) -> None:
        """Let the colours of this stage's distances reach from one limit to the other."""
        self._sink.at(ITERATIONS, self._begun)
        self._log("depth", rr.DepthImage.from_fields(depth_range=limits))
        self.shown = replace(self.shown, limits=limits)

    def _follow(self) -> None:
        """Tell a viewer how to show the run so far."""
        if self.path is None:
            self._sink.arrange(reconstruction(self.shown))

    def _at(self, iterate: Iterate) -> None:
        self._sink.at(ITERATIONS, self._before + iterate.k)

    def _log(self, entity: str, *what: rr.AsComponents, static: bool = False) -> None:
        self._sink.log(f"{self._run}/{entity}", *what, static=static)

    def _log_pictures(self, iterate: Iterate) -> None:
        self._at(iterate)
        for entity, what in self._painter.paint(iterate).items():
            self._log(entity, what)
        self._pictured = iterate.k


def _settings(iterate: Iterate) -> str:
    """What is solved and how, as Markdown."""
    problem = iterate.problem
    camera = problem.camera
    photometry = problem.photometry
    rows = {
        "distances": "mm" if problem.metric else "**relative units**",
        "picture": f"{camera.width} x {camera.height} px",
        "camera": camera.model.replace("_", "-"),
        "k": photometry.k,
        "γ": photometry.gamma,
        "gain": photometry.gain,
        **iterate.report.settings,
        "regulariser": problem.regulariser,
        "lam": problem.lam,
        "epsilon": problem.epsilon,
        "xi": problem.xi,
    }
    table = "## Settings\n\n| | |\n|---|---|\n"
    for name, value in rows.items():
        words = f"{value:.4g}" if isinstance(value, float) else str(value)
        cell = words.replace("|", "\\|")
        table += f"| {name} | {cell} |\n"
    return table
