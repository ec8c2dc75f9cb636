"""What may be wrong, as changes of the picture: of the logarithm of its light, (H, W).

Most of it has a name and a number (`prior_sigma`). What has none is what the model leaves unexplained: the
wall's own texture, folds that are no contours, light that it does not know. It shows in the residual, of
which a fit takes most: a random field of the texture's length, fitted like the picture, tells how much it
leaves. The residual around a pixel over that share is how strong such a field must be there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from endolab.model.surface import normals
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.derivatives import links, px_per_reference
from endolab.reconstruction.contours.lines import find_contours
from endolab.reconstruction.light.walls import Walls
from endolab.reconstruction.uncertainty.linearised import Linearised
from endolab.reconstruction.uncertainty.prior_sigma import PriorSigma
from endolab.solvers.problem import Problem
from endolab.solvers.provenance import LightOutcome
from endolab.solvers.result import Iterate


@dataclass(frozen=True)
class CauseLimits:
    """How random fields and changes of light are made.

    Lengths are standard deviations of Gaussians, per 320 px of the longer side.
    """

    length: float = 12.0  # of a wall's texture
    around: float = 10.0  # of the residuals that count for a pixel
    # Of the median of what fits leave, below which a pixel's own is not taken.
    least_left: float = 0.5
    grazing: float = 0.05  # cos θ below which a lamp's place tells nothing more
    # Of the light's logarithm, that a lamp beside the optical centre changes at most.
    lamp_change: float = 1.0
    # From which on every second line is a contour: log d₀ per 1/320 of the longer side.
    possible_steepness: float = 0.03


CAUSES = CauseLimits()


def correlated_field(
    rng: np.random.Generator, shape: tuple[int, ...], length: float
) -> FloatArray:
    """A random field of unit variance: white noise, blurred by a Gaussian of this many px if by any."""
    if length == 0:
        return rng.standard_normal(shape)
    margin = int(3 * length) + 1
    white = rng.standard_normal((shape[0] + 2 * margin, shape[1] + 2 * margin))
    smooth = _blur(white, length)[margin:-margin, margin:-margin]
    return np.asarray(smooth * 2 * np.sqrt(np.pi) * length)


def _blur(a: FloatArray, sigma: float) -> FloatArray:
    """In single precision, to three σ: a draw need not be finer."""
    size = 2 * int(np.ceil(3 * sigma)) + 1
    single = a.astype(np.float32)
    blurred = cv2.GaussianBlur(single, (size, size), sigma, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(blurred, dtype=np.float64)


def rms_around(values: FloatArray, weight: FloatArray, sigma: float) -> FloatArray:
    """Root mean square around each pixel of those that are said."""
    share = np.maximum(_blur(weight, sigma), 1e-6)
    return np.asarray(np.sqrt(np.maximum(_blur(weight * values**2, sigma), 0.0) / share))


class Texture:
    """The wall's texture, and all else that the model does not explain, as a random field of the light."""

    def __init__(self, surface: Linearised, rng: np.random.Generator, least: float) -> None:
        self._surface = surface
        self._rng = rng
        self._least = least
        problem = surface.problem
        self._scale = px_per_reference(problem.mask.shape)
        self._informative = (surface.weight > 0).astype(np.float64)
        # Change of I per change of log light.
        self._light = surface.model / problem.photometry.gamma
        self._left: list[FloatArray] = []

    def draw(self) -> FloatArray:
        """One of unit variance."""
        return correlated_field(
            self._rng, self._informative.shape, CAUSES.length * self._scale
        )

    def try_field(self) -> None:
        """See what a fit leaves of a field of unit variance."""
        field = self.draw()
        change = self._surface.apply(self._surface.to_light(field))
        left = field - self._in_light(change)
        self._left.append(
            rms_around(left, self._informative, CAUSES.around * self._scale) ** 2
        )

    def _in_light(self, change: FloatArray | float) -> FloatArray:
        """A change of the picture as one of the light's logarithm; 0 where there is none."""
        light = self._light
        return np.asarray(
            np.divide(change, light, out=np.zeros_like(light), where=light > 0)
        )

    def strength(self, noise: float) -> FloatArray:
        """Standard deviation of the light's logarithm, by what fits leave and the residual beside noise."""
        left = np.sqrt(np.mean(self._left, axis=0))
        usual = (
            float(np.median(left[self._informative > 0]))
            if self._informative.any()
            else 1.0
        )
        unexplained = self._in_light(self._surface.residual)
        by_noise = self._in_light(noise)
        squares = [
            rms_around(square, self._informative, CAUSES.around * self._scale) ** 2
            for square in (unexplained, by_noise)
        ]
        strength = np.sqrt(np.maximum(squares[0] - squares[1], 0.0))
        return np.hypot(
            strength / np.maximum(left, CAUSES.least_left * max(usual, 1e-6)), self._least
        )


def light_changes(
    iterate: Iterate, prior_sigma: PriorSigma
) -> Iterator[tuple[str, FloatArray]]:
    """What one standard deviation of each named cause changes in the logarithm of the light."""
    problem = iterate.problem
    log_distance = iterate.log_distance
    mask = problem.mask
    field = problem.field
    brightness = np.where(mask, problem.image, 1.0)
    if prior_sigma.k:
        yield "k", -prior_sigma.k * np.log(np.where(mask, field.cos_alpha, 1.0))
    if prior_sigma.gamma:
        yield "gamma", prior_sigma.gamma * np.log(np.maximum(brightness, 0.5 / 255))
    share = (
        prior_sigma.left_in if iterate.provenance.albedo is None else prior_sigma.bounced
    )
    bounced = share * bounced_light(iterate) if share else None
    if bounced is not None and bounced.any():
        yield "bounced light", bounced
    if prior_sigma.lamp and problem.metric:
        rays = np.where(mask[..., None], field.rays, 0.0)
        normal = np.nan_to_num(normals(np.where(mask, log_distance, np.nan), field, mask))
        cosine = np.maximum(-(normal * rays).sum(axis=-1), CAUSES.grazing)
        distance = np.exp(np.where(mask, log_distance, 0.0))
        for axis in range(2):
            # Of cos θ/d² by the lamp's place: it is nearer, and the wall turned to it.
            slope = (3 * rays[..., axis] + normal[..., axis] / cosine) / distance
            yield (
                f"lamp {'xy'[axis]}",
                np.where(
                    mask,
                    np.clip(
                        prior_sigma.lamp * slope, -CAUSES.lamp_change, CAUSES.lamp_change
                    ),
                    0.0,
                ),
            )


def bounced_light(iterate: Iterate) -> FloatArray:
    """log(1 + ι) of the light that the wall's green bounces, as this surface makes it."""
    problem = iterate.problem
    albedo = iterate.provenance.albedo
    light = iterate.provenance.light
    if light is not None and light.outcome is LightOutcome.NONE_BOUNCED:
        return np.zeros(problem.mask.shape)
    brdf = problem.photometry.brdf
    rho = (
        float(np.pi * brdf.value(np.ones(1), np.ones(1))[0])
        if albedo is None
        else albedo[1]
    )
    rho = min(rho, 0.95)
    mask = problem.mask
    walls = Walls.of(
        np.where(mask, iterate.log_distance, np.nan),
        mask,
        problem.field,
        problem.photometry.k,
        problem.cuts,
    )
    return np.where(mask, np.log1p(walls.indirect_ratio(np.full(3, rho))[..., 1]), 0.0)


def possible_cuts(problem: Problem) -> BoolArray | None:
    """Cuts at every line of the picture that may be a contour, beside those of the problem."""
    cuts = (
        find_contours(problem.log_d0, problem.mask) > CAUSES.possible_steepness
    ) & links(problem.mask, problem.cuts)
    if not cuts.any():
        return problem.cuts
    return cuts if problem.cuts is None else cuts | problem.cuts
