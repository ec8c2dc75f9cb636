"""Where recordings go, and what things look like in them."""

from __future__ import annotations

import contextlib
import subprocess
import tempfile
from pathlib import Path

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from endolab.io.atomic import PathLike, write_atomically
from endolab.model.cameras import Camera, Pinhole
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.recording.viewer import start_viewer, viewer_address

START = (86, 180, 233)
THIN = rr.Radius.ui_points(1.5)


class Sink:
    """Where a recording goes: a file, which is kept in memory until it is whole, or a viewer.

    Parameters
    ----------
    path : path, optional
        The file, ``.rrd``.
    live : bool
        Without a path: the viewer in the notebook rather than the native one.
    """

    def __init__(self, path: PathLike | None, live: bool = False) -> None:
        self.path = None if path is None else Path(path)
        if self.path is not None and self.path.suffix != ".rrd":
            raise ValueError(f"a recording's name ends in .rrd, got {path}")
        # Hurried: what is encoded during the run does not wait for its end.
        hurry = rr.ChunkBatcherConfig.LOW_LATENCY()
        self.stream = rr.RecordingStream("endolab", batcher_config=hurry)
        self.open = True
        self._memory: rr.BinaryStream | None = None
        self._viewer: subprocess.Popen[bytes] | None = None
        if self.path is not None:
            try:  # now, rather than after an hour's run
                if self.path.is_dir():
                    raise OSError("it is a folder")
                with tempfile.TemporaryFile(dir=self.path.parent):
                    pass
            except OSError as error:
                raise OSError(f"cannot write the recording {self.path}: {error.strerror or error}") from error
        elif live:
            from endolab.recording.viewer import follow

            follow(self.stream)
        else:
            self._viewer = start_viewer()
            self.stream.connect_grpc(viewer_address())

    @property
    def gone(self) -> bool:
        """Whether the user has closed the viewer's window."""
        return self._viewer is not None and self._viewer.poll() is not None

    def begin(self) -> None:
        """Start keeping what is logged."""
        # Not before there is something to keep: Rerun complains of a memory that nobody reads.
        if self.path is not None and self._memory is None:
            self._memory = rr.binary_stream(self.stream)

    def close(self) -> None:
        """Write the file, if something was logged; a second call does nothing."""
        if not self.open:
            return
        self.open = False
        if self.path is None:
            with contextlib.suppress(RuntimeError):  # a viewer that the user has closed
                self.stream.flush(timeout_sec=60)
        elif self._memory is not None:
            write_atomically(self.path, self._memory.read() or b"")
        self.stream.disconnect()


def camera_shape(camera: Camera, size: float) -> rr.Pinhole | rr.LineStrips3D:
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
    outwards = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    end = np.array([camera.width, camera.height]) - 0.5
    room = np.where(outwards > 0, end - centre, centre + 0.5)  # to the picture's edges
    edge = np.min(room / np.maximum(np.abs(outwards), 1e-9), axis=-1)
    seen, share = edge.copy(), np.linspace(0, 1, 25)[:, None]
    blind = ~np.isfinite(camera.unproject(centre + edge[:, None] * outwards)).all(axis=-1)
    length, seen[blind] = edge[blind], 0.0
    for _ in range(2 * bool(blind.any())):  # ever more finely
        tried = np.minimum(seen[blind] + share * length, edge[blind])
        good = np.isfinite(camera.unproject(centre + tried[..., None] * outwards[blind])).all(axis=-1)
        seen[blind], length = np.where(good, tried, 0).max(axis=0), length / 24
    rim = size * camera.unproject(centre + seen[:, None] * outwards)
    spokes = [np.array([[0.0, 0.0, 0.0], end]) for end in rim[:-1:12]]
    return rr.LineStrips3D([rim, *spokes], colors=START, radii=THIN)


def as_bytes(colours: FloatArray) -> NDArray[np.uint8]:
    """Turn [0, 1] into bytes; nan becomes 0. OpenCV's way takes a tenth of NumPy's time."""
    return np.asarray(cv2.convertScaleAbs(np.ascontiguousarray(np.maximum(colours, 0)), alpha=255))


def grey(values: NDArray, inside: BoolArray) -> FloatArray:
    """Stretch a map to [0, 1] within the mask; truth values are 0 and 1 already."""
    values = np.where(inside, values, np.nan)
    seen = values[np.isfinite(values)]
    low, high = min(seen.min(initial=0.0), 0.0), max(seen.max(initial=1.0), 1.0)
    return (values - low) / (high - low)
