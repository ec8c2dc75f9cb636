"""A surface seen from beside the camera: the view, the light, and a depth map's surface in it."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from endolab.numerics.arrays import FloatArray
from endolab.workbench.plots.scales import brighten, in_colour
from endolab.workbench.plots.style import HOUSE, house, new_axes, scale_bar


@dataclass(frozen=True)
class CloudLook:
    """What is drawn of a surface from the side, and how it is lit; chosen by eye."""

    columns: int = 320  # more cost time and show no more
    jump: float = 1.25  # neighbours whose distances differ by more are not joined
    # Cosine to the line of sight below which a patch joins the two sides of a contour.
    edge_on: float = 0.15
    farthest: float = 8.0  # median distances that the view reaches
    # Over the viewer's left shoulder.
    to_lamp: tuple[float, float, float] = (-0.35, 0.35, 0.87)


CLOUD = CloudLook()


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
    lift: bool = True,
) -> Axes:
    """Show a surface from beside the camera, in its picture's colours and with relief.

    Parameters
    ----------
    points : (H, W, 3) float array
        Surface points in the camera frame, in `unit`; nan where unknown.
    colours : (H, W, 3) or (H, W) float array, in [0, 1]
    angle, elevation : float
        How far the viewer stands to the left of the optical axis and above it, degrees.
    unit, title : str
    lift : bool
        Make the dark of a frame brighter; not for a map whose colours have a meaning.

    Notes
    -----
    A parallel projection. What the viewer would see from behind is not drawn, so that a tube
    lies open, and neither are jumps in depth nor what the camera sees edge-on.
    """
    ax = new_axes(ax)
    step = -(-points.shape[1] // CLOUD.columns)
    points = points[::step, ::step]
    colours = np.clip(colours[::step, ::step], 0, 1)

    def corners(a: FloatArray) -> FloatArray:
        return np.stack([a[:-1, :-1], a[:-1, 1:], a[1:, 1:], a[1:, :-1]], axis=2)

    patch = corners(points @ _to_viewer(angle, elevation).T)
    distance = corners(np.linalg.norm(points, axis=-1))
    # Rows and columns turn clockwise around a patch for the camera; so they must for the viewer.
    normal = np.cross(patch[:, :, 2] - patch[:, :, 0], patch[:, :, 3] - patch[:, :, 1])
    sight = patch.mean(axis=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
        kept = (normal[..., 2] > 0) & (
            distance.max(axis=-1) < CLOUD.jump * distance.min(axis=-1)
        )
        kept &= np.abs(np.sum(normal * sight, axis=-1)) > CLOUD.edge_on
    colour = in_colour(colours)[:-1, :-1][kept]
    _show_patches(
        ax, patch[kept], colour, normal[kept], distance[kept].max(axis=-1), unit, lift
    )
    _mark_camera(ax, title)
    return ax


def _show_patches(
    ax: Axes,
    patches: FloatArray,
    colours: FloatArray,
    away: FloatArray,
    distance: FloatArray,
    unit: str,
    lift: bool,
) -> None:
    """Draw flat patches, the farthest first, with relief and a scale bar.

    `patches`, (n, corners, 3), and `away`, (n, 3), their unit normals that point away from the viewer, are in
    the viewer's frame; `colours`, (n, 3); `distance`, (n,), from the camera.
    """
    if not len(patches):
        return
    order = np.argsort(-patches[..., 2].mean(axis=-1))
    light = 0.4 + 0.6 * np.clip(away @ CLOUD.to_lamp, 0, 1)
    faces = ((brighten(colours) if lift else colours) * light[:, None])[order]
    # An array: Matplotlib takes several times as long over a list.
    flat = patches[order, :, :2]
    look = {"facecolors": faces, "edgecolors": faces, "linewidths": 0.4, "rasterized": True}
    drawn = PolyCollection(flat, **look)  # type: ignore[arg-type]
    ax.add_collection(drawn, autolim=False)
    low, high = _bounds(patches[..., :2], distance)
    # Room for the camera's name above, and for the bar below.
    ax.update_datalim(
        np.stack([low - (high - low) * [0, 0.12], high + (high - low) * [0, 0.12]])
    )
    ax.autoscale_view()
    scale_bar(ax, high[0] - low[0], unit)


def _to_viewer(angle: float, elevation: float) -> FloatArray:
    """Rotation, (3, 3), from the camera's frame to the viewer's: right, down, away."""
    yaw = np.deg2rad(angle)
    pitch = np.deg2rad(elevation)
    turn = np.array(
        [[np.cos(yaw), 0, -np.sin(yaw)], [0, 1, 0], [np.sin(yaw), 0, np.cos(yaw)]]
    )
    nod = np.array(
        [[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]]
    )
    return nod @ turn


def _bounds(seen: FloatArray, distance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least and greatest right and down, (2,) each, of what is near, the camera included.

    `seen`, (n, ..., 2), are places in the viewer's frame, `distance`, (n,), their distances from the
    camera: a plane that runs to the horizon must not make what is near small.
    """
    nearby = seen[distance <= CLOUD.farthest * np.median(distance)].reshape(-1, 2)
    return np.minimum(nearby.min(axis=0), 0), np.maximum(nearby.max(axis=0), 0)


def _mark_camera(ax: Axes, title: str) -> None:
    """Finish the axes of a view: no ticks, for a scale bar says the size; the camera at 0."""
    if not ax.yaxis_inverted():
        ax.invert_yaxis()
    ax.plot(0, 0, marker="o", color="white", ms=5)
    # In a corner, for around the camera there are walls.
    ax.annotate(
        "camera",
        (0, 0),
        xytext=(0.97, 0.97),
        textcoords="axes fraction",
        ha="right",
        va="top",
        color="white",
        arrowprops={"arrowstyle": "-", "color": "white", "lw": 0.8, "shrinkB": 4},
    )
    ax.set_title(title)
    ax.set(xticks=[], yticks=[], facecolor=HOUSE.backdrop)
    ax.set_aspect("equal", adjustable="datalim")
