"""Where recordings go, how the native Rerun viewer is started, and what things look like in it."""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from endolab.cameras import Camera, Pinhole
from endolab.files import PathLike, write_atomically
from endolab.operators import BoolArray, FloatArray

PORT = 9876  # the viewer's own default
SCREENS = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")  # variables, one of which Linux has then
NO_SCREEN = "the Rerun viewer did not start: it needs a screen; record to a file instead"
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
            from endolab.embed import follow

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


def viewer_address(port: int | None = None) -> str:
    """Where the native viewer listens, or a server at a port."""
    return f"rerun+http://127.0.0.1:{PORT if port is None else port}/proxy"


def start_viewer(path: Path | None = None) -> subprocess.Popen[bytes] | None:
    """Start the native viewer, unless one is there; not by ``rr.spawn``, which listens to the network.

    Parameters
    ----------
    path : Path, optional
        A recording to open; a viewer that is there already is told to.

    Returns
    -------
    Popen or None
        The viewer, if it was started here.

    Raises
    ------
    OSError
        If it does not start.
    """
    there = _listening(PORT)
    if there and path is None:
        return None
    if sys.platform == "linux" and not any(os.environ.get(name) for name in SCREENS):
        raise OSError(NO_SCREEN)
    viewer = _start(PORT, "--expect-data-soon" if path is None else str(path.resolve()))
    started = time.monotonic()
    # With a screen that it cannot use it listens for a moment before it gives up.
    while time.monotonic() < started + 1.5 or (not _listening(PORT) and time.monotonic() < started + 20):
        if viewer.poll() is not None:
            if there and viewer.returncode == 0:  # it has passed the recording on
                return None
            raise OSError(NO_SCREEN)
        time.sleep(0.1)
    return viewer


def start_server() -> str:
    """Start a server between a run and the pages that follow it; it ends with this program.

    A process of its own: Rerun's server within a program listens to the network, and ends with the
    stream, before a slow page has asked for it.

    Returns
    -------
    str
        Its address.

    Raises
    ------
    OSError
        If it does not start.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = _start(port, "--serve-grpc")
    atexit.register(_end, server)
    started = time.monotonic()
    while not _listening(port):
        if server.poll() is not None or time.monotonic() > started + 20:
            _end(server)
            raise OSError("Rerun's server did not start; record to a file instead")
        time.sleep(0.02)
    return viewer_address(port)


def _start(port: int, *arguments: str) -> subprocess.Popen[bytes]:
    """Start Rerun's program; for this machine only."""
    # Run as a module, rerun_cli exits with 0 whatever has happened.
    program = [sys.executable, "-c", "import sys, rerun_cli.__main__ as cli; sys.exit(cli.main())"]
    return subprocess.Popen(
        [*program, "--bind", "127.0.0.1", "--port", str(port), *arguments],
        env={**os.environ, "CI": "1"},  # the one variable by which the viewer sends no usage data
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # an interrupt ends the run and leaves the window
    )


def _end(program: subprocess.Popen[bytes]) -> None:
    """End a program with those that it has started."""
    with contextlib.suppress(OSError):
        if hasattr(os, "killpg"):
            os.killpg(program.pid, signal.SIGTERM)
        else:
            program.terminate()
    program.wait(10)


def _listening(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


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
