"""Where recordings go, and what things look like in them."""

from __future__ import annotations

import contextlib
import os
import subprocess
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from endolab.io.atomic import PathLike, one_sentence, stage_file
from endolab.model.cameras import Camera
from endolab.numerics.arrays import FloatArray
from endolab.workbench.plots.scales import OKABE_ITO
from endolab.workbench.recording.viewer import VIEWER_PORT, end, start_viewer

TRUTH_COLOUR = (160, 160, 160)
THIN = rr.Radius.ui_points(1.5)


class Layout(rrb.Blueprint):
    """How the viewer opens a recording, which remembers the stream that it was sent by.

    Rerun sends a layout by a stream of its own and keeps that for good, with two threads.
    """

    sent_by: rr.RecordingStream | None = None

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        self.sent_by = stream
        super()._log_to_stream(stream)


class _Writer(threading.Thread):
    """Write to a file what Rerun writes to a pipe; what comes after a failure is thrown away.

    Rerun's own writer sometimes never comes to an end when it finds the disk full.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(daemon=True)
        self.failure: OSError | None = None
        self._target = path.open("wb", buffering=0)
        self._source, self.entry = os.pipe()

    def run(self) -> None:
        """Write until the pipe is closed."""
        with open(self._source, "rb", buffering=0) as source, self._target as target:
            while content := source.read(2**20):
                try:
                    while self.failure is None and content:
                        content = content[target.write(content) :]
                except OSError as error:
                    self.failure = error


class Sink:
    """Where a recording goes: a file, ``.rrd``, or a viewer.

    Rerun writes a file under a temporary name, and `close` gives it its own; if nothing was logged, or
    something failed, there is none. Without a path it is the native viewer, started if none listens, to
    take that much `memory`. As a context manager it is closed at the end, and an error leaves no file.
    """

    def __init__(self, path: PathLike | None = None, *, memory: str | None = None) -> None:
        self.path = None if path is None else Path(path)
        if self.path is not None and self.path.suffix != ".rrd":
            raise ValueError(f"a recording's name ends in .rrd, got {path}")
        self.open = True
        self._used = False
        self._viewer: subprocess.Popen[bytes] | None = None
        self._staged: contextlib.AbstractContextManager[Path] | None = None
        self._writer: _Writer | None = None
        if self.path is None:
            self._viewer = start_viewer(memory=memory)
        self.stream = rr.RecordingStream("endolab")
        try:
            self._connect()
        except BaseException:
            self.drop()
            raise

    def _connect(self) -> None:
        if self.path is not None:
            staging = stage_file(self.path)
            temporary = staging.__enter__()
            self._staged = staging
            pipes = Path("/dev/fd")  # names of open files, where the system has such
            if pipes.is_dir():
                with one_sentence(f"cannot write {self.path}"):
                    self._writer = _Writer(temporary)
                self.stream.save(pipes / str(self._writer.entry))
                os.close(self._writer.entry)  # Rerun has opened it anew
                self._writer.start()
            else:
                self.stream.save(temporary)
        else:
            self.stream.connect_grpc(f"rerun+http://127.0.0.1:{VIEWER_PORT}/proxy")

    @property
    def is_viewer_closed(self) -> bool:
        """Whether the user has closed the viewer's window."""
        return self._viewer is not None and self._viewer.poll() is not None

    def at(self, timeline: str, number: int) -> None:
        """Log at this place of a timeline from now on."""
        self.stream.reset_time()
        self.stream.set_time(timeline, sequence=number)

    def log(self, entity: str, *what: rr.AsComponents, static: bool = False) -> None:
        """Log something, now or for all times."""
        if not self.open:
            raise ValueError("the recording is closed")
        self._used = True
        self.stream.log(entity, *what, static=static, strict=True)

    def log_scalar(self, entity: str, value: float) -> None:
        """Log a number, now; nothing if it is not finite."""
        if np.isfinite(value):
            self.log(entity, rr.Scalars(float(value)))

    def arrange(self, layout: Layout) -> None:
        """Tell the viewer how to open the recording."""
        self.stream.send_blueprint(layout)
        if layout.sent_by is not None:
            layout.sent_by.disconnect()

    def close(self) -> None:
        """Finish the file, or see a viewer off; a second call does nothing. OSError leaves no file."""
        if not self.open:
            return
        try:
            if self._staged is not None and self._used:
                self._finish(self._staged)
            elif self._staged is None:
                self._see_off()
        finally:
            self.drop()

    def _finish(self, staging: contextlib.AbstractContextManager[Path]) -> None:
        """Give the file its name, if all of it was written."""
        self._disconnect()
        if self._writer is not None and self._writer.failure is not None:
            with one_sentence(f"cannot write {self.path}"):
                raise self._writer.failure
        self._staged = None
        staging.__exit__(None, None, None)

    def _disconnect(self) -> None:
        """Wait until all is written."""
        self.stream.disconnect()
        if self._writer is not None:
            self._writer.join()

    def _see_off(self) -> None:
        try:
            self.stream.flush(timeout_sec=5.0)  # to take the last of what was logged
        except RuntimeError:
            if self._viewer is not None:  # it hangs, and Rerun would wait for it for good
                end(self._viewer)

    def drop(self) -> None:
        """Let go of what was logged and is no file yet; a second call does nothing."""
        if not self.open:
            return
        self.open = False
        self._disconnect()
        if self._staged is not None:
            failure = RuntimeError("the recording was dropped")
            self._staged.__exit__(RuntimeError, failure, None)
        del self.stream
        # Rerun keeps streams that nobody has any more, with two threads each, until it begins anew, which
        # would end a session that the user has begun with `rr.init`.
        if rr.get_application_id() is None:
            with contextlib.suppress(RuntimeError):  # the viewer of another stream is gone
                rr.init("endolab", init_logging=False)

    def __enter__(self) -> Sink:
        return self

    def __exit__(self, failure: object, *_: object) -> None:
        if failure is not None:
            self.drop()
        self.close()


def camera_shape(camera: Camera, size: float) -> rr.LineStrips3D:
    """What the camera sees, as a cone about `size` long; Rerun's own pinhole knows no distortion."""
    rim = size * _rim(camera)
    spokes = [np.array([[0.0, 0.0, 0.0], end]) for end in rim[:-1:12]]
    return rr.LineStrips3D([rim, *spokes], colors=OKABE_ITO.sky, radii=THIN)


def _rim(camera: Camera) -> FloatArray:
    """Rays of the rim of what a camera sees, (97, 3): in all directions the last one in the picture."""
    around = np.linspace(0, 2 * np.pi, 97)[:, None]
    angle = np.linspace(0, camera.max_angle * (1 - 1e-6), 400)
    sine = np.sin(angle)
    cosine = np.broadcast_to(np.cos(angle), (97, 400))
    rays = np.stack([np.cos(around) * sine, np.sin(around) * sine, cosine], axis=-1)
    pixels = camera.project(rays)
    inside = ((pixels >= -0.5) & (pixels <= [camera.width - 0.5, camera.height - 0.5])).all(
        axis=-1
    )
    return rays[np.arange(97), np.maximum(inside.sum(axis=1) - 1, 0)]


def every(width: int, most: int) -> tuple[slice, slice]:
    """Rows and columns of a map that is that wide, thinned by a whole number to `most` columns."""
    return (slice(None, None, max(1, -(-width // most))),) * 2


def depth_map(
    distance: FloatArray,
    metric: bool,
    limits: tuple[float, float] | None = None,
    colormap: Literal["viridis", "magma"] = "viridis",
) -> rr.DepthImage:
    """Distance, (h, w), mm if `metric`; the viewer paints nan like the nearest distance."""
    return rr.DepthImage(
        distance.astype(np.float32),
        meter=1000.0 if metric else 1.0,
        colormap=colormap,
        depth_range=limits,
        magnification_filter="nearest",  # else it mixes a pixel with one that has no distance
    )


def jpeg(colours: NDArray[np.uint8], quality: int = 95) -> rr.EncodedImage:
    """Encode bytes, (h, w) or (h, w, 3), with losses; all that one entity gets must be of one size."""
    stored = cv2.cvtColor(colours, cv2.COLOR_RGB2BGR) if colours.ndim == 3 else colours
    contents = cv2.imencode(".jpeg", stored, (cv2.IMWRITE_JPEG_QUALITY, quality))[
        1
    ].tobytes()
    return rr.EncodedImage(contents=contents, media_type="image/jpeg")


def as_bytes(colours: FloatArray) -> NDArray[np.uint8]:
    """Turn [0, 1] into bytes; nan becomes 0. OpenCV's way takes a tenth of NumPy's time."""
    return np.asarray(
        cv2.convertScaleAbs(np.ascontiguousarray(np.maximum(colours, 0)), alpha=255)
    )


def classes(
    values: NDArray, names: Mapping[str, tuple[int, ...]]
) -> tuple[rr.AsComponents, ...]:
    """A map of numbers, (h, w), that stand for these names, from 0, each with its colour."""
    named = [(number, name, colour) for number, (name, colour) in enumerate(names.items())]
    picture = rr.SegmentationImage(np.ascontiguousarray(values, np.uint8), opacity=1.0)
    return rr.AnnotationContext(named), picture
