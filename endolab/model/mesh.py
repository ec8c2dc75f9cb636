"""A surface of triangles."""

from dataclasses import dataclass

import numpy as np

from endolab.numerics.arrays import FloatArray, IndexArray


@dataclass(frozen=True, eq=False)
class Mesh:
    """A surface made of triangles."""

    vertices: FloatArray  # (n, 3), in the camera frame: x right, y down, z forward
    triangles: (
        IndexArray  # (m, 3), three vertices each, counterclockwise as the camera sees them
    )
    colours: FloatArray  # (n, 3), R, G, B in [0, 1]
    normals: FloatArray  # (n, 3), unit normals, towards the camera
    unit: str = "mm"  # of the vertices
    legend: str = ""  # what the colours say, if they are not those of a picture


def triangle_normals(corners: FloatArray) -> FloatArray:
    """Normals of triangles (m, 3, 3), as long as twice their areas."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def vertex_normals(vertices: FloatArray, triangles: IndexArray) -> FloatArray:
    """Unit normals of the vertices: those of the triangles around, weighted by area."""
    towards = triangle_normals(vertices[triangles])
    total = np.zeros_like(vertices)
    for corner in triangles.T:
        np.add.at(total, corner, towards)
    # No sum is 0: seen from the camera, every triangle at a vertex has it in its plane.
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    return total / np.maximum(length, np.finfo(float).tiny)
