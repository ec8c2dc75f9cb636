"""Recordings of a calibration for the Rerun viewer: what was found in its frames, and how well it fits."""

import numpy as np
import rerun as rr

from endolab.calibration.session import Named, Session
from endolab.calibration.summary import account, light_errors, mean_distances
from endolab.io.atomic import PathLike
from endolab.io.video import Frames
from endolab.numerics.arrays import FloatArray
from endolab.workbench.plots.calibration import points_of, samples_of, video_frames
from endolab.workbench.plots.scales import OKABE_ITO, palette
from endolab.workbench.recording.layouts import FRAMES, calibration
from endolab.workbench.recording.stream import (
    TRUTH_COLOUR,
    Sink,
    camera_shape,
    every,
    jpeg,
    markdown,
)


def record_calibration(session: Session, frames: Named, path: PathLike) -> None:
    """Record a calibration to a file for the Rerun viewer, whole or not at all.

    `frames` is what was calibrated from; pictures wider than 480 px are thinned.

    Static: ``account``, ``world/camera``. On the timeline "frame": ``picture``, ``picture/detected``,
    ``picture/reprojection`` (measured - predicted of inliers, magnified), ``picture/outliers``,
    ``picture/samples`` (coloured by measured - predicted grey level), ``world/sheet`` (the
    target's points), ``plots/gain``, ``plots/distance``, ``plots/residual`` (root mean square).
    """
    names = list(session.detections)
    # 300 frames of a long video, evenly; curves have all.
    shown = set(names[:: -(-len(names) // 300)])
    thin = every(session.camera.width, 480)
    geometry = session.geometry
    sigma = 1.0 if geometry is None else max(geometry.sigma, 1e-6)
    # A reprojection residual of one standard deviation is 1.5 % of the picture's width.
    magnify = 0.015 * session.camera.width / sigma
    with Sink(path) as sink:
        _log_static(sink, session, magnify)
        _log_curves(sink, session)
        pictures = frames.read(shown) if isinstance(frames, Frames) else frames
        for name, image in pictures:
            if name in shown:
                sink.at(FRAMES, names.index(name))
                if image is not None:
                    sink.log("picture", jpeg(image[thin]))
                _log_frame(sink, session, name, thin[0].step, magnify)


def _log_static(sink: Sink, session: Session, magnify: float) -> None:
    lines = "\n".join(account(session))
    text = (
        f"```\n{lines}\n```\n\n"
        f"- **Detection**: features found; arrows are reprojection residuals x {magnify:.0f}, "
        "red dots outliers\n"
        "- **Brightness**: where the paper's brightness was read; blue is darker than the model, "
        "red brighter, grey was left out\n"
    )
    sink.log("account", markdown(text), static=True)
    sink.log("world", rr.ViewCoordinates.RDF, static=True)
    sheets = [_sheet(session, name) for name in session.poses]
    centre = np.concatenate([np.array([[0.0, 0.0, 50.0]]), *sheets]).mean(axis=0)
    shape = camera_shape(session.camera, 0.2 * float(np.linalg.norm(centre)))
    sink.log("world/camera", shape, static=True)
    curves = {"Distance [mm]": ["distance"]}
    if session.light is not None:
        curves |= {"Gain [mm²]": ["gain"], "Residual [grey levels]": ["residual"]}
    sink.arrange(calibration(centre, curves))


def _log_curves(sink: Sink, session: Session) -> None:
    distances = mean_distances(session.samples, np.arange(len(session.poses)))
    residuals = light_errors(session)
    gains = {}
    light = session.light
    if light is not None:
        known = np.isfinite(light.gain_errors)
        gains = dict(zip(light.frames[known], light.gains[known], strict=True))
    for frame, (name, number) in enumerate(
        zip(session.poses, video_frames(session), strict=True)
    ):
        sink.at(FRAMES, number)
        values = {"distance": distances[frame], "residual": residuals.get(name, np.nan)}
        sink.log_scalars("plots", {**values, "gain": gains.get(frame, np.nan)})


def _sheet(session: Session, name: str) -> FloatArray:
    """Where the target's points are in a frame, (n, 3), mm; those of panels that were located."""
    points = session.target.points
    panels = session.target.panel_of(points)
    sheet = [np.zeros((0, 3))]
    for panel, pose in enumerate(session.poses.get(name, ())):
        if pose is not None:
            sheet.append(pose.transform(points[panels == panel]))
    return np.concatenate(sheet)


def _log_frame(sink: Sink, session: Session, name: str, step: int, magnify: float) -> None:
    """Log what was found in a frame, over its picture, which is thinned by a step."""
    dots = {"detected": (session.detections[name].pixels, OKABE_ITO.sky, 2.5)}
    geometry = session.geometry
    if geometry is not None:
        counts = [len(view.pixels) for view in geometry.views]
        here = np.repeat([view.name == name for view in geometry.views], counts)
        pixels, residuals, inliers = points_of(geometry)
        dots["outliers"] = (pixels[here & ~inliers], OKABE_ITO.vermilion, 4.0)
        arrows = rr.Arrows2D(
            vectors=magnify / step * residuals[here & inliers],
            origins=pixels[here & inliers] / step + 0.5,
            colors=OKABE_ITO.orange,
            radii=rr.Radius.ui_points(1.0),
        )
        sink.log("picture/reprojection", arrows)
    of_frame = samples_of(session, name)
    colours = np.full((int(of_frame.sum()), 3), TRUTH_COLOUR, np.uint8)
    light = session.light
    if light is not None:
        used = light.used[of_frame]
        share = light.residuals[of_frame][used] / (3 * light.sigma)
        place = np.clip(128 + 128 * share, 0, 255).astype(int)
        colours[used] = palette("model - frame")[place, :3]
    places = session.camera.project(session.samples.points[of_frame])
    dots["samples"] = (places, colours, 4.0)
    for entity, (pixels, colour, size) in dots.items():
        radii = rr.Radius.ui_points(size)
        # Rerun counts from a pixel's corner.
        found = rr.Points2D(pixels / step + 0.5, colors=colour, radii=radii)
        sink.log(f"picture/{entity}", found)
    radii = rr.Radius.ui_points(3.0)
    sheet = rr.Points3D(_sheet(session, name), colors=TRUTH_COLOUR, radii=radii)
    sink.log("world/sheet", sheet)
