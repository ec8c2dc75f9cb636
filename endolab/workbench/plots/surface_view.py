"""A surface seen from beside the camera: the view, the light, and a depth map's surface in it."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar  # type: ignore[import-untyped]
from scipy.spatial.transform import Rotation

from endolab.numerics.arrays import FloatArray
from endolab.workbench.plots.scales import brighten, in_colour, round_length
from endolab.workbench.plots.style import AxesOrNew, decorate, house

# Chosen by eye.
COLUMNS = 320  # more cost time and show no more
JUMP = 1.25  # neighbours whose distances differ by more are not joined
EDGE_ON = (
    0.15  # cosine to the line of sight below which a patch joins the sides of a contour
)
FARTHEST = 8.0  # median distances that the view reaches
TO_LAMP = (-0.35, 0.35, 0.87)  # over the viewer's left shoulder


@house()
def show_cloud(
    points: FloatArray,
    colours: FloatArray,
    ax: AxesOrNew = None,
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
    ax = decorate(ax, title, "", "", grid=False)
    ax.plot(0, 0, "o", color="white", label="camera")
    ax.legend(loc="upper right", labelcolor="white")
    ax.set(xticks=[], yticks=[], facecolor="#171A1F")  # a scale bar says the size
    ax.set_aspect("equal", adjustable="datalim")
    ax.yaxis.set_inverted(True)
    step = -(-points.shape[1] // COLUMNS)
    # Turned right, then down: to the viewer's right, down and away.
    turn = Rotation.from_euler("yx", [-angle, elevation], degrees=True).as_matrix()
    points = points[::step, ::step] @ turn.T
    # Patches between four pixels, (h, w, 4, 3), clockwise for the camera; so they must be for the viewer.
    corners = (points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1])
    patches = np.stack(corners, axis=2)
    diagonals = patches[:, :, 2:] - patches[:, :, :2]
    normals = np.cross(diagonals[:, :, 0], diagonals[:, :, 1])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    distances = np.linalg.norm(patches, axis=-1)
    farthest = distances.max(axis=-1)
    cosine = np.abs(np.sum(normals * patches[:, :, 0], axis=-1)) / farthest
    joined = (farthest < JUMP * distances.min(axis=-1)) & (cosine > EDGE_ON)
    seen = joined & (normals[..., 2] > 0)
    if not seen.any():
        return ax
    shown = patches[seen]
    order = np.argsort(-shown[:, 0, 2])  # the farthest first
    faces = in_colour(np.clip(colours[::step, ::step], 0, 1))[:-1, :-1][seen]
    faces = brighten(faces) if lift else faces
    faces = faces * (0.4 + 0.6 * np.clip(normals[seen] @ TO_LAMP, 0, 1))[:, None]
    # An array: Matplotlib takes several times as long over a list.
    flat: Any = shown[order, :, :2]
    drawn = PolyCollection(flat, facecolors=faces[order], edgecolors="face")
    drawn.set(linewidths=0.4, rasterized=True)
    ax.add_collection(drawn, autolim=False)
    # A plane that runs to the horizon must not make what is near small.
    near = shown[farthest[seen] <= FARTHEST * np.median(farthest[seen]), :, :2]
    ax.update_datalim(near.reshape(-1, 2))
    ax.margins(y=0.12)  # for the camera's name above, and for the bar below
    ax.autoscale_view()
    length = round_length(np.ptp(near[..., 0]) / 4)
    bar = (ax.transData, length, f"{length:g} {unit}", "lower left")
    ax.add_artist(AnchoredSizeBar(*bar, frameon=False, color="white", pad=0.8, sep=4))
    return ax
