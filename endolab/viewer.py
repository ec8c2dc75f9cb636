"""Where recordings go, how the native Rerun viewer is started, and what a camera looks like in it."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import rerun as rr

from endolab.cameras import Camera, Pinhole
from endolab.files import PathLike, write_atomically

PORT = 9876  # the viewer's own default
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
        self.stream = rr.RecordingStream("endolab")
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


def viewer_address() -> str:
    """Where the native viewer listens."""
    return f"rerun+http://127.0.0.1:{PORT}/proxy"


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
    there = _listening()
    if there and path is None:
        return None
    command = [sys.executable, "-m", "rerun_cli", "--bind", "127.0.0.1", "--port", str(PORT)]
    viewer = subprocess.Popen(
        [*command, "--expect-data-soon"] if path is None else [*command, str(path.resolve())],
        env={**os.environ, "CI": "1"},  # the one variable by which the viewer sends no usage data
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # an interrupt ends the run and leaves the window
    )
    started = time.monotonic()
    # Without a screen it listens for a moment before it gives up.
    while time.monotonic() < started + 1.5 or (not _listening() and time.monotonic() < started + 20):
        if viewer.poll() is not None:
            if there and viewer.returncode == 0:  # it has passed the recording on
                return None
            raise OSError("the Rerun viewer did not start: it needs a screen; record to a file instead")
        time.sleep(0.1)
    return viewer


def _listening() -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", PORT)) == 0


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
    length, seen, share = edge, np.zeros_like(edge), np.linspace(0, 1, 25)[:, None]
    for _ in range(2):  # ever more finely
        tried = np.minimum(seen + share * length, edge)
        good = np.isfinite(camera.unproject(centre + tried[..., None] * outwards)).all(axis=-1)
        seen, length = np.where(good, tried, 0).max(axis=0), length / 24
    rim = size * camera.unproject(centre + seen[:, None] * outwards)
    spokes = [np.array([[0.0, 0.0, 0.0], end]) for end in rim[:-1:12]]
    return rr.LineStrips3D([rim, *spokes], colors=START, radii=THIN)
