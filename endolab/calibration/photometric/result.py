"""What a photometric calibration returns: the model, its uncertainties, and how far it is off."""

from dataclasses import dataclass, field

import numpy as np

from endolab.calibration import constants
from endolab.calibration.least_squares import Row, list_rows
from endolab.calibration.photometric.model import GREY_LEVELS
from endolab.calibration.photometric.samples import Samples
from endolab.calibration.refusals import Doubt
from endolab.model.brdf import TabulatedBRDF
from endolab.model.photometry import Photometry
from endolab.numerics.arrays import BoolArray, FloatArray, IntArray, nan_if_undefined
from endolab.numerics.iteration import Status


@dataclass(frozen=True, eq=False)
class AngleErrors:
    """How far the fall-off of a calibration is off, against the angle off the axis."""

    edges: FloatArray  # (m + 1,), bins of α, rad
    error: FloatArray  # (m,), measured over modelled μ′ - 1, averaged over the bin; nan where no samples are
    standard_error: FloatArray  # (m,), of that, by noise alone
    count: IntArray  # (m,), samples

    @property
    def largest(self) -> float:
        """Largest error of the bins that have enough samples; nan without any."""
        known = np.abs(self.error[self.count >= constants.LEAST_SCORED])
        return float(known.max()) if known.size else np.nan


@dataclass(frozen=True, eq=False)
class PhotometricFit:
    """A photometric calibration with its evidence.

    `covariance`, (p, p), is of the unknowns that all frames share, `names`: "k", "gamma", "lamp l x" and
    "lamp l y", mm, "brdf j", "reflectance m"; of the logarithms of BRDF and reflectances. `standard_errors`
    are of the values themselves, "k/gamma" included; 0 for what was given.
    """

    photometry: Photometry  # its gain is None, or the one that all frames share
    frames: IntArray  # (m,), their numbers
    gains: FloatArray  # (m,), g of each
    gain_errors: FloatArray  # (m,); inf where no sample of the frame could be used
    reflectance: FloatArray  # (materials,), relative to material 0
    names: list[str]
    covariance: FloatArray
    standard_errors: dict[str, float]
    residuals: FloatArray = field(repr=False)  # (n,), measured - predicted, grey levels
    used: BoolArray = field(repr=False)  # (n,), samples that counted in the end
    sigma: float  # standard deviation of the residuals used, grey levels
    alpha_range: tuple[float, float]  # of the samples used, rad
    theta_range: tuple[float, float]  # likewise, rad
    # Lamps that were tried → root mean square residual of frames held out, grey levels; auto alone tries.
    held_out: dict[str, float]
    doubts: list[Doubt]
    status: Status

    @property
    def k(self) -> float:
        """Joint exponent of light and vignetting."""
        return self.photometry.simplify().k

    @property
    def ratio(self) -> float:
        """k/γ, the one thing that every set-up determines."""
        return self.k / self.photometry.gamma

    @property
    def correlation(self) -> FloatArray:
        """Of the unknowns that all frames share, (p, p)."""
        deviation = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(deviation, deviation)

    def table(self) -> list[Row]:
        """Name, value, standard error and unit of what was found; of how well it fits, without error (nan).

        An error of 0 is that of a given number.
        """
        values = {"k": (self.k, ""), "gamma": (self.photometry.gamma, "")}
        values["k/gamma"] = self.ratio, ""
        for number, light in enumerate(self.photometry.lights, 1):
            for axis, place in zip("xy", light.position, strict=False):
                values[f"lamp {number} {axis}"] = place, "mm"
        for material, ratio in enumerate(self.reflectance.tolist()[1:], 1):
            values[f"reflectance {material}"] = ratio, ""
        values["residual of the light"] = self.sigma, "grey levels"
        for lamps, off in self.held_out.items():
            values[f"lamps {lamps}, held out"] = off, "grey levels"
        edge = self.alpha_range[1]
        at_edge = -100 * float(np.log(np.cos(edge))) * self.standard_errors["k"]
        values["light seen to"] = float(np.rad2deg(edge)), "°"
        values["σ of the light there"] = at_edge, "%"
        return list_rows(values, self.standard_errors)

    def relative_brdf(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the BRDF's nodes θ, rad, its values relative to the node that is not fitted, their errors.

        Two nodes of 1 ± 0 at the ends of the range if the surface was taken to be matt.
        """
        brdf = self.photometry.brdf
        if not isinstance(brdf, TabulatedBRDF):
            return np.array(self.theta_range), np.ones(2), np.zeros(2)
        values = np.array(brdf.values)
        errors = np.array(
            [self.standard_errors[f"brdf {node}"] for node in range(len(values))]
        )
        pinned = values[np.argmin(errors)]
        return np.array(brdf.theta), values / pinned, errors / pinned

    def errors_by_angle(self, samples: Samples) -> AngleErrors:
        """Measure how far the fall-off is off, in bins of α of 10°, by the samples of the fit.

        The error of μ′ at α is the factor, less 1, by which the linear light of the samples in a bin exceeds
        the model's. It is the least-squares factor of their grey levels to the power γ: a mean of measured
        light itself would be biased by noise, which γ bends.
        """
        gamma = self.photometry.gamma
        residual = self.residuals[self.used]
        counted = samples[self.used]
        predicted = GREY_LEVELS * counted.level - residual
        edges = np.deg2rad(np.arange(0.0, 91.0, 10.0))
        count, power, excess = (
            np.histogram(np.arccos(np.minimum(counted.cos_alpha, 1)), edges, weights=w)[0]
            for w in (None, predicted**2, predicted * residual)
        )
        with nan_if_undefined():
            error = (1 + excess / power) ** gamma - 1
            standard_error = gamma * self.sigma / np.sqrt(power)
        return AngleErrors(edges, error, standard_error, count)
