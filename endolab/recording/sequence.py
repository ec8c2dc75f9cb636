"""A recording of a video's frames for the Rerun viewer, on the timeline "frame"."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from endolab.io.atomic import PathLike
from endolab.model.cameras import Camera
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.recording.layouts import BACKGROUND
from endolab.recording.stream import Sink, as_bytes, camera_shape

TIMELINE = "frame"
CLOUD_WIDTH = 120  # columns of a cloud: coordinates would be most of a recording
JPEG = (cv2.IMWRITE_JPEG_QUALITY, 85)


class SequenceRecorder:
    """Logs frames and what was made of them, in any order.

    Per frame: ``input``, ``depth`` (distance), ``normals`` ((n + 1)/2), ``world/cloud`` and
    ``plots/<name>``; ``world/camera`` is the same for all. The file is kept in memory until `close`,
    which writes it whole or not at all.

    Parameters
    ----------
    path : path
        The recording to write, ``.rrd``.
    unit : str
        Of distances.
    max_width : int
        Pictures wider than this, px, are thinned.

    Raises
    ------
    OSError
        If the file cannot be written.
    """

    def __init__(self, path: PathLike, unit: str, max_width: int = 320) -> None:
        self.unit, self.max_width = unit, max_width
        self._sink = Sink(path)
        self._range: tuple[float, float] | None = None

    def log(
        self,
        number: int,
        picture: FloatArray,
        distance: FloatArray,
        normals: FloatArray,
        camera: Camera,
        scalars: Mapping[str, float],
    ) -> None:
        """Log one frame.

        Parameters
        ----------
        number : int
            Its place on the timeline.
        picture : (h, w) or (h, w, 3) float array
            Stored values in [0, 1].
        distance : (H, W) float array
            mm or relative; nan where unknown.
        normals : (H, W, 3) float array
        camera : Camera
            Of size (W, H).
        scalars : mapping of str to float
            What is to be plotted.
        """
        stream = self._sink.stream
        width = distance.shape[1]
        step, sparse = (max(1, -(-width // most)) for most in (self.max_width, CLOUD_WIDTH))
        mask = np.isfinite(distance)
        if self._range is None:
            self._begin(distance[mask], camera)
        stream.set_time(TIMELINE, sequence=number)
        skip = max(1, -(-picture.shape[1] // self.max_width))
        self._log_picture("input", picture[::skip, ::skip])
        near = distance[::step, ::step].astype(np.float32)
        meter = 1000.0 if self.unit == "mm" else 1.0
        stream.log(
            "depth",
            rr.DepthImage(near, meter=meter, colormap="viridis", depth_range=self._range),
            strict=True,
        )
        self._log_picture("normals", np.nan_to_num((normals[::step, ::step] + 1) / 2))
        inside = mask[::sparse, ::sparse]
        rays = camera.field.rays[::sparse, ::sparse][inside]
        cloud = distance[::sparse, ::sparse][inside][:, None] * rays
        colours = as_bytes(_colours(picture, inside, distance.shape, sparse))
        stream.log("world/cloud", rr.Points3D(cloud.astype(np.float32), colors=colours), strict=True)
        for name, value in scalars.items():
            if np.isfinite(value):
                stream.log(f"plots/{name}", rr.Scalars(float(value)), strict=True)

    def close(self) -> None:
        """Write the file; without a frame there is none. A second call does nothing.

        Raises
        ------
        OSError
            If the file cannot be written; then there is none.
        """
        self._sink.close()

    def _begin(self, known: FloatArray, camera: Camera) -> None:
        self._sink.begin()
        low, middle, high = (float(value) for value in np.percentile(known, [1, 50, 99]))
        self._range = low, high
        stream = self._sink.stream
        stream.log("world", rr.ViewCoordinates.RDF, static=True)
        stream.log("world/camera", camera_shape(camera, 0.2 * middle), static=True)
        target = np.array([0.0, 0.0, middle])
        surface = rrb.Spatial3DView(
            origin="/world",
            name=f"Surface [{self.unit}]",
            eye_controls=rrb.EyeControls3D(
                position=target + 1.5 * high * np.array([-0.5, -0.35, -0.8]),
                look_target=target,
                eye_up=[0, -1, 0],
            ),
            background=BACKGROUND,
            line_grid=False,
        )
        plots = {
            "Energy": ["energy"],
            f"Median distance [{self.unit}]": ["median_distance"],
            "Gain": ["gain"],
            "Iterations, seconds": ["iterations", "seconds"],
        }
        curves = [
            rrb.TimeSeriesView(origin="/", contents=[f"/plots/{name}" for name in names], name=title)
            for title, names in plots.items()
        ]
        pictures = [
            rrb.Spatial2DView(origin=f"/{entity}", name=title)
            for entity, title in (
                ("input", "Frame"),
                ("depth", f"Distance [{self.unit}]"),
                ("normals", "Normals"),
            )
        ]
        stream.send_blueprint(
            rrb.Blueprint(
                rrb.Vertical(
                    rrb.Horizontal(*pictures),
                    rrb.Horizontal(surface, rrb.Grid(*curves, grid_columns=2), column_shares=[1, 1.2]),
                    row_shares=[1, 1.3],
                ),
                rrb.TimePanel(state="collapsed", timeline=TIMELINE),
                rrb.SelectionPanel(state="hidden"),
                rrb.BlueprintPanel(state="hidden"),
            )
        )

    def _log_picture(self, entity: str, values: FloatArray) -> None:
        stored = as_bytes(values)
        colour = stored if stored.ndim == 2 else cv2.cvtColor(stored, cv2.COLOR_RGB2BGR)
        done, content = cv2.imencode(".jpg", colour, JPEG)
        if done:
            image = rr.EncodedImage(contents=content.tobytes(), media_type="image/jpeg")
            self._sink.stream.log(entity, image, strict=True)


def _colours(picture: FloatArray, inside: BoolArray, shape: tuple[int, ...], sparse: int) -> FloatArray:
    """Colours of the cloud's points, (n, 3), from a picture that may be larger than the depth map."""
    height, width = shape
    if picture.shape[:2] != (height, width):
        picture = np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), np.float64)
    thin = picture[::sparse, ::sparse][inside]
    return thin if thin.ndim == 2 else np.repeat(thin[:, None], 3, axis=1)
