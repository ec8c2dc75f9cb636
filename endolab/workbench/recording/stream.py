"""Where recordings go, and what things look like in them."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Literal, Self

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from endolab.io.atomic import PathLike, one_sentence, write_atomically
from endolab.model.cameras import Camera
from endolab.numerics.arrays import FloatArray
from endolab.workbench.plots.scales import OKABE_ITO

Thinned = tuple[slice, slice]  # rows and columns
THIN = rr.Radius.ui_points(1.5)


class Sink:
    """A recording that becomes a file, ``.rrd``.

    `close` writes it, whole or not at all; if nothing was logged, there is none. Until then it is in memory,
    as Rerun's own writer may never come to an end when it finds the disk full. As a context manager it is
    closed at the end, and an error leaves no file.
    """

    def __init__(self, path: PathLike) -> None:
        self.path = Path(path)
        self.open = True  # for what is logged
        self._used = False
        if self.path.suffix != ".rrd":
            raise ValueError(f"a recording's name ends in .rrd, got {path}")
        with one_sentence(f"cannot write {path}"):  # told before the run, not after it
            tempfile.TemporaryFile(dir=self.path.parent).close()
        self._stream = rr.RecordingStream("endolab")
        self._content = rr.binary_stream(self._stream)

    def at(self, timeline: str, number: int) -> None:
        """Log at this place of a timeline from now on."""
        self._stream.reset_time()
        self._stream.set_time(timeline, sequence=number)

    def log(self, entity: str, *what: rr.AsComponents, static: bool = False) -> None:
        """Log something, now or for all times."""
        if not self.open:
            raise ValueError("the recording is closed")
        self._stream.log(entity, *what, static=static, strict=True)
        self._used = True

    def log_scalars(self, entity: str, values: Mapping[str, float]) -> None:
        """Log numbers by their names below an entity, now; those that are finite."""
        for name, value in values.items():
            if np.isfinite(value):
                self.log(f"{entity}/{name}", rr.Scalars(float(value)))

    def arrange(self, layout: rrb.Blueprint) -> None:
        """Tell the viewer how to open the recording."""
        self._stream.send_blueprint(layout)

    def close(self) -> None:
        """Write the file; a second call does nothing. OSError leaves no file."""
        if not self.open:
            return
        content = self._content.read() if self._used else None
        self.drop()
        if content is not None:
            write_atomically(self.path, content)

    def drop(self) -> None:
        """Let go of what was logged and is no file yet."""
        self.open = False
        self._stream.disconnect()
        # Rerun keeps streams that nobody has any more, with two threads each, until it begins anew, which
        # would end a session that the user has begun with `rr.init`.
        if rr.get_application_id() is None:
            rr.init("endolab", init_logging=False)

    def __enter__(self) -> Self:
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
    ends = outline[np.linspace(0, len(outline) - 1, 97).astype(int)]
    rim = size * camera.field.rays[ends[:, 1], ends[:, 0]]
    spokes = [np.stack([np.zeros(3), end]) for end in rim[:-1:12]]
    return rr.LineStrips3D([rim, *spokes], colors=OKABE_ITO.sky, radii=THIN)


def every(width: int, most: int) -> Thinned:
    """Rows and columns of a map that is that wide, thinned by a whole number to `most` columns."""
    return (slice(None, None, -(-width // most)),) * 2


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


def jpeg(colours: FloatArray) -> rr.AsComponents:
    """Encode [0, 1], (h, w) or (h, w, 3), with losses; all that one entity gets must be of one size."""
    return rr.Image(as_bytes(colours)).compress(jpeg_quality=85)


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
