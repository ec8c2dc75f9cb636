"""Figures of a calibration: what was detected, how well the camera fits, and whole pages.

As in `maps`, every function but the two pages draws into the axes ``ax`` it is given, or into
new ones, under ``title``, and returns the axes. The figures of the light are in `light`.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from endolab.calibration.detection.detect import Detection
from endolab.calibration.geometric.fit import GeometricFit
from endolab.calibration.session import Session
from endolab.calibration.summary import count_of, light_errors, mean_distances
from endolab.calibration.targets import Target
from endolab.model.cameras import Camera
from endolab.numerics.arrays import BoolArray, FloatArray, IntArray
from endolab.workbench.plots import light as plots_of_light
from endolab.workbench.plots.maps import show_picture
from endolab.workbench.plots.scales import round_length
from endolab.workbench.plots.style import (
    HOUSE,
    decorate,
    house,
    legend_below,
    page,
    pixel_axes,
)
from endolab.workbench.plots.uncertainty import ring


@dataclass(frozen=True)
class Crowding:
    """How much a figure of a calibration shows before things hide one another; chosen by eye."""

    most_arrows: int = 800
    longest_arrow: float = 4.0  # standard deviations
    between_rings: float = 0.035  # of the picture's width, between the numbers of two
    between_names: float = 0.02  # of the axis, between the names of two frames
    worst_shown: float = 4.0  # times the median error, where bars of frames end
    few_frames: int = 40  # whose names fit below their bars


CROWDING = Crowding()


def _picture_axes(ax: Axes | None, title: str, camera: Camera) -> Axes:
    """Axes of a picture that is not shown, pixels as in an array."""
    ax = pixel_axes(ax, title)
    ax.set_facecolor(HOUSE.paper)
    ax.set(xlim=(-0.5, camera.width - 0.5), ylim=(camera.height - 0.5, -0.5))
    ax.set_aspect("equal")
    return ax


def shorten(vectors: FloatArray, most: float) -> FloatArray:
    """Vectors, (n, 2), no longer than `most`: those of outliers would run across the picture."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors * np.minimum(1, most / np.maximum(length, 1e-12))


def _arrows(
    ax: Axes, at: FloatArray, off: FloatArray, magnify: float, most: float, **look: Any
) -> None:
    """Draw differences of pixels, at most so many px, longer than they are by a factor."""
    shown = shorten(off, most).T
    look |= {"angles": "xy", "scale_units": "xy", "width": 0.0025}
    ax.quiver(*at.T, *shown, scale=1 / magnify, **look)


@house()
def show_detection(
    image: FloatArray,
    detection: Detection,
    target: Target,
    ax: Axes | None = None,
    *,
    title: str = "Detection",
) -> Axes:
    """Show the features that were found, joined along the target's rows: a wrong id makes a wild line.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) float array
        Stored values in [0, 1].
    detection : Detection
    target : Target
    """
    ids = detection.ids
    pixels = detection.pixels
    title = f"{title}: {len(ids)} of {len(target.points)} {detection.reason}"
    ax = show_picture(image, ax, title.rstrip())
    column, row = np.round(target.points[ids, :2] / target.spacing).astype(int).T
    colours = (HOUSE.sky, HOUSE.vermilion, *HOUSE.curve_colours)  # of rows, over and over
    for number in np.unique(row):
        of_row = np.flatnonzero(row == number)
        of_row = of_row[np.argsort(column[of_row])]
        # Features that are farther apart than one that was missed are not joined.
        for run in np.split(of_row, np.flatnonzero(np.diff(column[of_row]) > 2) + 1):
            colour = colours[number % len(colours)]
            ax.plot(*pixels[run].T, "o-", color=colour, lw=1.3, ms=2.6)
    if len(ids):
        circle: Any = {"ms": 13, "mfc": "none", "mec": HOUSE.vermilion, "mew": 2}
        ax.plot(*pixels[0], "o", label=f"id {ids[0]}", **circle)
        legend_below(ax)
    return ax


def points_of(geometry: GeometricFit) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Pixels (n, 2), residuals (n, 2) and inliers (n,) of all views."""
    pixels = np.concatenate([view.pixels for view in geometry.views])
    return pixels, np.concatenate(geometry.residuals), np.concatenate(geometry.inliers)


@house()
def show_reprojection(geometry: GeometricFit, ax: Axes | None = None) -> Axes:
    """Show measured less predicted pixels of all views as arrows, where they are in the picture.

    Arrows of one standard deviation are about 2 % of the picture's width. They end at 4 standard
    deviations, or outliers would hide the rest; of more than 800 inliers or outliers some, chosen at
    random, are left out.
    """
    pixels, residuals, inliers = points_of(geometry)
    camera = geometry.camera
    sigma = max(geometry.sigma, 1e-6)
    magnify = round_length(0.02 * camera.width / sigma)
    ax = _picture_axes(ax, f"Reprojection, arrows × {magnify:g}", camera)
    most = CROWDING.longest_arrow * sigma
    for which, colour, what, order in (
        (inliers, HOUSE.blue, "inlier", 3),
        (~inliers, HOUSE.vermilion, "outlier", 2),
    ):
        drawn = np.random.default_rng(0).permutation(np.flatnonzero(which))
        drawn = drawn[: CROWDING.most_arrows]
        look = {"color": colour, "label": count_of(int(which.sum()), what), "zorder": order}
        _arrows(ax, pixels[drawn], residuals[drawn], magnify, most, **look)
    legend_below(ax)
    return ax


@house()
def show_reprojection_histogram(geometry: GeometricFit, ax: Axes | None = None) -> Axes:
    """Show how the coordinates of the inliers' residuals are spread, with a Gaussian as wide."""
    title = f"Reprojection: RMSE {geometry.rmse:.3f} px"
    ax = decorate(ax, title, "measured - predicted [px]", "density [1/px]")
    _, residuals, inliers = points_of(geometry)
    values = residuals[inliers].ravel()
    label = f"{count_of(int(inliers.sum()), 'point')}, u and v"
    plots_of_light.histogram(ax, values, 0.0, float(np.std(values)), label)
    return ax


@house()
def show_coverage(geometry: GeometricFit, ax: Axes | None = None) -> Axes:
    """Show where in the picture features were seen, with circles of equal angle off the axis."""
    pixels, _, inliers = points_of(geometry)
    camera = geometry.camera
    seen = np.rad2deg(geometry.max_angle_seen)
    ax = _picture_axes(ax, f"Field covered: to {seen:.0f}° off the axis", camera)
    ax.plot(*pixels[inliers].T, ".", color=HOUSE.blue, ms=3, alpha=0.5, mew=0)
    box = {"fc": "white", "ec": "none", "pad": 0.8, "alpha": 0.85}
    words: Any = {"ha": "center", "va": "center", "size": "small", "bbox": box}
    last = (-np.inf, 0.0)
    least = CROWDING.between_rings * camera.width
    for angle in range(10, int(min(np.rad2deg(camera.max_angle), 180)) + 1, 10):
        around = ring(camera, np.deg2rad(angle))
        ax.plot(*around.T, color="0.35", lw=0.8)
        # To the lower right, unless that lies outside or on another number.
        u, v = around[30]
        inside = u < 0.97 * camera.width and v < 0.97 * camera.height
        if inside and np.hypot(u - last[0], v - last[1]) > least:
            ax.text(u, v, f"{angle}°", clip_on=True, **words)
            last = (u, v)
    farthest = ring(camera, geometry.max_angle_seen).T
    ax.plot(*farthest, "--", color=HOUSE.vermilion, lw=2.2, label="farthest feature")
    legend_below(ax)
    return ax


def best_frame(session: Session) -> str:
    """Name the frame to show: of those that were located, the one with many features seen large."""
    detections = session.detections

    def worth(name: str) -> float:
        pixels = detections[name].pixels
        if not len(pixels):
            return 0.0
        return float(len(pixels) * np.sqrt(np.prod(np.ptp(pixels, axis=0))))

    return max(session.poses or detections, key=worth)


def samples_of(session: Session, name: str) -> BoolArray:
    """Tell which of a session's samples were read in a frame, (n,)."""
    number = list(session.poses).index(name) if name in session.poses else -1
    return session.samples.frame == number


def video_frames(session: Session) -> IntArray:
    """Numbers, in the video, of the frames that were located: those that ``samples.frame`` counts."""
    names = list(session.detections)
    return np.array([names.index(name) for name in session.poses], dtype=int)


def worst_frames(session: Session, count: int = 4) -> list[str]:
    """Name the frames whose features lie farthest from where they are expected, the worst first."""
    return sorted(session.errors, key=lambda name: -session.errors[name])[:count]


@house()
def show_frame_errors(
    errors: Mapping[str, float],
    marked: Collection[str] = (),
    ax: Axes | None = None,
    *,
    unit: str = "px",
) -> Axes:
    """Show the errors of frames, by their names, as bars; those that are `marked` in red."""
    ax = decorate(ax, "Error of every frame", "", f"root mean square [{unit}]")
    names = list(errors)
    values = np.nan_to_num(list(errors.values()))
    colours = [HOUSE.vermilion if name in marked else HOUSE.sky for name in names]
    ax.bar(range(len(names)), values, color=colours)
    labelled = names if len(names) <= CROWDING.few_frames else list(marked)
    places: list[int] = []
    for place in map(names.index, labelled):
        if all(abs(place - at) >= CROWDING.between_names * len(names) for at in places):
            places.append(place)
    ax.set_xticks(places, [names[place] for place in places], rotation=90)
    # One frame that is far off must not make the others small: its bar ends at the top, with its number.
    top = CROWDING.worst_shown * float(np.median(values))
    if 0 < top < values.max(initial=0):
        ax.set_ylim(0, top)
        for high in np.flatnonzero(values > top).tolist():
            ax.text(high, top, f"{values[high]:.3g} ", ha="right", va="top")
    return ax


@house()
def show_features(
    image: FloatArray, session: Session, name: str, ax: Axes | None = None
) -> Axes:
    """Show the part of a located frame with its features: where they are expected and where they were found.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) float array
        The frame, stored values in [0, 1].
    session : Session
    name : str
        Of the frame.
    """
    expected = session.predict_pixels(name)
    detected = session.detections[name].pixels
    error = max(session.errors[name], 1e-6)
    low = detected.min(axis=0)
    high = detected.max(axis=0)
    room = 0.1 * float(np.max(high - low)) + 10
    magnify = round_length(0.4 * room / error)
    ax = show_picture(image, ax, f"{name}: {error:.3f} px, arrows × {magnify:g}")
    ax.plot(*expected.T, "o", ms=8, mfc="none", mec=HOUSE.orange, mew=1.4, label="expected")
    ax.plot(*detected.T, "o", ms=3, color=HOUSE.sky, label="found")
    most = CROWDING.longest_arrow * error
    _arrows(ax, expected, detected - expected, magnify, most, color=HOUSE.vermilion)
    left, top = low - room
    right, bottom = high + room
    ax.set(xlim=(left, right), ylim=(bottom, top))
    legend_below(ax)
    return ax


def frames_figure(session: Session, pictures: Mapping[str, FloatArray]) -> Figure:
    """Draw the errors of all located frames, and some frames with what was found over what was expected.

    Parameters
    ----------
    session : Session
    pictures : mapping of str to (H, W) or (H, W, 3) float array
        Frames to show, as `worst_frames` names them; stored values in [0, 1].
    """
    rows = {"px": session.errors}
    if session.light is not None:
        rows["grey levels"] = light_errors(session)
    shown = [*pictures, ".", ".", "."]
    mosaic: Any = [[unit, unit] for unit in rows] + [shown[:2], shown[2:4]]
    heights = [4] * len(rows) + [5.5, 5.5]
    with page(16, sum(heights)) as figure:
        axes = figure.subplot_mosaic(mosaic, height_ratios=heights)
        for unit, errors in rows.items():
            show_frame_errors(errors, pictures, axes[unit], unit=unit)
        for name, picture in pictures.items():
            show_features(picture, session, name, axes[name])
    return figure


def geometry_figure(session: Session, image: FloatArray) -> Figure:
    """Draw the evidence for a camera on one page, of 1600 x 1120 px when saved.

    Parameters
    ----------
    session : Session
    image : (H, W) or (H, W, 3) float array
        The `best_frame`, stored values in [0, 1].

    Raises
    ------
    ValueError
        If the session's camera was given.
    """
    if session.geometry is None:
        raise ValueError("session has no geometry to draw: its camera was given")
    detection = session.detections[best_frame(session)]
    with page(16, 11.2) as figure:
        ((detected, arrows), (covered, spread)) = figure.subplots(2, 2)
        show_detection(image, detection, session.target, detected)
        show_reprojection(session.geometry, arrows)
        show_coverage(session.geometry, covered)
        show_reprojection_histogram(session.geometry, spread)
    return figure


def light_figure(session: Session, image: FloatArray) -> Figure:
    """Draw the evidence for a light on one page: the paper's five panels, and the frames held out.

    Parameters as of `geometry_figure`; 1800 x 1000 px when saved; ValueError if the light was refused.
    """
    light = session.light
    samples = session.samples
    if light is None:
        raise ValueError(f"session has no light to draw: {session.refused}")
    of_frame = samples_of(session, best_frame(session))
    here = samples[of_frame]
    with page(18, 10) as figure:
        ((sampling, residuals, fall_off), (gains, brdf, scores)) = figure.subplots(2, 3)
        used = light.used[of_frame]
        plots_of_light.show_sampling(image, here, session.camera, sampling, used=used)
        plots_of_light.show_light_residuals(light, residuals)
        plots_of_light.show_fall_off(light, fall_off)
        frames = video_frames(session)[light.frames]
        distance = mean_distances(samples, light.frames)
        plots_of_light.show_gains(light, gains, frames=frames, distance=distance)
        plots_of_light.show_brdf(light, brdf, samples=samples)
        if session.scores is None:
            scores.set_axis_off()
        else:
            plots_of_light.show_scores(session.scores, scores)
    return figure
