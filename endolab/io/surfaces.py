"""Depth maps, clouds and meshes in files: npz, PLY, OBJ."""

from __future__ import annotations

import io
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from endolab.io.atomic import PathLike, name_damage, read_bytes, write_atomically
from endolab.model.mesh import Mesh
from endolab.numerics.checks import PATH, check_kinds

if TYPE_CHECKING:
    from endolab.reconstruction.uncertainty import Uncertainty
    from endolab.solvers.result import Result
    from endolab.synthetic.rendering import Rendered

DEPTH_FILE = "a depth.npz that endolab wrote"


# Depth maps -----------------------------------------------------------------------------
def read_arrays(path: PathLike, what: str, names: Collection[str]) -> dict[str, np.ndarray]:
    """Read the arrays of an .npz that have one of a few names; one sentence, if it is not `what`."""
    content = io.BytesIO(read_bytes(path))
    with name_damage(path, what), np.load(content, allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files if name in names}


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
    maps = {"distance": surface.distance, "z": surface.z, "normals": surface.normals}
    more: dict[str, Any] = {"mask": surface.mask, "metric": np.array(metric)}
    if uncertainty is not None:
        maps |= {"sigma": uncertainty.sigma, "sigma_shape": uncertainty.sigma_shape}
        more["dominant_source"] = uncertainty.dominant_source
    more |= {name: values.astype(np.float32) for name, values in maps.items()}
    content = io.BytesIO()
    np.savez_compressed(content, **more)
    write_atomically(path, content.getvalue())


def read_depth(
    path: PathLike, needed: Collection[str] = ("distance", "z")
) -> dict[str, np.ndarray]:
    """Read what `save_depth` wrote, whatever else is in the file; nan where a distance is not known.

    ValueError or OSError in one sentence, if it is something else, or holds what no surface has.
    """
    lengths = ("distance", "z", "normals", "sigma", "sigma_shape")
    others = ("mask", "metric", "dominant_source")
    maps = read_arrays(path, DEPTH_FILE, (*lengths, *others))
    with name_damage(path, DEPTH_FILE):
        size = maps["distance"].shape
        for name in {*needed, *maps}.difference(others):
            values = np.asarray(maps[name], np.float32)
            maps[name] = np.where(np.abs(values) < 1e12, values, np.nan)  # in any unit
            if values.shape != (*size, 3)[: 3 if name == "normals" else 2]:
                raise ValueError(f"{name} is of another size")
        maps["distance"][maps["distance"] <= 0] = np.nan
    return maps


# Clouds and meshes ----------------------------------------------------------------------
@check_kinds(path=PATH, mesh=Mesh)
def write_mesh(path: PathLike, mesh: Mesh) -> None:
    """Write a mesh with its colours and normals, or a point cloud, which is one without triangles.

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
    comments = [f"unit: {mesh.unit}", "camera frame: x right, y down, z forward"]
    comments += [f"colours: {mesh.legend}"] if mesh.legend else []
    if suffix == ".ply":
        vertices = np.empty(len(mesh.vertices), [("place", "<f4", 6), ("colour", "u1", 3)])
        vertices["place"] = np.hstack([mesh.vertices, mesh.normals])
        vertices["colour"] = np.round(np.clip(mesh.colours, 0, 1) * 255)
        faces = np.empty(len(mesh.triangles), [("count", "u1"), ("corners", "<i4", 3)])
        faces["count"] = 3
        faces["corners"] = mesh.triangles
        header = ["ply", "format binary_little_endian 1.0"]
        header += [f"comment {text}" for text in comments]
        header += [f"element vertex {len(vertices)}"]
        header += [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
        header += [f"property uchar {name}" for name in ("red", "green", "blue")]
        if len(faces):
            header += [f"element face {len(faces)}"]
            header += ["property list uchar int vertex_indices"]
        begin = "\n".join([*header, "end_header\n"])
        content = begin.encode() + vertices.tobytes() + faces.tobytes()
    elif suffix == ".obj":
        text = io.BytesIO()
        text.write("".join(f"# {line}\n" for line in comments).encode())
        places = np.hstack([mesh.vertices, mesh.colours])
        np.savetxt(text, places, fmt="v %.6g %.6g %.6g %.4f %.4f %.4f")
        np.savetxt(text, mesh.normals, fmt="vn %.5f %.5f %.5f")
        corners = np.repeat(mesh.triangles + 1, 2, axis=1)
        np.savetxt(text, corners, fmt="f %d//%d %d//%d %d//%d")
        content = text.getvalue()
    else:
        found = suffix or "no suffix"
        raise ValueError(f"{path}: meshes are written as .ply or .obj, found {found}")
    write_atomically(path, content)
