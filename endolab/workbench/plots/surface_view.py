"""A surface seen from beside the camera: the view, the light, and a depth map's surface in it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

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
    colours = in_colour(np.clip(colours[::step, ::step], 0, 1))
    # Turned right, then down: to the viewer's right, down and away.
    turn = Rotation.from_euler("yx", [-angle, elevation], degrees=True)
    patches = _corners(points @ turn.as_matrix().T)
    distances = _corners(np.linalg.norm(points, axis=-1))
    # Rows and columns turn clockwise around a patch for the camera; so they must for the viewer.
    diagonals = patches[:, :, 2:] - patches[:, :, :2]
    normals = _unit(np.cross(diagonals[:, :, 0], diagonals[:, :, 1]))
    sight = _unit(patches.mean(axis=2))
    farthest = distances.max(axis=-1)
    seen = (normals[..., 2] > 0) & (farthest < CLOUD.jump * distances.min(axis=-1))
    seen &= np.abs(np.sum(normals * sight, axis=-1)) > CLOUD.edge_on
    if seen.any():
        light = 0.4 + 0.6 * np.clip(normals[seen] @ CLOUD.to_lamp, 0, 1)
        faces = colours[:-1, :-1][seen]
        faces = (brighten(faces) if lift else faces) * light[:, None]
        _show_patches(ax, patches[seen], faces)
        low, high = _bounds(patches[seen][..., :2], farthest[seen])
        # Room for the camera's name above, and for the bar below.
        room = (high - low) * [0, 0.12]
        ax.update_datalim(np.stack([low - room, high + room]))
        ax.autoscale_view()
        scale_bar(ax, high[0] - low[0], unit)
    _mark_camera(ax, title)
    return ax


def _corners(values: NDArray) -> NDArray:
    """Values, (H, W, ...), at the corners of all patches between four pixels, clockwise: (h, w, 4, ...)."""
    above = [values[:-1, :-1], values[:-1, 1:]]
    below = [values[1:, 1:], values[1:, :-1]]
    return np.stack(above + below, axis=2)


def _unit(vectors: FloatArray) -> FloatArray:
    """Vectors, (..., 3), made of length 1; nan if they have none."""
    with np.errstate(invalid="ignore"):
        return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _show_patches(ax: Axes, patches: FloatArray, faces: FloatArray) -> None:
    """Draw flat patches, (n, corners, 3) in the viewer's frame, in colours, (n, 3); the farthest first."""
    order = np.argsort(-patches[..., 2].mean(axis=-1))
    faces = faces[order]
    look: Any = {"linewidths": 0.4, "rasterized": True}
    # An array: Matplotlib takes several times as long over a list.
    flat: Any = patches[order, :, :2]
    drawn = PolyCollection(flat, facecolors=faces, edgecolors=faces, **look)
    ax.add_collection(drawn, autolim=False)


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
