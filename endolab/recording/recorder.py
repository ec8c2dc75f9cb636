"""Recordings of a run for the Rerun viewer: every iterate on the timeline "iteration".

`record` makes an observer for `run`; what it logs, and under which names, is in `Recorder`.
A file is written when the run has ended, interrupted or not, whole or not at all.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import rerun as rr

from endolab.depth.problem import Problem
from endolab.depth.result import SOLUTION, Iterate, Result
from endolab.io.atomic import PathLike
from endolab.model.schema import unknown_name
from endolab.numerics.arrays import FloatArray
from endolab.numerics.side_by_side import side_by_side
from endolab.plots.scales import DECIDERS, in_colour, round_length
from endolab.recording.layouts import BLUEPRINTS, TIMELINE, Shown, comparison
from endolab.recording.pictures import Painter, section
from endolab.recording.stream import (
    NOW,
    START,
    THIN,
    TRUTH,
    Sink,
    as_bytes,
    camera_shape,
    depth_columns,
    every,
    png,
    png_columns,
    stage_text,
)
from endolab.trust.trust import Trust

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


_Place = tuple[
    int, Iterate | Callable[[], None]
]  # on the timeline; whose pictures come there, or what is done


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
            shown = [recorder.shown for recorder in self._runs.values() if recorder.shown is not None]
            if shown and self._sink.open:
                self._sink.arrange(comparison(shown))

    def __enter__(self) -> Comparison:
        return self

    def __exit__(self, *failure: object) -> None:
        self.close()


class Recorder:
    """An observer that logs iterates to a recording; see `record`.

    Of the problem: ``input``, ``mask``, ``settings``, ``world/camera``, ``world/truth``,
    ``section/start``, ``section/truth``; static, but where a run has several stages these are
    logged when each begins, with its name, ``stage``. Per iterate: ``depth`` (distance),
    ``normals`` ((n + 1)/2), ``residual`` (model - image), ``front/<name>`` (the iterate's maps),
    ``world/cloud``, ``section/now``, ``plots/<name>``. Scalars are logged for every iterate,
    pictures for the first 20 of the solution, its last, and between them each time k has grown by
    half; of the stages before it only for the first and the last, as there may be a dozen.
    The timeline runs on over all stages. In a `Comparison` all names begin with the run's.
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
        self._open, self._within = True, False  # within: in a block at whose end it is closed
        self._thread = ThreadPoolExecutor(1)
        self._jobs: deque[Future[None]] = deque()  # of the thread
        self._waiting: list[_Place] = []  # what is not given to it yet
        self._kept = 0  # bytes of that
        self._painter: Painter | None = None
        self._input: tuple[FloatArray, rr.EncodedImage] | None = None  # a frame and its picture
        self._curves: dict[str, list[tuple[int, float]]] = {}  # what is still to be logged
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
            self._defer(partial(self._begin, replace(iterate), truth), self._before + iterate.k)
        self._last = iterate
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
            whole = True
        finally:
            self._thread.shutdown()
            self._last, self._waiting, self._painter, self._input = None, [], None, None
            if not whole:
                self._sink.drop()
            elif not self._run:
                self._sink.close()

    def _end_stage(self, last: Iterate) -> None:
        if last.k != self._pictured:
            self._picture(last)
        self._pictured = -1

    def _picture(self, iterate: Iterate) -> None:
        self._pictured = iterate.k
        self._kept += _bytes((iterate.log_distance, *iterate.maps.values()))
        # Without what others have asked it for, which it would keep as well.
        self._defer(replace(iterate), self._before + iterate.k)

    def _defer(self, what: Iterate | Callable[[], None], place: int) -> None:
        """Have pictures logged, or something done, at a place of the timeline: later, if nobody watches."""
        self._waiting.append((place, what))
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
        for place, what in waiting:
            if isinstance(what, Iterate):
                pictured.append((place, what))
                continue
            self._log_pictures(pictured)
            pictured = []
            self._sink.at(TIMELINE, place)
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
            self._log("stage", rr.TextDocument(self._began[1]))

    # What stays -----------------------------------------------------------------------

    def _begin(self, iterate: Iterate, truth: FloatArray | None) -> None:
        problem, inside = iterate.problem, iterate.mask
        painter = self._painter_of(problem)
        thin, sparse, seen = painter.thin, painter.sparse, painter.seen
        distance = np.exp(iterate.log_distance[thin])
        near, middle, far = (float(value) for value in np.percentile(distance[seen], [1, 50, 99]))
        self._range = near, far
        error = np.abs(painter.misfit(iterate.log_distance)[seen])
        self._grey_levels = max(5.0, float(np.ceil(255 * np.percentile(error, 98))))
        picture = in_colour(problem.shown)
        if self._input is None or self._input[0] is not problem.shown:
            self._input = problem.shown, png(picture[thin])
        self._log_of_stage("input", self._input[1])
        classes = rr.AnnotationContext([(0, "left out", (0, 0, 0, 255)), (1, "used", (0, 0, 0, 0))])
        mask = rr.SegmentationImage(seen.astype(np.uint8), opacity=1.0)
        self._log_of_stage("mask", classes, mask)
        self._log_of_stage("settings", rr.TextDocument(self._settings(problem), media_type="text/markdown"))
        self._log_of_stage("world/camera", camera_shape(problem.camera, 0.35 * middle))
        # The colours of the cloud never change: logged once.
        own = as_bytes(picture[sparse][inside[sparse]])
        colours = rr.Points3D.from_fields(colors=own, radii=rr.Radius.ui_points(2.5))
        self._log_of_stage("world/cloud", colours)
        self._log_of_stage("section/start", _strips(section(iterate.log_distance, problem), START))
        shown = (distance[..., None] * problem.field.rays[thin])[seen]
        if truth is not None and np.isfinite(truth[inside]).any():
            unit = 1.0 if problem.metric else np.nanmedian((distance / truth[thin])[seen])
            true = np.where(inside & (truth > 0), unit * truth, np.nan)
            self._log_of_stage("section/truth", _strips(section(np.log(true), problem), TRUTH))
            points = true[thin][..., None] * problem.field.rays[thin]
            shown = points[np.isfinite(points).all(axis=-1)]
            self._log_of_stage("world/truth", rr.Points3D(shown, colors=TRUTH, radii=THIN))
        low, high = np.percentile(shown, [1, 99], axis=0)
        far = float(high[2])
        length = round_length(far / 3)
        label = f"{length:g} {problem.unit}"
        bar = rr.LineStrips2D([[[0.0, 0.0], [length, 0.0]]], colors=TRUTH, radii=THIN, labels=label)
        self._log_of_stage("section/scale", bar)
        self._log_views(iterate, low, high, far)

    def _log_views(self, iterate: Iterate, low: FloatArray, high: FloatArray, far: float) -> None:
        """Log what a new stage has to show beside the others, and hide what it has not."""
        terms, maps = tuple(iterate.terms), tuple(iterate.maps)
        earlier = self.shown
        if earlier is None:
            self._log("world", rr.ViewCoordinates.RDF, static=True)
        else:
            self._log("stage", rr.TextDocument(stage_text(iterate.stage, iterate.round)))
            nothing = png(np.zeros_like(self._painter_of(iterate.problem).seen, np.uint8))
            for name in set(earlier.maps) - set(maps):
                self._log(f"front/{name}", nothing)  # the viewer would show the old one despite a Clear
            terms = tuple(dict.fromkeys(earlier.terms + terms))
            maps = tuple(dict.fromkeys(earlier.maps + maps))
        for name in ("energy", *terms, *(["change"] if self._run else [])):
            colour = self._colour if self._run else COLOURS.get(name)
            style = rr.SeriesLines(colors=colour, names=f"{self._run} {name}".strip(), widths=2)
            self._log(f"plots/{name}", style, static=True)
        unit = iterate.problem.unit
        self.shown = Shown(self._run, unit, terms, maps, low, high, far, earlier is not None)
        if self.path is None:  # someone is watching
            self._log_blueprint()

    def _finish(self) -> None:
        if not self._several:
            self._release()
        if self.path is not None:
            self._log_blueprint()

    def _log_blueprint(self) -> None:
        if self._blueprint is not None and self.shown is not None:
            self._sink.arrange(BLUEPRINTS[self._blueprint](self.shown))

    def _settings(self, problem: Problem) -> str:
        gain = problem.photometry.gain
        low, high = self._range
        order = "" if problem.regulariser == "curvature" else " order"
        rows = {
            "distances": "mm" if problem.metric else "**relative units**, not mm: the gain is unknown",
            "picture": f"{problem.camera.width} x {problem.camera.height} px, {problem.camera.model} camera",
            "k": problem.photometry.k,
            "γ": problem.photometry.gamma,
            "gain": ("unknown" if gain is None else f"{gain:.6g}") + ("" if problem.metric else " (a guess)"),
            "ξ": problem.xi,
            "regulariser": f"{problem.regulariser}{order}, λ = {problem.lam:g}, ε = {problem.epsilon:g}",
            "data": f"Huber, threshold {255 * problem.threshold:.3g} grey levels of 255",
            **problem.settings,
        }
        for name, value in rows.items():
            rows[name] = f"{value:.6g}" if isinstance(value, float) else str(value).replace("|", "\\|")
        table = "\n".join(f"| {name} | {value} |" for name, value in rows.items())
        return (
            f"## Settings\n\n| | |\n|---|---|\n{table}\n\n## Colours\n\n"
            f"- **depth**: distance from the camera, dark {low:.3g} to bright {high:.3g} {problem.unit}\n"
            f"- **residual**: model - image, blue -{self._grey_levels:.0f} (too dark), white 0, "
            f"red +{self._grey_levels:.0f} grey levels of 255 (too bright)\n"
            "- **normals**: (n + 1)/2 as red, green, blue; x right, y down, z forward\n"
            "- **section**: middle column; orange now, blue start, grey truth\n"
            "- black: left out\n"
        )

    # How far it can be trusted ----------------------------------------------------------

    def _log_trust(self, trust: Trust, percent: FloatArray, problem: Problem) -> None:
        thin = every(problem.camera.width, self.max_width)
        seen = np.ascontiguousarray(problem.mask[thin])
        shown, decided = percent[thin].astype(np.float32), np.ascontiguousarray(trust.decided_by[thin])
        most = float(f"{np.percentile(shown[seen], 98):.2g}") or 1.0
        # Values, not colours, so that the viewer tells them to who points at them.
        sigma = rr.DepthImage(shown, meter=1.0, colormap="magma", depth_range=(0.0, most))
        self._log("front/trust/sigma", sigma, static=True)
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
            self._log_blueprint()

    # What changes ---------------------------------------------------------------------

    def _note_scalars(self, iterate: Iterate) -> None:
        scalars = {"energy": iterate.energy, **iterate.terms, "change": iterate.change, **iterate.scalars}
        for name, value in scalars.items():
            if np.isfinite(value):
                self._curves.setdefault(name, []).append((self._before + iterate.k, float(value)))
        if self.path is None:  # someone is watching
            self._log_scalars()

    def _log_scalars(self) -> None:
        """Log the curves' new pieces."""
        for name, pieces in self._curves.items():
            at, values = zip(*pieces, strict=True)
            self._sink.log_curve(f"{self._run}/plots/{name}", TIMELINE, at, values)
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
        all_made = side_by_side(lambda one: one[0].paint(one[1], self._grey_levels), painted, pixels)

        def log(entity: str, *columns: Iterable[rr.ComponentColumn], at: Sequence[int] = places) -> None:
            self._sink.log_rows(f"{self._run}/{entity}", TIMELINE, at, *columns)

        # The viewer paints nan like the nearest distance: the blueprint lays the mask over it.
        depths, metric = [made.depth for made in all_made], iterates[0].problem.metric
        log("depth", depth_columns(depths, metric, self._range))
        log("normals", png_columns([made.normals for made in all_made]))
        log("residual", png_columns([made.residual for made in all_made]))
        for name in dict.fromkeys(name for made in all_made for name in made.maps):
            maps = {k: made.maps[name] for k, made in zip(places, all_made, strict=True) if name in made.maps}
            log(f"front/{name}", png_columns([*maps.values()]), at=[*maps])
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
