"""The surface behind a depth map: v = log d, the maps ξ that a regulariser sees, normals, points.

For the ray field r(u) with metric G and v = log d (`../README.md` has the symbol table):

    P = ∇vᵀ G⁻¹ ∇v = tan²θ,    n = -(r - Σ g^ij v_j r_i) / √(1 + P)

Normals face the camera. Masked pixels are nan and never reach their neighbours.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from endolab.model.cameras import RayField
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.derivatives import gradient

XI = ("1/z", "d", "1/d")


def check_xi(xi: str) -> str:
    """Return `xi` if it is one of the maps; raise a ValueError that names them otherwise."""
    if xi not in XI:
        raise ValueError(f"unknown xi {xi!r}; choose {', '.join(XI)}")
    return xi


def to_xi(log_distance: ArrayLike, xi: str, cos_alpha: ArrayLike) -> FloatArray:
    """Map log-distance to ξ.

    Parameters
    ----------
    log_distance : (...) array of float
        v = log d, d in mm.
    xi : {"1/z", "d", "1/d"}
        Which map.
    cos_alpha : (...) array of float
        z component of the unit rays.

    Returns
    -------
    (...) float array
        mm or 1/mm; nan for "1/z" where the ray does not point forward.
    """
    v = np.asarray(log_distance, dtype=np.float64)
    if check_xi(xi) == "d":
        return np.exp(v)
    if xi == "1/d":
        return np.exp(-v)
    forward = np.asarray(cos_alpha) > 0
    return np.where(forward, np.exp(-v) / np.where(forward, cos_alpha, 1.0), np.nan)


def from_xi(value: ArrayLike, xi: str, cos_alpha: ArrayLike) -> FloatArray:
    """Map ξ back to log-distance; the inverse of `to_xi`.

    Parameters
    ----------
    value : (...) array of float
        ξ, mm or 1/mm.
    xi : {"1/z", "d", "1/d"}
        Which map.
    cos_alpha : (...) array of float
        z component of the unit rays.

    Returns
    -------
    (...) float array
        v = log d; nan where ξ is not positive.
    """
    value = np.asarray(value, dtype=np.float64)
    scaled = value * cos_alpha if check_xi(xi) == "1/z" else value
    logarithm = np.log(np.where(scaled > 0, scaled, np.nan))
    return logarithm if xi == "d" else -logarithm


def slant(f_u: FloatArray, f_v: FloatArray, field: RayField) -> FloatArray:
    """P = tan²θ from the gradient of v.

    Parameters
    ----------
    f_u, f_v : (H, W) float arrays
        ∂v/∂column and ∂v/∂row, per pixel.
    field : RayField
        Of the camera.

    Returns
    -------
    (H, W) float array
    """
    guu, guv, gvv = np.moveaxis(field.inverse_metric, -1, 0)
    return guu * f_u**2 + 2 * guv * f_u * f_v + gvv * f_v**2


def normals(log_distance: FloatArray, field: RayField, mask: BoolArray | None = None) -> FloatArray:
    """Normals from the gradient of log-distance and the ray metric.

    Parameters
    ----------
    log_distance : (H, W) float array
        v = log d.
    field : RayField
        Of the camera.
    mask : (H, W) bool array, optional
        Where v is defined; where it is finite by default.

    Returns
    -------
    (H, W, 3) float array
        Unit normals in the camera frame, towards the camera; nan outside the mask.
    """
    inside = field.valid & (np.isfinite(log_distance) if mask is None else mask)
    return normals_from_gradient(*gradient(log_distance, inside), field)


def normals_from_gradient(f_u: FloatArray, f_v: FloatArray, field: RayField) -> FloatArray:
    """Normals from ∂v/∂column and ∂v/∂row, (H, W) each; see `normals`."""
    guu, guv, gvv = np.moveaxis(field.inverse_metric, -1, 0)
    raised_u, raised_v = guu * f_u + guv * f_v, guv * f_u + gvv * f_v
    tangent = raised_u[..., None] * field.jacobian[..., 0] + raised_v[..., None] * field.jacobian[..., 1]
    return (tangent - field.rays) / np.sqrt(1 + slant(f_u, f_v, field))[..., None]


def normals_by_gradient(f_u: FloatArray, f_v: FloatArray, field: RayField) -> FloatArray:
    """Derivatives of the normal by ∂v/∂column and ∂v/∂row.

    Parameters
    ----------
    f_u, f_v : (H, W) float arrays
        The gradient of v, per pixel.
    field : RayField
        Of the camera.

    Returns
    -------
    (H, W, 3, 2) float array
        ∂n/∂v_j = (Σ_i g^ij r_i) / √(1 + P) - n (Σ_k g^jk v_k) / (1 + P).
    """
    guu, guv, gvv = np.moveaxis(field.inverse_metric, -1, 0)
    raised = np.stack([guu * f_u + guv * f_v, guv * f_u + gvv * f_v], axis=-1)
    one = 1 + slant(f_u, f_v, field)[..., None, None]
    inverse = np.stack([np.stack([guu, guv], -1), np.stack([guv, gvv], -1)], axis=-2)
    n = normals_from_gradient(f_u, f_v, field)
    return field.jacobian @ inverse / np.sqrt(one) - n[..., None] * raised[..., None, :] / one


def points(log_distance: ArrayLike, field: RayField) -> FloatArray:
    """Surface points d·r.

    Parameters
    ----------
    log_distance : (H, W) array of float
        v = log d, d in mm.
    field : RayField
        Of the camera.

    Returns
    -------
    (H, W, 3) float array
        Points in the camera frame, mm.
    """
    return np.exp(np.asarray(log_distance, dtype=np.float64))[..., None] * field.rays


def normals_by_cross_product(points: FloatArray, mask: BoolArray | None = None) -> FloatArray:
    """Normals from the tangents of a grid of points, knowing nothing of cameras.

    Parameters
    ----------
    points : (H, W, 3) float array
        Surface points in the camera frame, mm.
    mask : (H, W) bool array, optional
        Where they are defined; where they are finite by default.

    Returns
    -------
    (H, W, 3) float array
        Unit normals towards the camera; nan outside the mask and where a pixel has no
        neighbour along a row or column.
    """
    inside = np.all(np.isfinite(points), axis=-1) if mask is None else mask
    along = [gradient(points[..., axis], inside) for axis in range(3)]
    normal = np.cross(np.stack([u for u, _ in along], -1), np.stack([v for _, v in along], -1))
    length = np.linalg.norm(normal, axis=-1)
    normal /= np.where(length > 0, length, np.nan)[..., None]
    towards = np.einsum("hwi,hwi->hw", normal, np.nan_to_num(points))
    return normal * np.where(towards > 0, -1.0, 1.0)[..., None]
