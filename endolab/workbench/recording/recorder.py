"""Recordings of a run for the Rerun viewer: every iterate on the timeline "iteration", as it comes.

`record` makes an observer for `run`; what it logs, and under which names, is in `Recorder`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np
import rerun as rr

from endolab.io.atomic import PathLike
from endolab.numerics.arrays import FloatArray
from endolab.reconstruction.sentences import notes
from endolab.solvers.result import SOLUTION, Iterate, Result
from endolab.workbench.plots.scales import (
    OKABE_ITO,
    SOURCE_COLOURS,
    Colour,
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
)

if TYPE_CHECKING:
    from endolab.reconstruction.uncertainty.estimate import Uncertainty


@dataclass(frozen=True)
class PictureRate:
    """Of which iterates pictures are kept, that a recording stays small."""

    all_until: int = 20  # the first ones, ...
    growth: float = 1.5  # ... then each time k has grown by half


PICTURE_RATE = PictureRate()


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
    if max_width < 1:
        raise ValueError(f"max_width must be at least 1 px, got {max_width}")
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
        self._truth = truth
        self._max_width = max_width
        self.path = self._sink.path
        self._runs: dict[str, Recorder] = {}

    def run(self, name: str) -> Recorder:
        """Make the observer of one run; its entities begin with the run's name."""
        if not name.isidentifier() or name in self._runs:
            why = (
                "there is one already"
                if name in self._runs
                else "expected a word such as gauss_newton"
            )
            raise ValueError(f"a run cannot be called {name!r}: {why}")
        colours = (OKABE_ITO.orange, OKABE_ITO.green, OKABE_ITO.purple, OKABE_ITO.sky)
        colour = colours[len(self._runs) % len(colours)]
        self._runs[name] = Recorder(
            self._sink, self._truth, self._max_width, run=name, colour=colour
        )
        return self._runs[name]

    def close(self) -> None:
        """Write the file; a second call does nothing. Without an iterate there is none."""
        if not self._sink.open:
            return
        with self._sink:
            for recorder in self._runs.values():
                recorder.close()
            shown = [
                recorder.shown
                for recorder in self._runs.values()
                if recorder.shown is not None
            ]
            if shown:
                self._arrange(shown)

    def _arrange(self, runs: list[Shown]) -> None:
        """Give the ends of all runs in one unit the same colours, and tell the viewer."""
        for shown in runs:
            nearest, farthest = zip(
                *(other.limits for other in runs if other.unit == shown.unit), strict=True
            )
            self._runs[shown.run].reach((min(nearest), max(farthest)))
        self._sink.arrange(
            comparison([self._runs[shown.run].shown or shown for shown in runs])
        )

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
    (distance), ``normals`` ((n + 1)/2), ``residual`` (model - image), ``front/<name>`` (the iterate's
    maps), ``world/cloud``, ``plots/<name>``, and ``log10/<name>`` of energy, terms and change. Scalars are
    logged for every iterate, pictures for the first 20 of the solution, its last, and between them each
    time k has grown by half; of the stages before it only for the first and the last, as there may be a
    dozen. The timeline "iteration" runs on over all stages. At the end, static: ``end`` (what came of each
    stage), and of how far it can be trusted, if that is added: ``uncertainty/sigma`` (% of the distance) and
    ``uncertainty/dominant_source``. In a `Comparison` all names begin with the run's.
    """

    def __init__(
        self,
        sink: Sink,
        truth: FloatArray | None,
        max_width: int,
        *,
        run: str = "",
        colour: Colour = OKABE_ITO.orange,
    ) -> None:
        self.path = sink.path  # None if it goes to a viewer
        self.truth = truth
        self.max_width = max_width
        # What the layout needs to know; None before the first iterate.
        self.shown: Shown | None = None
        self._sink = sink
        self._run = run
        self._colour = colour
        # within: in a block at whose end it is closed
        self._open = True
        self._within = False
        self._last: Iterate | None = None
        self._first: Iterate | None = None  # of this stage
        self._pictured: Iterate | None = None  # the last one with pictures
        self._before = 0  # places on the timeline before this stage's k = 0
        self._rows: list[str] = []  # of what came of each stage

    def __call__(self, iterate: Iterate) -> None:
        """Log one iterate."""
        if not self._open:
            raise ValueError("the recording is closed")
        if self._sink.is_viewer_closed:
            return  # the run goes on
        last = self._last
        if last is None or (last.stage, last.round) != (iterate.stage, iterate.round):
            if last is not None:
                self._end_stage(last)
                self._before += last.k + 1 - iterate.k
            self._begin_stage(iterate)
        self._last = iterate
        self._at(iterate)
        self._log_scalars(iterate)
        shown = self._pictured
        often = shown is not None and (
            iterate.k <= PICTURE_RATE.all_until
            or iterate.k >= PICTURE_RATE.growth * shown.k
        )
        if shown is None or (often and iterate.stage == SOLUTION):
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
        if not self._open:
            raise ValueError(
                "the recording is closed: use it as a context manager, or add it before"
            )
        if self._last is None or self.shown is None:
            raise ValueError("nothing was recorded that could be trusted")
        shapes = uncertainty.sigma.shape, result.mask.shape, self._last.mask.shape
        if len(set(shapes)) > 1:
            raise ValueError(
                "uncertainty has shape {}, the result {}, what was recorded {}".format(
                    *shapes
                )
            )
        thin = every(result.mask.shape[1], self.max_width)
        percent = (100 * uncertainty.sigma / result.distance)[thin]
        most = float(f"{np.nanpercentile(percent, 98):.2g}") or 1.0
        self._log(
            "uncertainty/sigma",
            depth_map(percent, False, (0.0, most), "magma"),
            static=True,
        )
        colours = {"left out": OPAQUE_BLACK} | {
            name: (*colour, 255) for name, colour in SOURCE_COLOURS.items()
        }
        self._log(
            "uncertainty/dominant_source",
            *classes(uncertainty.dominant_source[thin], colours),
            static=True,
        )
        self.shown = replace(self.shown, sigma=most)
        self._arrange(watched=True)

    def __enter__(self) -> Self:
        self._within = True
        return self

    def __exit__(self, failure: object, *_: object) -> None:
        self._within = False
        if failure is not None and not self._run:
            self._open = False
            self._sink.drop()
        self.close()

    def close(self) -> None:
        """End the recording and write the file, or raise an OSError and leave none; once is enough.

        In a block of its own (``with record(...) as recorder:``) this is done at the block's end.
        """
        if not self._open or self._within:
            return
        self._open = False
        if self._run:  # the comparison goes on
            self._end()
            return
        with self._sink:
            self._end()
            self._arrange(watched=False)

    # Stages ---------------------------------------------------------------------------

    def _begin_stage(self, iterate: Iterate) -> None:
        """Log what stays for a stage."""
        problem = iterate.problem
        last = self._last
        self._painter = painter = Painter(problem, self.max_width)
        self._first = iterate
        self._pictured = None
        distance = np.exp(iterate.log_distance[painter.thin])
        if last is None:
            self._log("world", rr.ViewCoordinates.RDF, static=True)
            self._log(
                "residual", classes(np.zeros((1, 1)), RESIDUAL_COLOURS)[0], static=True
            )
        self._style(iterate)
        self._at(iterate)
        self._log("stage", rr.TextLog(stage_text(iterate.stage, iterate.round)))
        picture = as_bytes(in_colour(problem.shown))
        if last is None or last.problem.shown is not problem.shown:
            self._log("input", rr.Image(picture[painter.thin]))
        for entity, what in painter.show_preparation().items():
            self._log(entity, *what)
        self._log(
            "settings", rr.TextDocument(_settings(iterate), media_type="text/markdown")
        )
        inside = problem.mask[painter.sparse]
        own = rr.Points3D.from_fields(
            colors=picture[painter.sparse][inside], radii=rr.Radius.ui_points(2.5)
        )
        self._log("world/cloud", own)
        self._log(
            "world/camera",
            camera_shape(problem.camera, 0.35 * float(np.nanmedian(distance))),
        )
        if self.truth is not None and (
            iterate.stage == SOLUTION or self.truth.shape == iterate.mask.shape
        ):
            self._log_truth(iterate, self.truth)
        self._reach_of(iterate)
        self._arrange(watched=True)

    def _style(self, iterate: Iterate) -> None:
        """Name and colour the curves that are new, and note for the layout what there is."""
        terms = dict.fromkeys([*(self.shown.terms if self.shown else ()), *iterate.terms])
        maps = dict.fromkeys([*(self.shown.maps if self.shown else ()), *iterate.maps])
        self.shown = Shown(self._run, iterate.problem.unit, (*terms,), (*maps,), (0.0, 1.0))
        colours = {
            "energy": OKABE_ITO.orange,
            "data": OKABE_ITO.sky,
            "regulariser": OKABE_ITO.vermilion,
        }
        for name in ("energy", "change", *iterate.terms):
            colour = self._colour if self._run else colours.get(name)
            style = rr.SeriesLines(
                colors=colour, names=f"{self._run} {name}".strip(), widths=2
            )
            self._log(f"log10/{name}", style, static=True)

    def _log_truth(self, iterate: Iterate, truth: FloatArray) -> None:
        """Log the true surface, in the unit of an iterate."""
        problem = iterate.problem
        thin = self._painter.thin
        shape = iterate.mask.shape
        if truth.shape != shape:
            raise ValueError(f"truth has shape {truth.shape}, the frame {shape}")
        known = iterate.mask & (truth > 0) & np.isfinite(truth)
        if not known.any():
            return
        unit = (
            1.0 if problem.metric else float(np.median((iterate.distance / truth)[known]))
        )
        points = (unit * np.where(known, truth, np.nan)[..., None] * problem.field.rays)[
            thin
        ]
        points = points[np.isfinite(points).all(axis=-1)]
        self._log(
            "world/truth",
            rr.Points3D(points.astype(np.float32), colors=TRUTH_COLOUR, radii=THIN),
        )

    def _end_stage(self, last: Iterate) -> None:
        """Log the pictures of a stage's last iterate, and let the colours reach what it needs."""
        if self._pictured is not last:
            self._log_pictures(last)
        self._reach_of(last)
        first = self._first or last
        name = stage_text(last.stage, last.round)
        self._rows.append(f"| {name} | {last.k} | {first.energy:.3e} | {last.energy:.3e} |")

    def _end(self) -> None:
        """Log what is known at the end only."""
        if self._last is None or self._sink.is_viewer_closed:
            return
        self._end_stage(self._last)
        table = "\n".join(
            [
                "| stage | iterations | energy, first | last |",
                "|---|---|---|---|",
                *self._rows,
            ]
        )
        remarks = "\n".join(f"- {note}" for note in notes(self._last))
        words = rr.TextDocument(
            f"## End\n\n{table}\n\n{remarks}", media_type="text/markdown"
        )
        self._log("end", words, static=True)
        if self.shown is not None:
            self.shown = replace(self.shown, last=self._before + self._last.k)

    def _reach_of(self, iterate: Iterate) -> None:
        self.reach(common_limits([np.exp(iterate.log_distance[self._painter.thin])]))

    def reach(self, limits: tuple[float, float]) -> None:
        """Let the colours of this stage's distances reach from one limit to the other."""
        if self._first is not None and self.shown is not None:
            self._at(self._first)
            self._log("depth", rr.DepthImage.from_fields(depth_range=limits))
            self.shown = replace(self.shown, limits=limits)

    def _arrange(self, watched: bool) -> None:
        """Tell the viewer how to open the recording: at its end, and before if someone is watching."""
        if not self._run and self.shown is not None and (self.path is None or not watched):
            self._sink.arrange(reconstruction(self.shown))

    # Iterates -------------------------------------------------------------------------

    def _at(self, iterate: Iterate) -> None:
        self._sink.at(ITERATIONS, self._before + iterate.k)

    def _log(self, entity: str, *what: rr.AsComponents, static: bool = False) -> None:
        self._sink.log(f"{self._run}/{entity}", *what, static=static)

    def _log_scalars(self, iterate: Iterate) -> None:
        falling = {"energy": iterate.energy, **iterate.terms, "change": iterate.change}
        for name, value in {**falling, **iterate.scalars}.items():
            self._sink.log_scalar(f"{self._run}/plots/{name}", value)
        # The viewer knows no logarithmic axis, and on another one all but the first steps are flat.
        for name, value in falling.items():
            if value > 0:
                self._sink.log_scalar(f"{self._run}/log10/{name}", np.log10(value))

    def _log_pictures(self, iterate: Iterate) -> None:
        self._at(iterate)
        for entity, what in self._painter.paint(iterate).items():
            self._log(entity, *what)
        self._pictured = iterate


def stage_text(name: str, round: int) -> str:
    """Name a stage of a run; `stage_of` is the way back."""
    return f"{name}, round {round}" if round else name


def stage_of(text: str) -> tuple[str, int]:
    """Name and round of a stage."""
    name, _, round = text.partition(", round ")
    return (name, int(round)) if round else (name, 0)


def _settings(iterate: Iterate) -> str:
    """What is solved and how, as Markdown."""
    problem = iterate.problem
    photometry = problem.photometry
    order = "" if problem.regulariser == "curvature" else " order"
    rows = {
        "distances": "mm" if problem.metric else "**relative units**",
        "picture": f"{problem.camera.width} x {problem.camera.height} px",
        "camera": problem.camera.model.replace("_", "-"),
        "light": f"k = {photometry.k:.6g}, γ = {photometry.gamma:.6g}, gain = {photometry.gain or 'unknown'}",
        "ξ": problem.xi,
        "regulariser": f"{problem.regulariser}{order}, λ = {problem.lam:g}, ε = {problem.epsilon:g}",
        "data": f"Huber, ρ = {255 * problem.threshold:.3g}/255",
        **iterate.provenance.settings,
    }
    cells = {name: str(value).replace("|", "\\|") for name, value in rows.items()}
    table = "\n".join(f"| {name} | {value} |" for name, value in cells.items())
    return f"## Settings\n\n| | |\n|---|---|\n{table}"
