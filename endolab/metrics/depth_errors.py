"""How far a depth map is from the truth."""

from dataclasses import dataclass

import cv2
import numpy as np

from endolab.model.schema import unknown_name
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checks import mask_array, real_array
from endolab.numerics.derivatives import forward_gradient, links

SCALES = ("none", "median", "medians")


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
    truth = truth.astype(np.float64)
    height, width = truth.shape[:2]
    rows, columns = shape
    if (height, width) == shape:
        return truth
    if (
        abs(rows - height * columns / width) > 1
        and abs(columns - width * rows / height) > 1
    ):
        raise ValueError(
            f"the depth map is {columns}x{rows} px, the truth {width}x{height} px, of other proportions"
        )
    interpolation = cv2.INTER_AREA if columns <= width else cv2.INTER_LINEAR

    def mean(a: FloatArray) -> FloatArray:
        return np.asarray(
            cv2.resize(a, (columns, rows), interpolation=interpolation), dtype=np.float64
        )

    known: BoolArray = np.all(np.isfinite(truth).reshape(height, width, -1), axis=-1)
    share = mean(known.astype(np.float64))
    share[share < 0.5] = np.nan
    if truth.ndim == 2:
        return mean(np.where(known, truth, 0.0)) / share
    normals = mean(np.where(known[..., None], truth, 0.0)) / share[..., None]
    return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True))


def of_shape(shape: tuple[int, ...], **maps: FloatArray) -> list[FloatArray]:
    """Maps of this shape as arrays of real numbers, or a ValueError that names the first that is none."""
    arrays = {name: real_array(name, given) for name, given in maps.items()}
    for name, array in arrays.items():
        if array.shape != shape:
            raise ValueError(f"{name} has shape {array.shape}, the depth map {shape}")
    return [*arrays.values()]


def valid_in_all(
    mask: BoolArray | None, **maps: FloatArray
) -> tuple[list[FloatArray], BoolArray]:
    """Maps of distances, (H, W), and which pixels of a mask are positive and finite in all of them."""
    shape = np.shape(next(iter(maps.values())))
    arrays = of_shape(shape, **maps)
    if len(shape) != 2:
        raise ValueError(f"a depth map has rows and columns, got shape {shape}")
    known = np.ones(shape, dtype=bool) if mask is None else mask_array("mask", mask)
    if known.shape != shape:
        raise ValueError(f"mask has shape {known.shape}, the depth map {shape}")
    return arrays, np.logical_and.reduce(
        [known, *(np.isfinite(array) & (array > 0) for array in arrays)]
    )


def scale_to(truth: FloatArray, distance: FloatArray, scale: str) -> float:
    """What distances are multiplied by first; see `compare`."""
    if scale not in SCALES:
        raise unknown_name("scale", scale, SCALES)
    if scale == "medians":
        return float(np.median(truth) / np.median(distance))
    return float(np.median(truth / distance)) if scale == "median" else 1.0


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
        Euclidean distances, mm, positive; anything else where unknown.
    cos_alpha : (H, W) float array
        z of the unit rays, which turns distance into z; nan where it is not known, which leaves z out.
    normals, true_normals : (H, W, 3) float arrays, optional
        Unit normals.
    mask : (H, W) bool array, optional
        Further restricts the pixels.
    scale : {"none", "median", "medians"}
        "median" multiplies the estimate by the median of d*/d, for results up to scale; "medians" by the
        median of d* over the median of d, as most papers do since Zhou et al., "Unsupervised learning of
        depth and ego-motion from video", 2017.

    Raises
    ------
    ValueError
        If the sizes differ, if no pixel is known in both, or if `scale` is neither.

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
    (distance, truth), known = valid_in_all(mask, distance=distance, truth=truth)
    cos_alpha = of_shape(distance.shape, cos_alpha=cos_alpha)[0]
    if not known.any():
        raise ValueError("no pixel has both an estimate and a true distance")
    if np.any(np.isinf(cos_alpha[known])):
        raise ValueError("cos_alpha must be finite where both distances are known")
    true = truth[known]
    factor = scale_to(true, distance[known], scale)
    estimate = factor * distance[known]
    error = np.abs(estimate - true)
    ratio = np.maximum(estimate / true, true / estimate)
    within = [float(100 * np.mean(ratio < 1.25**power)) for power in (1, 2, 3)]
    degrees = np.array([np.nan])
    if normals is not None and true_normals is not None:
        vectors = {"normals": normals, "true_normals": true_normals}
        normals, true_normals = of_shape((*distance.shape, 3), **vectors)
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
        within_125=within[0],
        within_125_squared=within[1],
        within_125_cubed=within[2],
    )
