"""Recordings of a run for the Rerun viewer: every iterate on the timeline "iteration".

`record` makes an observer for `run`; what it logs, and under which names, is in `Recorder`.
A file is written when the run has ended, interrupted or not, whole or not at all: Rerun's own
writer can hang for good on a full disk, so the recording is kept in memory until then.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import tempfile
from pathlib import Path

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from endolab.depth.energy import Problem, model_image
from endolab.files import write_atomically
from endolab.iteration import Iterate
from endolab.operators import BoolArray, FloatArray
from endolab.viewer import START, THIN, TIMELINE, blueprint, camera_shape, start_viewer, viewer_address

ALL_UNTIL, GROWTH = 20, 1.05  # pictures of the first iterates, then each time k has grown by 5 %
BLUE_WHITE_RED = np.array(
    [[0, 68, 136], [110, 170, 220], [255, 255, 255], [250, 150, 90], [153, 26, 0]], float
)
COLOURS = {"energy": (230, 159, 0), "data": (86, 180, 233), "regulariser": (213, 94, 0)}
NOW, TRUTH = (230, 159, 0), (160, 160, 160)


def record(
    path: str | os.PathLike[str] | None = None,
    *,
    spawn: bool = False,
    truth: FloatArray | None = None,
    max_width: int = 480,
) -> Recorder:
    """Make an observer that records a run, to a file or in the native viewer.

    Parameters
    ----------
    path : path, optional
        The recording to write, ``.rrd``. An old one is replaced when the run has ended.
    spawn : bool
        Show the run in the native viewer instead; it listens on this machine only.
    truth : (H, W) float array, optional
        True distance, mm, to show beside the result; nan where unknown.
    max_width : int
        Pictures and point clouds wider than this, px, are thinned.

    Returns
    -------
    Recorder
        Give it to ``run`` or call it with each iterate, then `Recorder.close` it.

    Raises
    ------
    OSError
        If the file cannot be written or the viewer does not start.
    """
    return Recorder(path, spawn=spawn, truth=truth, max_width=max_width)


class Recorder:
    """An observer that logs iterates to a recording; see `record`.

    Notes
    -----
    Static: ``input``, ``mask``, ``settings``, ``world/camera``, ``world/truth``,
    ``section/start``, ``section/truth``. Per iterate: ``depth`` (distance), ``normals``
    ((n + 1)/2), ``residual`` (model - image), ``front/<name>`` (the iterate's maps),
    ``world/cloud``, ``section/now``, ``plots/<name>``. Scalars are logged for every iterate,
    pictures for the first 20, the last, and between them each time k has grown by 5 %.
    """

    def __init__(
        self, path: str | os.PathLike[str] | None, *, spawn: bool, truth: FloatArray | None, max_width: int
    ) -> None:
        if (path is None) != spawn:
            raise ValueError("give record() either a path or spawn=True")
        if path is not None and Path(path).suffix != ".rrd":
            raise ValueError(f"a recording's name ends in .rrd, got {path}")
        if max_width < 1:
            raise ValueError(f"max_width must be at least 1 px, got {max_width}")
        self.truth, self.max_width = truth, max_width
        self.stream = rr.RecordingStream("endolab")
        self._viewer: subprocess.Popen[bytes] | None = None
        self._last: Iterate | None = None
        self._shown = -1  # k of the last iterate whose pictures were logged
        self._open = True
        self._path = None if path is None else Path(path)
        if self._path is None:
            self._viewer = start_viewer()
            self.stream.connect_grpc(viewer_address())
            return
        try:  # now, rather than after an hour's run
            if self._path.is_dir():
                raise OSError("it is a folder")
            with tempfile.TemporaryFile(dir=self._path.parent):
                pass
        except OSError as error:
            raise OSError(f"cannot write the recording {self._path}: {error.strerror or error}") from error

    def __call__(self, iterate: Iterate) -> None:
        """Log one iterate."""
        if not self._open:
            raise ValueError("the recording is closed")
        if self._viewer is not None and self._viewer.poll() is not None:
            return  # the user has closed the window; the run goes on
        if self._last is None and self._path is not None:
            # Not before there is something to keep: Rerun complains of a memory that nobody reads.
            self._memory = rr.binary_stream(self.stream)
        self.stream.set_time(TIMELINE, sequence=iterate.k)
        if self._last is None:
            self._begin(iterate)
        self._last = iterate
        self._log_scalars(iterate)
        if iterate.k <= ALL_UNTIL or iterate.k >= GROWTH * self._shown:
            self._log_pictures(iterate)

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
        if self._last is not None and self._last.k != self._shown:
            self.stream.set_time(TIMELINE, sequence=self._last.k)
            self._log_pictures(self._last)
        if self._path is None:
            with contextlib.suppress(RuntimeError):  # a viewer that the user has closed
                self.stream.flush(timeout_sec=60)
        elif self._last is not None:
            write_atomically(self._path, self._memory.read() or b"")
        self.stream.disconnect()

    def _log(self, entity: str, *what: rr.AsComponents, static: bool = False) -> None:
        self.stream.log(entity, *what, static=static, strict=True)

    def _log_colours(self, entity: str, colours: FloatArray, static: bool = False) -> None:
        """Log (h, w) or (h, w, 3) values in [0, 1] as PNG; nan is black."""
        stored = _bytes(np.nan_to_num(colours))
        contents = cv2.imencode(".png", stored[..., ::-1] if stored.ndim == 3 else stored)[1].tobytes()
        self._log(entity, rr.EncodedImage(contents=contents, media_type="image/png"), static=static)

    # What stays -----------------------------------------------------------------------

    def _begin(self, iterate: Iterate) -> None:
        problem, step = iterate.problem, -(-iterate.problem.camera.width // self.max_width)
        self._thin = thin = (slice(None, None, step), slice(None, None, step))
        inside = problem.mask[thin]
        self._range = np.percentile(iterate.distance[problem.mask], [1, 99])
        error = model_image(problem, iterate.log_distance)[problem.mask] - problem.image[problem.mask]
        self._grey_levels = max(5.0, float(np.ceil(255 * np.percentile(np.abs(error), 98))))
        picture = _colour_picture(problem)[thin]
        if self.truth is not None and self.truth.shape != problem.mask.shape:
            raise ValueError(f"truth has shape {self.truth.shape}, the frame {problem.mask.shape}")

        self._log_colours("input", picture, static=True)
        classes = rr.AnnotationContext([(0, "left out", (0, 0, 0, 255)), (1, "used", (0, 0, 0, 0))])
        self._log("mask", classes, rr.SegmentationImage(inside.astype(np.uint8), opacity=1.0), static=True)
        text = rr.TextDocument(self._settings(problem), media_type="text/markdown")
        self._log("settings", text, static=True)
        for name in ("energy", *iterate.terms):
            style = rr.SeriesLines(colors=COLOURS.get(name), names=name, widths=2)
            self._log(f"plots/{name}", style, static=True)

        self._log("world", rr.ViewCoordinates.RDF, static=True)
        size = 0.35 * float(np.median(iterate.distance[problem.mask]))
        self._log("world/camera", camera_shape(problem.camera, size), static=True)
        # The colours of the cloud never change: logged once, they halve the recording.
        cloud = rr.Points3D.from_fields(colors=_bytes(picture[inside]), radii=rr.Radius.ui_points(2.0))
        self._log("world/cloud", cloud, static=True)

        self._log_section("start", iterate.points, START, static=True)
        shown = iterate.points[thin][inside]
        if self.truth is not None and np.isfinite(self.truth[problem.mask]).any():
            unit = 1.0 if problem.metric else np.nanmedian((iterate.distance / self.truth)[problem.mask])
            truth = np.where(problem.mask, unit * self.truth, np.nan)[..., None] * problem.field.rays
            self._log_section("truth", truth, TRUTH, static=True)
            shown = truth[thin][np.isfinite(truth[thin]).all(axis=-1)]
            self._log("world/truth", rr.Points3D(shown, colors=TRUTH, radii=THIN), static=True)
        far = float(np.percentile(shown[:, 2], 99))
        power = 10 ** np.floor(np.log10(far / 3))
        length = max(power * factor for factor in (1, 2, 5) if power * factor <= far / 3)
        label = f"{length:g} {problem.unit}"
        bar = rr.LineStrips2D([[[0, 0], [length, 0]]], colors=TRUTH, radii=THIN, labels=label)
        self._log("section/scale", bar, static=True)
        self.stream.send_blueprint(blueprint(iterate, shown, far))

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

    def _log_scalars(self, iterate: Iterate) -> None:
        scalars = {"energy": iterate.energy, **iterate.terms, "change": iterate.change, **iterate.scalars}
        for name, value in scalars.items():
            if np.isfinite(value):
                self._log(f"plots/{name}", rr.Scalars(value))

    def _log_pictures(self, iterate: Iterate) -> None:
        self._shown = iterate.k
        problem, thin = iterate.problem, self._thin
        inside = problem.mask[thin]
        # The viewer paints nan like the nearest distance: the blueprint lays the mask over it.
        distance = iterate.distance[thin].astype(np.float32)
        meter = 1000.0 if problem.metric else 1.0
        self._log("depth", rr.DepthImage(distance, meter=meter, colormap="viridis", depth_range=self._range))
        self._log_colours("normals", (iterate.normals[thin] + 1) / 2)
        error = model_image(problem, iterate.log_distance)[thin] - problem.image[thin]
        self._log_colours("residual", _diverging(255 * error / self._grey_levels))
        for name, values in iterate.maps.items():
            self._log_colours(f"front/{name}", _grey(np.asarray(values)[thin], inside))
        self._log("world/cloud", rr.Points3D.from_fields(positions=iterate.points[thin][inside]))
        self._log_section("now", iterate.points, NOW)

    def _log_section(
        self, name: str, points: FloatArray, colour: tuple[int, ...], static: bool = False
    ) -> None:
        """Log where the middle column cuts the surface: z to the right, y down."""
        line = points[:, points.shape[1] // 2][:, [2, 1]]
        seen = np.isfinite(line).all(axis=-1)
        runs = np.ma.clump_unmasked(np.ma.masked_array(seen, ~seen))
        strips = [line[run] for run in runs if run.stop - run.start > 1]
        shape = rr.LineStrips2D(strips, colors=[colour] * len(strips), radii=THIN)
        self._log(f"section/{name}", shape, static=static)


def _bytes(colours: FloatArray) -> NDArray[np.uint8]:
    return np.round(255 * np.clip(colours, 0, 1)).astype(np.uint8)


def _colour_picture(problem: Problem) -> FloatArray:
    picture = problem.image if problem.picture is None else problem.picture
    return np.repeat(picture[..., None], 3, axis=-1) if picture.ndim == 2 else picture


def _diverging(values: FloatArray) -> FloatArray:
    """Map -1…1 to blue, white, red, (…, 3) in [0, 1]; nan stays."""
    nodes = np.linspace(-1, 1, len(BLUE_WHITE_RED))
    return np.stack([np.interp(values, nodes, channel) for channel in BLUE_WHITE_RED.T / 255], axis=-1)


def _grey(values: NDArray, inside: BoolArray) -> FloatArray:
    """Stretch a map to [0, 1] within the mask; truth values are 0 and 1 already."""
    values = np.where(inside, values, np.nan)
    seen = values[np.isfinite(values)]
    low, high = min(seen.min(initial=0.0), 0.0), max(seen.max(initial=1.0), 1.0)
    return (values - low) / (high - low)
