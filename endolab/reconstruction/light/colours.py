r"""What three colours of one wall tell: how much light bounced, and the wall's albedos.

A wall of albedo a_c shows, of the lamp's light E,

    q_c = g/π E a_c (1 + p ι_c),        ι_c = S_c/E,

where S, light that bounced, follows from a surface and the albedos (`walls`). E is the same in red, green and
blue:

    red    log q_r - log a_r (1 + p ι_r)  \
    green  log q_g - log a_g (1 + p ι_g)   >  one log E for each patch of the wall
    blue   log q_b - log a_b (1 + p ι_b)  /

So the colours, in level and in tint, tell how right S is: a factor p for walls that are not in the picture,
the share b of the light's fall cos^k α that is the lamp's (the lens's part lights no walls), and the albedos.
All have priors, so that what the colours do not tell stays as it was: given albedos as given, others those
of mucosa. The prior of p is a line, not a square, far from its middle, so that a picture in which nothing
bounces is heard. The sheen of a wet film was once fitted, too; without it, no set is worse by 0.1 points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from endolab.frames.frame import ROUNDING
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.reconstruction.light.walls import Walls, bounced_light_and_slope
from endolab.solvers.problem import EXACT, Problem
from endolab.solvers.provenance import LightOutcome

LAMPS = (0.0, 0.5, 1.0)  # shares b for which S is computed, to be interpolated


@dataclass(frozen=True)
class LightFit:
    """The constants of the fit, chosen on path-traced cavities, whose truth is known.

    A prior is its middle and its width. Albedos' widths are of logarithms: of green's, and of red's and
    blue's against green's.
    """

    # p; 0.8 to 1.1 for the true surfaces of traced cavities.
    factor: tuple[float, float] = (0.9, 0.2)
    lamp: tuple[float, float] = (1.0, 0.3)  # b: all the lamp's, or any share
    # Width of albedos that are given, and of those that are not.
    given: float = 0.03
    unknown: float = 0.35
    # Of the albedos' logarithms in red, green and blue: blood takes green and blue light, hardly red.
    texture: tuple[float, float, float] = (0.05, 0.2, 0.2)
    together: float = 0.8  # correlation of green's texture with blue's
    # Errors of S go on over many patches: so many of them are independent.
    pieces: float = 20.0
    # Robust standard deviation, in units of texture: S is never exact.
    least_spread: float = 0.25
    largest_factor: float = 2.5
    # Mean difference of the colours' log E beyond which they say no one E.
    most_misfit: float = 0.1
    none_bounced: float = 0.05  # p below which nothing is taken to have bounced
    rounds: int = 3  # of the robust weights' scale
    # Of the steps of one round: the damping at first, how many, and the share of the misfit or the change at
    # which they end.
    damping: float = 1e-4
    steps: int = 25
    precision: float = 1e-5
    # Width of log ι from place to place, as a share of ι/(1 + ι) in red: the surface's errors are those of
    # S/E, most of all deep down. And how many widths a tint may be off before it counts for texture only.
    width_per_pixel: float = 0.5
    outlier: float = 1.5
    # Red, green and blue albedo of mucosa, before anything is known.
    tissue: tuple[float, float, float] = (0.7, 0.35, 0.28)
    albedos: tuple[float, float] = (0.02, 0.95)  # least and greatest
    alike: float = 0.1  # albedos that differ by no more, as a share, tell nothing
    least_patches: int = 30  # patches that show all three colours


FIT = LightFit()


@dataclass(frozen=True)
class AlbedoPrior:
    """What is believed of a wall's albedos before the colours are asked."""

    albedo: FloatArray  # (3,)
    # Of the logarithm of green's, and of red's and blue's against green's.
    widths: tuple[float, float]

    @classmethod
    def of(cls, given: ArrayLike | None) -> AlbedoPrior:
        """Make it of three albedos, of green's alone, or of nothing but that the wall is tissue."""
        tissue = np.array(FIT.tissue)
        if given is None:
            return cls(tissue, (FIT.unknown, FIT.unknown))
        albedo = np.asarray(given, dtype=np.float64)
        if albedo.ndim == 1:
            return cls(albedo, (FIT.given, FIT.given))
        widths = (FIT.given, FIT.unknown)
        return cls(np.minimum(tissue * albedo / tissue[1], 0.9 * FIT.albedos[1]), widths)

    @property
    def is_given(self) -> bool:
        """Whether all three albedos were given."""
        return self.widths[1] == FIT.given

    @property
    def light(self) -> Light:
        """What follows if the colours are not heard."""
        return Light(LightOutcome.COMPUTED, self.albedo, FIT.factor[0], FIT.lamp[0])

    @property
    def whitening(self) -> FloatArray:
        """What makes the albedos' logarithms independent and of unit variance, (3, 3)."""
        level, ratio = self.widths
        return np.array(
            [
                [1 / ratio, -1 / ratio, 0.0],
                [0.0, 1 / level, 0.0],
                [0.0, -1 / ratio, 1 / ratio],
            ]
        )


def known_albedo(endoscope: Calibration) -> FloatArray | None:
    """Return albedos in red, green and blue, (3,), or green's alone, (), as far as they can be: else None."""
    albedo = np.asarray(getattr(endoscope.photometry.brdf, "albedo", 0.0), dtype=np.float64)
    if albedo.ndim == 0:
        return albedo if FIT.albedos[0] < albedo < FIT.albedos[1] else None
    possible = np.all((albedo > 0) & (albedo < 1))
    differ = np.ptp(albedo) >= FIT.alike * albedo.max()
    return albedo if possible and differ else None


class NoColour(ValueError):
    """The three colours of a picture are one, so that nothing of bounced light can be told from them."""


@dataclass(frozen=True)
class Light:
    """What three colours tell of a wall and its light."""

    outcome: LightOutcome
    albedo: FloatArray  # (3,)
    factor: float  # p
    lamp: float  # b
    misfit: float = 0.0  # mean |log E_c - its mean over colours|
    reason: str = ""  # why the colours' word is not taken, in words; else ""

    def indirect_ratio(self, walls: Walls, k: float) -> FloatArray:
        """Return what is seen beside direct light, as a share of it, (H, W, 3).

        k is the joint exponent of lamp and lens.
        """
        return self.factor * walls.under(self.lamp * k).indirect_ratio(self.albedo)


@dataclass(frozen=True)
class Patches:
    """What the fit needs of a picture and its walls; P patches of it that show all three colours."""

    light: FloatArray  # (P, 3), log q_c
    direct: FloatArray  # (L, P), E under each of LAMPS
    orders: list[FloatArray]  # (bounces, P) under each, see `Walls.orders`

    @classmethod
    def of(cls, colours: Sequence[Problem], walls: Walls) -> Patches:
        """Average a picture over the patches of its walls."""
        photometry = colours[1].photometry
        pictures = [colour.image**photometry.gamma for colour in colours]
        means, direct, orders, _ = walls.averages(
            np.dstack(pictures),
            all_exact(colours) & (walls.direct > 0),
            [lamp * photometry.k for lamp in LAMPS],
        )
        return cls(np.log(means), direct, orders)

    def ratio_and_slopes(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return indirect over direct light, (P, 3), and its derivatives, (3, P, 3).

        They are those by the factor, the lamp's share and the logarithm of the colour's albedo; x is as of
        `ColourResiduals`.
        """
        factor, lamp = x[:2]
        albedo = np.exp(x[2:])
        place = lamp * (len(LAMPS) - 1)
        low = min(int(place), len(LAMPS) - 2)
        ratios = []
        slopes = []
        for index in (low, low + 1):
            bounced, slope = bounced_light_and_slope(self.orders[index], albedo)
            direct = self.direct[index][:, None]
            ratios.append(bounced / direct)
            slopes.append(slope / direct)
        change = ratios[1] - ratios[0]
        ratio = ratios[0] + (place - low) * change
        by_albedo = slopes[0] + (place - low) * (slopes[1] - slopes[0])
        by_lamp = factor * (len(LAMPS) - 1) * change
        return factor * ratio, np.stack([ratio, by_lamp, factor * by_albedo])


def all_exact(colours: Sequence[Problem]) -> BoolArray:
    """Return where all three colours say how bright the wall is, (H, W)."""
    exact = np.ones(colours[0].mask.shape, dtype=bool)
    for colour in colours:
        exact &= colour.mask
        if colour.evidence is not None:
            exact &= colour.evidence == EXACT
    return exact


def refine_per_pixel(
    colours: Sequence[Problem], indirect_ratio: FloatArray, light: Light
) -> FloatArray:
    """Correct ι (H, W, 3) where the wall's own tint tells that there is more of it, or less.

    Where the surface is wrong, S/E is wrong by one factor e^s in all colours, and what bounces too much is
    redder than the wall. The most likely s is told by least squares, with a prior and the wall's texture, as
    strong as the picture shows it.
    """
    exact = all_exact(colours) & (indirect_ratio[..., 0] > 0)
    if light.reason or not exact.any():
        return indirect_ratio
    ratio = indirect_ratio[exact]
    picture = np.stack([colour.image[exact] for colour in colours], axis=-1)
    lit = colours[1].photometry.gamma * np.log(np.maximum(picture, ROUNDING))
    wall = lit - np.log1p(ratio) - np.log(light.albedo)
    whitening = _tint_whitening().T
    tint = wall @ whitening
    sigma = max(1.48 * float(np.median(np.abs(tint))), FIT.least_spread)
    tint = FIT.outlier * np.tanh(tint / (FIT.outlier * sigma))
    slope = (ratio / (1 + ratio)) @ whitening / sigma
    width = FIT.width_per_pixel * ratio[:, 0] / (1 + ratio[:, 0])
    s = (tint * slope).sum(axis=1) / ((slope**2).sum(axis=1) + 1 / width**2)
    corrected = indirect_ratio.copy()
    corrected[exact] *= np.exp(s)[:, None]
    return corrected


def _tint_whitening() -> FloatArray:
    """Return two sums of the colours' logarithms, (2, 3).

    They are independent, of unit variance by texture, and know nothing of E.
    """
    covariance = np.diag(np.square(FIT.texture))
    covariance[1, 2] = covariance[2, 1] = FIT.together * FIT.texture[1] * FIT.texture[2]
    differences = np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0]])
    return np.linalg.solve(
        np.linalg.cholesky(differences @ covariance @ differences.T), differences
    )


def _charbonnier(r: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what half the square of is Charbonnier's penalty, √(1 + r²) - 1, and its derivative.

    The penalty is a square, but for large r a line.
    """
    root = np.sqrt(1 + r**2)
    size = np.sqrt(2 * (root - 1))
    small = np.abs(r) < 1e-4  # where the root says nothing
    slope = np.where(small, 1.0, np.abs(r) / (root * np.where(small, 1.0, size)))
    return np.sign(r) * size, slope


@dataclass(frozen=True)
class ColourResiduals:
    """How far the colours and the priors are from what light and albedos x make of them.

    x holds p, b and the logarithms of the albedos.
    """

    patches: Patches
    prior: AlbedoPrior
    sigma: float  # of the tint, in units of texture

    def __call__(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what least squares are of, (2 P + 5,), and its derivatives, a column for each of x."""
        by_colours, slopes_by_colours = self._of_colours(x)
        by_prior, slopes_by_prior = self._of_prior(x)
        slopes = [slopes_by_colours.reshape(-1, len(x)), slopes_by_prior]
        return np.concatenate([by_colours.ravel(), by_prior]), np.concatenate(slopes)

    def _of_colours(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (P, 2), and by x (P, 2, 5)."""
        ratio, slopes = self.patches.ratio_and_slopes(x)
        tint = _tint_whitening().T / self.sigma
        weight = float(np.sqrt(min(FIT.pieces / len(ratio), 1.0)))
        apart = (self.patches.light - np.log1p(ratio) - x[2:]) @ tint
        slopes = -slopes / (1 + ratio)
        jacobian = np.empty((*apart.shape, len(x)))
        jacobian[..., :2] = np.moveaxis(slopes[:2] @ tint, 0, -1)
        jacobian[..., 2:] = (slopes[2] - 1)[:, None] * tint.T
        apart, bend = _charbonnier(apart)
        jacobian *= weight * bend[..., None]
        return weight * apart, jacobian

    def _of_prior(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (5,), and by x (5, 5): a line far from the middle for p."""
        middle, width = np.transpose([FIT.factor, FIT.lamp])
        whitening = self.prior.whitening
        light = (x[:2] - middle) / width
        by_light = np.diag(1 / width)
        light[0], bend = _charbonnier(light[0])
        by_light[0, 0] *= bend
        albedo = whitening @ (x[2:] - np.log(self.prior.albedo))
        none = np.zeros((2, 3))
        return np.concatenate([light, albedo]), np.block(
            [[by_light, none], [none.T, whitening]]
        )


def fit_light(patches: Patches, prior: AlbedoPrior) -> Light:
    """Fit the light to the three colours; reject the fit where it is at a bound or they say no one E.

    Raises `NoColour` if albedos that are not given come out as good as equal.
    """
    if len(patches.light) < FIT.least_patches:
        return replace(prior.light, reason="too little of the picture shows all three")

    def log_direct(x: FloatArray) -> FloatArray:
        """Return log E_c but for a constant, (P, 3)."""
        ratio, _ = patches.ratio_and_slopes(x)
        return patches.light - np.log1p(ratio) - x[2:]

    low = np.array([0.0, 0.0, *np.log(3 * [FIT.albedos[0]])])
    high = np.array([FIT.largest_factor, 1.0, *np.log(3 * [FIT.albedos[1]])])
    x = np.array([FIT.factor[0], FIT.lamp[0], *np.log(prior.albedo)])
    sigma = 1.0
    for _ in range(FIT.rounds):
        x = _fit_within(ColourResiduals(patches, prior, sigma), x, low, high)
        tint = np.median(np.abs(log_direct(x) @ _tint_whitening().T))
        sigma = max(1.48 * float(tint), FIT.least_spread)
    light = log_direct(x)
    misfit = float(np.abs(light - light.mean(axis=1, keepdims=True)).mean())
    albedo = np.exp(x[2:])
    estimate = Light(LightOutcome.REMOVED, albedo, float(x[0]), float(x[1]), misfit)
    if not prior.is_given and np.ptp(albedo) < FIT.alike * albedo.max():
        raise NoColour("they are as good as equal")
    reason = _why_unlikely(misfit, x <= low, x >= high)
    if reason:
        return replace(prior.light, misfit=misfit, reason=reason)
    if estimate.factor < FIT.none_bounced:
        known = prior.light if prior.is_given else estimate
        none = LightOutcome.NONE_BOUNCED
        return replace(known, outcome=none, factor=0.0, misfit=misfit)
    return estimate


def _fit_within(
    residuals: ColourResiduals, x: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    """Fit x by the steps of Levenberg and Marquardt; what would leave its bounds stays at them.

    (JᵀJ + damping · its diagonal) step = -Jᵀr. SciPy's trust region finds the same in ten times the time.
    """
    residual, jacobian = residuals(x)
    misfit = residual @ residual
    damping = FIT.damping
    for _ in range(FIT.steps):
        slope = jacobian.T @ residual
        free = np.where(slope > 0, x > low, x < high)
        bend = (jacobian.T @ jacobian)[np.ix_(free, free)]
        step = np.zeros_like(x)
        step[free] = np.linalg.solve(bend + damping * np.diag(np.diag(bend)), -slope[free])
        tried = np.clip(x + step, low, high)
        residual_there, jacobian_there = residuals(tried)
        fall = misfit - residual_there @ residual_there
        if fall <= 0:
            damping *= 10
            continue
        change = np.abs(tried - x).max()
        x = tried
        residual = residual_there
        jacobian = jacobian_there
        if fall < FIT.precision * misfit or change < FIT.precision:
            break
        misfit -= fall
        damping /= 10
    return x


def _why_unlikely(misfit: float, at_low: BoolArray, at_high: BoolArray) -> str:
    """Say why a fit is no answer; "" if it is one. Which of x ended at a bound are given."""
    if at_high[0]:
        return "more light than can have bounced"
    if (at_low | at_high)[2:].any():
        return "albedos that no tissue has"
    if misfit > FIT.most_misfit:
        return "the channels disagree on the direct light"
    return ""
