"""How well a stated σ tells how far a depth map is from the truth.

A σ is judged by how often the truth lies within it, by whether the pixels it calls bad are the bad ones, and
by a proper score, which no σ can better but by saying what is so: with Gneiting and Raftery, "Strictly
proper scoring rules, prediction, and estimation", 2007. A σ that is the same share of every distance, the
best there is for this very picture, is what it has to beat.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from endolab.metrics.depth_errors import align_to, known_in_all, rank_correlation
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
    align: str = "none",
) -> Coverage:
    """Compare the stated σ of a depth map with its true errors.

    Parameters
    ----------
    distance, sigma, truth : (H, W) float arrays
        Euclidean distances and the standard deviation of the first, one unit, positive; anything else where
        unknown.
    mask : (H, W) bool array, optional
        Further restricts the pixels.
    align : {"none", "scale"}
        "scale" multiplies distance and σ by the median of d*/d: for a σ without what all pixels share, and
        for results up to scale.

    Raises
    ------
    ValueError
        If the sizes differ, if no pixel is known in all three, or if `align` is neither.
    """
    known = known_in_all(mask, distance=distance, sigma=sigma, truth=truth)
    factor, _ = align_to(truth[known], distance[known], align)
    error = np.abs(1 - truth[known] / (factor * distance[known]))
    relative = sigma[known] / distance[known]
    rms = np.sqrt(np.mean(error**2))
    found = {
        "scale": factor,
        "sigma_percent": 100 * np.median(relative),
        "within_one": 100 * np.mean(error <= relative),
        "within_two": 100 * np.mean(error <= 2 * relative),
        "spearman": rank_correlation(relative, error),
        "log_score": -np.mean(norm.logpdf(error, scale=relative)),
        "constant_percent": 100 * rms,
        "constant_log_score": -np.mean(norm.logpdf(error, scale=rms)),
    }
    return Coverage(int(known.sum()), **{name: float(a) for name, a in found.items()})
