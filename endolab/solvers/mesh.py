"""A mesh out of a result."""

import cv2
import numpy as np

from endolab.model.mesh import Mesh, triangle_normals, vertex_normals
from endolab.numerics.arrays import BoolArray, FloatArray, IndexArray
from endolab.numerics.stencils import links
from endolab.solvers.result import Iterate, Result


def make_mesh(
    shown: Result | Iterate | FloatArray,
    colours: FloatArray | None = None,
    *,
    sigma: FloatArray | None = None,
    cuts: BoolArray | None = None,
) -> Mesh:
    """Join the surface points of neighbouring pixels by triangles.

    One is left out if the distances of its corners from the camera differ by more than 8 % and it is seen at
    more than 85° off its normal. (Either alone would cut a slanted wall in a small frame, or a smooth one
    seen at its limb.)

    Parameters
    ----------
    shown : Result, Iterate or (H, W, 3) float array
        The last one are surface points in the camera frame, mm; nan where unknown.
    colours : (H, W, 3) or (H, W) float array, optional
        Of the pixels, in [0, 1]; by default those of the frame, or grey for bare points.
    sigma : (H, W) float array, optional
        How far each distance of a result can be trusted, in its unit (`endolab.uncertainty_of`): instead, the
        colours tell it in % of the distance; what they mean is in the mesh's `legend`, and in the files
        that are made of it.
    cuts : (2, H, W) bool array, optional
        Links to the right and lower neighbour over which the surface is cut, as
        `metrics.depth_cuts` finds them; by default those of the problem that was solved.

    Returns
    -------
    Mesh
        Only of the pixels that are a triangle's corner; empty if there is none. A square with
        one corner missing, or cut off, is one triangle. Normals are those of the triangles, weighted by area.

    Raises
    ------
    ValueError
        If arrays do not fit.

    Examples
    --------
    >>> import endolab as el
    >>> sample = el.load_traced("matt")  # a frame that comes with endolab
    >>> mesh = el.make_mesh(el.reconstruct(sample.frame, sample.calibration, width=96, channel="green"))
    >>> mesh.unit, mesh.triangles.shape[1]
    ('mm', 3)
    """
    unit = "mm"
    if isinstance(shown, Result | Iterate):
        points = shown.points
        unit = shown.problem.unit
        colours = shown.problem.shown if colours is None else colours
        cuts = shown.problem.cuts if cuts is None else cuts
    else:
        points = np.asarray(shown, dtype=np.float64)
    if points.ndim != 3 or points.shape[2] != 3:
        raise ValueError(f"points must have shape (H, W, 3), found {points.shape}")
    distance = np.linalg.norm(points, axis=-1)
    legend = ""
    if sigma is not None:
        percent = 100 * sigma / distance
        # As in figures, 98 % of the pixels are within the scale.
        most = float(f"{np.nanpercentile(percent, 98):.2g}") or 1.0
        places = np.round(255 * np.clip(np.nan_to_num(percent) / most, 0, 1))
        bgr = cv2.applyColorMap(places.astype(np.uint8), cv2.COLORMAP_MAGMA)
        colours = bgr[..., ::-1] / 255
        legend = (
            f"sigma of the distance, dark 0 to bright {most:g} % of it, or more (magma)"
        )
    joined = links(np.isfinite(distance) & (distance > 0), cuts)
    triangles = join_triangles(*joined)
    points = points.reshape(-1, 3)
    corners = points[triangles]
    far = distance.ravel()[triangles]
    normal = triangle_normals(corners)
    sight = corners.mean(axis=1)
    size = np.linalg.norm(normal, axis=-1) * np.linalg.norm(sight, axis=-1)
    is_seen = np.abs(np.sum(normal * sight, axis=-1)) >= np.cos(np.deg2rad(85)) * size
    triangles = triangles[is_seen | (far.max(axis=1) <= 1.08 * far.min(axis=1))]
    used = np.zeros(len(points), dtype=bool)
    used[triangles] = True
    triangles = (np.cumsum(used, dtype=np.int32) - 1)[triangles]
    grey = np.full(distance.shape, 0.7)
    rgb = np.atleast_3d(grey if colours is None else colours).clip(0, 1)
    rgb = np.broadcast_to(rgb, (*distance.shape, 3)).reshape(-1, 3)
    normals = vertex_normals(points[used], triangles)
    return Mesh(points[used], triangles, rgb[used], normals, unit, legend)


def join_triangles(across: BoolArray, down: BoolArray) -> IndexArray:
    """Triangles, (m, 3), between the points of a grid, whose sides along rows and columns are all links.

    The links that there are, (H, W) each, are those of `stencils.links`.
    """
    top, bottom = across[:-1, :-1], across[1:, :-1]
    left, right = down[:-1, :-1], down[:-1, 1:]
    number = np.arange(across.size, dtype=np.int32).reshape(across.shape)
    a, b = number[:-1, :-1], number[:-1, 1:]
    c, d = number[1:, :-1], number[1:, 1:]
    # At a and d they share the diagonal b-c; at c and b the other, where it alone leaves a triangle.
    at_a, at_d, at_c, at_b = top & left, bottom & right, left & bottom, top & right
    neither = ~(at_a | at_d)
    kinds = (
        (a, c, b, at_a),
        (b, c, d, at_d),
        (a, c, d, at_c & neither),
        (a, d, b, at_b & neither),
    )
    return np.concatenate([np.stack(kind, -1)[there] for *kind, there in kinds])
