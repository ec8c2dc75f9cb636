"""Recordings of a calibration for the Rerun viewer: what was found in its frames, and how well it fits."""

from typing import Any

import numpy as np
import rerun as rr

from endolab.calibration.session import Named, Session
from endolab.calibration.summary import account, light_errors, mean_distances
from endolab.io.atomic import PathLike
from endolab.io.video import Frames
from endolab.numerics.arrays import FloatArray
from endolab.workbench.plots.calibration import (
    points_of,
    samples_of,
    shorten,
    video_frames,
)
from endolab.workbench.plots.scales import OKABE_ITO, blue_white_red
from endolab.workbench.recording import layouts
from endolab.workbench.recording.layouts import FRAMES
from endolab.workbench.recording.stream import (
    TRUTH_COLOUR,
    Sink,
    camera_shape,
    every,
    jpeg,
    markdown,
)


def record_calibration(
    session: Session, frames: Named, path: PathLike, *, max_width: int = 480
) -> None:
    """Record a calibration to a file for the Rerun viewer, whole or not at all.

    `frames` is what was calibrated from; pictures wider than `max_width`, px, are thinned.

    Static: ``account``, ``world/camera``. On the timeline "frame": ``picture``, ``picture/detected``,
    ``picture/reprojection`` (measured - predicted, magnified), ``picture/samples`` (coloured by
    measured - predicted grey level), ``world/sheet`` (the target's points), ``plots/gain``,
    ``plots/distance``, ``plots/residual`` (root mean square).
    """
    with Sink(path) as sink:
        _Recording(sink, session, max_width).log(frames)


class _Recording:
    """One session, on its way into a file."""

    def __init__(self, sink: Sink, session: Session, max_width: int) -> None:
        self.sink = sink
        self.session = session
        self.names = list(session.detections)
        self.thin = every(session.camera.width, max_width)
        self.step = self.thin[0].step
        self.sigma = 1.0 if session.geometry is None else session.geometry.sigma
        # A reprojection residual of one standard deviation is 1.5 % of the picture's width.
        self.magnify = 0.015 * session.camera.width / max(self.sigma, 1e-6)

    def log(self, frames: Named) -> None:
        # 300 frames of a long video, evenly; curves have all.
        shown = set(self.names[:: -(-len(self.names) // 300)])
        self._log_static()
        self._log_curves()
        pictures = frames.read(shown) if isinstance(frames, Frames) else frames
        for name, image in pictures:
            if name in shown:
                self.sink.at(FRAMES, self.names.index(name))
                self._log_frame(name, image)

    def _log_points(
        self, entity: str, pixels: FloatArray, colours: Any, radius: float
    ) -> None:
        """Log dots of so many points over the picture."""
        radii = rr.Radius.ui_points(radius)
        dots = rr.Points2D(self._places(pixels), colors=colours, radii=radii)
        self.sink.log(entity, dots)

    def _places(self, pixels: FloatArray) -> FloatArray:
        """Where pixels are in the thinned picture; Rerun counts from a pixel's corner."""
        return pixels / self.step + 0.5

    # What stays -----------------------------------------------------------------------

    def _log_static(self) -> None:
        session = self.session
        lines = "\n".join(account(session))
        text = (
            f"```\n{lines}\n```\n\n"
            f"- **Detection**: features found; arrows are reprojection residuals x {self.magnify:.0f}, "
            "outliers red\n"
            "- **Brightness**: where the paper's brightness was read; blue is darker than the model, "
            "red brighter, grey was left out\n"
        )
        self.sink.log("account", markdown(text), static=True)
        self.sink.log("world", rr.ViewCoordinates.RDF, static=True)
        sheets = [np.zeros((0, 3)), *map(self._sheet, session.poses)]
        points = np.concatenate(sheets)
        centre = points.mean(axis=0) if len(points) else np.array([0.0, 0.0, 50.0])
        shape = camera_shape(session.camera, 0.2 * float(np.linalg.norm(centre)))
        self.sink.log("world/camera", shape, static=True)
        curves = {"Distance [mm]": ["distance"]}
        if session.light is not None:
            curves |= {"Gain [mm²]": ["gain"], "Residual [grey levels]": ["residual"]}
        self.sink.arrange(layouts.calibration(centre, curves))

    # Frames ---------------------------------------------------------------------------

    def _log_curves(self) -> None:
        session = self.session
        samples = session.samples
        frames = np.arange(len(session.poses))
        curves = {"distance": mean_distances(samples, frames)}
        light = session.light
        if light is not None:
            gains = np.full(len(frames), np.nan)
            gains[light.frames] = light.gains
            gains[light.frames[np.isinf(light.gain_errors)]] = np.nan
            curves["gain"] = gains
            curves["residual"] = np.array(list(light_errors(session).values()))
        for name, values in curves.items():
            for number, value in zip(video_frames(session), values, strict=True):
                self.sink.at(FRAMES, number)
                self.sink.log_scalar(f"plots/{name}", value)

    def _log_frame(self, name: str, image: FloatArray | None) -> None:
        if image is not None:
            self.sink.log("picture", jpeg(image[self.thin]))
        pixels = self.session.detections[name].pixels
        self._log_points("picture/detected", pixels, OKABE_ITO.sky, 2.5)
        self._log_reprojection(name)
        self._log_samples(name)
        radii = rr.Radius.ui_points(3.0)
        dots = rr.Points3D(self._sheet(name), colors=TRUTH_COLOUR, radii=radii)
        self.sink.log("world/sheet", dots)

    def _sheet(self, name: str) -> FloatArray:
        """Where the target's points are in a frame, (n, 3), mm; those of panels that were located."""
        points = self.session.target.points
        panels = self.session.target.panel_of(points)
        sheet = [np.zeros((0, 3))]
        for panel, pose in enumerate(self.session.poses.get(name, ())):
            if pose is not None:
                sheet.append(pose.transform(points[panels == panel]))
        return np.concatenate(sheet)

    def _log_reprojection(self, name: str) -> None:
        geometry = self.session.geometry
        if geometry is None:
            return
        counts = [len(view.pixels) for view in geometry.views]
        here = np.repeat([view.name == name for view in geometry.views], counts)
        pixels, residuals, inliers = points_of(geometry)
        vectors = shorten(residuals[here], 4 * self.sigma) * self.magnify / self.step
        colours = np.where(inliers[here, None], OKABE_ITO.orange, OKABE_ITO.vermilion)
        arrows = rr.Arrows2D(
            vectors=vectors,
            origins=self._places(pixels[here]),
            colors=colours.astype(np.uint8),
            radii=rr.Radius.ui_points(1.0),
        )
        self.sink.log("picture/reprojection", arrows)

    def _log_samples(self, name: str) -> None:
        session = self.session
        light = session.light
        of_frame = samples_of(session, name)
        colours = np.full((int(of_frame.sum()), 3), TRUTH_COLOUR, dtype=np.uint8)
        if light is not None:
            used = light.used[of_frame]
            residuals = light.residuals[of_frame][used]
            colours[used] = blue_white_red(residuals / (3 * light.sigma))
        pixels = session.camera.project(session.samples.points[of_frame])
        self._log_points("picture/samples", pixels, colours, 4.0)
