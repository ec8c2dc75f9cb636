"""How far a depth map is from the truth."""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.stats import spearmanr

from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checks import mask_array, unknown_name
from endolab.numerics.stencils import forward_gradient, links


@dataclass(frozen=True)
class Errors:
    """Errors of a depth map over the pixels where estimate and truth are both known."""

    pixels: int  # how many those are
    # What the estimate was multiplied by first, 1 for none, and what was added then, 0 for none; of the
    # disparity, 1/mm, if that was aligned.
    scale: float
    shift: float
    mean_mm: float  # of |d - d*|, Euclidean distances, mm
    median_mm: float
    rmse_mm: float
    mean_percent: float  # of |d - d*|/d* (this is AbsRel), %
    median_percent: float
    rmse_z_mm: float  # of z instead of Euclidean distance, mm, as most benchmarks state it
    mean_degrees: float  # angle between the normals; nan if the truth has none
    median_degrees: float
    # Pixels of which d/d* or d*/d, the larger, is below 1.25, its square, its cube (δ₁, δ₂, δ₃), %.
    within_125: float
    within_125_squared: float
    within_125_cubed: float


def angle_between(a: FloatArray, b: FloatArray) -> FloatArray:
    """Angle between unit vectors (..., 3), degrees; exact for small angles too."""
    return np.rad2deg(
        2 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))
    )


def depth_cuts(distance: FloatArray, threshold: float = 0.08) -> BoolArray:
    """Steps between neighbouring pixels over which a true depth map jumps: occluding contours.

    Parameters
    ----------
    distance : (H, W) float array
        True distances, any unit; nan (or 0, or anything else that has no logarithm) where unknown.
    threshold : float
        The least jump of log distance that counts.

    Returns
    -------
    (2, H, W) bool array
        Whether the step from a pixel to its right (first) and lower (second) neighbour is such a
        jump, as `Problem.cuts` takes it; False where either distance is unknown.
    """
    known = np.isfinite(distance) & (distance > 0)
    log_distance = np.log(distance, where=known, out=np.zeros(known.shape))
    return links(known) & (np.abs(forward_gradient(log_distance, known)) > threshold)


def resample_truth(truth: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Resample a true map to the grid of a result, whose frame may have been shrunk.

    Parameters
    ----------
    truth : (H, W) or (H, W, 3) float array
        Distances or z, any unit, or unit normals; nan where unknown.
    shape : (h, w)
        Rows and columns of the same picture.

    Returns
    -------
    (h, w) or (h, w, 3) float array
        In each pixel the mean over the part of it that is known; nan where that is less than half.

    Raises
    ------
    ValueError
        If the two are not of one picture, for their proportions differ.
    """
    height, width = truth.shape[:2]
    rows, columns = shape
    if abs(rows * width - columns * height) > max(width, height):
        raise ValueError(
            f"the depth map is {columns}x{rows} px, the truth {width}x{height} px, of other proportions"
        )
    maps = np.atleast_3d(truth).astype(np.float64)
    known = np.isfinite(maps).all(axis=-1, keepdims=True)
    parts = np.dstack([np.where(known, maps, 0.0), known])
    *means, share = cv2.split(
        cv2.resize(parts, (columns, rows), interpolation=cv2.INTER_AREA)
    )
    mean = np.stack(means, axis=-1) / np.where(share < 0.5, np.nan, share)[..., None]
    if truth.ndim == 2:
        return mean[..., 0]
    return mean / np.linalg.norm(mean, axis=-1, keepdims=True)


def known_in_all(mask: BoolArray | None, **maps: np.ndarray) -> BoolArray:
    """Pixels of a mask that are positive and finite in all maps, (H, W), of which there must be one."""
    shape = np.shape(next(iter(maps.values())))
    known = np.ones(shape, dtype=bool)
    if mask is not None:
        maps["mask"] = mask_array("mask", mask)
    for name, given in maps.items():
        if np.shape(given) != shape:
            raise ValueError(f"{name} has shape {np.shape(given)}, the depth map {shape}")
        known &= np.isfinite(given) & (given > 0)
    if not known.any():
        raise ValueError(f"no pixel is known in all of {', '.join(maps)}")
    return known


def rank_correlation(a: FloatArray, b: FloatArray) -> float:
    """Spearman's, of two arrays (n,); nan if either is constant."""
    is_constant = np.ptp(a) == 0 or np.ptp(b) == 0
    return float(np.nan if is_constant else spearmanr(a, b).statistic)


def align_to(truth: FloatArray, estimate: FloatArray, align: str) -> tuple[float, float]:
    """What estimates, (n,), are multiplied by first, and what is added then; see `compare`."""
    match align:
        case "none":
            return 1.0, 0.0
        case "scale":
            return float(np.median(truth / estimate)), 0.0
        case "affine":
            columns = np.stack([estimate, np.ones_like(estimate)], axis=-1)
            scale, shift = np.linalg.lstsq(columns, truth)[0].tolist()
            return scale, shift
    raise unknown_name("align", align, ("none", "scale", "affine"))


def compare(
    distance: FloatArray,
    truth: FloatArray,
    cos_alpha: FloatArray,
    *,
    normals: FloatArray | None = None,
    true_normals: FloatArray | None = None,
    mask: BoolArray | None = None,
    align: str = "none",
    as_disparity: bool = False,
) -> Errors:
    """Compare a depth map with the truth.

    Parameters
    ----------
    distance, truth : (H, W) float arrays
        Euclidean distances, mm, positive; anything else where unknown.
    cos_alpha : (H, W) float array
        z of the unit rays, which turns distance into z; nan where it is not known, which leaves z out.
    normals, true_normals : (H, W, 3) float arrays, optional
        Unit normals.
    mask : (H, W) bool array, optional
        Further restricts the pixels.
    align : {"none", "scale", "affine"}
        "scale" multiplies the estimate by the median of d*/d, for results up to scale; "affine" takes scale
        and shift of least squares, and puts no estimate below all of the truth.
    as_disparity : bool
        Align 1/d with 1/d*, as Ranftl et al., "Towards robust monocular depth estimation", 2022, do: for the
        inverse of a disparity.

    Raises
    ------
    ValueError
        If the sizes differ, if no pixel is known in both, or if `align` is neither.

    Examples
    --------
    >>> import endolab as el
    >>> from endolab import metrics
    >>> sample = el.load_traced("matt")
    >>> result = el.reconstruct(sample.frame, sample.calibration)
    >>> errors = metrics.compare(result.distance, sample.distance, sample.calibration.camera.field.cos_alpha)
    >>> errors.median_percent < 5
    True
    """
    known = known_in_all(mask, distance=distance, truth=truth)
    true = truth[known]
    power = -1 if as_disparity else 1
    aim = true**power
    scale, shift = align_to(aim, distance[known] ** power, align)
    estimate = scale * distance[known] ** power + shift
    if align == "affine":
        estimate = np.maximum(estimate, aim.min())
    estimate = estimate**power
    error = np.abs(estimate - true)
    ratio = np.maximum(estimate / true, true / estimate)
    degrees = np.array(np.nan)
    if normals is not None and true_normals is not None:
        degrees = angle_between(normals[known], true_normals[known])
    found = {
        "scale": scale,
        "shift": shift,
        "mean_mm": error.mean(),
        "median_mm": np.median(error),
        "rmse_mm": np.sqrt(np.mean(error**2)),
        "mean_percent": 100 * np.mean(error / true),
        "median_percent": 100 * np.median(error / true),
        "rmse_z_mm": np.sqrt(np.mean((error * cos_alpha[known]) ** 2)),
        "mean_degrees": np.mean(degrees),
        "median_degrees": np.median(degrees),
        "within_125": 100 * np.mean(ratio < 1.25),
        "within_125_squared": 100 * np.mean(ratio < 1.25**2),
        "within_125_cubed": 100 * np.mean(ratio < 1.25**3),
    }
    return Errors(int(known.sum()), **{name: float(value) for name, value in found.items()})
