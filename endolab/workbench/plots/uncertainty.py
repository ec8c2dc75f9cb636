"""Figures of how well a calibration is known over the picture: its rays, and the light along them.

As in `maps`, every function but the page draws into the axes ``ax`` it is given, or into new ones, under
``title``, and returns the axes.
"""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from endolab.calibration.geometric.fit import GeometricFit
from endolab.calibration.photometric.result import PhotometricFit
from endolab.calibration.session import Session
from endolab.calibration.uncertainty import (
    fall_off_uncertainty,
    ray_uncertainty,
    values_within,
)
from endolab.model.cameras import Camera
from endolab.numerics.arrays import FloatArray
from endolab.workbench.plots.scales import common_limit
from endolab.workbench.plots.style import (
    HOUSE,
    house,
    legend_below,
    page,
    show_values,
)


def ring(camera: Camera, angle: float) -> FloatArray:
    """Where the picture shows rays of an angle off the axis, rad: (241, 2), column and row, px."""
    turn = np.linspace(0, 2 * np.pi, 241)
    out = np.sin(angle)
    along = np.full_like(turn, np.cos(angle))
    return camera.project(
        np.stack([out * np.cos(turn), out * np.sin(turn), along], axis=-1)
    )


def _show(
    values: FloatArray,
    camera: Camera,
    seen: float,
    ax: Axes | None,
    title: str,
    label: str,
    ends: str,
    limit: float | None = None,
) -> Axes:
    """Show a map at `places` with the ring of the largest angle seen."""
    # Colours end at the 90th percentile of what lies within the angles seen: the rim is far worse.
    if limit is None:
        limit = common_limit([values_within(values, camera, seen)], 90)
    extent = (-0.5, camera.width - 0.5, camera.height - 0.5, -0.5)
    look: Any = {"cmap": "viridis", "extent": extent}
    ax = show_values(values, ax, title, label, (0.0, limit), **look)
    ax.locator_params(nbins=4)
    name = f"{ends}, {np.rad2deg(seen):.0f}°"
    rim = ring(camera, seen).T
    (line,) = ax.plot(*rim, color=HOUSE.vermilion, lw=2.2, ls="--", label=name)
    line.set_clip_path(ax.patch)
    ax.set(xlim=extent[:2], ylim=extent[2:])
    legend_below(ax)
    return ax


@house()
def show_ray_uncertainty(
    geometry: GeometricFit,
    ax: Axes | None = None,
    *,
    limit: float | None = None,
    title: str = "Rays, a common turn apart",
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
    words = (title, "σ of the ray [mrad]", "farthest feature")
    return _show(known.mrad_shape, camera, seen, ax, *words, limit)


@house()
def show_fall_off_uncertainty(
    light: PhotometricFit, camera: Camera, ax: Axes | None = None
) -> Axes:
    """Show how well the light along each ray is known, relative to that on the axis.

    Parameters
    ----------
    light : PhotometricFit
    camera : Camera
    """
    values = fall_off_uncertainty(light, camera)
    words = ("Light's fall-off μ′", "σ of μ′ [%]", "farthest sample")
    return _show(values, camera, light.alpha_range[1], ax, *words)


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
