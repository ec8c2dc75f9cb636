"""A recording of a video's frames for the Rerun viewer, on the timeline "frame"."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
import rerun as rr

from endolab.io.atomic import PathLike
from endolab.model.cameras import Camera
from endolab.numerics.arrays import FloatArray
from endolab.workbench.plots.scales import common_limits, in_colour
from endolab.workbench.recording.layouts import FRAMES, sequence
from endolab.workbench.recording.pictures import USED_COLOURS
from endolab.workbench.recording.stream import (
    Sink,
    as_bytes,
    camera_shape,
    classes,
    depth_map,
    every,
    jpeg,
)

VIDEO_CURVES = {
    "Energy": ["energy"],
    "Median distance": ["median_distance"],
    "Gain": ["gain"],
    "Iterations, seconds": ["iterations", "seconds"],
}


class SequenceRecorder:
    """Logs frames and what was made of them, in any order: to a file, or to a viewer that shows them live.

    Per frame: ``input``, ``depth`` (distance), ``mask``, ``normals`` ((n + 1)/2), ``world/cloud`` and
    ``plots/<name>``; ``world/camera`` is the same for all. Distances are in `unit`; pictures wider than
    `max_width`, px, are thinned; `curves` are titles of what is plotted.

    `path` names a file, which `close` writes, whole or not at all, or is a `Sink`: ``Sink()`` is the native
    viewer, and its ``is_viewer_closed`` tells whether the user has closed it.
    """

    def __init__(
        self,
        path: PathLike | Sink,
        unit: str,
        max_width: int = 320,
        curves: Mapping[str, Sequence[str]] = VIDEO_CURVES,
    ) -> None:
        self.unit = unit
        self.max_width = max_width
        self._curves = curves
        self._sink = path if isinstance(path, Sink) else Sink(path)
        self._limits: tuple[float, float] | None = None  # of the colours of distances

    def log(
        self,
        number: int,
        picture: FloatArray,
        distance: FloatArray,
        normals: FloatArray,
        camera: Camera,
        scalars: Mapping[str, float],
    ) -> None:
        """Log one frame at a place of the timeline.

        The picture, (h, w) or (h, w, 3) in [0, 1], may be larger than the camera; distance, (H, W),
        and normals, (H, W, 3), are of its size, nan where unknown. The scalars are plotted.
        """
        sink = self._sink
        height, width = distance.shape
        thin = every(width, self.max_width)
        sparse = every(width, 120)  # coordinates would be most of a recording
        if self._limits is None:
            self._limits = common_limits([distance])
            sink.log("world", rr.ViewCoordinates.RDF, static=True)
            long = 0.2 * float(np.nanmedian(distance))
            sink.log("world/camera", camera_shape(camera, long), static=True)
            sink.arrange(sequence(self.unit, self._limits, self._curves))
        sink.at(FRAMES, number)
        sink.log("input", self._encode(picture[every(picture.shape[1], self.max_width)]))
        sink.log("depth", depth_map(distance[thin], self.unit == "mm", self._limits))
        sink.log("mask", *classes(np.isfinite(distance[thin]), USED_COLOURS))
        sink.log("normals", self._encode((normals[thin] + 1) / 2))
        inside = np.isfinite(distance[sparse])
        cloud = distance[sparse][inside][:, None] * camera.field.rays[sparse][inside]
        if picture.shape[:2] != distance.shape:  # it may be larger than the depth map
            size = (width, height)
            picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
        colours = as_bytes(in_colour(picture)[sparse][inside])
        sink.log("world/cloud", rr.Points3D(cloud.astype(np.float32), colors=colours))
        for name, value in scalars.items():
            sink.log_scalar(f"plots/{name}", value)

    def close(self) -> None:
        """Write the file, whole or not at all; without a frame there is none."""
        self._sink.close()

    def _encode(self, colours: FloatArray) -> rr.AsComponents:
        """A picture, small in a file; as it is for a viewer, which would show none while it decodes."""
        return rr.Image(as_bytes(colours)) if self._sink.path is None else jpeg(colours)
