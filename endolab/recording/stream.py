"""Where recordings go, and what things look like in them."""

from __future__ import annotations

import contextlib
import struct
import subprocess
import tempfile
import threading
import time
import zlib
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from endolab.io.atomic import PathLike, write_atomically
from endolab.model.cameras import Camera, Pinhole
from endolab.numerics.arrays import BoolArray, FloatArray, frozen
from endolab.recording.decoder import CHECKSUM, UNKNOWN, stamped
from endolab.recording.layouts import Layout
from endolab.recording.viewer import follow, start_viewer, viewer_address

NOW, START, TRUTH, OUTLIER = (230, 159, 0), (86, 180, 233), (160, 160, 160), (213, 94, 0)
THIN = rr.Radius.ui_points(1.5)
LOOK = 0.002  # s


class Sink:
    """Where a recording goes: a file, ``.rrd``, or the viewer, native or (`live`) in the notebook.

    A file is kept in memory until it is whole: Rerun's own writer can hang for good on a full disk.
    A native viewer is started if none listens, to take that much `memory`; one at an `address` is there.
    As a context manager it is closed at the end, and an error leaves no file.
    """

    def __init__(
        self,
        path: PathLike | None,
        live: bool = False,
        *,
        address: str | None = None,
        memory: str | None = None,
    ) -> None:
        self.path = None if path is None else Path(path)
        if self.path is not None and self.path.suffix != ".rrd":
            raise ValueError(f"a recording's name ends in .rrd, got {path}")
        self.open = True
        self._alone = threading.Lock()  # of who begins or ends a memory
        self._stream: rr.RecordingStream | None = None
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
            follow(self.stream)
        elif address is not None:
            self.stream.connect_grpc(address)
        else:
            self._viewer = start_viewer(memory=memory)
            self.stream.connect_grpc(viewer_address())

    @property
    def stream(self) -> rr.RecordingStream:
        """Rerun's end of it, from the first use until it is closed."""
        if not self.open:
            raise ValueError("the recording is closed")
        if self._stream is None:
            # Hurried: what is encoded during the run does not wait for its end.
            hurry = rr.ChunkBatcherConfig.LOW_LATENCY()
            self._stream = rr.RecordingStream("endolab", batcher_config=hurry)
        return self._stream

    @property
    def gone(self) -> bool:
        """Whether the user has closed the viewer's window."""
        return self._viewer is not None and self._viewer.poll() is not None

    @property
    def sent(self) -> bool:
        """Whether a viewer has got all that was logged; RuntimeError if it is not there any more."""
        try:
            # Hardly waiting: Rerun lets no other thread run meanwhile.
            self.stream.flush(timeout_sec=LOOK)
        except RuntimeError as error:
            if "timed out" in str(error):
                return False
            raise
        return True

    def begin(self) -> None:
        """Start keeping what is logged."""
        # Not before there is something to keep: Rerun complains of a memory that nobody reads.
        if self.path is not None and self._memory is None:
            # In a thread, which Ctrl-C does not reach: Rerun complains of one that is lost half-way, too.
            remembering = threading.Thread(target=self._remember, daemon=True)
            remembering.start()
            remembering.join()
            self.log(CHECKSUM, rr.TextDocument(UNKNOWN.decode()), static=True)

    def _remember(self) -> None:
        with self._alone:
            if self.open:  # else Ctrl-C came before this thread got here
                self._memory = rr.binary_stream(self.stream)

    def at(self, timeline: str, number: int, also: Mapping[str, int] | None = None) -> None:
        """Log at this place of a timeline, and `also` of others, from now on; counts for this thread only."""
        self.stream.reset_time()
        for name, place in {timeline: number, **(also or {})}.items():
            self.stream.set_time(name, sequence=place)

    def log(self, entity: str, *what: rr.AsComponents, static: bool = False) -> None:
        """Log something, now or for all times."""
        self.stream.log(entity, *what, static=static, strict=True)

    def log_scalars(self, scalars: Mapping[str, float]) -> None:
        """Log numbers by their entities, now; not those that are not finite."""
        for entity, value in scalars.items():
            if np.isfinite(value):
                self.log(entity, rr.Scalars(float(value)))

    def log_rows(
        self,
        entity: str,
        timeline: str,
        at: Sequence[int],
        *columns: Iterable[rr.ComponentColumn],
        also: Mapping[str, Sequence[int]] | None = None,
    ) -> None:
        """Log one thing at each of several places of a timeline: all at once costs little more than one.

        `also` are the places on other timelines.
        """
        every_column = [column for one in columns for column in one]
        lines = {timeline: at, **(also or {})}
        times = [rr.TimeColumn(name, sequence=places) for name, places in lines.items()]
        self.stream.send_columns(entity, times, every_column, strict=True)

    def log_curve(
        self,
        entity: str,
        timeline: str,
        at: Sequence[int],
        values: Sequence[float] | FloatArray,
        also: Mapping[str, Sequence[int]] | None = None,
    ) -> None:
        """Log numbers at many places of a timeline; `also` as of `log_rows`."""
        self.log_rows(entity, timeline, at, rr.Scalars.columns(scalars=values), also=also)

    def arrange(self, layout: Layout) -> None:
        """Tell the viewer how to open the recording."""
        self.stream.send_blueprint(layout)
        layout.let_go()

    def close(self) -> None:
        """Write the file, if something was logged; a second call does nothing."""
        if not self.open:
            return
        try:
            if self._memory is not None and self.path is not None:
                write_atomically(self.path, stamped(self._memory.read() or b""))
            elif self._stream is not None:
                with contextlib.suppress(RuntimeError):  # a viewer that the user has closed
                    self._stream.flush(timeout_sec=60)
        finally:
            self.drop()

    def leave(self, patience: float) -> None:
        """Let go of a viewer, which gets so many seconds to take what it has not got yet."""
        until = time.monotonic() + patience
        with contextlib.suppress(RuntimeError):  # it is gone
            while not self.sent and time.monotonic() < until:
                time.sleep(LOOK)
            if self._viewer is not None and not self.sent:
                self._viewer.kill()  # it hangs, and Rerun would wait for it for good
        self.drop()

    def drop(self) -> None:
        """Let go of what was logged and is not written yet; a second call does nothing."""
        with self._alone:
            memory, stream = self._memory, self._stream
            self.open, self._memory, self._stream = False, None, None
        if memory is not None:
            memory.read()
        if stream is not None:
            stream.disconnect()
            # Rerun keeps streams that nobody has any more, with two threads each, until it begins anew.
            del memory, stream
            with contextlib.suppress(RuntimeError):  # another one's viewer is gone
                rr.init("endolab", init_logging=False)

    def __enter__(self) -> Sink:
        return self

    def __exit__(self, failure: object, *_: object) -> None:
        if failure is not None:
            self.drop()
        self.close()


def camera_shape(camera: Camera, size: float) -> rr.Pinhole | rr.LineStrips3D:
    """The camera in space, about `size` long."""
    if isinstance(camera, Pinhole):
        matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
        return rr.Pinhole(
            image_from_camera=matrix,
            resolution=[camera.width, camera.height],
            image_plane_distance=size,
            color=START,
        )
    rim = size * _rim(camera)
    spokes = [np.array([[0.0, 0.0, 0.0], end]) for end in rim[:-1:12]]
    return rr.LineStrips3D([rim, *spokes], colors=START, radii=THIN)


@lru_cache(8)
def _rim(camera: Camera) -> FloatArray:
    """Rays of the rim of what a camera really sees, (97, 3)."""
    # Rerun's Pinhole knows no distortion, and near 90° off the axis no pinhole comes close.
    # Outwards from the axis a model ends once and for all.
    centre, end = camera.project([0.0, 0.0, 1.0]), np.array([camera.width, camera.height]) - 0.5
    angle = np.linspace(0, 2 * np.pi, 97)
    outwards = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    room = np.where(outwards > 0, end - centre, centre + 0.5)  # to the picture's edges
    edge = outwards * np.min(room / np.maximum(np.abs(outwards), 1e-9), axis=-1)[:, None]
    # The rays at the model's largest angle make an ellipse in the picture, beyond which there is none.
    most = camera.max_angle * (1 - 1e-6)  # single precision must not lead out again
    axes = camera.project([[np.sin(most), 0, np.cos(most)], [0, np.sin(most), np.cos(most)]]) - centre
    side = edge @ np.linalg.inv(axes)
    reach = np.linalg.norm(side, axis=-1, keepdims=True)
    last = np.concatenate([np.sin(most) * side / reach, np.full(reach.shape, np.cos(most))], axis=-1)
    return frozen(np.where(reach < 1, camera.unproject(centre + np.where(reach < 1, edge, 0.0)), last))


def every(width: int, most: int) -> tuple[slice, slice]:
    """Rows and columns of a map that is that wide, thinned by a whole number to `most` columns."""
    return (slice(None, None, max(1, -(-width // most))),) * 2


def depth_map(distance: FloatArray, metric: bool, limits: tuple[float, float]) -> rr.DepthImage:
    """Distance, (h, w), mm if `metric`; the viewer paints nan like the nearest distance."""
    values, meter = distance.astype(np.float32), 1000.0 if metric else 1.0
    # Between a pixel and one without a distance the viewer would mix a colour of neither.
    return rr.DepthImage(
        values, meter=meter, colormap="viridis", depth_range=limits, magnification_filter="nearest"
    )


def depth_columns(maps: Sequence[NDArray[np.float32]], metric: bool) -> Iterable[rr.ComponentColumn]:
    """Distances, (h, w) each, one below the other; see `depth_map` and `depth_limits`."""
    (height, width), count = maps[0].shape, len(maps)
    form = rr.components.ImageFormat(width=width, height=height, channel_datatype=rr.ChannelDatatype.F32)
    return rr.DepthImage.columns(
        buffer=[one.tobytes() for one in maps],
        format=[form] * count,
        meter=[1000.0 if metric else 1.0] * count,
        colormap=["viridis"] * count,
        magnification_filter=["nearest"] * count,
    )


def depth_limits(limits: tuple[float, float]) -> rr.DepthImage:
    """What the colours of `depth_columns` reach; what is logged of it stays until other limits come."""
    return rr.DepthImage.from_fields(depth_range=limits)


def png_columns(contents: Sequence[bytes]) -> Iterable[rr.ComponentColumn]:
    """Encoded pictures, one below the other."""
    return rr.EncodedImage.columns(blob=contents, media_type=["image/png"] * len(contents))


def png(colours: NDArray, how: tuple[int, ...] = ()) -> rr.EncodedImage:
    """Encode (h, w) or (h, w, 3) bytes, or values in [0, 1]; nan is black."""
    return rr.EncodedImage(contents=png_bytes(colours, how), media_type="image/png")


def png_bytes(colours: NDArray, how: tuple[int, ...] = ()) -> bytes:
    """Encode as `png` does."""
    return _encoded(colours, "png", how)


def palette_png(places: NDArray[np.uint8], colours: NDArray[np.uint8]) -> bytes:
    """Encode the places (h, w) of pixels in a table of colours (n, 3), R, G, B.

    A third of what has to be compressed otherwise, and half of the file; OpenCV writes no palettes.
    """
    height, width = places.shape
    rows = np.zeros((height, width + 1), np.uint8)  # each begins with its filter: none
    rows[:, 1:] = places
    squeezed = zlib.compressobj(1, zlib.DEFLATED, 15, 9, zlib.Z_RLE)
    parts = {
        b"IHDR": struct.pack(">2I5B", width, height, 8, 3, 0, 0, 0),
        b"PLTE": colours.tobytes(),
        b"IDAT": squeezed.compress(rows.tobytes()) + squeezed.flush(),
        b"IEND": b"",
    }
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(part)) + kind + part + struct.pack(">I", zlib.crc32(kind + part))
        for kind, part in parts.items()
    )


def jpeg(colours: NDArray, quality: int = 95) -> rr.EncodedImage:
    """Encode as `png` does, with losses."""
    contents = _encoded(colours, "jpeg", (cv2.IMWRITE_JPEG_QUALITY, quality))
    return rr.EncodedImage(contents=contents, media_type="image/jpeg")


def _encoded(colours: NDArray, kind: str, how: tuple[int, ...]) -> bytes:
    stored = colours if colours.dtype == np.uint8 else as_bytes(colours)
    stored = cv2.cvtColor(stored, cv2.COLOR_RGB2BGR) if stored.ndim == 3 else stored
    return cv2.imencode(f".{kind}", stored, how)[1].tobytes()


def as_bytes(colours: FloatArray) -> NDArray[np.uint8]:
    """Turn [0, 1] into bytes; nan becomes 0. OpenCV's way takes a tenth of NumPy's time."""
    return np.asarray(cv2.convertScaleAbs(np.ascontiguousarray(np.maximum(colours, 0)), alpha=255))


def grey(values: NDArray, inside: BoolArray) -> FloatArray:
    """Stretch a map to [0, 1] within the mask; truth values are 0 and 1 already."""
    values = np.where(inside, values, np.nan)
    seen = values[np.isfinite(values)]
    low, high = min(seen.min(initial=0.0), 0.0), max(seen.max(initial=1.0), 1.0)
    return (values - low) / (high - low)


def stage_text(name: str, round: int) -> str:
    """Name a stage of a run; `stage_of` is the way back."""
    return f"{name}, round {round}" if round else name


def stage_of(text: str) -> tuple[str, int]:
    """Name and round of a stage."""
    name, _, round = text.partition(", round ")
    return (name, int(round)) if round.isdecimal() else (text, 0)
