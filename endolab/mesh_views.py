"""Meshes on the screen: a window to turn them in, or a picture from the side where none opens."""

from __future__ import annotations

import os
import sys

import numpy as np
from matplotlib.axes import Axes

from endolab.meshes import Mesh, caster, facing, load_open3d, to_open3d
from endolab.operators import FloatArray
from endolab.side_view import bounds, lit, mark_camera, to_viewer
from endolab.style import BACKDROP, house, new_axes, scale_bar


def show_mesh(
    mesh: Mesh,
    ax: Axes | None = None,
    *,
    angle: float = 30.0,
    elevation: float = 20.0,
    title: str = "Surface from the side",
) -> Axes | None:
    """Show a mesh: in a window to turn it in, or as a picture.

    Parameters
    ----------
    mesh : Mesh
    ax : Axes, optional
        If given, the picture is drawn there and no window opens.
    angle, elevation : float
        Of the picture: how far the viewer stands to the left of the optical axis and above it,
        degrees.
    title : str

    Returns
    -------
    Axes or None
        None after the window has been closed. Where none can open, a sentence says so and the
        axes are those of a new figure.

    Raises
    ------
    OSError
        In one sentence, if Open3D does not import.
    """
    if ax is None:
        if _show_window(mesh, title):
            return None
        print("No window can open here, so this is a picture of the mesh; `angle` and `elevation` turn it.")
    return _draw(mesh, ax, angle, elevation, title)


def _show_window(mesh: Mesh, title: str) -> bool:
    """Open a window and wait until it is closed; False if it does not open."""
    open3d = load_open3d()
    on_linux = sys.platform.startswith("linux")
    if on_linux and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return False
    quiet = open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error)
    window = open3d.visualization.Visualizer()
    with quiet:
        if not window.create_window(window_name=title, width=1200, height=900):
            return False
        try:
            window.add_geometry(to_open3d(mesh))
            view = window.get_view_control()
            view.set_front([-0.5, -0.35, -0.8])  # from behind the camera, to its left and above it
            view.set_up([0, -1, 0])
            window.run()
        finally:
            window.destroy_window()
    return True


def _draw(mesh: Mesh, ax: Axes | None, angle: float, elevation: float, title: str) -> Axes:
    with house():
        ax = new_axes(ax)
        if len(mesh.triangles):
            picture, extent = render_side(mesh, angle=angle, elevation=elevation, background=BACKDROP)
            ax.imshow(picture, extent=extent, interpolation="antialiased")
            scale_bar(ax, extent[1] - extent[0], mesh.unit)
        mark_camera(ax, title)
    return ax


def render_side(
    mesh: Mesh,
    *,
    angle: float = 30.0,
    elevation: float = 20.0,
    width: int = 960,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[FloatArray, tuple[float, float, float, float]]:
    """Render a mesh from beside the camera, with relief; on the processor, no display is needed.

    Parameters
    ----------
    mesh : Mesh
        With at least one triangle.
    angle, elevation : float
        How far the viewer stands to the left of the optical axis and above it, degrees.
    width : int
        Of the picture, pixels.
    background : three floats
        R, G, B.

    Returns
    -------
    picture : (height, width, 3) float array
        In [0, 1]. A parallel projection; what the viewer would see from behind is not drawn.
    extent : four floats
        Left, right, bottom, top of the picture in the mesh's unit, the camera being at 0, 0.
    """
    turn = to_viewer(angle, elevation)
    vertices, away = mesh.vertices @ turn.T, -mesh.normals @ turn.T
    low, high = bounds(vertices[:, :2], np.linalg.norm(vertices, axis=-1))
    margin = 0.05 * (high - low).max()
    low, high = low - margin, high + margin * np.array([1, 2])  # the scale bar's place
    pixel = (high - low)[0] / width
    height = int(np.clip(round((high - low)[1] / pixel), width // 4, 2 * width))
    x, y = np.meshgrid(low[0] + pixel * (np.arange(width) + 0.5), low[1] + pixel * (np.arange(height) + 0.5))
    rays = np.zeros((height, width, 6), dtype=np.float32)
    rays[..., 0], rays[..., 1], rays[..., 2], rays[..., 5] = x, y, vertices[:, 2].min() - 1, 1
    seen = mesh.triangles[facing(vertices[mesh.triangles])[:, 2] < 0]
    picture = np.empty((height, width, 3))
    picture[:] = background
    if len(seen):
        hit = caster(vertices, seen).cast_rays(load_open3d().core.Tensor(rays))
        met = np.isfinite(hit["t_hit"].numpy())
        corners = seen[hit["primitive_ids"].numpy()[met]]
        u, v = np.moveaxis(hit["primitive_uvs"].numpy()[met].astype(np.float64), -1, 0)
        weights = np.stack([1 - u - v, u, v], axis=-1)[..., None]
        normal = (weights * away[corners]).sum(axis=1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        picture[met] = lit((weights * mesh.colours[corners]).sum(axis=1), normal)
    return picture, (low[0], high[0], low[1] + pixel * height, low[1])
