"""What a photometric calibration returns: the model, its uncertainties, and its score on other frames."""

from dataclasses import dataclass, field, replace

import numpy as np

from endolab.calibration.least_squares import OUTLIER, robust_sigma
from endolab.calibration.photometric.model import GREY_LEVELS, LEVELS
from endolab.calibration.photometric.samples import Samples
from endolab.model.photometry import Photometry
from endolab.numerics.arrays import BoolArray, FloatArray, IntArray
from endolab.numerics.iteration import Status


@dataclass(frozen=True)
class HeldOut:
    """How well a calibration predicts frames that it has not seen, against the angle off the axis."""

    edges: FloatArray  # (m + 1,), bins of α, rad
    error: FloatArray  # (m,), measured over modelled μ′ - 1, averaged over the bin; nan where no samples are
    standard_error: FloatArray  # (m,), of that, by noise alone
    count: IntArray  # (m,), samples
    sigma: float  # standard deviation of measured - predicted, grey levels


@dataclass(frozen=True)
class PhotometricFit:
    """A photometric calibration with its evidence.

    `covariance` and `correlation`, (p, p), are of the unknowns that all frames share, `names`: "k", "gamma",
    "brdf j", "reflectance m"; of the logarithms of BRDF and reflectances. `standard_errors` are
    of the values themselves, "k/gamma" included; 0 for what was given. Where γ or a reflectance is only
    known beforehand, `gain_errors` are those at its given value.
    """

    photometry: Photometry  # its gain is None, or the one that all frames share
    frames: IntArray  # (m,), their numbers
    gains: FloatArray  # (m,), g of each
    gain_errors: FloatArray  # (m,); inf where no sample of the frame could be used
    reflectance: FloatArray  # (materials,), relative to material 0
    names: list[str]
    covariance: FloatArray
    correlation: FloatArray
    standard_errors: dict[str, float]
    ratio: float  # k/γ, the one thing that every set-up determines
    residuals: FloatArray = field(repr=False)  # (n,), measured - predicted, grey levels
    used: BoolArray = field(repr=False)  # (n,), samples that counted in the end
    sigma: float  # standard deviation of the residuals used, grey levels
    mean: float  # of the same, grey levels
    alpha_range: tuple[float, float]  # of the samples used, rad
    theta_range: tuple[float, float]  # likewise, rad
    distance_range: tuple[float, float]  # likewise, mm
    # What is determined, by what, how well, and what is not, in sentences.
    verdict: list[str]
    status: Status

    @property
    def k(self) -> float:
        """Joint exponent of light and vignetting."""
        return self.photometry.k

    def _shape(self, samples: Samples) -> FloatArray:
        """Stored values at a gain of 1."""
        unit_gain = replace(self.photometry, gain=1.0)
        level = unit_gain.intensity(samples.points, samples.normals)
        return level * self.reflectance[samples.material] ** (1 / self.photometry.gamma)

    def score_held_out(self, samples: Samples) -> HeldOut:
        """Score the calibration on frames that it has not seen, in bins of α of 10°.

        Only the gain of each frame (one for all, if it is locked) is fitted to it, as it has to be; an error
        that all samples of a frame share stays unseen. The error of μ′ at α is the factor, less 1, by which
        the linear light of the samples in a bin exceeds the model's. It is the least-squares factor of their
        grey levels to the power γ: a mean of measured light itself would be biased by noise, which γ bends.
        """
        measured = GREY_LEVELS * samples.level
        shape = GREY_LEVELS * self._shape(samples)
        _, group = np.unique(samples.frame, return_inverse=True)
        if self.photometry.gain is not None:
            group = np.zeros_like(group)
        low, high = GREY_LEVELS * np.array(LEVELS)
        weight = ((measured > low) & (measured < high)).astype(float)
        for _ in range(10):
            total = np.bincount(group, weight * shape**2)
            factor = np.bincount(group, weight * shape * measured)
            predicted = (factor / np.where(total > 0, total, 1))[group] * shape
            residual = measured - predicted
            inside = (predicted > low) & (predicted < high)
            if not inside.any():
                raise ValueError("samples must hold some within the range of levels")
            sigma = robust_sigma(residual[:, None], inside, len(total))
            weight = (inside & (np.abs(residual) < OUTLIER * sigma)).astype(float)
        used = weight > 0
        alpha = np.arccos(np.clip(samples.cos_alpha[used], -1, 1))
        edges = np.deg2rad(np.arange(0.0, 91.0, 10.0))
        count, _ = np.histogram(alpha, edges)
        power, _ = np.histogram(alpha, edges, weights=predicted[used] ** 2)
        excess, _ = np.histogram(alpha, edges, weights=(predicted * residual)[used])
        gamma = self.photometry.gamma
        with np.errstate(invalid="ignore", divide="ignore"):
            error = (1 + excess / power) ** gamma - 1
            standard_error = np.where(count > 0, gamma * sigma / np.sqrt(power), np.nan)
        return HeldOut(edges, error, standard_error, count, sigma)
