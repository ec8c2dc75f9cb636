"""A recording of a video's frames for the Rerun viewer, on the timeline "frame"."""

import itertools
from collections.abc import Mapping
from typing import Any

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
    """Logs frames and what was made of them, in any order, to a file that `close` writes.

    Per frame: ``input``, ``depth`` (distance), ``mask``, ``normals`` ((n + 1)/2), ``world/cloud`` and
    ``plots/<name>``; ``world/camera`` is the same for all. Distances are in `unit`; pictures wider than
    `max_width`, px, are thinned.
    """

    def __init__(self, path: PathLike, unit: str, max_width: int = 320) -> None:
        self.unit = unit
        self.max_width = max_width
        self._sink = Sink(path)
        self._limits: tuple[float, float] | None = None  # of the colours of distances
        self._camera: Camera

    def log(
        self,
        row: Mapping[str, Any],
        picture: FloatArray,
        maps: Mapping[str, FloatArray],
        camera: Camera,
    ) -> None:
        """Log one frame, with numbers of its row of ``frames.csv``, at its index on the timeline.

        The picture is (h, w) or (h, w, 3) in [0, 1]; the maps, distance and normals, may be smaller.
        """
        sink = self._sink
        distance = maps["distance"]
        height, width = distance.shape
        thin = every(width, self.max_width)
        sparse = every(width, 120)  # coordinates would be most of a recording
        if self._limits is None:
            self._limits = common_limits([distance])
            sink.log("world", rr.ViewCoordinates.RDF, static=True)
            long = 0.2 * float(np.nanmedian(distance))
            self._camera = camera.resize(width, height)  # once, as its rays take their time
            sink.log("world/camera", camera_shape(self._camera, long), static=True)
            sink.arrange(sequence(self.unit, self._limits, VIDEO_CURVES))
        sink.at(FRAMES, row["index"])
        sink.log("input", jpeg(picture[every(picture.shape[1], self.max_width)]))
        sink.log("depth", depth_map(distance[thin], self.unit == "mm", self._limits))
        sink.log("mask", *classes(np.isfinite(distance[thin]), USED_COLOURS))
        sink.log("normals", jpeg((maps["normals"][thin] + 1) / 2))
        inside = np.isfinite(distance[sparse])
        cloud = distance[sparse][inside][:, None] * self._camera.field.rays[sparse][inside]
        # It may be larger than the depth map.
        size = (width, height)
        small = cv2.resize(in_colour(picture), size, interpolation=cv2.INTER_AREA)
        colours = as_bytes(np.asarray(small, float)[sparse][inside])
        sink.log("world/cloud", rr.Points3D(cloud.astype(np.float32), colors=colours))
        for name in itertools.chain(*VIDEO_CURVES.values()):
            sink.log_scalar(f"plots/{name}", row[name])

    def close(self) -> None:
        """Write the file, whole or not at all; without a frame there is none."""
        self._sink.close()
