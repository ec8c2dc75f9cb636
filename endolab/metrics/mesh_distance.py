"""How far a mesh is from another, by Open3D."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from endolab._extras import need
from endolab.model.mesh import Mesh
from endolab.numerics.arrays import FloatArray


@dataclass(frozen=True)
class SurfaceDistance:
    """How far a mesh is from the true surface."""

    distance: (
        FloatArray  # (n,), from each vertex to the nearest point of the true surface, mm
    )
    mean: float  # of the distances, mm
    median: float
    percentile_95: float


# Open3D ---------------------------------------------------------------------------------
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


def caster(vertices: FloatArray, triangles: NDArray) -> Any:
    """Open3D's scene of one mesh, for rays and nearest points."""
    open3d = load_open3d()
    made = open3d.t.geometry.RaycastingScene()
    made.add_triangles(
        open3d.core.Tensor(np.ascontiguousarray(vertices, dtype=np.float32)),
        open3d.core.Tensor(np.ascontiguousarray(triangles, dtype=np.uint32)),
    )
    return made


def to_open3d(mesh: Mesh) -> Any:
    """Make an ``open3d.geometry.TriangleMesh`` with colours and normals."""
    open3d = load_open3d()
    made = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(mesh.vertices),
        open3d.utility.Vector3iVector(mesh.triangles),
    )
    made.vertex_colors = open3d.utility.Vector3dVector(mesh.colours)
    made.vertex_normals = open3d.utility.Vector3dVector(mesh.normals)
    return made


def distance_to(
    mesh: Mesh,
    truth: Mesh | tuple[FloatArray, NDArray] | FloatArray,
    scale: float | None = None,
) -> SurfaceDistance:
    """Measure how far a mesh is from the true surface, from its vertices to what is nearest there.

    Parameters
    ----------
    mesh : Mesh
    truth : Mesh, pair of (V, 3) float and (T, 3) int arrays, or (..., 3) float array
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
    own = mesh.vertices * (1.0 if scale is None else scale)
    if isinstance(truth, Mesh | tuple):
        vertices, triangles = (
            (truth.vertices, truth.triangles) if isinstance(truth, Mesh) else truth
        )
        size = len(triangles)
    else:
        vertices = np.asarray(truth, dtype=np.float64).reshape(-1, 3)
        vertices = vertices[np.isfinite(vertices).all(axis=-1)]
        triangles = None
        size = len(vertices)
    if not (len(own) and size):
        raise ValueError(
            f"nothing to measure: the mesh has {len(own)} vertices, the truth {size} parts"
        )
    if triangles is None:
        distance = scipy.spatial.cKDTree(vertices).query(own)[0]
    else:
        place = load_open3d().core.Tensor(own.astype(np.float32))
        distance = (
            caster(vertices, triangles).compute_distance(place).numpy().astype(np.float64)
        )
    mean = np.mean(distance)
    median = np.median(distance)
    most = np.percentile(distance, 95)
    return SurfaceDistance(distance, float(mean), float(median), float(most))
