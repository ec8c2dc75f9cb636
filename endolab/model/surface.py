"""The surface behind a depth map: v = log d, the maps ξ that a regulariser sees, normals, points.

For the ray field r(u) with metric G and v = log d (the symbols are in `notebooks/guides/symbols.md`):

    P = ∇vᵀ G⁻¹ ∇v = tan²θ,    n = -(r - Σ g^ij v_j r_i) / √(1 + P)

Normals face the camera. Masked pixels are nan and never reach their neighbours.
"""

import numpy as np
from numpy.typing import ArrayLike

from endolab.model.cameras import RayField
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checks import unknown_name
from endolab.numerics.stencils import gradient

XI = ("1/z", "d", "1/d")


def to_xi(log_distance: ArrayLike, xi: str, cos_alpha: ArrayLike) -> FloatArray:
    """Map log-distance v = log d, d in mm, to ξ, mm or 1/mm.

    `cos_alpha` is the z component of the unit rays; "1/z" is nan where they do not point forward.
    """
    v = np.asarray(log_distance, float)
    if xi not in XI:
        raise unknown_name("xi", xi, XI)
    if xi == "d":
        return np.exp(v)
    if xi == "1/d":
        return np.exp(-v)
    return np.exp(-v) / np.where(np.asarray(cos_alpha) > 0, cos_alpha, np.nan)


def slant(f_u: FloatArray, f_v: FloatArray, field: RayField) -> FloatArray:
    """P = tan²θ, (H, W), from ∂v/∂column and ∂v/∂row, per pixel."""
    guu, guv, gvv = np.moveaxis(field.inverse_metric, -1, 0)
    return guu * f_u**2 + 2 * guv * f_u * f_v + gvv * f_v**2


def normals(
    log_distance: FloatArray,
    field: RayField,
    mask: BoolArray | None = None,
    step: int = 1,
    cuts: BoolArray | None = None,
) -> FloatArray:
    """Unit normals (H, W, 3) in the camera frame, towards the camera, from v = log d; nan outside the mask.

    The mask is by default where v is finite; no difference is taken across `cuts` (2, H, W). Of every
    `step`-th row and column alone, if it is given.
    """
    inside = field.valid & (np.isfinite(log_distance) if mask is None else mask)
    f_u, f_v = (f[::step, ::step] for f in gradient(log_distance, inside, cuts))
    return normals_from_gradient(f_u, f_v, field.every(step))


def normals_from_gradient(f_u: FloatArray, f_v: FloatArray, field: RayField) -> FloatArray:
    """Normals from ∂v/∂column and ∂v/∂row, (H, W) each; see `normals`."""
    guu, guv, gvv = np.moveaxis(field.inverse_metric, -1, 0)
    raised_u = guu * f_u + guv * f_v
    raised_v = guv * f_u + gvv * f_v
    tangent = (
        raised_u[..., None] * field.jacobian[..., 0]
        + raised_v[..., None] * field.jacobian[..., 1]
    )
    return (tangent - field.rays) / np.sqrt(1 + slant(f_u, f_v, field))[..., None]


def points(log_distance: ArrayLike, field: RayField) -> FloatArray:
    """Surface points d·r in the camera frame, (H, W, 3), mm, from v = log d, d in mm."""
    return np.exp(np.asarray(log_distance, float))[..., None] * field.rays
