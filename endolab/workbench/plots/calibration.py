"""Figures of a calibration: what was detected, how well camera and light fit, and whole pages.

As in `maps`, every function but the pages draws into the axes ``ax`` it is given, or into
new ones, under ``title``, and returns the axes.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import norm

from endolab.calibration.constants import LEAST_SCORED
from endolab.calibration.detection.detect import Detection
from endolab.calibration.geometric.fit import GeometricFit
from endolab.calibration.photometric.result import AngleErrors, PhotometricFit
from endolab.calibration.photometric.samples import Samples
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
from endolab.workbench.plots.maps import show_picture
from endolab.workbench.plots.scales import limits
from endolab.workbench.plots.style import (
    HOUSE,
    AxesOrNew,
    decorate,
    house,
    legend_below,
    page,
    show_values,
)

ALPHA = "angle α off the axis [°]"
# With their standard errors.
POINTS: Any = {"color": HOUSE.vermilion, "marker": "o", "capsize": 3}
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


# Figures of the camera --------------------------------------------------------------------
def histogram(ax: AxesOrNew, title: str, unit: str, values: FloatArray) -> Axes:
    """Draw a histogram of residuals as a density, and the normal distribution as wide over it."""
    ax = decorate(ax, title, f"measured - predicted [{unit}]", f"density [1/{unit}]")
    mean = float(np.mean(values))
    sigma = float(np.std(values)) or 1.0
    x = mean + np.linspace(-4, 4, 301) * sigma
    label = f"{len(values)} values"
    ax.hist(values, x[::5].tolist(), density=True, color=HOUSE.sky, label=label)
    ax.plot(x, norm.pdf(x, mean, sigma), "--", color="black", label="Gaussian")
    ax.margins(y=0.3)
    ax.locator_params(axis="x", nbins=5)
    ax.legend(loc="upper right", ncols=2)
    return ax


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
    y = target.points[detection.ids, 1]
    for row in np.unique(y):
        ax.plot(*pixels[y == row].T, "o-", lw=1.3, ms=2.6)
    return ax


@house()
def show_reprojection(geometry: GeometricFit, ax: AxesOrNew = None) -> Axes:
    """Show measured less predicted pixels of all views as arrows, where they are in the picture.

    Arrows of one standard deviation are about 2 % of the picture's width. Of many inliers some are left out.
    """
    pixels, residuals, inliers = points_of(geometry)
    long = 0.02 * geometry.camera.width / max(geometry.sigma, 1e-6)
    power = 10 ** np.floor(np.log10(long))
    longer = power * np.floor(long / power)  # of one digit
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
    return histogram(ax, title, "px", residuals[inliers].ravel())


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
    title: str = "",
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
    title: str = "",
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


# Figures of the light ---------------------------------------------------------------------
def _over_angles(ax: AxesOrNew, title: str, x: str, y: str, seen: Any) -> Axes:
    """Give axes over angles of 0 to 90°; those beyond what was `seen`, rad, are shaded."""
    ax = decorate(ax, title, x, y)
    low, high = np.rad2deg(seen)
    ax.axvspan(0, low, color="0.88", lw=0, zorder=0)
    ax.axvspan(high, 90, color="0.88", lw=0, zorder=0)
    ax.set(xlim=(0, 90), xticks=range(0, 91, 15))
    return ax


def _show_counts(ax: Axes, count: IntArray, edges: FloatArray) -> None:
    """Draw how many samples there are between edges, at the bottom."""
    low: Any = {"transform": ax.get_xaxis_transform(), "color": HOUSE.sky, "alpha": 0.8}
    heights = 0.2 * count / max(count.max(), 1)
    ax.bar(edges[:-1], heights, np.diff(edges), align="edge", label="samples", **low)


def _show_beside(ax: Axes, x: Any, values: Any, label: str) -> None:
    """Draw a dashed curve in blue, with a scale of its own on the right, beside one in red."""
    twin = ax.twinx()
    twin.plot(x, values, "--", color=HOUSE.blue)
    twin.set_ylabel(label)
    for axes, colour in ((ax, HOUSE.vermilion), (twin, HOUSE.blue)):
        axes.set_ylim(bottom=0)
        axes.yaxis.label.set_color(colour)
        axes.tick_params(axis="y", colors=colour)


@house()
def show_sampling(
    image: FloatArray,
    samples: Samples,
    camera: Camera,
    ax: AxesOrNew = None,
    *,
    used: BoolArray | bool = True,
    title: str = "Samples",
) -> Axes:
    """Show where the brightness of a frame was read.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) float array
        Stored values in [0, 1].
    samples : Samples
        Of this frame.
    camera : Camera
    used : (n,) bool array, optional
        Those that counted in the fit; all by default.
    """
    ax = show_picture(image, ax, f"{title}: {len(samples)} in this frame")
    pixels = camera.project(samples.points)
    kind = np.where(used, samples.material > 0, 2)
    fills = {"bare paper": HOUSE.vermilion, "grey patch": HOUSE.blue, "left out": "black"}
    for number, (label, fill) in enumerate(fills.items()):
        ax.plot(*pixels[kind == number].T, "o", ms=5, mfc=fill, mec="white", label=label)
    legend_below(ax)
    return ax


@house()
def show_light_residuals(light: PhotometricFit, ax: AxesOrNew = None) -> Axes:
    """Show how the residuals of the samples that counted are spread, with a Gaussian."""
    left_out = np.count_nonzero(~light.used)
    title = f"Residuals: ± {light.sigma:.2f} grey levels; {left_out} left out"
    return histogram(ax, title, "grey levels", light.residuals[light.used])


@house()
def show_fall_off(light: PhotometricFit, ax: AxesOrNew = None) -> Axes:
    """Show the joint vignetting and light spread cosᵏα beside cos⁴α.

    Angles at which there were no samples are shaded.
    """
    share = "share of the light on the axis"
    ax = _over_angles(ax, "Light's fall-off", ALPHA, share, light.alpha_range)
    alpha = np.linspace(0, 90, 361)
    cosine = np.cos(np.deg2rad(alpha)).clip(1e-9)
    ax.plot(alpha, cosine**4, color="black", lw=1.5, ls=":", label="cos⁴ α")
    label = f"cosᵏ α, k = {light.k:.3f} ± {light.standard_errors['k']:.3f}"
    ax.plot(alpha, cosine**light.k, color=HOUSE.vermilion, label=label)
    ax.set_ylim(0, 1.05)
    ax.legend(loc="upper right")
    return ax


@house()
def show_gains(
    light: PhotometricFit, ax: AxesOrNew = None, *, distance: FloatArray
) -> Axes:
    """Show the gains with their standard errors, and how far away the sheet was.

    Parameters
    ----------
    light : PhotometricFit
    distance : (m,) float array
        Mean distance of the samples of each frame in ``light.frames``, mm.
    """
    ax = decorate(ax, "Gain of each frame", "located frame", "gain g ± s.e. [mm²]")
    known = np.isfinite(light.gain_errors)
    gains = np.where(known, light.gains, np.nan)
    ax.errorbar(light.frames, gains, light.gain_errors, **POINTS)
    ax.set_ylim(bottom=0)
    ax.locator_params(axis="x", integer=True)
    _show_beside(ax, light.frames, distance, "mean distance of the sheet [mm]")
    return ax


@house()
def show_brdf(
    light: PhotometricFit,
    ax: AxesOrNew = None,
    *,
    samples: Samples | None = None,
    title: str = "BRDF of the paper",
) -> Axes:
    """Show the BRDF at its nodes with standard errors, beside a matt surface.

    Parameters
    ----------
    light : PhotometricFit
    samples : Samples, optional
        Those of the fit; how many lie at each angle is then drawn below.
    """
    theta, relative, errors = light.relative_brdf()
    relation = "$f_r$ relative to the pinned node"
    ax = _over_angles(ax, title, "incidence θ [°]", relation, theta[[0, -1]])
    ax.axhline(1, color="black", lw=1.5, ls=":", label="Lambertian")
    ax.errorbar(np.rad2deg(theta), relative, errors, label="fitted ± 1 s.e.", **POINTS)
    ax.margins(y=0.3)
    if samples is not None:
        incidence = np.arccos(np.minimum(samples.cos_theta[light.used], 1))
        _show_counts(ax, *np.histogram(np.rad2deg(incidence), 30, (0, 90)))
    ax.legend(loc="upper right")
    return ax


@house()
def show_scores(scores: AngleErrors, ax: AxesOrNew = None) -> Axes:
    """Show by how much the measured fall-off differs from the model's, and by how many samples."""
    ax = decorate(ax, "Error of the fall-off", ALPHA, "measured/modelled light - 1 [%]")
    edges = np.rad2deg(scores.edges)
    half = np.diff(edges) / 2
    # Of a few samples too little is known to be drawn.
    error = 100 * np.where(scores.count >= LEAST_SCORED, scores.error, np.nan)
    ax.axhline(0, color="black", lw=1.2)
    middle = edges[:-1] + half
    spread = 100 * scores.standard_error
    ax.errorbar(middle, error, spread, half, ls="none", **POINTS)
    ax.margins(y=0.3)
    _show_counts(ax, scores.count, edges)
    ax.set(xlim=(0, edges[-1]), xticks=range(0, int(edges[-1]) + 1, 15))
    ax.legend(loc="upper right")
    return ax


@house()
def show_ridge(
    fits: Sequence[PhotometricFit],
    ax: AxesOrNew = None,
    title: str = "What the samples know of γ",
) -> Axes:
    """Show how well fits with γ held at several values explain the samples, and the k that goes with each."""
    ax = decorate(ax, title, "γ", "σ of residuals [grey levels]")
    gammas = [fit.photometry.gamma for fit in fits]
    ax.plot(gammas, [fit.sigma for fit in fits], "o-", color=HOUSE.vermilion)
    ks = [fit.photometry.k for fit in fits]
    _show_beside(ax, gammas, ks, "k that goes with it [1]")
    return ax


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
        show_sampling(image, samples[here], session.camera, sampling, used=used)
        show_light_residuals(light, residuals)
        show_fall_off(light, fall_off)
        distance = mean_distances(samples, light.frames)
        show_gains(light, gains, distance=distance)
        show_brdf(light, brdf, samples=samples)
        show_scores(light.errors_by_angle(samples), scores)
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
            values = fall_off_uncertainty(light, session.camera)
            seen = light.alpha_range[1]
            _show_sigma("σ of μ′", values, session.camera, seen, axes[-1])
    return figure
