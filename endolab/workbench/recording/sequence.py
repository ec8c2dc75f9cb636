"""A recording of a video's frames for the Rerun viewer, on the timeline "frame"."""

import itertools
from collections.abc import Iterable, Mapping
from typing import Any

import cv2
import numpy as np
import rerun as rr

from endolab.io.atomic import PathLike
from endolab.model.cameras import Camera
from endolab.numerics.arrays import FloatArray
from endolab.workbench.plots.scales import common_limits, in_colour
from endolab.workbench.recording.layouts import FRAMES, sequence
from endolab.workbench.recording.pictures import (
    USED_COLOURS,
    distance_classes,
    distance_codes,
)
from endolab.workbench.recording.stream import (
    Sink,
    as_bytes,
    camera_shape,
    classes,
    depth_map,
    every,
    jpeg,
)

CURVES = {
    "Energy": ["energy"],
    "Median distance": ["median_distance"],
    "Gain": ["gain"],
    "Iterations, seconds": ["iterations", "seconds"],
}
# A row of ``frames.csv``, the picture, (h, w) or (h, w, 3) in [0, 1], distance and normals by their names.
Shown = tuple[Mapping[str, Any], FloatArray, Mapping[str, FloatArray]]


def record_sequence(
    path: PathLike, unit: str, camera: Camera, frames: Iterable[Shown]
) -> None:
    """Record frames and what was made of them, in any order, whole or not at all.

    Per frame, at its row's index: ``input``, ``depth``, ``distance`` (the same in logarithmic colours),
    ``mask``, ``normals`` ((n + 1)/2), ``world/cloud`` and ``plots/<name>``; ``world/camera`` is the same for
    all. Distances are in `unit`. Maps may be smaller than the picture; what is wider than 320 px is thinned.
    """
    limits = None  # of the colours of distances
    with Sink(path) as sink:
        for row, picture, maps in frames:
            distance = maps["distance"]
            height, width = distance.shape
            thin = every(width, 320)
            sparse = every(width, 120)  # coordinates would be most of a recording
            if limits is None:
                limits = common_limits([distance])
                camera = camera.resize(width, height)
                long = 0.2 * float(np.nanmedian(distance))
                sink.log("world", rr.ViewCoordinates.RDF, static=True)
                sink.log("world/camera", camera_shape(camera, long), static=True)
                sink.log("distance", distance_classes(limits, unit), static=True)
                sink.arrange(sequence(unit, limits, CURVES))
            sink.at(FRAMES, row["index"])
            sink.log("input", jpeg(picture[every(picture.shape[1], 320)]))
            sink.log("depth", depth_map(distance[thin], unit == "mm", limits))
            sink.log("distance", distance_codes(distance[thin]))
            sink.log("mask", *classes(np.isfinite(distance[thin]), USED_COLOURS))
            sink.log("normals", jpeg((maps["normals"][thin] + 1) / 2))
            inside = np.isfinite(distance[sparse])
            points = (distance[..., None] * camera.field.rays)[sparse][inside]
            size = (width, height)
            small = cv2.resize(in_colour(picture), size, interpolation=cv2.INTER_AREA)
            colours = as_bytes(np.asarray(small, float)[sparse][inside])
            cloud = rr.Points3D(points.astype(np.float32), colors=colours)
            sink.log("world/cloud", cloud)
            names = itertools.chain(*CURVES.values())
            sink.log_scalars("plots", {name: row[name] for name in names})
