"""Meshes of depth maps: made, written, and measured against the true surface.

A mesh is made on the frame's own pixel grid, fisheye or not, two triangles to every square of
four pixels. Only measuring against triangles needs Open3D; `mesh_views` shows meshes.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from endolab.files import PathLike, as_ply, write_atomically
from endolab.iteration import Iterate, Result
from endolab.operators import BoolArray, FloatArray, links

IndexArray = NDArray[np.int32]
JUMP = 1.08  # corners whose distances differ by more may lie on two surfaces …
GRAZING = 85.0  # … and do if what would join them is seen at more than this angle, degrees
NEUTRAL = 0.7  # grey of a mesh without a picture
FRAME = "camera frame: x right, y down, z forward"


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


@dataclass(frozen=True)
class SurfaceDistance:
    """How far a mesh is from the true surface.

    Attributes
    ----------
    distance : (n,) float array
        From each vertex to the nearest point of the true surface, mm.
    mean, median, percentile_95 : float
        Of the distances, mm.
    """

    distance: FloatArray
    mean: float
    median: float
    percentile_95: float


# Making ---------------------------------------------------------------------------------


def mesh_of(
    shown: Result | Iterate | FloatArray,
    colours: FloatArray | None = None,
    *,
    cuts: BoolArray | None = None,
    jump: float = JUMP,
    grazing: float = GRAZING,
) -> Mesh:
    """Join the surface points of neighbouring pixels by triangles.

    Parameters
    ----------
    shown : Result, Iterate or (H, W, 3) float array
        The last one are surface points in the camera frame, mm; nan where unknown.
    colours : (H, W, 3) or (H, W) float array, optional
        Of the pixels, in [0, 1]; by default those of the frame, or grey for bare points.
    cuts : (2, H, W) bool array, optional
        Steps to the right and lower neighbour over which the surface is torn, as
        `evaluation.occlusion_cuts` finds them; by default those of the problem that was solved.
    jump, grazing : float
        A triangle is left out if the distances of its corners from the camera differ by more
        than the factor `jump` and the angle between its normal and the line of sight is more
        than `grazing`, degrees. (The factor alone would tear a slanted wall in a small frame, the
        angle alone a smooth one seen at its limb.)

    Returns
    -------
    Mesh
        Only of the pixels that are a triangle's corner; empty if there is none. A square with
        one corner missing, or cut off, is one triangle; else it is split along the diagonal over
        which the distance changes less. Normals are those of the triangles, weighted by area.

    Raises
    ------
    ValueError
        If arrays do not fit or a threshold is out of range.
    """
    if isinstance(shown, Result | Iterate):
        problem, unit = shown.problem, shown.problem.unit
        points = shown.points
        colours = problem.picture if colours is None else colours
        colours = problem.image if colours is None else colours
        cuts = problem.cuts if cuts is None else cuts
    else:
        points, unit = np.asarray(shown, dtype=np.float64), "mm"
    if points.ndim != 3 or points.shape[2] != 3:
        raise ValueError(f"points must be an array of shape (H, W, 3), found {points.shape}")
    shape = points.shape[:2]
    if cuts is not None and (cuts.shape != (2, *shape) or cuts.dtype != bool):
        raise ValueError(
            f"cuts must be a bool array of shape {(2, *shape)}, found {cuts.dtype} of shape {cuts.shape}"
        )
    colours = np.full(shape, NEUTRAL) if colours is None else colours
    if colours.shape not in (shape, (*shape, 3)):
        raise ValueError(f"colours must have shape {shape} or {(*shape, 3)}, found {colours.shape}")
    if not (jump >= 1 and 0 <= grazing <= 90):
        raise ValueError(
            f"jump must be at least 1 and grazing from 0 to 90 degrees, got {jump} and {grazing}"
        )
    triangles = _triangles(points, cuts)
    points = points.reshape(-1, 3)
    triangles = triangles[~_torn(points, triangles, jump, grazing)]
    used = np.zeros(len(points), dtype=bool)
    used[triangles] = True
    vertices, triangles = points[used], (np.cumsum(used, dtype=np.int32) - 1)[triangles]
    colours = colours[..., None] if colours.ndim == 2 else colours
    colours = np.broadcast_to(colours, (*shape, 3)).reshape(-1, 3)[used].clip(0, 1)
    return Mesh(vertices, triangles, colours, _normals(vertices, triangles), unit)


def _triangles(points: FloatArray, cuts: BoolArray | None) -> IndexArray:
    """Triangles whose sides along rows and columns are all steps that may be taken."""
    distance = np.linalg.norm(points, axis=-1)
    right, lower = links(np.isfinite(distance) & (distance > 0), cuts)
    number = np.arange(distance.size, dtype=np.int32).reshape(distance.shape)

    def corners(a: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        return a[:-1, :-1], a[:-1, 1:], a[1:, :-1], a[1:, 1:]

    a, b, c, d = corners(number)
    (top, _, bottom, _), (left, far, _, _) = corners(right), corners(lower)
    upper_left, lower_right, lower_left, upper_right = top & left, bottom & far, left & bottom, top & far
    with np.errstate(divide="ignore", invalid="ignore"):
        at_a, at_b, at_c, at_d = corners(np.log(distance))
        flatter = np.abs(at_a - at_d) < np.abs(at_b - at_c)
    rising, falling = 1 * upper_left + lower_right, 1 * lower_left + upper_right
    falls = (falling > rising) | ((falling == rising) & flatter)  # the diagonal is a-d, else b-c
    parts = [
        (upper_left & ~falls, (a, c, b)),
        (lower_right & ~falls, (b, c, d)),
        (lower_left & falls, (a, c, d)),
        (upper_right & falls, (a, d, b)),
    ]
    return np.concatenate([np.stack([corner[kept] for corner in three], -1) for kept, three in parts])


def _torn(points: FloatArray, triangles: IndexArray, jump: float, grazing: float) -> BoolArray:
    """Triangles that would join two surfaces."""
    distance = np.linalg.norm(points, axis=-1)[triangles]
    torn = distance.max(axis=1, initial=0) > jump * distance.min(axis=1, initial=np.inf)
    corners = points[triangles[torn]]
    normal, sight = facing(corners), corners.mean(axis=1)
    size = np.linalg.norm(normal, axis=-1) * np.linalg.norm(sight, axis=-1)
    cosine = np.abs(np.einsum("ni,ni->n", normal, sight))
    torn[torn] = cosine < np.cos(np.deg2rad(grazing)) * size
    return torn


def facing(corners: FloatArray) -> FloatArray:
    """Normals of triangles (m, 3, 3), as long as twice their areas."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _normals(vertices: FloatArray, triangles: IndexArray) -> FloatArray:
    towards = facing(vertices[triangles])
    total = np.stack(
        [
            sum(np.bincount(triangles[:, i], towards[:, axis], len(vertices)) for i in range(3))
            for axis in range(3)
        ],
        axis=-1,
    )
    # No sum is 0: seen from the camera, every triangle at a vertex has it in its plane.
    return total / np.maximum(np.linalg.norm(total, axis=-1, keepdims=True), np.finfo(float).tiny)


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


# Open3D ---------------------------------------------------------------------------------


def load_open3d() -> Any:
    """Import Open3D, or say in one sentence why it cannot be."""
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise OSError(f"Open3D does not import ({error}); on Debian install libusb-1.0-0") from error
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
        open3d.utility.Vector3dVector(mesh.vertices), open3d.utility.Vector3iVector(mesh.triangles)
    )
    made.vertex_colors = open3d.utility.Vector3dVector(mesh.colours)
    made.vertex_normals = open3d.utility.Vector3dVector(mesh.normals)
    return made


def distance_to(
    mesh: Mesh, truth: Mesh | tuple[FloatArray, NDArray] | FloatArray, scale: float | None = None
) -> SurfaceDistance:
    """Measure how far a mesh is from the true surface, from its vertices to what is nearest there.

    Parameters
    ----------
    mesh : Mesh
    truth : Mesh, pair of (V, 3) float and (T, 3) int arrays, or (..., 3) float array
        The true surface in mm and in the same frame, as ``Scene.mesh()`` gives it. An array holds
        mere points, of which the nearest counts; those that are nan are left out.
    scale : float, optional
        What to multiply the mesh by first, mm per unit; needed if it is in relative units.

    Returns
    -------
    SurfaceDistance

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
        vertices, triangles = (truth.vertices, truth.triangles) if isinstance(truth, Mesh) else truth
        size = len(triangles)
    else:
        vertices = np.asarray(truth, dtype=np.float64).reshape(-1, 3)
        vertices = vertices[np.isfinite(vertices).all(axis=-1)]
        triangles, size = None, len(vertices)
    if not (len(own) and size):
        raise ValueError(f"nothing to measure: the mesh has {len(own)} vertices, the truth {size} parts")
    if triangles is None:
        found = cKDTree(vertices).query(own)[0]
    else:
        place = load_open3d().core.Tensor(own.astype(np.float32))
        found = caster(vertices, triangles).compute_distance(place).numpy().astype(np.float64)
    mean, median, most = np.mean(found), np.median(found), np.percentile(found, 95)
    return SurfaceDistance(found, float(mean), float(median), float(most))
