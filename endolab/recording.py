"""Recordings of a run for the Rerun viewer: every iterate on the timeline "iteration".

`record` makes an observer for `run`; what it logs, and under which names, is in `Recorder`.
A recording grows beside its final name and takes it when the run has ended, so a file of
that name is a whole one; a run that was killed leaves ``<name>.partial.rrd``, which opens too.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from endolab.cameras import Camera, Pinhole
from endolab.depth.energy import Problem, model_image
from endolab.iterate import Iterate
from endolab.operators import BoolArray, FloatArray

TIMELINE = "iteration"
PORT = 9876  # the viewer's own default
ALL_UNTIL, GROWTH = 20, 1.05  # pictures of the first iterates, then each time k has grown by 5 %
BLUE_WHITE_RED = np.array(
    [[0, 68, 136], [110, 170, 220], [255, 255, 255], [250, 150, 90], [153, 26, 0]], float
)
COLOURS = {"energy": (230, 159, 0), "data": (86, 180, 233), "regulariser": (213, 94, 0)}
NOW, START, TRUTH = (230, 159, 0), (86, 180, 233), (160, 160, 160)
THIN = rr.Radius.ui_points(1.5)


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
            self._viewer = _start_viewer()
            self.stream.connect_grpc(f"rerun+http://127.0.0.1:{PORT}/proxy")
            return
        # The suffix stays last: the viewer goes by it.
        self._partial = self._path.with_name(f"{self._path.stem}.partial.rrd")
        try:
            if self._path.is_dir():
                raise IsADirectoryError(f"{self._path} is a folder")
            self._file = _File(self._partial)
            self.stream.save(self._file.entrance)
            self._file.start()
        except (OSError, RuntimeError) as error:
            raise OSError(f"cannot write the recording {self._path}: {error}") from error

    def __call__(self, iterate: Iterate) -> None:
        """Log one iterate."""
        if not self._open:
            raise ValueError("the recording is closed")
        if self._viewer is not None and self._viewer.poll() is not None:
            return  # the user has closed the window; the run goes on
        self.stream.set_time(TIMELINE, sequence=iterate.k)
        if self._last is None:
            self._begin(iterate)
        self._last = iterate
        self._log_scalars(iterate)
        if iterate.k <= ALL_UNTIL or iterate.k >= GROWTH * self._shown:
            self._log_pictures(iterate)
        self._flush()

    def close(self) -> None:
        """End the recording and give the file its name; a second call does nothing.

        Raises
        ------
        OSError
            If the recording could not be written to its end.
        """
        if not self._open:
            return
        try:
            if self._last is not None and self._last.k != self._shown:
                self.stream.set_time(TIMELINE, sequence=self._last.k)
                self._log_pictures(self._last)
            self._flush()
        finally:
            self._open = False
            self.stream.disconnect()
            if self._path is not None:
                self._file.close()
        if self._path is None:
            return
        self._check()
        if self._last is None:
            self._partial.unlink(missing_ok=True)  # nothing happened: nothing to keep
            return
        try:
            self._partial.replace(self._path)
        except OSError as error:
            raise self._failure(error) from error

    def _failure(self, error: OSError) -> OSError:
        reason = error.strerror or error
        return OSError(
            f"cannot write the recording {self._path}: {reason}; its beginning is in {self._partial}"
        )

    def _check(self) -> None:
        if self._file.error is not None:
            raise self._failure(self._file.error) from self._file.error

    def _flush(self) -> None:
        with contextlib.suppress(RuntimeError):  # a viewer that the user has closed
            self.stream.flush(timeout_sec=60)
        if self._path is not None:
            self._file.drain()
            self._check()

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

        self._log_colours("input", picture, static=True)
        classes = rr.AnnotationContext([(0, "left out", (0, 0, 0, 255)), (1, "used", (0, 0, 0, 0))])
        self._log("mask", classes, rr.SegmentationImage(inside.astype(np.uint8), opacity=1.0), static=True)
        self._log(
            "settings", rr.TextDocument(self._settings(problem), media_type="text/markdown"), static=True
        )
        for name in ("energy", *iterate.terms):
            style = rr.SeriesLines(colors=COLOURS.get(name), names=name, widths=2)
            self._log(f"plots/{name}", style, static=True)

        self._log("world", rr.ViewCoordinates.RDF, static=True)
        size = 0.35 * float(np.median(iterate.distance[problem.mask]))
        self._log("world/camera", _camera_shape(problem.camera, size), static=True)
        # The colours of the cloud never change: logged once, they halve the recording.
        cloud = rr.Points3D.from_fields(colors=_bytes(picture[inside]), radii=rr.Radius.ui_points(2.0))
        self._log("world/cloud", cloud, static=True)

        self._log_section("start", iterate.points, START, static=True)
        shown = iterate.points[thin][inside]
        if self.truth is not None:
            unit = 1.0 if problem.metric else np.nanmedian((iterate.distance / self.truth)[problem.mask])
            truth = np.where(problem.mask, unit * self.truth, np.nan)[..., None] * problem.field.rays
            self._log_section("truth", truth, TRUTH, static=True)
            shown = truth[thin][np.isfinite(truth[thin]).all(axis=-1)]
            self._log("world/truth", rr.Points3D(shown, colors=TRUTH, radii=THIN), static=True)
        far = float(np.percentile(shown[:, 2], 99))
        power = 10 ** np.floor(np.log10(far / 3))
        length = max(power * factor for factor in (1, 2, 5) if power * factor <= far / 3)
        text = f"{length:g} {problem.unit}"
        bar = rr.LineStrips2D([[[0, 0], [length, 0]]], colors=TRUTH, radii=THIN, labels=text)
        self._log("section/scale", bar, static=True)
        self.stream.send_blueprint(_blueprint(iterate, shown, far))

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


class _File:
    """A file that Rerun writes through a pipe: its own writer can hang for good on a full disk."""

    def __init__(self, path: Path) -> None:
        self.error: OSError | None = None
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | getattr(os, "O_BINARY", 0), 0o666)
        self._exit, self._own_entrance = os.pipe()
        self.entrance = f"/dev/fd/{self._own_entrance}"
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._copy, daemon=True)

    def start(self) -> None:
        """Start to copy, once Rerun has opened its entrance."""
        os.close(self._own_entrance)
        self._thread.start()

    def _copy(self) -> None:
        """Copy to the end; after an error drain what comes, so that Rerun never waits."""
        while True:
            select.select([self._exit], [], [])
            with self._lock:
                block = memoryview(os.read(self._exit, 1 << 20))
                if not block:
                    break
                try:
                    while block and self.error is None:
                        block = block[os.write(self._file, block) :]
                except OSError as error:
                    self.error = error
        os.close(self._exit)
        os.close(self._file)

    def drain(self) -> None:
        """Wait until all that Rerun has flushed is in the file."""
        while self._thread.is_alive():
            with self._lock:
                if not select.select([self._exit], [], [], 0)[0]:
                    return
            time.sleep(1e-4)

    def close(self) -> None:
        """Wait for the end, once Rerun has closed its entrance."""
        self._thread.join()


def _start_viewer() -> subprocess.Popen[bytes] | None:
    """Start the native viewer, unless one is there; not by ``rr.spawn``, which listens to the network."""
    if _listening():
        return None
    command = [sys.executable, "-m", "rerun_cli", "--bind", "127.0.0.1", "--port", str(PORT)]
    viewer = subprocess.Popen(
        [*command, "--expect-data-soon"],
        env={**os.environ, "CI": "1"},  # the one variable by which the viewer sends no usage data
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # an interrupt ends the run and leaves the window
    )
    started = time.monotonic()
    # Without a screen it listens for a moment before it gives up.
    while time.monotonic() < started + 1.5 or (not _listening() and time.monotonic() < started + 20):
        if viewer.poll() is not None:
            raise OSError("the Rerun viewer did not start: it needs a screen; record to a file instead")
        time.sleep(0.1)
    return viewer


def _listening() -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", PORT)) == 0


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


def _camera_shape(camera: Camera, size: float) -> rr.Pinhole | rr.LineStrips3D:
    """The camera in space, about `size` long."""
    if isinstance(camera, Pinhole):
        matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
        return rr.Pinhole(
            image_from_camera=matrix, resolution=[camera.width, camera.height], image_plane_distance=size
        )
    # Rerun's Pinhole knows no distortion, and near 90° off the axis no pinhole comes close: draw
    # the rim of what the camera really sees. Outwards from the axis a model ends once and for all.
    centre = camera.project([0.0, 0.0, 1.0])
    angle = np.linspace(0, 2 * np.pi, 97)
    radius = np.linspace(0, np.hypot(camera.width, camera.height), 400)
    pixels = centre + radius[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    rays = camera.unproject(pixels)
    end = np.array([camera.width, camera.height]) - 0.5
    seen = np.isfinite(rays).all(axis=-1) & ((pixels >= -0.5) & (pixels <= end)).all(axis=-1)
    last = np.maximum(seen.sum(axis=0) - 1, 0)
    rim = size * rays[last, np.arange(angle.size)]
    spokes = [np.array([[0.0, 0.0, 0.0], end]) for end in rim[:-1:12]]
    return rr.LineStrips3D([rim, *spokes], colors=START, radii=THIN)


def _blueprint(iterate: Iterate, points: FloatArray, far: float) -> rrb.Blueprint:
    """How the viewer opens: pictures above, the surface and the curves below."""
    low, high = np.percentile(points, [1, 99], axis=0)
    target = (low + high) / 2
    # From behind the camera, to its left and above it.
    eye = target + 0.9 * np.linalg.norm(high - low) * np.array([-0.5, -0.35, -0.8])
    bounds = rrb.VisualBounds2D(x_range=[-0.1 * far, 1.1 * far], y_range=[1.2 * low[1], 1.2 * high[1]])
    terms = [f"/plots/{name}" for name in ("energy", *iterate.terms)]
    residual: list[rrb.View] = [rrb.Spatial2DView(origin="/residual", name="Residual")]
    residual += [rrb.Spatial2DView(origin=f"/front/{name}", name=name.capitalize()) for name in iterate.maps]
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                rrb.Spatial2DView(origin="/", contents=["/input"], name="Frame"),
                rrb.Spatial2DView(
                    origin="/", contents=["/depth", "/mask"], name=f"Distance [{iterate.problem.unit}]"
                ),
                rrb.Spatial2DView(origin="/normals", name="Normals"),
                rrb.Tabs(*residual, active_tab=len(residual) - 1),
            ),
            rrb.Horizontal(
                rrb.Spatial3DView(
                    origin="/world",
                    name="Surface",
                    eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=[0, -1, 0]),
                    overrides={"/world/truth": rrb.EntityBehavior(visible=False)},
                    background=(45, 50, 58),
                    line_grid=False,
                ),
                rrb.Vertical(
                    rrb.TimeSeriesView(origin="/plots", contents=terms, name="Energy"),
                    rrb.Spatial2DView(origin="/section", name="Middle column", visual_bounds=bounds),
                ),
                rrb.Tabs(
                    rrb.TextDocumentView(origin="/settings", name="Settings"),
                    rrb.TimeSeriesView(
                        origin="/plots",
                        contents=["/plots/**", *(f"- {term}" for term in terms)],
                        name="Steps",
                    ),
                ),
                column_shares=[2, 1.4, 1],
            ),
            row_shares=[1, 1.4],
        ),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )
