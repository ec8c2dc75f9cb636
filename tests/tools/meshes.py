"""Meshes of scenes, for path tracing: vertices (V, 3), mm, and triangles (T, 3)."""

import numpy as np

from endolab.synthetic.scenes import SIDEWAYS, Colon


def mesh_of(scene, size):
    """The whole mesh of a cavity or a colon, of about `size` steps a side."""
    return _colon_mesh(scene, size) if isinstance(scene, Colon) else scene.mesh(size)


def grid_triangles(rows, columns):
    """Triangles (T, 3) that join the points of a grid, row by row."""
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    upper = np.stack([corner, corner + 1, corner + columns], axis=-1)
    lower = np.stack([corner + 1, corner + columns + 1, corner + columns], axis=-1)
    return np.concatenate([upper, lower])


def _colon_mesh(colon, size):
    """Also 60 mm of the tube behind the camera."""
    s = np.linspace(-60.0, colon.length, 2 * size)
    s = np.append(s, colon.length)
    closing = np.append(np.ones(2 * size), 0.0)
    around = np.linspace(0, 2 * np.pi, 2 * size)
    angle = 3 * (around + colon._twist * s[:, None])
    radius = (
        colon._shape(s[:, None], np.cos(angle), np.sin(angle))[0] * closing[:, None]
    )
    swing = colon._winding(s)[0][:, None]
    vertices = np.empty((2 * size + 1, 2 * size, 3))
    vertices[..., 0] = swing + radius * np.cos(around)
    vertices[..., 1] = SIDEWAYS * swing + radius * np.sin(around)
    vertices[..., 2] = s[:, None]
    return vertices.reshape(-1, 3) - colon._camera, grid_triangles(
        2 * size + 1, 2 * size
    )
