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
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.workbench.plots import light as of_light
from endolab.workbench.plots.maps import show_picture
from endolab.workbench.plots.scales import limits, round_length
from endolab.workbench.plots.style import (
    HOUSE,
    AxesOrNew,
    house,
    legend_below,
    page,
    show_values,
)

FARTHEST: Any = {"colors": HOUSE.vermilion, "linewidths": 2.2, "linestyles": "--"}


# What a session knows ---------------------------------------------------------------------
def points_of(geometry: GeometricFit) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Pixels (n, 2), residuals (n, 2) and inliers (n,) of all views."""
    pixels = np.concatenate([view.pixels for view in geometry.views])
    return pixels, np.concatenate(geometry.residuals), np.concatenate(geometry.inliers)


def best_frame(session: Session) -> str:
    """Name the frame to show: of those that were located, the one with most features."""
    found = session.detections
    return max(session.poses or found, key=lambda name: len(found[name].ids))


# Figures ----------------------------------------------------------------------------------
def _show_empty(ax: AxesOrNew, title: str, camera: Camera) -> Axes:
    """Show a white picture."""
    ax = show_picture(np.ones((camera.height, camera.width)), ax, title)
    ax.autoscale(enable=False)
    return ax


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
    pixels = detection.pixels
    title = f"{title}: {len(pixels)} of {len(target.points)} {detection.reason}"
    ax = show_picture(image, ax, title.rstrip())
    places = target.points[detection.ids, :2] / target.spacing
    column, row = np.round(places).astype(int).T
    order = np.lexsort((column, row))
    for of_row in np.split(pixels[order], np.flatnonzero(np.diff(row[order])) + 1):
        ax.plot(*of_row.T, "o-", lw=1.3, ms=2.6)
    return ax


@house()
def show_reprojection(geometry: GeometricFit, ax: AxesOrNew = None) -> Axes:
    """Show measured less predicted pixels of all views as arrows, where they are in the picture.

    Arrows of one standard deviation are about 2 % of the picture's width. Of many inliers some are left out.
    """
    pixels, residuals, inliers = points_of(geometry)
    longer = round_length(0.02 * geometry.camera.width / max(geometry.sigma, 1e-6))
    ax = _show_empty(ax, f"Reprojection, arrows × {longer:g}", geometry.camera)
    bad = pixels[~inliers]
    ax.plot(*bad.T, "x", ms=4, color=HOUSE.vermilion, label=count_of(len(bad), "outlier"))
    good = np.flatnonzero(inliers)
    some = good[:: 1 + len(good) // 800]
    look: Any = {"color": HOUSE.blue, "label": count_of(len(good), "inlier")}
    look |= {"angles": "xy", "scale_units": "xy", "scale": 1 / longer, "width": 0.0025}
    ax.quiver(*pixels[some].T, *residuals[some].T, **look)
    legend_below(ax)
    return ax


@house()
def show_reprojection_histogram(geometry: GeometricFit, ax: AxesOrNew = None) -> Axes:
    """Show how the coordinates of the inliers' residuals are spread, with a Gaussian as wide."""
    _, residuals, inliers = points_of(geometry)
    title = f"Reprojection, u and v: RMSE {geometry.rmse:.3f} px"
    return of_light.histogram(ax, title, "px", residuals[inliers].ravel())


@house()
def show_coverage(geometry: GeometricFit, ax: AxesOrNew = None) -> Axes:
    """Show where in the picture features were seen, and how far off the axis; the farthest is dashed."""
    pixels, _, inliers = points_of(geometry)
    camera = geometry.camera
    farthest = geometry.max_angle_seen
    title = f"Field covered: to {np.rad2deg(farthest):.0f}° off the axis"
    ax = _show_empty(ax, title, camera)
    ax.plot(*pixels[inliers].T, ".", color=HOUSE.blue, ms=3, alpha=0.5, mew=0)
    off = np.rad2deg(np.arccos(camera.field.cos_alpha))
    rings = ax.contour(off, range(10, 180, 10), colors="0.35", linewidths=0.8)
    ax.clabel(rings, fmt="%d°")
    ax.contour(off, [np.rad2deg(farthest)], **FARTHEST)
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
    """Show a map with the largest angle seen, rad."""
    # The rim is far worse than all else.
    limit = limit or limits(name, values_within(values, camera, 0.9 * seen))[1]
    picture = (-0.5, camera.width - 0.5, camera.height - 0.5, -0.5)
    ax = show_values(name, values, ax, title, limits=(0.0, limit), extent=picture)
    ring = ax.contour(camera.field.cos_alpha, [np.cos(seen)], **FARTHEST)
    ax.clabel(ring, fmt=f"seen to {np.rad2deg(seen):.0f}°")
    ax.axis(picture)
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
    """Draw the evidence for a camera on one page, of 1600 x 1120 px when saved; for a given one, a frame.

    Parameters
    ----------
    session : Session
    image : (H, W) or (H, W, 3) float array
        The `best_frame`, stored values in [0, 1].
    """
    geometry = session.geometry
    count = 1 if geometry is None else 2
    detection = session.detections[best_frame(session)]
    with page(16, 11.2) as figure:
        panels = figure.subplots(count, count, squeeze=False)
        show_detection(image, detection, session.target, panels[0, 0])
        if geometry is not None:
            show_reprojection(geometry, panels[0, 1])
            show_coverage(geometry, panels[1, 0])
            show_reprojection_histogram(geometry, panels[1, 1])
    return figure


def light_figure(session: Session, image: FloatArray) -> Figure:
    """Draw the evidence for a light on one page: the paper's five panels, and the fall-off's error.

    Parameters as of `geometry_figure`; 1800 x 1000 px when saved; ValueError if the light was refused.
    """
    light = session.light
    samples = session.samples
    if light is None:
        raise ValueError(f"session has no light to draw: {session.refused}")
    here = samples.frame == list(session.poses).index(best_frame(session))
    with page(18, 10) as figure:
        ((sampling, residuals, fall_off), (gains, brdf, scores)) = figure.subplots(2, 3)
        used = light.used[here]
        of_light.show_sampling(image, samples[here], session.camera, sampling, used=used)
        of_light.show_light_residuals(light, residuals)
        of_light.show_fall_off(light, fall_off)
        distance = mean_distances(samples, light.frames)
        of_light.show_gains(light, gains, distance=distance)
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
