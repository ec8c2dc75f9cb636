"""Depth maps, clouds and meshes in files: npz, PLY, OBJ."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from endolab.io.archives import read_arrays
from endolab.io.atomic import PathLike, write_atomically
from endolab.model.mesh import Mesh
from endolab.model.ranges import RANGES
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import PATH, check_kinds

if TYPE_CHECKING:
    from endolab.reconstruction.uncertainty import Uncertainty
    from endolab.solvers.result import Result
    from endolab.synthetic.rendering import Rendered

NEAREST, FARTHEST = RANGES["distance"]
# What a depth.npz holds for each pixel.
DEPTH_MAPS = {
    "distance": (),
    "z": (),
    "normals": (3,),
}
# And, if it is known, how far that can be trusted, with `dominant_source`.
TRUSTED = (
    "sigma",
    "sigma_shape",
)


# Depth maps -----------------------------------------------------------------------------
def save_depth(
    path: PathLike,
    surface: Result | Rendered,
    metric: bool,
    uncertainty: Uncertainty | None = None,
) -> None:
    """Write `depth.npz`: distance and z (H, W), normals (H, W, 3), mask, metric.

    With `uncertainty` also sigma and sigma_shape (H, W), and dominant_source, uint8: 0 outside, 1 data,
    2 border or contour, 3 prior.
    """
    maps = {name: getattr(surface, name).astype(np.float32) for name in DEPTH_MAPS}
    maps |= {"mask": surface.mask, "metric": np.array(metric)}
    if uncertainty is not None:
        maps |= {name: getattr(uncertainty, name).astype(np.float32) for name in TRUSTED}
        maps["dominant_source"] = uncertainty.dominant_source
    content = io.BytesIO()
    np.savez_compressed(content, **maps)
    write_atomically(path, content.getvalue())


def read_depth(
    path: PathLike, needed: Sequence[str] = ("distance", "z")
) -> dict[str, np.ndarray]:
    """Read what `save_depth` wrote, whatever else is in the file; nan where a distance is not known.

    ValueError or OSError in one sentence, if it is something else, or holds what no surface has.
    """
    known = (*DEPTH_MAPS, *TRUSTED, "dominant_source", "mask", "metric")
    maps = read_arrays(path, "a depth.npz that endolab wrote", known)
    for name in needed:
        if name not in maps:
            raise ValueError(f"{path}: {name} is missing")
    size = maps["distance"].shape
    for name, values in maps.items():
        is_real = name in (*DEPTH_MAPS, *TRUSTED)
        expected = () if name == "metric" else (*size, *DEPTH_MAPS.get(name, ()))
        is_of_kind = values.dtype.kind in ("f" if is_real else "biu")
        if not is_of_kind or values.shape != expected or len(size) != 2:
            should = "a map of the size of distance" if expected else "true or false"
            raise ValueError(f"{path}: {name} is not {should}")
        if is_real:
            maps[name] = np.where(np.isfinite(values), values, np.nan)
            if np.nanmax(np.abs(maps[name]), initial=0.0) > FARTHEST:
                raise ValueError(f"{path}: {name} holds values that no surface has")
    maps["distance"][maps["distance"] < NEAREST] = np.nan
    return maps


# Clouds and meshes ----------------------------------------------------------------------
def write_cloud(
    path: PathLike, points: FloatArray, normals: FloatArray, colours: FloatArray
) -> None:
    """Write a point cloud as binary PLY: all (n, 3); camera frame, mm or relative; R, G, B in [0, 1]."""
    write_atomically(path, as_ply(points, normals, colours))


@check_kinds(path=PATH, mesh=Mesh)
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
    if suffix == ".ply":
        content = as_ply(
            mesh.vertices, mesh.normals, mesh.colours, mesh.triangles, _comments(mesh)
        )
    elif suffix == ".obj":
        content = _as_obj(mesh)
    else:
        raise ValueError(
            f"{path}: meshes are written as .ply or .obj, found {suffix or 'no suffix'}"
        )
    write_atomically(path, content)


def as_ply(
    points: FloatArray,
    normals: FloatArray,
    colours: FloatArray,
    triangles: NDArray | None = None,
    comments: Sequence[str] = (),
) -> bytes:
    """Encode points, and triangles between them if there are any, as binary PLY.

    `triangles`, (m, 3), hold numbers of points, from 0; the others are (n, 3), `colours` R, G, B, of
    which values outside [0, 1] are clipped; `comments` are lines of the header.
    """
    vertices = np.empty(len(points), dtype=[("place", "<f4", 6), ("colour", "u1", 3)])
    vertices["place"][:, :3] = points
    vertices["place"][:, 3:] = normals
    vertices["colour"] = np.round(np.clip(colours, 0, 1) * 255)
    header = ["ply", "format binary_little_endian 1.0"]
    header += [f"comment {text}" for text in comments]
    header += [f"element vertex {len(points)}"]
    header += [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
    header += [f"property uchar {name}" for name in ("red", "green", "blue")]
    body = vertices.tobytes()
    if triangles is not None:
        faces = np.empty(len(triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
        faces["count"] = 3
        faces["corners"] = triangles
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        body += faces.tobytes()
    return "\n".join([*header, "end_header", ""]).encode() + body


def _comments(mesh: Mesh) -> list[str]:
    comments = [f"unit: {mesh.unit}", "camera frame: x right, y down, z forward"]
    return [*comments, f"colours: {mesh.legend}"] if mesh.legend else comments


def _as_obj(mesh: Mesh) -> bytes:
    text = io.BytesIO()
    text.write("".join(f"# {comment}\n" for comment in _comments(mesh)).encode())
    np.savetxt(
        text,
        np.hstack([mesh.vertices, mesh.colours]),
        fmt="v %.6g %.6g %.6g %.4f %.4f %.4f",
    )
    np.savetxt(text, mesh.normals, fmt="vn %.5f %.5f %.5f")
    np.savetxt(text, np.repeat(mesh.triangles + 1, 2, axis=1), fmt="f %d//%d %d//%d %d//%d")
    return text.getvalue()
