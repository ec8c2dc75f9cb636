"""A surface seen from beside the camera: the view, the light, and a depth map's surface in it."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from endolab.operators import FloatArray
from endolab.style import BACKDROP, house, new_axes, scale_bar

VIEW_WIDTH = 320  # columns of a surface that `show_cloud` draws; more cost time and show no more
JUMP = 1.25  # neighbours whose distances differ by more are not joined
EDGE_ON = 0.15  # cosine to the line of sight below which a patch joins the two sides of a contour
FARTHEST = 8.0  # median distances that the view reaches
LAMP = np.array([-0.35, 0.35, 0.87])  # over the left shoulder of the viewer


def to_viewer(angle: float, elevation: float) -> FloatArray:
    """Turn the camera frame into the viewer's: right, down, away.

    Parameters
    ----------
    angle, elevation : float
        How far the viewer stands to the left of the optical axis and above it, degrees.

    Returns
    -------
    (3, 3) float array
        A rotation about the camera.
    """
    yaw, pitch = np.deg2rad(angle), np.deg2rad(elevation)
    turn = np.array([[np.cos(yaw), 0, -np.sin(yaw)], [0, 1, 0], [np.sin(yaw), 0, np.cos(yaw)]])
    nod = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    return nod @ turn


def lit(colours: FloatArray, away: FloatArray) -> FloatArray:
    """Give colours the relief of a lamp that stands by the viewer.

    Parameters
    ----------
    colours : (n, 3) float array
        R, G, B in [0, 1].
    away : (n, 3) float array
        Unit normals in the viewer's frame that point away from the viewer.

    Returns
    -------
    (n, 3) float array
    """
    if not len(colours):
        return colours
    # The far end of a lumen is dark in any frame: lift it, or relief drowns.
    colours = (colours / max(np.percentile(colours, 99), 1e-6)).clip(0, 1) ** 0.6
    return colours * (0.4 + 0.6 * np.clip(away @ LAMP, 0, 1)[:, None])


def bounds(seen: FloatArray, distance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least and greatest right and down of what is near, the camera included.

    Parameters
    ----------
    seen : (n, ..., 2) float array
        Places in the viewer's frame.
    distance : (n,) float array
        From the camera. A plane that runs to the horizon must not make what is near small.

    Returns
    -------
    low, high : (2,) float arrays
    """
    near = seen[distance <= FARTHEST * np.median(distance)].reshape(-1, 2)
    return np.minimum(near.min(axis=0), 0), np.maximum(near.max(axis=0), 0)


def mark_camera(ax: Axes, title: str) -> None:
    """Finish the axes of a view: no ticks, for a scale bar says the size; the camera at 0."""
    if not ax.yaxis_inverted():
        ax.invert_yaxis()
    ax.plot(0, 0, marker="o", color="white", ms=5)
    ax.annotate("camera", (0, 0), xytext=(0, 7), textcoords="offset points", color="white", ha="center")
    ax.set_title(title)
    ax.set(xticks=[], yticks=[], facecolor=BACKDROP)
    ax.set_aspect("equal", adjustable="datalim")


@house()
def show_cloud(
    points: FloatArray,
    colours: FloatArray,
    ax: Axes | None = None,
    *,
    angle: float = 30.0,
    elevation: float = 20.0,
    unit: str = "mm",
    title: str = "Surface from the side",
) -> Axes:
    """Show a surface from beside the camera, in its picture's colours and with relief.

    Parameters
    ----------
    points : (H, W, 3) float array
        Surface points in the camera frame; nan where unknown.
    colours : (H, W, 3) or (H, W) float array
        Of the points, in [0, 1].
    angle, elevation : float
        How far the viewer stands to the left of the optical axis and above it, degrees.
    unit : str
        Of the points.

    Notes
    -----
    A parallel projection. What the viewer would see from behind is not drawn, so that a tube
    lies open, and neither are jumps in depth nor what the camera sees edge-on.
    """
    ax = new_axes(ax)
    step = -(-points.shape[1] // VIEW_WIDTH)
    points, colours = points[::step, ::step], np.clip(colours[::step, ::step], 0, 1)

    def corners(a: FloatArray) -> FloatArray:
        return np.stack([a[:-1, :-1], a[:-1, 1:], a[1:, 1:], a[1:, :-1]], axis=2)

    patch = corners(points @ to_viewer(angle, elevation).T)
    distance = corners(np.linalg.norm(points, axis=-1))
    # Rows and columns turn clockwise around a patch for the camera; so they must for the viewer.
    normal = np.cross(patch[:, :, 2] - patch[:, :, 0], patch[:, :, 3] - patch[:, :, 1])
    sight = patch.mean(axis=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
        kept = (normal[..., 2] > 0) & (distance.max(axis=-1) < JUMP * distance.min(axis=-1))
        kept &= np.abs(np.sum(normal * sight, axis=-1)) > EDGE_ON
    patch = patch[kept]
    colour = colours[:-1, :-1][kept]
    colour = np.repeat(colour[:, None], 3, axis=-1) if colour.ndim == 1 else colour
    if len(patch):
        colour = lit(colour, normal[kept])
        order = np.argsort(-patch[..., 2].mean(axis=-1))
        faces, flat = colour[order], patch[order, :, :2]
        patches = PolyCollection(flat, facecolors=faces, edgecolors=faces, linewidths=0.4, rasterized=True)
        ax.add_collection(patches, autolim=False)
        low, high = bounds(patch[..., :2], distance[kept].max(axis=-1))
        ax.update_datalim(np.stack([low, high + (high - low) * [0, 0.12]]))  # the bar's place
        ax.autoscale_view()
        scale_bar(ax, high[0] - low[0], unit)
    mark_camera(ax, title)
    return ax
