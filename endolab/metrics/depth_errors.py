"""How far a depth map is from the truth."""

from dataclasses import dataclass

import numpy as np

from endolab.model.schema import unknown_name
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.derivatives import forward_gradient, links


@dataclass(frozen=True)
class Errors:
    """Errors of a depth map over the pixels where estimate and truth are both known."""

    pixels: int  # how many those are
    scale: float  # what the estimate was multiplied by first; 1 for none
    mean_mm: float  # of |d - d*|, Euclidean distances, mm
    median_mm: float
    rmse_mm: float
    mean_percent: float  # of |d - d*|/d* (this is AbsRel), %
    median_percent: float
    rmse_z_mm: float  # of z instead of Euclidean distance, mm, as most benchmarks state it
    mean_degrees: float  # angle between the normals; nan if the truth has none
    median_degrees: float


def angle_between(a: FloatArray, b: FloatArray) -> FloatArray:
    """Angle between unit vectors (..., 3), degrees; exact for small angles too."""
    return np.rad2deg(2 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1)))


def occlusion_cuts(distance: FloatArray, threshold: float = 0.08) -> BoolArray:
    """Steps between neighbouring pixels over which a true depth map jumps: occluding contours.

    Parameters
    ----------
    distance : (H, W) float array
        True distances, any unit; nan (or 0, or anything else that has no logarithm) where unknown.
    threshold : float
        The least jump of log distance that counts, positive.

    Returns
    -------
    (2, H, W) bool array
        Whether the step from a pixel to its right (first) and lower (second) neighbour is such a
        jump, as `Problem.cuts` takes it; False where either distance is unknown.
    """
    if not threshold > 0:
        raise ValueError(f"threshold must be positive, got {threshold}")
    known = np.isfinite(distance) & (distance > 0)
    log_distance = np.log(np.where(known, distance, 1.0))
    return links(known) & (np.abs(forward_gradient(log_distance)) > threshold)


def compare(
    distance: FloatArray,
    truth: FloatArray,
    cos_alpha: FloatArray,
    *,
    normals: FloatArray | None = None,
    true_normals: FloatArray | None = None,
    mask: BoolArray | None = None,
    scale: str = "none",
) -> Errors:
    """Compare a depth map with the truth.

    Parameters
    ----------
    distance, truth : (H, W) float arrays
        Euclidean distances, mm; nan where unknown.
    cos_alpha : (H, W) float array
        z of the unit rays, which turns distance into z.
    normals, true_normals : (H, W, 3) float arrays, optional
        Unit normals.
    mask : (H, W) bool array, optional
        Further restricts the pixels.
    scale : {"none", "median"}
        "median" multiplies the estimate by the median of d*/d, for results up to scale.

    Raises
    ------
    ValueError
        If the sizes differ, if no pixel is known in both, or if `scale` is neither.
    """
    if scale not in ("none", "median"):
        raise unknown_name("scale", scale, ("none", "median"))
    if distance.shape != truth.shape:
        raise ValueError(
            f"the depth map is {distance.shape[1]}x{distance.shape[0]} px, "
            f"the truth {truth.shape[1]}x{truth.shape[0]} px"
        )
    known = np.isfinite(distance) & np.isfinite(truth)
    if mask is not None:
        known &= mask
    if not known.any():
        raise ValueError("no pixel has both an estimate and a true distance")
    true = truth[known]
    factor = float(np.median(true / distance[known])) if scale == "median" else 1.0
    error = np.abs(factor * distance[known] - true)
    degrees = np.array([np.nan])
    if normals is not None and true_normals is not None:
        degrees = angle_between(normals[known], true_normals[known])
    return Errors(
        pixels=int(known.sum()),
        scale=factor,
        mean_mm=float(error.mean()),
        median_mm=float(np.median(error)),
        rmse_mm=float(np.sqrt(np.mean(error**2))),
        mean_percent=float(100 * np.mean(error / true)),
        median_percent=float(100 * np.median(error / true)),
        rmse_z_mm=float(np.sqrt(np.mean((error * cos_alpha[known]) ** 2))),
        mean_degrees=float(np.mean(degrees)),
        median_degrees=float(np.median(degrees)),
    )
