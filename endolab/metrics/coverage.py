"""How well a stated σ tells how far a depth map is from the truth.

A σ is judged by how often the truth lies within it, by whether the pixels it calls bad are the bad ones, and
by a proper score, which no σ can better but by saying what is so: with Gneiting and Raftery, "Strictly
proper scoring rules, prediction, and estimation", 2007. A σ that is the same share of every distance, the
best there is for this very picture, is what it has to beat.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import spearmanr

from endolab.metrics.depth_errors import scale_to, valid_in_all
from endolab.numerics.arrays import BoolArray, FloatArray


@dataclass(frozen=True)
class Coverage:
    """How a depth map's σ fares over the pixels where it, the distance and the truth are known.

    Errors and σ are taken as shares of the estimated distance. The score is the mean over pixels of what a
    normal distribution with that σ is charged for the truth: the less, the better.
    """

    pixels: int  # how many those are
    scale: float  # what the estimate and its σ were multiplied by first; 1 for none
    sigma_percent: float  # median of σ, %
    within_one: float  # pixels whose truth is within σ of the estimate, %; 68.3 if normal
    within_two: float  # within 2σ, %; 95.4 if normal
    spearman: (
        float  # rank correlation of σ with the size of the error; nan if either is constant
    )
    log_score: float  # -log of the density at the truth, nats
    constant_percent: float  # the best constant, %
    constant_log_score: float  # its score


def coverage_of(
    distance: FloatArray,
    sigma: FloatArray,
    truth: FloatArray,
    mask: BoolArray | None = None,
    scale: str = "none",
) -> Coverage:
    """Compare the stated σ of a depth map with its true errors.

    Parameters
    ----------
    distance, sigma, truth : (H, W) float arrays
        Euclidean distances and the standard deviation of the first, one unit, positive; anything else where
        unknown.
    mask : (H, W) bool array, optional
        Further restricts the pixels.
    scale : {"none", "median"}
        "median" multiplies distance and σ by the median of d*/d: for a σ without what all pixels share, and
        for results up to scale.

    Raises
    ------
    ValueError
        If the sizes differ, if no pixel is known in all three, or if `scale` is neither.
    """
    (distance, sigma, truth), known = valid_in_all(
        mask, distance=distance, sigma=sigma, truth=truth
    )
    if not known.any():
        raise ValueError("no pixel has an estimate, a σ and a true distance")
    factor = scale_to(truth[known], distance[known], scale)
    error = np.abs(1 - truth[known] / (factor * distance[known]))
    share = sigma[known] / distance[known]
    rms = float(np.sqrt(np.mean(error**2)))
    return Coverage(
        pixels=int(known.sum()),
        scale=factor,
        sigma_percent=float(100 * np.median(share)),
        within_one=float(100 * np.mean(error <= share)),
        within_two=float(100 * np.mean(error <= 2 * share)),
        spearman=spearman(share, error),
        log_score=float(np.mean(log_score(error, share))),
        constant_percent=100 * rms,
        constant_log_score=float(np.mean(log_score(error, rms))),
    )


def spearman(a: FloatArray, b: FloatArray) -> float:
    """Correlation of the ranks of two samples; nan if one is constant."""
    return float(spearmanr(a, b).statistic) if np.ptp(a) > 0 < np.ptp(b) else float("nan")


def log_score(error: FloatArray, sigma: FloatArray | float) -> FloatArray:
    """-log of a normal density of this σ at this error; -inf of no error with no σ."""
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.where(error == 0, 0.0, error / sigma)
        return np.asarray(0.5 * np.log(2 * np.pi) + np.log(sigma) + 0.5 * z**2)
