"""Figures of how well a calibration is known over the picture: its rays, and the light along them.

As in `maps`, every function but the page draws into the axes ``ax`` it is given, or into new ones, under
``title``, and returns the axes.
"""

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
from endolab.model.schema import unknown_name
from endolab.numerics.arrays import FloatArray
from endolab.workbench.plots.style import HOUSE, colour_bar, decorate, house, new_axes

# What can be shown of rays: field of `RayUncertainty`, title and label.
RAY_MAPS = {
    "shape": ("mrad_shape", "Rays, a common turn apart", "σ of the ray [mrad]"),
    "px": ("px", "Pixel of a ray", "σ of the pixel [px]"),
}


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
    limit: float | None,
    title: str,
    label: str,
    ends: str,
) -> Axes:
    """Show a map at `places` with the ring of the largest angle seen."""
    ax = new_axes(ax)
    inside = values_within(values, camera, seen)
    # Colours end at the 90th percentile of what lies within the angles seen: the rim is far worse.
    most = (
        (float(np.percentile(inside, 90)) if inside.size else 0.0)
        if limit is None
        else limit
    )
    most = most if most > 0 else 1.0
    extent = (-0.5, camera.width - 0.5, camera.height - 0.5, -0.5)
    shown = ax.imshow(
        values, cmap="viridis", vmin=0.0, vmax=most, extent=extent, interpolation="nearest"
    )
    decorate(ax, title, "column u [px]", "row v [px]", grid=False).set_facecolor(
        HOUSE.left_out
    )
    ax.locator_params(nbins=4)
    label_of_ring = f"{ends}, {np.rad2deg(seen):.0f}°"
    (line,) = ax.plot(
        *ring(camera, seen).T, color=HOUSE.vermilion, lw=2.2, ls="--", label=label_of_ring
    )
    line.set_clip_path(ax.patch)
    ax.set(xlim=extent[:2], ylim=extent[2:])
    ax.legend(loc="upper right", frameon=True)
    colour_bar(ax, shown, label, "max" if np.any(values > most) else "neither")
    return ax


@house()
def show_ray_uncertainty(
    geometry: GeometricFit,
    ax: Axes | None = None,
    *,
    what: str = "shape",
    limit: float | None = None,
    title: str | None = None,
) -> Axes:
    """Show how well the ray of each pixel is known; beyond the dashed ring it was not seen, but follows.

    Parameters
    ----------
    geometry : GeometricFit
    what : {"shape", "px"}
        How far rays are off without the turn that all share, or how far pixels are.
    limit : float, optional
        Where the colours end, mrad or px; by default such that most of what was seen is below.
    """
    if what not in RAY_MAPS:
        raise unknown_name("what", what, tuple(RAY_MAPS))
    name, usual, label = RAY_MAPS[what]
    camera = geometry.camera
    seen = geometry.max_angle_seen
    values = getattr(ray_uncertainty(camera, geometry.covariance, max_angle=seen), name)
    title = usual if title is None else title
    return _show(values, camera, seen, ax, limit, title, label, "farthest feature")


@house()
def show_fall_off_uncertainty(
    light: PhotometricFit,
    camera: Camera,
    ax: Axes | None = None,
    *,
    limit: float | None = None,
    title: str = "Light's fall-off μ′",
) -> Axes:
    """Show how well the light along each ray is known, relative to that on the axis.

    Parameters
    ----------
    light : PhotometricFit
    camera : Camera
    limit : float, optional
        Where the colours end, %; by default such that most of what was seen is below.
    """
    values = fall_off_uncertainty(light, camera)
    return _show(
        values,
        camera,
        light.alpha_range[1],
        ax,
        limit,
        title,
        "σ of μ′ [%]",
        "farthest sample",
    )


def uncertainty_figure(session: Session) -> Figure:
    """Draw what a session knows of its rays and light on one page; ValueError if it found neither."""
    geometry = session.geometry
    light = session.light
    count = 2 * (geometry is not None) + (light is not None)
    if not count:
        raise ValueError(
            "session has no uncertainty to draw: its camera was given, its light refused"
        )
    with house(HOUSE.page_text_size):
        figure = Figure(figsize=(6.5 * count, 5), dpi=100, layout="constrained")
        axes = list(figure.subplots(1, count, squeeze=False)[0])
        if geometry is not None:
            show_ray_uncertainty(geometry, axes[0])
            show_ray_uncertainty(geometry, axes[1], what="px")
        if light is not None:
            show_fall_off_uncertainty(light, session.camera, axes[-1])
    return figure
