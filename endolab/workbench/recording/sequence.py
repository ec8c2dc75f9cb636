"""A recording of a video's frames for the Rerun viewer, on the timeline "frame"."""

from collections.abc import Iterable, Mapping
from typing import Any

import cv2
import numpy as np
import rerun as rr

from endolab.io.atomic import PathLike
from endolab.model.cameras import Camera
from endolab.numerics.arrays import FloatArray
from endolab.workbench.plots.scales import limits
from endolab.workbench.recording.layouts import FRAMES, Shown, layout
from endolab.workbench.recording.pictures import (
    all_names,
    looks_along,
    names,
    paint_frame,
    paint_surface,
)
from endolab.workbench.recording.stream import Painted, Sink, scalars

COLUMNS = ("energy", "median_distance", "gain", "iterations", "seconds")
# A row of ``frames.csv``, the picture, (h, w) or (h, w, 3) in [0, 1], distance and normals by their names.
Done = tuple[Mapping[str, Any], FloatArray, Mapping[str, FloatArray]]


def record_sequence(
    path: PathLike, unit: str, camera: Camera, frames: Iterable[Done]
) -> None:
    """Record frames and what was made of them, in any order, whole or not at all.

    Per frame, at its row's index: ``input``, ``distance``, ``found``, ``normals`` ((n + 1)/2),
    ``section/estimate``, ``world/cloud`` and ``plots/<name>``. Distances are in `unit`. The picture is shrunk
    to the size of the maps; what is wider than 320 px is thinned.
    """
    with Sink(path) as sink:
        shown: list[Shown] = []
        for row, picture, maps in frames:
            distance = maps["distance"]
            height, width = distance.shape
            step = -(-width // 320)
            if not shown:
                ends = limits("distance", distance)
                shown.append(Shown("", unit, ends))
                camera = camera.resize(width, height)
                still: Painted = {
                    "world": rr.ViewCoordinates.RDF,
                    "world/camera": looks_along(distance),
                    "distance": names("distance", ends, unit),
                    **all_names(),
                }
                sink.log(still, static=True)
            sink.at(FRAMES, row["index"])
            small: Any = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
            sink.log(paint_frame(small, 1 * np.isfinite(distance), step))
            points = distance[..., None] * camera.field.rays
            sink.log(paint_surface(points, maps["normals"], step))
            sink.log({"stage": rr.TextLog(row["frame"])})
            sink.log(scalars({f"plots/{name}": row[name] for name in COLUMNS}))
        sink.arrange(layout(shown, sink.entities, FRAMES))
