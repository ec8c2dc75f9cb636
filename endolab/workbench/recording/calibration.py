"""Recordings of a calibration for the Rerun viewer: its frames, and the steps of the light's fit.

The timeline "frame" shows what was found and how well it is explained, "iteration" how the light
was fitted.
"""

from collections.abc import Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from endolab.calibration.geometric.pose import Pose
from endolab.calibration.least_squares import FitIterate
from endolab.calibration.session import Named, Session
from endolab.calibration.summary import account, mean_distances
from endolab.io.atomic import PathLike
from endolab.io.video import Frames
from endolab.numerics.arrays import FloatArray
from endolab.workbench.plots.scales import OKABE_ITO, blue_white_red
from endolab.workbench.recording import layouts
from endolab.workbench.recording.layouts import ITERATIONS
from endolab.workbench.recording.stream import (
    TRUTH_COLOUR,
    Sink,
    as_bytes,
    camera_shape,
    every,
    jpeg,
)

FIT_CURVES = {
    "Distance [mm]": ["distance"],
    "Gain [mm²]": ["gain"],
    "Residual [grey levels]": ["residual"],
}


def record_calibration(
    session: Session,
    frames: Named,
    path: PathLike,
    *,
    light_steps: Sequence[FitIterate] = (),
    max_width: int = 480,
) -> None:
    """Record a calibration to a file for the Rerun viewer, whole or not at all.

    `frames` is what was calibrated from, `light_steps` what ``steps.append`` among the
    session's `light_observers` has kept; pictures wider than `max_width`, px, are thinned.

    Static: ``account``, ``world/camera``. Per frame: ``picture``, ``picture/detected``,
    ``picture/reprojection`` (measured - predicted, magnified), ``picture/samples`` (coloured by
    measured - predicted grey level), ``world/sheet`` (the target's points), ``plots/gain``,
    ``plots/distance``, ``plots/residual`` (standard deviation). Per iteration: ``fit/k``, ``fit/gamma``,
    ``fit/sigma``, ``fit/cost``, ``fit/change``.
    """
    with Sink(path) as sink:
        _Recording(sink, session, max_width).log(frames, light_steps)


class _Recording:
    """One session, on its way into a file."""

    def __init__(self, sink: Sink, session: Session, max_width: int) -> None:
        self.sink = sink
        self.session = session
        self.thin = every(session.camera.width, max_width)
        self.step = self.thin[0].step
        self.sigma = 1.0 if session.geometry is None else session.geometry.sigma
        # A reprojection residual of one standard deviation is 1.5 % of the picture's width.
        self.magnify = 0.015 * session.camera.width / max(self.sigma, 1e-6)

    def log(self, frames: Named, light_steps: Sequence[FitIterate]) -> None:
        names = list(self.session.detections)
        # 300 frames of a long video, evenly; curves have all.
        shown = set(names[:: -(-len(names) // 300)])
        self._log_static()
        self._log_curves(names)
        pictures = frames.read(shown) if isinstance(frames, Frames) else frames
        for name, image in pictures:
            if name in shown:
                self.sink.at("frame", names.index(name))
                self._log_frame(name, image)
        for step in light_steps:
            self.sink.at(ITERATIONS, step.k)
            self._log_step(step)

    def _places(self, pixels: FloatArray) -> FloatArray:
        """Where pixels are in the thinned picture; Rerun counts from a pixel's corner."""
        return pixels / self.step + 0.5

    # What stays -----------------------------------------------------------------------

    def _log_static(self) -> None:
        session = self.session
        text = (
            "```\n" + "\n".join(account(session)) + "\n```\n\n"
            f"- **Detection**: features found; arrows are reprojection residuals x {self.magnify:.0f}, "
            "outliers red\n"
            "- **Brightness**: where the paper's brightness was read; blue is darker than the model, "
            "red brighter, grey was left out\n"
            "- **Fit**: set the timeline to *iteration* to see the light being fitted\n"
        )
        self.sink.log(
            "account", rr.TextDocument(text, media_type="text/markdown"), static=True
        )
        self.sink.log("world", rr.ViewCoordinates.RDF, static=True)
        poses: list[Pose] = [
            pose for panels in session.poses.values() for pose in panels if pose is not None
        ]
        middles = [pose.transform(session.target.points.mean(axis=0)) for pose in poses]
        centre = np.mean(middles, axis=0) if middles else np.array([0.0, 0.0, 50.0])
        size = 0.2 * float(np.linalg.norm(centre))
        self.sink.log("world/camera", camera_shape(session.camera, size), static=True)
        curves = (
            FIT_CURVES if session.light is not None else {"Distance [mm]": ["distance"]}
        )
        self.sink.arrange(layouts.calibration(centre, curves, "frame"))

    # Frames ---------------------------------------------------------------------------

    def _log_curves(self, names: Sequence[str]) -> None:
        session = self.session
        light = self.session.light
        number = np.array([names.index(name) for name in session.poses], int)
        sampled = np.unique(session.samples.frame)
        curves = {"distance": (sampled, mean_distances(session.samples, sampled))}
        if light is not None:
            known = np.isfinite(light.gain_errors)
            curves["gain"] = light.frames[known], light.gains[known]
            used = light.used
            frame = session.samples.frame
            spread = [float(np.std(light.residuals[used & (frame == f)])) for f in sampled]
            some = np.array([np.sum(used & (frame == f)) > 1 for f in sampled], dtype=bool)
            curves["residual"] = sampled[some], np.array(spread)[some]
        for name, (frames, values) in curves.items():
            for place, value in zip(number[frames].tolist(), values, strict=True):
                self.sink.at("frame", place)
                self.sink.log_scalar(f"plots/{name}", value)

    def _log_frame(self, name: str, image: FloatArray | None) -> None:
        session = self.session
        if image is not None:
            self.sink.log("picture", jpeg(as_bytes(image[self.thin])))
        pixels = self._places(session.detections[name].pixels)
        self.sink.log(
            "picture/detected",
            rr.Points2D(pixels, colors=OKABE_ITO.sky, radii=rr.Radius.ui_points(2.5)),
        )
        self._log_reprojection(name)
        self._log_samples(name)
        target = session.target
        sheet = [np.zeros((0, 3))]
        for panel, pose in enumerate(session.poses.get(name, ())):
            if pose is not None:
                sheet.append(
                    pose.transform(target.points[target.panel_of(target.points) == panel])
                )
        dots = rr.Points3D(
            np.concatenate(sheet), colors=TRUTH_COLOUR, radii=rr.Radius.ui_points(3.0)
        )
        self.sink.log("world/sheet", dots)

    def _log_reprojection(self, name: str) -> None:
        parts: list[tuple[NDArray, ...]] = [
            (np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0, bool))
        ]
        geometry = self.session.geometry
        if geometry is not None:
            views = zip(geometry.views, geometry.residuals, geometry.inliers, strict=True)
            parts += [(view.pixels, *rest) for view, *rest in views if view.name == name]
        pixels, vector, good = (
            np.concatenate(arrays) for arrays in zip(*parts, strict=True)
        )
        # Outliers would run across the picture.
        length = np.linalg.norm(vector, axis=1, keepdims=True)
        vector = vector * np.minimum(1, 4 * self.sigma / np.maximum(length, 1e-12))
        colours = np.where(good[:, None], OKABE_ITO.orange, OKABE_ITO.vermilion).astype(
            np.uint8
        )
        origins = self._places(pixels)
        vector = vector * self.magnify / self.step
        radius = rr.Radius.ui_points(1.0)
        arrows = rr.Arrows2D(vectors=vector, origins=origins, colors=colours, radii=radius)
        self.sink.log("picture/reprojection", arrows)

    def _log_samples(self, name: str) -> None:
        session = self.session
        light = self.session.light
        names = list(session.poses)
        of_frame = session.samples.frame == (
            names.index(name) if name in session.poses else -1
        )
        colours = np.full((int(of_frame.sum()), 3), TRUTH_COLOUR, dtype=np.uint8)
        if light is not None:
            used = light.used[of_frame]
            colours[used] = blue_white_red(
                light.residuals[of_frame][used] / (3 * light.sigma)
            )
        places = self._places(session.camera.project(session.samples.points[of_frame]))
        self.sink.log(
            "picture/samples",
            rr.Points2D(places, colors=colours, radii=rr.Radius.ui_points(4.0)),
        )

    # Iterations -----------------------------------------------------------------------

    def _log_step(self, step: FitIterate) -> None:
        unknowns = step.unknowns
        numbers = {"fit/k": unknowns.k, "fit/gamma": unknowns.gamma}
        numbers |= {
            f"fit/{name}": getattr(step, name) for name in ("sigma", "cost", "change")
        }
        for name, value in numbers.items():
            self.sink.log_scalar(name, value)
