"""How well a stated σ tells how far a depth map is from the truth.

A σ is judged by how often the truth lies within it, by whether the pixels it calls bad are the bad ones, and
by two proper scores, which no σ can better but by saying what is so: with Gneiting and Raftery, "Strictly
proper scoring rules, prediction, and estimation", 2007. A σ that is the same share of every distance, the
best there is for this very picture, is what it has to beat.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr
from scipy.stats import spearmanr

from endolab.metrics.depth_errors import scale_to, valid_in_all
from endolab.numerics.arrays import BoolArray, FloatArray


@dataclass(frozen=True)
class Coverage:
    """How a depth map's σ fares over the pixels where it, the distance and the truth are known.

    Errors and σ are taken as shares of the estimated distance. Scores are means over pixels of what a normal
    distribution with that σ is charged for the truth: the less, the better.
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
    crps_percent: float  # continuous ranked probability score, %
    constant_percent: float  # the best constant for the log score, %
    constant_log_score: float  # its score
    constant_crps_percent: float  # score of the best constant for that score, %

    @property
    def beats_a_constant(self) -> bool:
        """Whether both scores are better than those of the best constants."""
        return (
            self.log_score < self.constant_log_score
            and self.crps_percent < self.constant_crps_percent
        )


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
        crps_percent=float(100 * np.mean(crps(error, share))),
        constant_percent=100 * rms,
        constant_log_score=float(np.mean(log_score(error, rms))),
        constant_crps_percent=float(100 * np.mean(crps(error, _best_for_crps(error)))),
    )


def spearman(a: FloatArray, b: FloatArray) -> float:
    """Correlation of the ranks of two samples; nan if one is constant."""
    return float(spearmanr(a, b).statistic) if np.ptp(a) > 0 < np.ptp(b) else float("nan")


def log_score(error: FloatArray, sigma: FloatArray | float) -> FloatArray:
    """-log of a normal density of this σ at this error; -inf of no error with no σ."""
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.where(error == 0, 0.0, error / sigma)
        return np.asarray(0.5 * np.log(2 * np.pi) + np.log(sigma) + 0.5 * z**2)


def crps(error: FloatArray, sigma: FloatArray | float) -> FloatArray:
    """Continuous ranked probability score of a normal distribution of this σ at this error, in its unit.

    ∫ (F(x) - [x ≥ error])² dx, which is |error| where σ is 0.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.where(error == 0, 0.0, error / sigma)
    density = np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi)
    return np.asarray(
        error * (2 * ndtr(z) - 1) + sigma * (2 * density - 1 / np.sqrt(np.pi))
    )


def _best_for_crps(error: FloatArray) -> float:
    """The σ that makes the mean score least: its derivative 2φ(error/σ) - 1/√π grows with σ."""
    high = 2 * float(error.max())

    def slope(sigma: float) -> float:
        return float(
            np.mean(np.exp(-0.5 * (error / sigma) ** 2)) * np.sqrt(2 / np.pi)
            - 1 / np.sqrt(np.pi)
        )

    return float(brentq(slope, 1e-6 * high, high)) if high > 0 else 0.0
