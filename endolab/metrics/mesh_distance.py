"""How far a mesh is from another, by Open3D."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from endolab._extras import need
from endolab.model.mesh import Mesh
from endolab.numerics.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class SurfaceDistance:
    """How far a mesh is from the true surface."""

    distance: (
        FloatArray  # (n,), from each vertex to the nearest point of the true surface, mm
    )
    mean: float  # of the distances, mm
    median: float
    percentile_95: float


def load_open3d() -> Any:
    """Import Open3D, or say in one sentence why it cannot be."""
    need("open3d")
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise OSError(
            f"Open3D does not import ({error}); on Debian install libusb-1.0-0"
        ) from error
    return open3d


def to_open3d(mesh: Mesh) -> Any:
    """Make an ``open3d.geometry.TriangleMesh`` with colours and normals."""
    open3d = load_open3d()
    vectors = open3d.utility.Vector3dVector
    triangles = open3d.utility.Vector3iVector(mesh.triangles)
    made = open3d.geometry.TriangleMesh(vectors(mesh.vertices), triangles)
    made.vertex_colors = vectors(mesh.colours)
    made.vertex_normals = vectors(mesh.normals)
    return made


def distance_to(
    mesh: Mesh, truth: Mesh | FloatArray, scale: float | None = None
) -> SurfaceDistance:
    """Measure how far a mesh is from the true surface, from its vertices to what is nearest there.

    Parameters
    ----------
    mesh : Mesh
    truth : Mesh or (..., 3) float array
        The true surface in mm and in the same frame. An array holds
        mere points, of which the nearest counts; those that are nan are left out.
    scale : float, optional
        What to multiply the mesh by first, mm per unit; needed if it is in relative units.

    Raises
    ------
    ValueError
        If either surface is empty, or the mesh has no scale.
    OSError
        In one sentence, if the truth has triangles and Open3D does not import.
    """
    if scale is None and mesh.unit != "mm":
        raise ValueError(f"the mesh is in {mesh.unit}: give scale, the mm of one unit")
    own = mesh.vertices * (scale or 1.0)
    if isinstance(truth, Mesh):
        scene = load_open3d().t.geometry.RaycastingScene()
        triangles = truth.triangles.astype(np.uint32)
        scene.add_triangles(truth.vertices.astype(np.float32), triangles)
        distance = scene.compute_distance(own.astype(np.float32)).numpy()
    else:
        points = np.reshape(truth, (-1, 3))
        points = points[np.isfinite(points).all(axis=-1)]
        distance = scipy.spatial.cKDTree(points).query(own)[0]
    if not (distance.size and np.isfinite(distance).all()):
        raise ValueError("nothing to measure: the mesh or the truth is empty")
    median, percentile = np.percentile(distance, [50, 95]).tolist()
    distance = distance.astype(np.float64)
    return SurfaceDistance(distance, float(distance.mean()), median, percentile)
