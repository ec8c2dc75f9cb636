"""A mesh out of a result."""

import cv2
import numpy as np
from numpy.typing import NDArray

from endolab.model.mesh import Mesh, triangle_normals, vertex_normals
from endolab.numerics.arrays import BoolArray, FloatArray, IndexArray
from endolab.numerics.checks import excerpt
from endolab.numerics.derivatives import links
from endolab.solvers.result import Iterate, Result


def make_mesh(
    shown: Result | Iterate | FloatArray,
    colours: FloatArray | None = None,
    *,
    sigma: FloatArray | None = None,
    cuts: BoolArray | None = None,
    jump: float = 1.08,
    grazing: float = 85.0,
) -> Mesh:
    """Join the surface points of neighbouring pixels by triangles.

    Parameters
    ----------
    shown : Result, Iterate or (H, W, 3) float array
        The last one are surface points in the camera frame, mm; nan where unknown.
    colours : (H, W, 3) or (H, W) float array, optional
        Of the pixels, in [0, 1]; by default those of the frame, or grey for bare points.
    sigma : (H, W) float array, optional
        How far each distance of a result can be trusted, in its unit (`endolab.uncertainty_of`): instead, the
        colours tell its share of the distance; what they mean is in the mesh's `legend`, and in the files
        that are made of it.
    cuts : (2, H, W) bool array, optional
        Steps to the right and lower neighbour over which the surface is cut, as
        `metrics.depth_cuts` finds them; by default those of the problem that was solved.
    jump, grazing : float
        A triangle is left out if the distances of its corners from the camera differ by more
        than the factor `jump` and the angle between its normal and the line of sight is more
        than `grazing`, degrees. (The factor alone would cut a slanted wall in a small frame, the
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

    Examples
    --------
    >>> import endolab as el
    >>> sample = el.load_traced("matt")  # a frame that comes with endolab
    >>> mesh = el.make_mesh(el.reconstruct(sample.frame, sample.calibration, width=96, channel="green"))
    >>> mesh.unit, mesh.triangles.shape[1]
    ('mm', 3)
    """
    legend = ""
    unit = "mm"
    if isinstance(shown, Result | Iterate):
        problem = shown.problem
        points = shown.points
        unit = problem.unit
        colours = problem.shown if colours is None else colours
        cuts = problem.cuts if cuts is None else cuts
        if sigma is not None:
            colours, legend = _certainty(sigma, shown)
    elif sigma is not None:
        raise ValueError("sigma is of a result: mere points have none")
    else:
        points = np.asarray(shown, dtype=np.float64)
    if points.ndim != 3 or points.shape[2] != 3:
        raise ValueError(f"points must have shape (H, W, 3), found {points.shape}")
    shape = points.shape[:2]
    colours = np.full(shape, 0.7) if colours is None else colours  # grey
    if colours.shape not in (shape, (*shape, 3)):
        raise ValueError(
            f"colours must have shape {shape} or {(*shape, 3)}, found {colours.shape}"
        )
    if cuts is not None and (cuts.shape != (2, *shape) or cuts.dtype != bool):
        raise ValueError(f"cuts must be {excerpt(np.empty((2, *shape), bool))}")
    if not (jump >= 1 and 0 <= grazing <= 90):
        raise ValueError(
            f"jump must be at least 1 and grazing from 0 to 90 degrees, got {jump} and {grazing}"
        )
    distance = np.linalg.norm(points, axis=-1)
    joined = links(np.isfinite(distance) & (distance > 0), cuts)
    triangles = join_triangles(distance, joined)
    points = points.reshape(-1, 3)
    triangles = triangles[~_joins_two_surfaces(points, triangles, jump, grazing)]
    used = np.zeros(len(points), dtype=bool)
    used[triangles] = True
    triangles = (np.cumsum(used, dtype=np.int32) - 1)[triangles]
    vertices = points[used]
    rgb = np.broadcast_to(colours.reshape(*shape, -1), (*shape, 3)).reshape(-1, 3)
    normals = vertex_normals(vertices, triangles)
    return Mesh(
        vertices,
        triangles,
        rgb[used].clip(0, 1),
        normals,
        unit,
        legend,
    )


def _certainty(sigma: FloatArray, shown: Result | Iterate) -> tuple[FloatArray, str]:
    """Colours of σ, from dark, certain, to bright, (H, W, 3), and what they mean."""
    if sigma.shape != shown.mask.shape:
        raise ValueError(f"sigma has shape {sigma.shape}, the result {shown.mask.shape}")
    percent = np.where(shown.mask, 100 * sigma / shown.distance, 0.0)
    # As in figures, 98 % of the pixels are within the scale.
    most = float(f"{np.percentile(percent[shown.mask], 98):.2g}") or 1.0
    places = np.round(255 * np.clip(percent / most, 0, 1)).astype(np.uint8)
    bgr = np.asarray(cv2.applyColorMap(places, cv2.COLORMAP_MAGMA), np.float64)
    legend = f"sigma of the distance, dark 0 to bright {most:g} % of it, or more (magma)"
    return bgr[..., ::-1] / 255, legend


def join_triangles(distance: FloatArray, joined: BoolArray) -> IndexArray:
    """Triangles, (m, 3), between the points of a grid, whose sides along rows and columns are all steps.

    `joined`, (2, H, W), are the steps that there are (see `derivatives.links`). A square that has all four is
    split along the diagonal over which the distance, (H, W), changes by the smaller factor.
    """
    right, lower = joined
    number = np.arange(distance.size, dtype=np.int32).reshape(distance.shape)

    def corners(a: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        return a[:-1, :-1], a[:-1, 1:], a[1:, :-1], a[1:, 1:]

    a, b, c, d = corners(number)
    top, _, bottom, _ = corners(right)
    left, far, _, _ = corners(lower)
    upper_left = top & left
    lower_right = bottom & far
    lower_left = left & bottom
    upper_right = top & far
    with np.errstate(divide="ignore", invalid="ignore"):
        at_a, at_b, at_c, at_d = corners(np.log(distance))
        flatter = np.abs(at_a - at_d) < np.abs(at_b - at_c)
    rising = 1 * upper_left + lower_right
    falling = 1 * lower_left + upper_right
    # The diagonal is a-d, else b-c.
    falls = (falling > rising) | ((falling == rising) & flatter)
    parts = [
        np.stack([a, c, b], -1)[upper_left & ~falls],
        np.stack([b, c, d], -1)[lower_right & ~falls],
        np.stack([a, c, d], -1)[lower_left & falls],
        np.stack([a, d, b], -1)[upper_right & falls],
    ]
    return np.concatenate(parts)


def _joins_two_surfaces(
    points: FloatArray, triangles: IndexArray, jump: float, grazing: float
) -> BoolArray:
    """Triangles that would join two surfaces."""
    distance = np.linalg.norm(points, axis=-1)[triangles]
    apart = distance.max(axis=1, initial=0) > jump * distance.min(axis=1, initial=np.inf)
    corners = points[triangles[apart]]
    normal = triangle_normals(corners)
    sight = corners.mean(axis=1)
    size = np.linalg.norm(normal, axis=-1) * np.linalg.norm(sight, axis=-1)
    cosine = np.abs(np.einsum("ni,ni->n", normal, sight))
    apart[apart] = cosine < np.cos(np.deg2rad(grazing)) * size
    return apart
