"""Depth maps, clouds and meshes in files: npz, PLY, OBJ."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from endolab.io.atomic import PathLike, write_atomically
from endolab.model.mesh import Mesh
from endolab.numerics.arrays import BoolArray, FloatArray


def as_ply(
    points: FloatArray,
    normals: FloatArray,
    colours: FloatArray,
    triangles: NDArray | None = None,
    comments: Sequence[str] = (),
) -> bytes:
    """Encode points, and triangles between them if there are any, as binary PLY.

    Parameters
    ----------
    points, normals : (n, 3) float arrays
    colours : (n, 3) float array
        R, G, B; values outside [0, 1] are clipped.
    triangles : (m, 3) int array, optional
        Numbers of points, from 0.
    comments : sequence of str
        Lines of the header.

    Returns
    -------
    bytes
    """
    vertices = np.empty(len(points), dtype=[("place", "<f4", 6), ("colour", "u1", 3)])
    vertices["place"][:, :3], vertices["place"][:, 3:] = points, normals
    vertices["colour"] = np.round(np.clip(colours, 0, 1) * 255)
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {text}" for text in comments)]
    header += [f"element vertex {len(points)}"]
    header += [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
    header += [f"property uchar {name}" for name in ("red", "green", "blue")]
    body = vertices.tobytes()
    if triangles is not None:
        faces = np.empty(len(triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
        faces["count"], faces["corners"] = 3, triangles
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        body += faces.tobytes()
    return "\n".join([*header, "end_header", ""]).encode() + body


def write_cloud(path: PathLike, points: FloatArray, normals: FloatArray, colours: FloatArray) -> None:
    """Write a point cloud as binary PLY.

    Parameters
    ----------
    path : path
    points : (n, 3) float array
        Camera frame, mm or relative.
    normals : (n, 3) float array
    colours : (n, 3) float array
        R, G, B in [0, 1].
    """
    write_atomically(path, as_ply(points, normals, colours))


# Results --------------------------------------------------------------------------------
def save_depth(
    path: PathLike, distance: FloatArray, z: FloatArray, normals: FloatArray, mask: BoolArray, metric: bool
) -> None:
    """Write `depth.npz`: distance and z (H, W), normals (H, W, 3), mask, metric."""
    try:
        with open(path, "wb") as stream:
            np.savez_compressed(
                stream,
                distance=distance.astype(np.float32),
                z=z.astype(np.float32),
                normals=normals.astype(np.float32),
                mask=mask,
                metric=np.array(metric),
            )
    except OSError as error:
        Path(path).unlink(missing_ok=True)
        raise OSError(f"cannot write {path}: {error.strerror or error}") from error


FRAME = "camera frame: x right, y down, z forward"


# Writing --------------------------------------------------------------------------------
def write_mesh(path: PathLike, mesh: Mesh) -> None:
    """Write a mesh with its colours and normals.

    Parameters
    ----------
    path : path
        Its suffix says how: .ply (binary) or .obj (text, colours beside the vertices).
    mesh : Mesh

    Raises
    ------
    ValueError
        If the suffix is another.
    OSError
        In one sentence, if the file cannot be written; then there is none.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in WRITERS:
        raise ValueError(f"{path}: meshes are written as .ply or .obj, found {suffix or 'no suffix'}")
    write_atomically(path, WRITERS[suffix](mesh))


def _as_ply(mesh: Mesh) -> bytes:
    comments = f"unit: {mesh.unit}", FRAME
    return as_ply(mesh.vertices, mesh.normals, mesh.colours, mesh.triangles, comments)


def _as_obj(mesh: Mesh) -> bytes:
    text = io.BytesIO()
    text.write(f"# unit: {mesh.unit}\n# {FRAME}\n".encode())
    np.savetxt(text, np.hstack([mesh.vertices, mesh.colours]), fmt="v %.6g %.6g %.6g %.4f %.4f %.4f")
    np.savetxt(text, mesh.normals, fmt="vn %.5f %.5f %.5f")
    np.savetxt(text, np.repeat(mesh.triangles + 1, 2, axis=1), fmt="f %d//%d %d//%d %d//%d")
    return text.getvalue()


WRITERS: dict[str, Callable[[Mesh], bytes]] = {".ply": _as_ply, ".obj": _as_obj}
