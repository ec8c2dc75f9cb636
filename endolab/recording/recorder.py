"""Recordings of a run for the Rerun viewer: every iterate on the timeline "iteration".

`record` makes an observer for `run`; what it logs, and under which names, is in `Recorder`.
A file is written when the run has ended, interrupted or not, whole or not at all.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from endolab.depth.problem import Problem
from endolab.depth.result import SOLUTION, Iterate, Result
from endolab.io.atomic import PathLike
from endolab.model.schema import unknown_name
from endolab.numerics.arrays import FloatArray
from endolab.numerics.side_by_side import side_by_side
from endolab.plots.scales import DECIDERS, in_colour, round_length
from endolab.recording.layouts import BLUEPRINTS, PICTURES, TIMELINE, Shown, comparison
from endolab.recording.pictures import Painter, Pictures, residual_png, section
from endolab.recording.scales import (
    Limits,
    box_of,
    cut,
    diverging,
    key,
    lines_key,
    scale,
    sequential,
    words,
)
from endolab.recording.stream import (
    NOW,
    START,
    THIN,
    TRUTH,
    Sink,
    as_bytes,
    camera_shape,
    depth_columns,
    depth_limits,
    every,
    png,
    png_columns,
    stage_of,
    stage_text,
)
from endolab.uncertainty.trust import Trust

ALL_UNTIL, GROWTH = 20, 1.5  # pictures of a stage's first iterates, then each time k has grown by half
KEPT = 64_000_000  # bytes of iterates that may wait for the run's end
WATCHED = 12  # jobs that may wait where someone is watching
TOGETHER = 16  # iterates whose pictures are logged at once
PAINTED = 5  # times that a pixel is computed for pictures of an iterate
COLOURS = {"energy": (230, 159, 0), "data": (86, 180, 233), "regulariser": (213, 94, 0)}
RUNS = ((230, 159, 0), (0, 158, 115), (204, 121, 167), (240, 228, 66))  # none like the start's


def record(
    path: PathLike | None = None,
    *,
    spawn: bool = False,
    live: bool = False,
    truth: FloatArray | None = None,
    max_width: int = 480,
    blueprint: str = "reconstruction",
) -> Recorder:
    """Make an observer that records a run: to a file, or into a viewer that follows it.

    Parameters
    ----------
    path : path, optional
        The recording to write, ``.rrd``. An old one is replaced when the run has ended.
    spawn, live : bool
        Show the run as it goes instead: in the native viewer, or in one below the notebook's cell.
        Viewer and server listen on this machine only.
    truth : (H, W) float array, optional
        True distance, mm, to show beside the result; nan where unknown.
    max_width : int
        Pictures and point clouds wider than this, px, are thinned.
    blueprint : {"reconstruction", "convergence"}
        How the viewer opens it: everything about the run, or its curves at large.

    Returns
    -------
    Recorder
        Give it to ``run`` or call it with each iterate, then `Recorder.close` it. As a context manager it
        stays open until the block ends, for `Recorder.add_trust`::

            with el.record("run.rrd") as recorder:
                result = el.reconstruct(frame, calibration, observers=[recorder])
                recorder.add_trust(el.trust_of(result, calibration), result)

    Raises
    ------
    ValueError
        If it is not one of path, spawn and live, or there is no such blueprint.
    OSError
        If the file cannot be written or the viewer does not start.
    """
    if (path is not None) + spawn + live != 1:
        raise ValueError("give record() either a path or spawn=True or live=True")
    if blueprint not in BLUEPRINTS:
        raise unknown_name("blueprint", blueprint, BLUEPRINTS)
    return Recorder(Sink(path, live), truth, max_width, blueprint)


# On the timelines of iterations and of pictures; whose pictures come there, or what is done.
_Place = tuple[int, int, Iterate | Callable[[], None]]


@dataclass(frozen=True)
class _Stage:
    """What a stage has come to."""

    at: int  # where it begins on the timeline of iterations, and on that of pictures
    picture: int
    unit: str  # of distances
    shape: tuple[int, ...]  # of its pictures
    limits: Limits  # of its last iterate
    low: FloatArray  # (3,), ends of the surface along x, y and z
    high: FloatArray
    box: FloatArray  # (2, 2), ends of the section along z and y
    facing: list[FloatArray]  # the section of d₀


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

    def __init__(self, path: PathLike, *, truth: FloatArray | None = None, max_width: int = 480) -> None:
        self._sink, self._truth, self._max_width = Sink(path), truth, max_width
        self.path = self._sink.path
        self._runs: dict[str, Recorder] = {}

    def run(self, name: str) -> Recorder:
        """Make the observer of one run; its entities begin with the run's name."""
        if not name.isidentifier() or name in self._runs:
            why = "there is one already" if name in self._runs else "expected a word such as gauss_newton"
            raise ValueError(f"a run cannot be called {name!r}: {why}")
        colour = RUNS[len(self._runs) % len(RUNS)]
        self._runs[name] = Recorder(self._sink, self._truth, self._max_width, run=name, colour=colour)
        return self._runs[name]

    def close(self) -> None:
        """Write the file; a second call does nothing. Without an iterate there is none."""
        with self._sink:
            for recorder in self._runs.values():
                recorder.close()
            if not self._sink.open:  # there was an error
                return
            runs = [recorder for recorder in self._runs.values() if recorder.limits]
            units = dict.fromkeys(unit for recorder in runs for unit in recorder.limits)
            common = {u: Limits.common(run.limits[u] for run in runs if u in run.limits) for u in units}
            for recorder in runs:
                recorder.conclude(common)
            if runs:
                self._sink.arrange(comparison([run.shown for run in runs if run.shown is not None]))

    def __enter__(self) -> Comparison:
        return self

    def __exit__(self, *failure: object) -> None:
        self.close()


class Recorder:
    """An observer that logs iterates to a recording; see `record`.

    Of the problem: ``input``, ``mask``, ``settings``, ``world/camera``, ``world/truth``,
    ``section/start`` (d₀), ``section/truth``, ``scales/<map>``; static, but where a run has several
    stages these are logged when each begins, with its name, ``stage``. Per iterate: ``depth``
    (distance), ``normals`` ((n + 1)/2), ``residual`` (model - image), ``front/<name>`` (the iterate's
    maps), ``world/cloud``, ``section/now``, ``plots/<name>``, and ``log10/<name>`` of energy, terms and
    change. Scalars are logged for every iterate, pictures for the first 20 of the solution, its last,
    and between them each time k has grown by half; of the stages before it only for the first and the
    last, as there may be a dozen. The timeline "iteration" runs on over all stages, and so does
    "picture", on which only iterates with pictures are, at equal distances.
    Colours reach what the last stage in a unit needs at its end; in a `Comparison`, where all names
    begin with the run's, what all its runs need.
    Of how far the end can be trusted, if that is added: ``front/trust/sigma`` (% of the distance),
    ``front/trust/decided_by``, ``front/trust/mask``, ``front/trust/words``; static.

    The solver needs all cores: for a file, iterates are but kept, and made into pictures when the run has
    ended, or by a thread when what is kept passes `KEPT`. For a viewer a thread does it at once.
    """

    def __init__(
        self,
        sink: Sink,
        truth: FloatArray | None,
        max_width: int,
        blueprint: str | None = None,
        *,
        run: str = "",
        colour: tuple[int, ...] = NOW,
    ) -> None:
        if max_width < 1:
            raise ValueError(f"max_width must be at least 1 px, got {max_width}")
        self.path = sink.path  # None if it goes to a viewer
        self.truth, self.max_width = truth, max_width
        self.shown: Shown | None = None
        self._sink, self._blueprint, self._run, self._colour = sink, blueprint, run, colour
        self._last: Iterate | None = None
        self._began = 0, SOLUTION  # where the run begins on the timeline, and with which stage
        self._several = False  # whether there are several stages
        self._before = 0  # places on the timeline before this stage's k = 0
        self._pictured = -1  # k of the last iterate whose pictures were logged
        self._numbers: dict[int, int] = {}  # of the iterates with pictures, by their places
        self._stage = 0, 0  # where the stage began: iteration and picture
        self._length = 0  # of the timeline
        self._open, self._within = True, False  # within: in a block at whose end it is closed
        self._thread = ThreadPoolExecutor(1)
        self._jobs: deque[Future[None]] = deque()  # of the thread
        self._waiting: list[_Place] = []  # what is not given to it yet
        self._kept = 0  # bytes of that
        self._painter: Painter | None = None
        self._input: tuple[FloatArray, rr.EncodedImage] | None = None  # a frame and its picture
        self._curves: dict[str, list[tuple[int, float]]] = {}  # what is still to be logged
        self._newest: Pictures | None = None  # that were made
        # Until all is over nobody knows what their colours must reach. No more than the depth maps take.
        self._residuals: list[tuple[str, Sequence[int], list[NDArray[np.float32]]]] = []
        self._facing: list[FloatArray] = []  # of the section: of d₀ and the truth
        self._true_section: list[FloatArray] = []
        self._true_points: FloatArray | None = None  # (n, 3)
        self._ends: list[_Stage] = []
        # What stays for a stage, until it is known whether it stays for ever.
        self._held: list[tuple[str, tuple[rr.AsComponents, ...]]] | None = None if self.path is None else []

    def __call__(self, iterate: Iterate) -> None:
        """Log one iterate."""
        if not self._open:
            raise ValueError("the recording is closed")
        if self._sink.gone:
            return  # the run goes on
        last = self._last
        if last is None or (last.stage, last.round) != (iterate.stage, iterate.round):
            truth = self._truth_of(iterate)
            if last is None:
                self._sink.begin()
                self._began = iterate.k, stage_text(iterate.stage, iterate.round)
            else:
                self._end_stage(last)
                if not self._several:
                    self._several = True
                    self._defer(self._release, self._began[0])
                self._before += last.k + 1 - iterate.k
            self._kept += _bytes(vars(iterate.problem).values())
            self._stage = self._before + iterate.k, len(self._numbers)
            self._defer(partial(self._begin, replace(iterate), truth, self._stage), self._stage[0])
        self._last, self._length = iterate, self._before + iterate.k
        self._note_scalars(iterate)
        often = iterate.k <= ALL_UNTIL or iterate.k >= GROWTH * self._pictured
        if self._pictured < 0 or (often and iterate.stage == SOLUTION):
            self._picture(iterate)

    def add_trust(self, trust: Trust, result: Result | Iterate) -> None:
        """Show how far the run's end can be trusted, before the recording is closed.

        Parameters
        ----------
        trust : Trust
            As `endolab.trust_of` tells.
        result : Result or Iterate
            What it was told of.

        Raises
        ------
        ValueError
            If the recording is closed, nothing was recorded, or what was is not of the same size.
        """
        if not self._open:
            raise ValueError("the recording is closed: use it as a context manager, or add the trust before")
        if self._last is None:
            raise ValueError("nothing was recorded that could be trusted")
        shapes = trust.sigma.shape, result.mask.shape, self._last.mask.shape
        if len(set(shapes)) > 1:
            raise ValueError("trust has shape {}, the result {}, what was recorded {}".format(*shapes))
        if not self._sink.gone:
            percent = 100 * trust.sigma / result.distance
            self._kept += _bytes((percent, trust.decided_by))
            job = partial(self._log_trust, trust, percent, result.problem)
            self._defer(job, self._before + self._last.k)

    def __enter__(self) -> Recorder:
        self._within = True
        return self

    def __exit__(self, *failure: object) -> None:
        self._within = False
        self.close()

    def close(self) -> None:
        """End the recording and write the file, or raise an OSError and leave none; once is enough.

        In a block of its own (``with record(...) as recorder:``) this is done at the block's end.
        """
        if not self._open or self._within:
            return
        self._open, whole = False, False
        try:
            if self._last is not None:
                self._end_stage(self._last)
                self._defer(self._finish, self._began[0])
            self._log_scalars()
            while self._jobs:
                self._jobs.popleft().result()
            self._log_all(self._waiting)
            if self._last is not None and not self._run:
                self.conclude(self.limits)
            whole = True
        finally:
            self._thread.shutdown()
            self._last, self._waiting, self._painter, self._input = None, [], None, None
            self._newest = self._true_points = None
            if not whole:
                self._sink.drop()
            elif not self._run:
                self._sink.close()

    def _end_stage(self, last: Iterate) -> None:
        if last.k != self._pictured:
            self._picture(last)
        self._pictured = -1
        self._defer(partial(self._sum_up, self._stage, last.problem), self._stage[0])

    def _picture(self, iterate: Iterate) -> None:
        self._pictured = iterate.k
        self._numbers[self._before + iterate.k] = len(self._numbers)
        self._kept += _bytes((iterate.log_distance, *iterate.maps.values()))
        # Without what others have asked it for, which it would keep as well.
        self._defer(replace(iterate), self._before + iterate.k)

    def _defer(self, what: Iterate | Callable[[], None], place: int) -> None:
        """Have pictures logged, or something done, at a place of the timeline: later, if nobody watches."""
        self._waiting.append((place, self._numbers.get(place, len(self._numbers)), what))
        if self.path is None:
            self._hand_over(WATCHED)
        elif self._kept > KEPT:
            self._hand_over(0)

    def _hand_over(self, most: int) -> None:
        """Give the thread what waits, when it has no more than so many jobs left: iterates take memory."""
        while self._jobs and (len(self._jobs) > most or self._jobs[0].done()):
            self._jobs.popleft().result()
        self._jobs.append(self._thread.submit(copy_context().run, self._log_all, self._waiting))
        self._waiting, self._kept = [], 0

    def _log_all(self, waiting: list[_Place]) -> None:
        pictured: list[tuple[int, Iterate]] = []
        for place, number, what in waiting:
            if isinstance(what, Iterate):
                pictured.append((place, what))
                continue
            self._log_pictures(pictured)
            pictured = []
            self._sink.at(TIMELINE, place, {PICTURES: number})
            what()
        self._log_pictures(pictured)

    def _truth_of(self, iterate: Iterate) -> FloatArray | None:
        """The truth on the grid of an iterate; stages before the solution may have a smaller one."""
        truth, shape = self.truth, iterate.mask.shape
        if truth is None or truth.shape == shape:
            return truth
        if iterate.stage == SOLUTION or abs(truth.shape[0] * shape[1] / truth.shape[1] - shape[0]) > 1:
            raise ValueError(f"truth has shape {truth.shape}, the frame {shape}")
        return np.asarray(cv2.resize(truth, shape[::-1], interpolation=cv2.INTER_AREA))

    def _log(self, entity: str, *what: rr.AsComponents, static: bool = False) -> None:
        self._sink.log(f"{self._run}/{entity}", *what, static=static)

    def _log_of_stage(self, entity: str, *what: rr.AsComponents) -> None:
        """Log what stays for a stage; it is static if a file has no other stage."""
        # In the viewer, what is static hides all that comes on the timeline.
        if self._held is None:
            self._log(entity, *what)
        else:
            self._held.append((entity, what))

    def _release(self) -> None:
        """Log what was held back of the first stage: now, if there are others."""
        held, self._held = self._held or [], None
        for entity, what in held:
            self._log(entity, *what, static=not self._several)
        if self._several or self._began[1] != SOLUTION:
            self._log_stage(self._began[1])

    def _log_stage(self, text: str) -> None:
        name, round = stage_of(text)
        self._log("stage", rr.TextDocument(text), rr.StateChange(state=name))
        self._log("round", rr.StateChange(state=str(round or "-")))

    # What stays -----------------------------------------------------------------------

    def _begin(self, iterate: Iterate, truth: FloatArray | None, began: tuple[int, int]) -> None:
        problem, inside = iterate.problem, iterate.mask
        painter = self._painter_of(problem)
        thin, sparse, seen = painter.thin, painter.sparse, painter.seen
        distance = np.exp(iterate.log_distance[thin])
        picture = in_colour(problem.shown)
        if self._input is None or self._input[0] is not problem.shown:
            self._input = problem.shown, png(picture[thin])
        self._log_of_stage("input", self._input[1])
        classes = rr.AnnotationContext([(0, "left out", (0, 0, 0, 255)), (1, "used", (0, 0, 0, 0))])
        mask = rr.SegmentationImage(seen.astype(np.uint8), opacity=1.0)
        self._log_of_stage("mask", classes, mask)
        self._log_of_stage("settings", rr.TextDocument(self._settings(problem), media_type="text/markdown"))
        size = 0.35 * float(np.median(distance[seen]))
        self._log_of_stage("world/camera", camera_shape(problem.camera, size))
        # The colours of the cloud never change: logged once.
        own = as_bytes(picture[sparse][inside[sparse]])
        colours = rr.Points3D.from_fields(colors=own, radii=rr.Radius.ui_points(2.5))
        self._log_of_stage("world/cloud", colours)
        self._facing = section(np.where(inside, problem.log_facing, np.nan), problem)
        self._true_section, self._true_points = [], None
        if truth is not None and np.isfinite(truth[inside]).any():
            unit = 1.0 if problem.metric else np.nanmedian((distance / truth[thin])[seen])
            true = np.where(inside & (truth > 0), unit * truth, np.nan)
            self._true_section = section(np.log(true), problem)
            self._log_of_stage("section/truth", _strips(self._true_section, TRUTH))
            points = true[thin][..., None] * problem.field.rays[thin]
            self._true_points = points[np.isfinite(points).all(axis=-1)]
            self._log_of_stage("world/truth", rr.Points3D(self._true_points, colors=TRUTH, radii=THIN))
        self._log_views(iterate)
        if self.path is None:  # someone is watching, and what comes is not known
            self._newest = painter.paint(iterate)
            self._sum_up(began, problem)
            stage = self._ends[-1]
            self._log_parts("section", {"start": _strips(cut(stage.facing, stage.box), START)})
            self._log_scales(stage, stage.limits, stage.box)
            self._show(self._ends[-1])
            self._log_blueprint()

    def _log_views(self, iterate: Iterate) -> None:
        """Log what a new stage has to show beside the others, and hide what it has not."""
        terms, maps = tuple(iterate.terms), tuple(iterate.maps)
        earlier = self.shown
        if earlier is None:
            self._log("world", rr.ViewCoordinates.RDF, static=True)
        else:
            self._log_stage(stage_text(iterate.stage, iterate.round))
            nothing = png(np.zeros_like(self._painter_of(iterate.problem).seen, np.uint8))
            for name in set(earlier.maps) - set(maps):
                self._log(f"front/{name}", nothing)  # the viewer would show the old one despite a Clear
            terms = tuple(dict.fromkeys(earlier.terms + terms))
            maps = tuple(dict.fromkeys(earlier.maps + maps))
        for name in ("energy", *terms, *(["change"] if self._run else [])):
            colour = self._colour if self._run else COLOURS.get(name)
            style = rr.SeriesLines(colors=colour, names=f"{self._run} {name}".strip(), widths=2)
            self._log(f"log10/{name}", style, static=True)
        self.shown = Shown(self._run, iterate.problem.unit, terms, maps, staged=earlier is not None)

    def _finish(self) -> None:
        if not self._several:
            self._release()

    # What is known at the end ---------------------------------------------------------

    @property
    def limits(self) -> dict[str, Limits]:
        """What the run's colours must reach, by the unit of distances."""
        return {stage.unit: stage.limits for stage in self._ends}

    def _sum_up(self, began: tuple[int, int], problem: Problem) -> None:
        """Note what a stage has come to, by the pictures that were made last."""
        newest = self._newest
        if newest is None:
            return
        surface = newest.cloud if self._true_points is None else self._true_points
        low, high = np.percentile(surface, [1, 99], axis=0)
        box = box_of(chain(newest.section, self._true_section))
        limits = Limits.of(newest.depth, newest.misfit)
        low, high = np.minimum(low, 0), np.maximum(high, 0)  # with the camera
        shape, facing = newest.depth.shape, self._facing
        self._ends.append(_Stage(*began, problem.unit, shape, limits, low, high, box, facing))

    def conclude(self, limits: Mapping[str, Limits]) -> None:
        """Log, when all else is logged, what depends on the end."""
        last = self._ends[-1]
        if self.path is not None:
            for unit, places, misfits in self._residuals:
                self._log_residuals(places, misfits, limits[unit].grey_levels)
            self._residuals.clear()
            boxes = {stage.unit: stage.box for stage in self._ends}
            there: object = None  # what the last scales depended on; they stay until others come
            for stage in self._ends:
                self._sink.at(TIMELINE, stage.at, {PICTURES: stage.picture})
                box = boxes[stage.unit]
                self._log_parts("section", {"start": _strips(cut(stage.facing, box), START)})
                if there != (stage.unit, stage.shape):
                    self._log_scales(stage, limits[stage.unit], box)
                there = stage.unit, stage.shape
        self._show(last)
        if self._blueprint is not None:
            self._log_blueprint()

    def _show(self, stage: _Stage) -> None:
        """Note for the layout what a stage has come to."""
        if self.shown is not None:
            known = replace(self.shown, last=self._length, shape=stage.shape, box=stage.box)
            self.shown = replace(known, low=stage.low, high=stage.high)

    def _log_scales(self, stage: _Stage, limits: Limits, box: FloatArray) -> None:
        """Log what the colours of a stage's maps mean, and how long things are in its section."""
        shape, levels = stage.shape, limits.grey_levels
        self._log("depth", depth_limits((limits.near, limits.far)), static=self._static)
        self._log_parts("scales/depth", scale(shape, sequential("viridis"), limits.near, limits.far))
        self._log_parts("scales/residual", scale(shape, diverging(), -levels, levels))
        wide = float((box[1] - box[0])[0])
        length = round_length(wide / 3) if wide > 0 else 0.0  # of a section that meets one pixel
        bar = rr.LineStrips2D([[[0.0, 0.0], [length, 0.0]]], colors=TRUTH, radii=THIN)
        named = words([[length / 2, 0.0]], [f"{length:g} {stage.unit}"])
        # Those of several runs have colours of their own, which the curves beside them name.
        lines = {} if self._run else {"now": self._colour}
        lines |= {"d₀": START, **({"truth": TRUTH} if self._true_section else {})}
        self._log_parts("section", {"scale": bar, "length": named, **lines_key(box, lines)})

    def _log_parts(self, entity: str, parts: Mapping[str, rr.AsComponents]) -> None:
        """Log what lies below an entity and depends on the end."""
        for name, what in parts.items():
            self._log(f"{entity}/{name}", what, static=self._static)

    @property
    def _static(self) -> bool:
        """Whether what depends on the end is logged for all times: a file has no other stage."""
        return self.path is not None and not self._several

    def _log_blueprint(self) -> None:
        if self._blueprint is not None and self.shown is not None:
            self._sink.arrange(BLUEPRINTS[self._blueprint](self.shown))

    def _settings(self, problem: Problem) -> str:
        gain = problem.photometry.gain
        order = "" if problem.regulariser == "curvature" else " order"
        rows = {
            "distances": "mm" if problem.metric else "**relative units**",
            "picture": f"{problem.camera.width} x {problem.camera.height} px",
            "camera": problem.camera.model.replace("_", "-"),
            "k": problem.photometry.k,
            "γ": problem.photometry.gamma,
            "gain": ("unknown" if gain is None else f"{gain:.6g}") + ("" if problem.metric else " (a guess)"),
            "ξ": problem.xi,
            "regulariser": f"{problem.regulariser}{order}, λ = {problem.lam:g}, ε = {problem.epsilon:g}",
            "data": f"Huber, ρ = {255 * problem.threshold:.3g}/255",
            **problem.settings,
        }
        for name, value in rows.items():
            rows[name] = f"{value:.6g}" if isinstance(value, float) else str(value).replace("|", "\\|")
        table = "\n".join(f"| {name} | {value} |" for name, value in rows.items())
        return (
            f"## Settings\n\n| | |\n|---|---|\n{table}\n\n## Colours\n\n"
            "- **depth**: distance from the camera, dark is near\n"
            "- **residual**: model - image in grey levels of 255; blue is too dark, red too bright\n"
            "- **normals**: (n + 1)/2 as red, green, blue; x right, y down, z forward\n"
            "- **section**: middle column; d₀ is where every bit of wall would face the camera\n"
            "- black: left out\n"
        )

    # How far it can be trusted ----------------------------------------------------------

    def _log_trust(self, trust: Trust, percent: FloatArray, problem: Problem) -> None:
        thin = every(problem.camera.width, self.max_width)
        seen = np.ascontiguousarray(problem.mask[thin])
        shown, decided = percent[thin].astype(np.float32), np.ascontiguousarray(trust.decided_by[thin])
        most = float(f"{np.percentile(shown[seen], 98):.2g}") or 1.0
        # Values, not colours, so that the viewer tells them to who points at them.
        sigma = rr.DepthImage(
            shown, meter=1.0, colormap="magma", depth_range=(0.0, most), magnification_filter="nearest"
        )
        self._log("front/trust/sigma", sigma, static=True)
        parts = {"sigma": scale(shown.shape, sequential("magma"), 0.0, most)}
        parts["decided_by"] = key(shown.shape, DECIDERS)
        for entity, drawn in parts.items():
            for name, what in drawn.items():
                self._log(f"scales/{entity}/{name}", what, static=True)
        black, nothing = (0, "left out", (0, 0, 0, 255)), (1, "used", (0, 0, 0, 0))
        # The run's own mask is that of a stage, which may be on a smaller grid.
        mask = rr.SegmentationImage(seen.astype(np.uint8), opacity=1.0)
        self._log("front/trust/mask", rr.AnnotationContext([black, nothing]), mask, static=True)
        classes = [black, *((k, name, colour) for k, (name, colour) in enumerate(DECIDERS.items(), 1))]
        decision = rr.SegmentationImage(decided, opacity=1.0)
        self._log("front/trust/decided_by", rr.AnnotationContext(classes), decision, static=True)
        words = rr.TextDocument(_words(trust, percent, problem, most), media_type="text/markdown")
        self._log("front/trust/words", words, static=True)
        if self.shown is not None:
            self.shown = replace(self.shown, sigma=most)
        if self.path is None:  # someone is watching
            self._show(self._ends[-1])
            self._log_blueprint()

    # What changes ---------------------------------------------------------------------

    def _note_scalars(self, iterate: Iterate) -> None:
        falling = {"energy": iterate.energy, **iterate.terms, "change": iterate.change}
        curves = {f"plots/{name}": value for name, value in {**falling, **iterate.scalars}.items()}
        # The viewer knows no logarithmic axis, and on another one all but the first steps are flat.
        curves |= {f"log10/{name}": np.log10(value) for name, value in falling.items() if value > 0}
        for name, value in curves.items():
            if np.isfinite(value):
                self._curves.setdefault(name, []).append((self._before + iterate.k, float(value)))
        if self.path is None:  # someone is watching
            self._log_scalars()

    def _log_scalars(self) -> None:
        """Log the curves' new pieces."""
        numbers = self._numbers
        for name, pieces in self._curves.items():
            for pictured in (False, True):
                chosen = [piece for piece in pieces if (piece[0] in numbers) is pictured]
                if chosen:
                    at, values = zip(*chosen, strict=True)
                    also = {PICTURES: [numbers[place] for place in at]} if pictured else None
                    self._sink.log_curve(f"{self._run}/{name}", TIMELINE, at, values, also=also)
        self._curves.clear()

    def _painter_of(self, problem: Problem) -> Painter:
        if self._painter is None or self._painter.problem is not problem:
            self._painter = Painter(problem, self.max_width)
        return self._painter

    def _log_pictures(self, pictured: Sequence[tuple[int, Iterate]]) -> None:
        """Log the pictures of iterates of one stage, at their places, a few at once."""
        for first in range(0, len(pictured), TOGETHER):
            places, iterates = zip(*pictured[first : first + TOGETHER], strict=True)
            self._log_some(places, iterates)

    def _log_some(self, places: Sequence[int], iterates: Sequence[Iterate]) -> None:
        painted = [(self._painter_of(iterate.problem), iterate) for iterate in iterates]
        pixels = PAINTED * sum(painter.seen.size for painter, _ in painted)
        all_made = side_by_side(lambda one: one[0].paint(one[1]), painted, pixels)
        self._newest = all_made[-1]
        log = partial(self._log_rows, places)
        # The viewer paints nan like the nearest distance: the blueprint lays the mask over it.
        depths, problem = [made.depth for made in all_made], iterates[0].problem
        log("depth", depth_columns(depths, problem.metric))
        log("normals", png_columns([made.normals for made in all_made]))
        misfits = [made.misfit for made in all_made]
        if self.path is None:  # someone is watching
            self._log_residuals(places, misfits, self._ends[-1].limits.grey_levels)
        else:
            self._residuals.append((problem.unit, places, misfits))
        for name in dict.fromkeys(name for made in all_made for name in made.maps):
            maps = {k: made.maps[name] for k, made in zip(places, all_made, strict=True) if name in made.maps}
            self._log_rows([*maps], f"front/{name}", png_columns([*maps.values()]))
        clouds = [made.cloud for made in all_made]
        points = rr.Points3D.columns(positions=np.concatenate(clouds)).partition([len(c) for c in clouds])
        log("world/cloud", points)
        sections = [made.section for made in all_made]
        strips, counts = [strip for one in sections for strip in one], [len(one) for one in sections]
        lines = rr.LineStrips2D.columns(strips=strips, colors=[self._colour] * len(strips))
        log(
            "section/now",
            lines.partition(counts),
            rr.LineStrips2D.columns(radii=np.full(len(places), THIN)),
        )

    def _log_residuals(
        self, places: Sequence[int], misfits: list[NDArray[np.float32]], grey_levels: float
    ) -> None:
        pixels = sum(misfit.size for misfit in misfits)
        made = side_by_side(lambda misfit: residual_png(misfit, grey_levels), misfits, pixels)
        self._log_rows(places, "residual", png_columns(made))

    def _log_rows(self, at: Sequence[int], entity: str, *columns: Iterable[rr.ComponentColumn]) -> None:
        """Log one thing at each of several places of the timelines that have pictures."""
        also = {PICTURES: [self._numbers[place] for place in at]}
        self._sink.log_rows(f"{self._run}/{entity}", TIMELINE, at, *columns, also=also)


def _words(trust: Trust, percent: FloatArray, problem: Problem, most: float) -> str:
    """How far the end can be trusted, as Markdown."""
    inside = problem.mask
    rows = {name: f"{100 * np.median(share[inside]):.2g}" for name, share in trust.causes.items()}
    rows = dict(sorted(rows.items(), key=lambda row: -float(row[1])))
    table = "\n".join(f"| {name} | {value} |" for name, value in rows.items())
    decided = trust.decided_by[inside]
    parts = [f"{name} {100 * np.mean(decided == k):.0f} %" for k, name in enumerate(DECIDERS, 1)]
    low, middle, high = np.percentile(percent[inside], [10, 50, 90])
    return (
        "## How far it can be trusted\n\n"
        f"σ, the standard deviation of the distance at the run's end: {middle:.2g} % for the median pixel, "
        f"{low:.2g} to {high:.2g} % for four in five; {100 * trust.sigma_scale:.2g} % is a scale that all "
        "share.\n\n"
        f"Who decided the pixels: {', '.join(parts)}.\n\n"
        f"| cause | σ of the shape, median [%] |\n|---|---|\n{table}\n\n"
        f"{' '.join(trust.notes)}\n\n## Colours\n\n"
        f"- **σ**: dark 0 to bright {most:g} % of the distance, or more\n"
        "- **who decided**: blue data, orange border or contour, pink prior\n"
        "- black: left out\n"
    )


def _bytes(values: Iterable[object]) -> int:
    """Size of the arrays among these."""
    return sum(value.nbytes for value in values if isinstance(value, np.ndarray))


def _strips(section: list[FloatArray], colour: tuple[int, ...]) -> rr.LineStrips2D:
    return rr.LineStrips2D(section, colors=[colour] * len(section), radii=THIN)
