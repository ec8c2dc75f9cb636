"""A surface seen from beside the camera: the view, the light, and the triangles in it."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from scipy.spatial.transform import Rotation

from endolab.model.mesh import triangle_normals
from endolab.numerics.arrays import FloatArray
from endolab.solvers.mesh import make_mesh
from endolab.workbench.plots.scales import brighten, in_colour
from endolab.workbench.plots.style import AxesOrNew, decorate, house

# Chosen by eye.
COLUMNS = 240  # more cost time and show no more
FARTHEST = 8.0  # median distances that the view reaches
# The viewer stands to the left of the optical axis and above it.
TO_VIEWER = Rotation.from_euler("yx", [-30, 20], degrees=True).as_matrix()
TO_LAMP = np.array([-0.35, 0.35, 0.87])  # over the viewer's left shoulder
TO_LAMP /= np.linalg.norm(TO_LAMP)


@house()
def show_cloud(
    points: FloatArray,
    colours: FloatArray,
    ax: AxesOrNew = None,
    *,
    unit: str = "mm",
) -> Axes:
    """Show a surface from beside the camera, in its picture's colours and with relief.

    Parameters
    ----------
    points : (H, W, 3) float array
        Surface points in the camera frame, in `unit`; nan where unknown.
    colours : (H, W, 3) or (H, W) float array, in [0, 1]
    unit : str

    Notes
    -----
    A parallel projection. What the viewer would see from behind is not drawn, so that a tube
    lies open, and neither are jumps in depth nor what the camera sees edge-on, see `make_mesh`.
    """
    title = "Surface from the side"
    ax = decorate(ax, title, f"to the right [{unit}]", f"down [{unit}]", grid=False)
    ax.plot(0, 0, "o", color="white", label="camera")
    ax.legend(loc="upper right", labelcolor="white")
    ax.set_facecolor("#171A1F")
    ax.set_aspect("equal", adjustable="datalim")
    ax.yaxis.set_inverted(True)
    step = -(-points.shape[1] // COLUMNS)
    mesh = make_mesh(points[::step, ::step], in_colour(colours[::step, ::step]))
    # To the viewer's right, down and away.
    corners = (mesh.vertices @ TO_VIEWER.T)[mesh.triangles]
    normals = -triangle_normals(corners)  # away from the camera, as z
    seen = normals[:, 2] > 0
    if not seen.any():
        return ax
    shown = corners[seen]
    order = np.argsort(-shown[:, 0, 2])  # the farthest first
    lengths = np.linalg.norm(normals[seen], axis=1, keepdims=True)
    light = 0.4 + 0.6 * (normals[seen] / lengths @ TO_LAMP).clip(0, 1)
    faces = brighten(mesh.colours[mesh.triangles[seen, 0]]) * light[:, None]
    # An array: Matplotlib takes several times as long over a list.
    flat: Any = shown[order, :, :2]
    drawn = PolyCollection(flat, facecolors=faces[order], edgecolors="face")
    drawn.set(linewidths=0.4, rasterized=True)
    ax.add_collection(drawn, autolim=False)
    # A plane that runs to the horizon must not make what is near small.
    far = np.linalg.norm(shown[:, 0], axis=1)
    near = shown[far <= FARTHEST * np.median(far), :, :2]
    ax.update_datalim(near.reshape(-1, 2))
    ax.margins(y=0.1)  # for the camera's name
    ax.autoscale_view()
    return ax
