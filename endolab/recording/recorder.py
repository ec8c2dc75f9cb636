"""Recordings of a run for the Rerun viewer: every iterate on the timeline "iteration".

`record` makes an observer for `run`; what it logs, and under which names, is in `Recorder`.
A file is written when the run has ended, interrupted or not, whole or not at all: Rerun's own
writer can hang for good on a full disk, so the recording is kept in memory until then.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from endolab.depth.energy import model_image
from endolab.depth.problem import Problem
from endolab.depth.result import Iterate
from endolab.io.atomic import PathLike
from endolab.numerics.arrays import FloatArray
from endolab.recording.layouts import BLUEPRINTS, TIMELINE, Shown, comparison
from endolab.recording.stream import START, THIN, Sink, as_bytes, camera_shape, grey

ALL_UNTIL, GROWTH = 20, 1.5  # pictures of the first iterates, then each time k has grown by half
CLOUD_WIDTH = 160  # columns of a cloud: coordinates would be most of a recording
WAITING = 4  # iterates that may wait to be encoded
BLUE_WHITE_RED = np.array(
    [[0, 68, 136], [110, 170, 220], [255, 255, 255], [250, 150, 90], [153, 26, 0]], float
)
SHADES = 65  # of the residual: fewer than a byte tells, and a picture that is half as large
_mixed = [np.interp(np.linspace(0, 4, SHADES), range(5), channel) for channel in BLUE_WHITE_RED.T]
DIVERGING = np.append(np.round(_mixed).T, [[0, 0, 0]], axis=0).astype(np.uint8)  # the last: black


# How PNG is compressed, which costs more than all else: few shades repeat themselves as they are.
PLAIN = (cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, 0, cv2.IMWRITE_PNG_FILTER, 8)
COLOURS = {"energy": (230, 159, 0), "data": (86, 180, 233), "regulariser": (213, 94, 0)}
RUNS = ((230, 159, 0), (0, 158, 115), (204, 121, 167), (240, 228, 66))  # none like the start's
NOW, TRUTH = (230, 159, 0), (160, 160, 160)


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
    spawn : bool
        Show the run in the native viewer instead; it listens on this machine only.
    live : bool
        Show the run in a viewer below the notebook's cell instead, as it goes. The server that
        feeds it listens on this machine only.
    truth : (H, W) float array, optional
        True distance, mm, to show beside the result; nan where unknown.
    max_width : int
        Pictures and point clouds wider than this, px, are thinned.
    blueprint : {"reconstruction", "convergence"}
        How the viewer opens it: everything about the run, or its curves at large.

    Returns
    -------
    Recorder
        Give it to ``run`` or call it with each iterate, then `Recorder.close` it.

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
        raise ValueError(f"unknown blueprint {blueprint!r}; choose {', '.join(BLUEPRINTS)}")
    return Recorder(Sink(path, live), truth, max_width, blueprint)


class Comparison:
    """Several runs in one recording, on the same timeline, side by side.

    ::

        with Comparison("both.rrd") as both:
            el.reconstruct(frame, calibration, observers=[both.run("gauss_newton")])
            el.reconstruct(frame, calibration, solver="primal_dual", observers=[both.run("primal_dual")])

    Parameters
    ----------
    path : path
        The recording to write, ``.rrd``, when the comparison is closed.
    truth, max_width
        See `record`.

    Raises
    ------
    OSError
        If the file cannot be written.
    """

    def __init__(self, path: PathLike, *, truth: FloatArray | None = None, max_width: int = 480) -> None:
        self._sink, self._truth, self._max_width = Sink(path), truth, max_width
        self._runs: dict[str, Recorder] = {}

    @property
    def path(self) -> Path | None:
        """The recording."""
        return self._sink.path

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
        for recorder in self._runs.values():
            recorder.close()
        shown = [recorder.shown for recorder in self._runs.values() if recorder.shown is not None]
        if shown and self._sink.open:
            self._sink.stream.send_blueprint(comparison(shown))
        self._sink.close()

    def __enter__(self) -> Comparison:
        return self

    def __exit__(self, *failure: object) -> None:
        self.close()


class Recorder:
    """An observer that logs iterates to a recording; see `record`.

    Notes
    -----
    Static: ``input``, ``mask``, ``settings``, ``world/camera``, ``world/truth``,
    ``section/start``, ``section/truth``. Per iterate: ``depth`` (distance), ``normals``
    ((n + 1)/2), ``residual`` (model - image), ``front/<name>`` (the iterate's maps),
    ``world/cloud``, ``section/now``, ``plots/<name>``. Scalars are logged for every iterate,
    pictures for the first 20, the last, and between them each time k has grown by half.
    In a `Comparison` all names begin with the run's. Encoding is left to a thread, so that the
    solver can go on meanwhile.
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
        self.truth, self.max_width = truth, max_width
        self.shown: Shown | None = None
        self._sink, self._blueprint, self._run, self._colour = sink, blueprint, run, colour
        self._last: Iterate | None = None
        self._pictured = -1  # k of the last iterate whose pictures were logged
        self._open = True
        self._encoder = ThreadPoolExecutor(1)
        self._jobs: deque[Future[None]] = deque()
        self._curves: dict[str, list[tuple[int, float]]] = {}  # what is still to be logged

    @property
    def path(self) -> Path | None:
        """The recording, once it is closed; None if it goes to a viewer."""
        return self._sink.path

    def __call__(self, iterate: Iterate) -> None:
        """Log one iterate."""
        if not self._open:
            raise ValueError("the recording is closed")
        if self._sink.gone:
            return  # the run goes on
        if self._last is None:
            self._check(iterate.problem)
            self._sink.begin()
            self._defer(self._begin, iterate)
        self._last = iterate
        self._note_scalars(iterate)
        if iterate.k <= ALL_UNTIL or iterate.k >= GROWTH * self._pictured:
            self._picture(iterate)

    def close(self) -> None:
        """End the recording and write the file; a second call does nothing.

        Raises
        ------
        OSError
            If the file cannot be written; then there is none.
        """
        if not self._open:
            return
        self._open = False
        if self._last is not None and self._last.k != self._pictured:
            self._picture(self._last)
        self._log_scalars()
        try:
            while self._jobs:
                self._jobs.popleft().result()
        finally:
            self._encoder.shutdown()
            if not self._run:
                self._sink.close()

    def _picture(self, iterate: Iterate) -> None:
        self._pictured = iterate.k
        self._defer(self._log_pictures, iterate)

    def _defer(self, task: Callable[[Iterate], None], iterate: Iterate) -> None:
        """Let the thread do it, but not fall behind for ever: iterates take memory."""

        def job() -> None:
            self._sink.stream.set_time(TIMELINE, sequence=iterate.k)  # counts for this thread only
            task(iterate)

        self._jobs.append(self._encoder.submit(job))
        while len(self._jobs) > 3 * WAITING:
            self._jobs.popleft().result()

    def _check(self, problem: Problem) -> None:
        if self.truth is not None and self.truth.shape != problem.mask.shape:
            raise ValueError(f"truth has shape {self.truth.shape}, the frame {problem.mask.shape}")

    def _log(self, entity: str, *what: rr.AsComponents, static: bool = False) -> None:
        self._sink.stream.log(f"{self._run}/{entity}", *what, static=static, strict=True)

    def _log_colours(
        self, entity: str, colours: NDArray, static: bool = False, how: tuple[int, ...] = ()
    ) -> None:
        """Log (h, w) or (h, w, 3) bytes, or values in [0, 1], as PNG; nan is black."""
        stored = colours if colours.dtype == np.uint8 else as_bytes(colours)
        contents = cv2.imencode(".png", stored[..., ::-1] if stored.ndim == 3 else stored, how)[1].tobytes()
        self._log(entity, rr.EncodedImage(contents=contents, media_type="image/png"), static=static)

    # What stays -----------------------------------------------------------------------

    def _begin(self, iterate: Iterate) -> None:
        problem, step = iterate.problem, -(-iterate.problem.camera.width // self.max_width)
        self._thin = thin = (slice(None, None, step), slice(None, None, step))
        # Clouds are thinned further, by a whole number.
        step *= max(1, -(-problem.camera.width // (step * CLOUD_WIDTH)))
        self._sparse = sparse = (slice(None, None, step), slice(None, None, step))
        inside = problem.mask[thin]
        self._range = np.percentile(iterate.distance[problem.mask], [1, 99])
        error = model_image(problem, iterate.log_distance)[problem.mask] - problem.image[problem.mask]
        self._grey_levels = max(5.0, float(np.ceil(255 * np.percentile(np.abs(error), 98))))
        picture = _colour_picture(problem)[thin]
        self._log_colours("input", picture, static=True)
        classes = rr.AnnotationContext([(0, "left out", (0, 0, 0, 255)), (1, "used", (0, 0, 0, 0))])
        self._log("mask", classes, rr.SegmentationImage(inside.astype(np.uint8), opacity=1.0), static=True)
        text = rr.TextDocument(self._settings(problem), media_type="text/markdown")
        self._log("settings", text, static=True)
        for name in ("energy", *iterate.terms, *(["change"] if self._run else [])):
            colour = self._colour if self._run else COLOURS.get(name)
            style = rr.SeriesLines(colors=colour, names=f"{self._run} {name}".strip(), widths=2)
            self._log(f"plots/{name}", style, static=True)

        self._log("world", rr.ViewCoordinates.RDF, static=True)
        size = 0.35 * float(np.median(iterate.distance[problem.mask]))
        self._log("world/camera", camera_shape(problem.camera, size), static=True)
        # The colours of the cloud never change: logged once.
        seen = _colour_picture(problem)[sparse][problem.mask[sparse]]
        cloud = rr.Points3D.from_fields(colors=as_bytes(seen), radii=rr.Radius.ui_points(2.5))
        self._log("world/cloud", cloud, static=True)

        self._log_section("start", iterate.distance, problem, START, static=True)
        shown = iterate.points[thin][inside]
        if self.truth is not None and np.isfinite(self.truth[problem.mask]).any():
            unit = 1.0 if problem.metric else np.nanmedian((iterate.distance / self.truth)[problem.mask])
            distance = np.where(problem.mask, unit * self.truth, np.nan)
            self._log_section("truth", distance, problem, TRUTH, static=True)
            truth = distance[..., None] * problem.field.rays
            shown = truth[thin][np.isfinite(truth[thin]).all(axis=-1)]
            self._log("world/truth", rr.Points3D(shown, colors=TRUTH, radii=THIN), static=True)
        far = float(np.percentile(shown[:, 2], 99))
        power = 10 ** np.floor(np.log10(far / 3))
        length = max(power * factor for factor in (1, 2, 5) if power * factor <= far / 3)
        label = f"{length:g} {problem.unit}"
        bar = rr.LineStrips2D([[[0, 0], [length, 0]]], colors=TRUTH, radii=THIN, labels=label)
        self._log("section/scale", bar, static=True)
        low, high = np.percentile(shown, [1, 99], axis=0)
        self.shown = Shown(self._run, problem.unit, tuple(iterate.terms), tuple(iterate.maps), low, high, far)
        if self._blueprint is not None:
            self._sink.stream.send_blueprint(BLUEPRINTS[self._blueprint](self.shown))

    def _settings(self, problem: Problem) -> str:
        gain = problem.photometry.gain
        low, high = self._range
        unit = problem.unit if problem.metric else "**relative units**, not mm: the gain is unknown"
        rows = {
            "distances": unit,
            "picture": f"{problem.camera.width} x {problem.camera.height} px, {problem.camera.model} camera",
            "k": problem.photometry.k,
            "γ": problem.photometry.gamma,
            "gain": ("unknown" if gain is None else f"{gain:.6g}") + ("" if problem.metric else " (a guess)"),
            "ξ": problem.xi,
            "regulariser": f"{problem.regulariser} order, λ = {problem.lam:g}, ε = {problem.epsilon:g}",
            "data": f"Huber, threshold {255 * problem.threshold:.3g} grey levels of 255",
            **problem.settings,
        }
        cells = {
            k: f"{v:.6g}" if isinstance(v, float) else str(v).replace("|", "\\|") for k, v in rows.items()
        }
        table = "\n".join(f"| {name} | {value} |" for name, value in cells.items())
        return (
            f"## Settings\n\n| | |\n|---|---|\n{table}\n\n## Colours\n\n"
            f"- **depth**: distance from the camera, dark {low:.3g} to bright {high:.3g} {problem.unit}\n"
            f"- **residual**: model - image, blue -{self._grey_levels:.0f} (too dark), white 0, "
            f"red +{self._grey_levels:.0f} grey levels of 255 (too bright)\n"
            "- **normals**: (n + 1)/2 as red, green, blue; x right, y down, z forward\n"
            "- **section**: middle column; orange now, blue start, grey truth\n"
            "- black: left out\n"
        )

    # What changes ---------------------------------------------------------------------

    def _note_scalars(self, iterate: Iterate) -> None:
        scalars = {"energy": iterate.energy, **iterate.terms, "change": iterate.change, **iterate.scalars}
        for name, value in scalars.items():
            if np.isfinite(value):
                self._curves.setdefault(name, []).append((iterate.k, float(value)))
        if self.path is None:  # someone is watching
            self._log_scalars()

    def _log_scalars(self) -> None:
        """Log the curves' new pieces: all at once costs little more than one value."""
        for name, pieces in self._curves.items():
            steps, values = zip(*pieces, strict=True)
            at, columns = rr.TimeColumn(TIMELINE, sequence=steps), rr.Scalars.columns(scalars=values)
            self._sink.stream.send_columns(f"{self._run}/plots/{name}", [at], columns, strict=True)
        self._curves.clear()

    def _log_pictures(self, iterate: Iterate) -> None:
        problem, thin, sparse = iterate.problem, self._thin, self._sparse
        # The viewer paints nan like the nearest distance: the blueprint lays the mask over it.
        distance = iterate.distance[thin].astype(np.float32)
        meter = 1000.0 if problem.metric else 1.0
        self._log("depth", rr.DepthImage(distance, meter=meter, colormap="viridis", depth_range=self._range))
        self._log_colours("normals", (iterate.normals[thin] + 1) / 2)
        error = model_image(problem, iterate.log_distance)[thin] - problem.image[thin]
        self._log_colours("residual", _diverging(255 * error / self._grey_levels), how=PLAIN)
        for name, values in iterate.maps.items():
            self._log_colours(f"front/{name}", grey(np.asarray(values)[thin], problem.mask[thin]))
        # Not the iterate's points: to make them all and keep them takes longer.
        cloud = (iterate.distance[sparse][..., None] * problem.field.rays[sparse])[problem.mask[sparse]]
        self._log("world/cloud", rr.Points3D.from_fields(positions=cloud))
        self._log_section("now", iterate.distance, problem, self._colour)

    def _log_section(
        self,
        name: str,
        distance: FloatArray,
        problem: Problem,
        colour: tuple[int, ...],
        static: bool = False,
    ) -> None:
        """Log where the middle column cuts the surface: z to the right, y down."""
        middle = distance.shape[1] // 2
        line = distance[:, middle, None] * problem.field.rays[:, middle][:, [2, 1]]
        seen = np.isfinite(line).all(axis=-1)
        runs = np.ma.clump_unmasked(np.ma.masked_array(seen, ~seen))
        strips = [line[run] for run in runs if run.stop - run.start > 1]
        shape = rr.LineStrips2D(strips, colors=[colour] * len(strips), radii=THIN)
        self._log(f"section/{name}", shape, static=static)


def _colour_picture(problem: Problem) -> FloatArray:
    picture = problem.image if problem.picture is None else problem.picture
    return np.repeat(picture[..., None], 3, axis=-1) if picture.ndim == 2 else picture


def _diverging(values: FloatArray) -> NDArray[np.uint8]:
    """Map -1…1 to shades of blue, white, red, (h, w, 3); nan is black."""
    index = np.rint((np.clip(values, -1, 1) + 1) * ((SHADES - 1) / 2))
    return DIVERGING.take(np.where(np.isnan(index), SHADES, index).astype(np.uint8), axis=0)
