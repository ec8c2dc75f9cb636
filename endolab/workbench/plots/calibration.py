"""Figures of a calibration: what was detected, how well the camera fits, and whole pages.

As in `maps`, every function but the pages draws into the axes ``ax`` it is given, or into
new ones, under ``title``, and returns the axes. The figures of the light are in `light`.
"""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from endolab.calibration.detection.detect import Detection
from endolab.calibration.geometric.fit import GeometricFit
from endolab.calibration.photometric.result import PhotometricFit
from endolab.calibration.session import Session
from endolab.calibration.summary import count_of, mean_distances
from endolab.calibration.targets import Target
from endolab.calibration.uncertainty import (
    fall_off_uncertainty,
    ray_uncertainty,
    values_within,
)
from endolab.model.cameras import Camera
from endolab.numerics.arrays import BoolArray, FloatArray, IntArray
from endolab.workbench.plots import light as of_light
from endolab.workbench.plots.maps import show_picture
from endolab.workbench.plots.scales import common_limit, round_length
from endolab.workbench.plots.style import (
    HOUSE,
    AxesOrNew,
    house,
    legend_below,
    page,
    show_values,
)


# What a session knows ---------------------------------------------------------------------
def points_of(geometry: GeometricFit) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Pixels (n, 2), residuals (n, 2) and inliers (n,) of all views."""
    pixels = np.concatenate([view.pixels for view in geometry.views])
    return pixels, np.concatenate(geometry.residuals), np.concatenate(geometry.inliers)


def best_frame(session: Session) -> str:
    """Name the frame to show: of those that were located, the one whose features reach farthest."""

    def reach(name: str) -> float:
        pixels = session.detections[name].pixels
        return float(np.prod(np.ptp(pixels, axis=0))) if len(pixels) else 0.0

    return max(session.poses or session.detections, key=reach)


def samples_of(session: Session, name: str) -> BoolArray:
    """Tell which of a session's samples were read in a frame, (n,)."""
    number = list(session.poses).index(name) if name in session.poses else -1
    return session.samples.frame == number


def video_frames(session: Session) -> IntArray:
    """Numbers, in the video, of the frames that were located: those that ``samples.frame`` counts."""
    names = list(session.detections)
    return np.array([names.index(name) for name in session.poses], dtype=int)


# Figures ----------------------------------------------------------------------------------
def _show_empty(ax: AxesOrNew, title: str, camera: Camera) -> Axes:
    """Show a white picture."""
    ax = show_picture(np.ones((camera.height, camera.width)), ax, title)
    ax.autoscale(enable=False)
    return ax


def _show_ring(ax: Axes, camera: Camera, angle: float, **look: Any) -> FloatArray:
    """Draw where rays of an angle off the axis, rad, are seen, and return it: (241, 2), px."""
    turn = np.linspace(0, 2 * np.pi, 241)
    x = np.sin(angle) * np.cos(turn)
    y = np.sin(angle) * np.sin(turn)
    ring = camera.project(np.stack([x, y, np.full(241, np.cos(angle))], axis=-1))
    ax.plot(*ring.T, **{"color": HOUSE.vermilion, "lw": 2.2, "ls": "--"} | look)
    return ring


def _show_arrows(
    ax: Axes, at: FloatArray, off: FloatArray, magnify: float, **look: Any
) -> None:
    """Draw differences of pixels longer than they are by a factor."""
    look |= {"angles": "xy", "scale_units": "xy", "scale": 1 / magnify, "width": 0.0025}
    ax.quiver(*at.T, *off.T, **look)


@house()
def show_detection(
    image: FloatArray,
    detection: Detection,
    target: Target,
    ax: AxesOrNew = None,
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
    for number in np.unique(row):
        of_row = np.flatnonzero(row == number)
        of_row = of_row[np.argsort(column[of_row])]
        ax.plot(*pixels[of_row].T, "o-", lw=1.3, ms=2.6)
    if len(ids):
        look: Any = {"ms": 13, "mfc": "none", "mec": HOUSE.vermilion, "mew": 2}
        ax.plot(*pixels[0], "o", label=f"id {ids[0]}", **look)
        legend_below(ax)
    return ax


@house()
def show_reprojection(geometry: GeometricFit, ax: AxesOrNew = None) -> Axes:
    """Show measured less predicted pixels of all views as arrows, where they are in the picture.

    Arrows of one standard deviation are about 2 % of the picture's width. Of more than 800 inliers some,
    taken by chance, are left out.
    """
    pixels, residuals, inliers = points_of(geometry)
    magnify = round_length(0.02 * geometry.camera.width / max(geometry.sigma, 1e-6))
    ax = _show_empty(ax, f"Reprojection, arrows × {magnify:g}", geometry.camera)
    bad = pixels[~inliers]
    ax.plot(*bad.T, "x", ms=4, color=HOUSE.vermilion, label=count_of(len(bad), "outlier"))
    label = count_of(int(inliers.sum()), "inlier")
    some = np.random.default_rng(0).permutation(np.flatnonzero(inliers))[:800]
    look = {"color": HOUSE.blue, "label": label}
    _show_arrows(ax, pixels[some], residuals[some], magnify, **look)
    legend_below(ax)
    return ax


@house()
def show_reprojection_histogram(geometry: GeometricFit, ax: AxesOrNew = None) -> Axes:
    """Show how the coordinates of the inliers' residuals are spread, with a Gaussian as wide."""
    _, residuals, inliers = points_of(geometry)
    values = residuals[inliers].ravel()
    title = f"Reprojection: RMSE {geometry.rmse:.3f} px"
    label = f"{count_of(len(values) // 2, 'point')}, u and v"
    return of_light.histogram(ax, title, "px", values, 0.0, float(np.std(values)), label)


@house()
def show_coverage(geometry: GeometricFit, ax: AxesOrNew = None) -> Axes:
    """Show where in the picture features were seen, with circles of equal angle off the axis."""
    pixels, _, inliers = points_of(geometry)
    camera = geometry.camera
    seen = np.rad2deg(geometry.max_angle_seen)
    ax = _show_empty(ax, f"Field covered: to {seen:.0f}° off the axis", camera)
    ax.plot(*pixels[inliers].T, ".", color=HOUSE.blue, ms=3, alpha=0.5, mew=0)
    words: Any = {"ha": "center", "va": "center", "size": "small"}
    for angle in range(10, int(min(np.rad2deg(camera.max_angle), 180)) + 1, 10):
        ring = _show_ring(ax, camera, np.deg2rad(angle), color="0.35", lw=0.8, ls="-")
        # Further around with each ring, so that no number lies on another.
        ax.annotate(f"{angle}°", ring[angle // 2], backgroundcolor="white", **words)
    _show_ring(ax, camera, geometry.max_angle_seen, label="farthest feature")
    legend_below(ax)
    return ax


def _show_sigma(
    name: str,
    values: FloatArray,
    camera: Camera,
    seen: float,
    ax: AxesOrNew,
    limit: float | None = None,
    title: str | None = None,
) -> Axes:
    """Show a map with the ring of the largest angle seen."""
    # Colours end at the 90th percentile of what lies within the angles seen: the rim is far worse.
    limit = limit or common_limit([values_within(values, camera, seen)], 90)
    picture = (-0.5, camera.width - 0.5, camera.height - 0.5, -0.5)
    ax = show_values(name, values, ax, title, limits=(0.0, limit), extent=picture)
    _show_ring(ax, camera, seen, label=f"farthest seen, {np.rad2deg(seen):.0f}°")
    ax.axis(picture)
    legend_below(ax)
    return ax


@house()
def show_ray_uncertainty(
    geometry: GeometricFit,
    ax: AxesOrNew = None,
    *,
    limit: float | None = None,
    title: str | None = None,
) -> Axes:
    """Show how well the ray of each pixel is known, a turn that all rays share apart.

    Beyond the dashed ring it was not seen, but follows.

    Parameters
    ----------
    geometry : GeometricFit
    limit : float, optional
        Where the colours end, mrad; by default such that most of what was seen is below.
    """
    camera = geometry.camera
    seen = geometry.max_angle_seen
    known = ray_uncertainty(camera, geometry.covariance, max_angle=seen)
    return _show_sigma("σ of rays", known, camera, seen, ax, limit, title)


@house()
def show_fall_off_uncertainty(
    light: PhotometricFit, camera: Camera, ax: AxesOrNew = None
) -> Axes:
    """Show how well the light along each ray is known, relative to that on the axis.

    Parameters
    ----------
    light : PhotometricFit
    camera : Camera
    """
    values = fall_off_uncertainty(light, camera)
    return _show_sigma("σ of μ′", values, camera, light.alpha_range[1], ax)


# Pages ------------------------------------------------------------------------------------
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
    """Draw the evidence for a light on one page: the paper's five panels, and the fall-off's error.

    Parameters as of `geometry_figure`; 1800 x 1000 px when saved; ValueError if the light was refused.
    """
    light = session.light
    samples = session.samples
    if light is None:
        raise ValueError(f"session has no light to draw: {session.refused}")
    here = samples_of(session, best_frame(session))
    with page(18, 10) as figure:
        ((sampling, residuals, fall_off), (gains, brdf, scores)) = figure.subplots(2, 3)
        used = light.used[here]
        of_light.show_sampling(image, samples[here], session.camera, sampling, used=used)
        of_light.show_light_residuals(light, residuals)
        of_light.show_fall_off(light, fall_off)
        frames = video_frames(session)[light.frames]
        distance = mean_distances(samples, light.frames)
        of_light.show_gains(light, gains, frames=frames, distance=distance)
        of_light.show_brdf(light, brdf, samples=samples)
        of_light.show_scores(light.errors_by_angle(samples), scores)
    return figure


def uncertainty_figure(session: Session) -> Figure:
    """Draw what a session knows of its rays and light on one page, one of which it must have found."""
    geometry = session.geometry
    light = session.light
    count = (geometry is not None) + (light is not None)
    with page(6.5 * count, 5) as figure:
        axes = figure.subplots(1, count, squeeze=False)[0]
        if geometry is not None:
            show_ray_uncertainty(geometry, axes[0])
        if light is not None:
            show_fall_off_uncertainty(light, session.camera, axes[-1])
    return figure
