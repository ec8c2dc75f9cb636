"""A surface of triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from endolab.numerics.arrays import FloatArray, IndexArray


@dataclass(frozen=True)
class Mesh:
    """A surface made of triangles.

    Attributes
    ----------
    vertices : (n, 3) float array
        In the camera frame: x right, y down, z forward.
    triangles : (m, 3) int array
        Three vertices each, counterclockwise as the camera sees them.
    colours : (n, 3) float array
        R, G, B in [0, 1].
    normals : (n, 3) float array
        Unit normals, towards the camera.
    unit : str
        Of the vertices.
    """

    vertices: FloatArray
    triangles: IndexArray
    colours: FloatArray
    normals: FloatArray
    unit: str = "mm"


def triangle_normals(corners: FloatArray) -> FloatArray:
    """Normals of triangles (m, 3, 3), as long as twice their areas."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def vertex_normals(vertices: FloatArray, triangles: IndexArray) -> FloatArray:
    """Unit normals of the vertices: those of the triangles around, weighted by area."""
    towards = triangle_normals(vertices[triangles])
    total = np.stack(
        [
            sum(np.bincount(triangles[:, i], towards[:, axis], len(vertices)) for i in range(3))
            for axis in range(3)
        ],
        axis=-1,
    )
    # No sum is 0: seen from the camera, every triangle at a vertex has it in its plane.
    return total / np.maximum(np.linalg.norm(total, axis=-1, keepdims=True), np.finfo(float).tiny)
