"""A mesh as Open3D has it, which measures how far it is from another, and much else."""

from typing import Any

from endolab._extras import need
from endolab.model.mesh import Mesh


def to_open3d(mesh: Mesh) -> Any:
    """Make an ``open3d.geometry.TriangleMesh`` with colours and normals.

    OSError in one sentence, if Open3D does not import.
    """
    need("open3d")
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise OSError(
            f"Open3D does not import ({error}); on Debian install libusb-1.0-0"
        ) from error
    vectors = open3d.utility.Vector3dVector
    triangles = open3d.utility.Vector3iVector(mesh.triangles)
    made = open3d.geometry.TriangleMesh(vectors(mesh.vertices), triangles)
    made.vertex_colors = vectors(mesh.colours)
    made.vertex_normals = vectors(mesh.normals)
    return made
