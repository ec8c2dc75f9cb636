"""Where recordings go, and what things look like in them."""

from __future__ import annotations

import contextlib
import os
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
    something failed, there is none. Without a path it is the native viewer, started if none listens. As a
    context manager it is closed at the end, and an error leaves no file.
    """

    def __init__(self, path: PathLike | None = None) -> None:
        self.path = None if path is None else Path(path)
        if self.path is not None and self.path.suffix != ".rrd":
            raise ValueError(f"a recording's name ends in .rrd, got {path}")
        self._used = False
        self._viewer = start_viewer() if self.path is None else None
        self._staged = contextlib.ExitStack()
        self._writer: _Writer | None = None
        self._stream: rr.RecordingStream | None = rr.RecordingStream("endolab")
        try:
            self._connect(self.stream)
        except BaseException:
            self.drop()
            raise

    @property
    def stream(self) -> rr.RecordingStream:
        """Rerun's own; ValueError when it is closed."""
        if self._stream is None:
            raise ValueError("the recording is closed")
        return self._stream

    @property
    def open(self) -> bool:
        """Whether it still takes what is logged."""
        return self._stream is not None

    def _connect(self, stream: rr.RecordingStream) -> None:
        if self.path is None:
            stream.connect_grpc(f"rerun+http://127.0.0.1:{VIEWER_PORT}/proxy")
            return
        temporary = self._staged.enter_context(stage_file(self.path))
        pipes = Path("/dev/fd")  # names of open files, where the system has such
        if not pipes.is_dir():
            stream.save(temporary)
            return
        self._writer = _Writer(temporary)
        stream.save(pipes / str(self._writer.entry))
        os.close(self._writer.entry)  # Rerun has opened it anew
        self._writer.start()

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
        self.stream.log(entity, *what, static=static, strict=True)
        self._used = True

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
            if self.path is None:
                self._see_off()
            elif self._used:
                self._disconnect()
                if self._writer is not None and self._writer.failure is not None:
                    with one_sentence(f"cannot write {self.path}"):
                        raise self._writer.failure
                self._staged.close()
        finally:
            self.drop()

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
        self._disconnect()
        self._stream = None
        with contextlib.suppress(RuntimeError), self._staged:
            raise RuntimeError("the recording was dropped")
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
    # Pixels along the outline of what is seen, once around.
    seen = camera.field.valid.astype(np.uint8)
    outlines, _ = cv2.findContours(seen, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = max(outlines, key=len)[:, 0]
    ends = outline[np.linspace(0, len(outline), 97).astype(int) % len(outline)]
    rim = size * camera.field.rays[ends[:, 1], ends[:, 0]]
    spokes = [np.stack([np.zeros(3), end]) for end in rim[:-1:12]]
    return rr.LineStrips3D([rim, *spokes], colors=OKABE_ITO.sky, radii=THIN)


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


def jpeg(colours: FloatArray) -> rr.EncodedImage:
    """Encode [0, 1], (h, w) or (h, w, 3), with losses; all that one entity gets must be of one size."""
    stored = as_bytes(colours)
    stored = stored[..., ::-1] if stored.ndim == 3 else stored
    _, contents = cv2.imencode(".jpeg", stored, (cv2.IMWRITE_JPEG_QUALITY, 85))
    return rr.EncodedImage(contents=contents.tobytes(), media_type="image/jpeg")


def as_bytes(colours: FloatArray) -> NDArray[np.uint8]:
    """Turn [0, 1] into bytes; nan becomes 0. OpenCV's way takes a tenth of NumPy's time."""
    return np.asarray(cv2.convertScaleAbs(np.maximum(colours, 0), alpha=255))


def classes(
    values: NDArray, names: Mapping[str, tuple[int, ...]]
) -> tuple[rr.AsComponents, ...]:
    """A map of numbers, (h, w), that stand for these names, from 0, each with its colour."""
    named = [(number, *entry) for number, entry in enumerate(names.items())]
    picture = rr.SegmentationImage(np.ascontiguousarray(values, np.uint8), opacity=1.0)
    return rr.AnnotationContext(named), picture


def markdown(text: str) -> rr.TextDocument:
    """A text to be set."""
    return rr.TextDocument(text, media_type="text/markdown")
