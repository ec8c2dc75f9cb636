r"""What three colours of one wall tell: how much light bounced, and the wall's albedos.

A wall of albedo a_c shows, of the lamp's light E,

    q_c = g/π E a_c (1 + p ι_c),        ι_c = S_c/E,

where S, light that bounced, follows from a surface and the albedos (`walls`). E is the same in red, green and
blue:

    red    log q_r - log a_r (1 + p ι_r)  \
    green  log q_g - log a_g (1 + p ι_g)   >  one log E for each patch of the wall
    blue   log q_b - log a_b (1 + p ι_b)  /

So the colours, in level and in tint, tell how right S is: a factor p for walls that are not in the picture,
the part b of the light's fall cos^k α that is the lamp's (the lens's part lights no walls), and the albedos.
All have priors, so that what the colours do not tell stays as it was: given albedos as given, others those
of mucosa. The prior of p is a line, not a square, far from its middle, so that a picture in which nothing
bounces is heard. The sheen of a wet film was once fitted, too; without it, no set is worse by 0.1 points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from endolab.frames.frame import ROUNDING
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.reconstruction import constants
from endolab.reconstruction.walls import Walls, bounced_light_and_slope
from endolab.solvers.problem import EXACT, Problem
from endolab.solvers.provenance import LightOutcome

LAMPS = (0.0, 0.5, 1.0)  # b for which S is computed, to be interpolated

# Widths of the logarithm of albedos that are given, and of those that are not.
GIVEN = 0.03
UNKNOWN = 0.35
TISSUE = (0.7, 0.35, 0.28)  # red, green and blue albedo of mucosa, before anything is known
LEAST_ALBEDO = 0.02
MOST_ALBEDO = 0.95
ALIKE = 0.1  # albedos that differ by no more, as a fraction, tell nothing


@dataclass(frozen=True, eq=False)
class AlbedoPrior:
    """What is believed of a wall's albedos before the colours are asked."""

    albedo: FloatArray  # (3,)
    # Of the logarithm of green's, and of red's and blue's against green's.
    widths: tuple[float, float]

    @classmethod
    def of(cls, given: ArrayLike | None) -> AlbedoPrior:
        """Make it of three albedos, of green's alone, or of nothing but that the wall is tissue."""
        tissue = np.array(TISSUE)
        if given is None:
            return cls(tissue, (UNKNOWN, UNKNOWN))
        albedo = np.asarray(given, dtype=np.float64)
        if albedo.ndim == 1:
            return cls(albedo, (GIVEN, GIVEN))
        widths = (GIVEN, UNKNOWN)
        return cls(np.minimum(tissue * albedo / tissue[1], 0.9 * MOST_ALBEDO), widths)

    @property
    def is_given(self) -> bool:
        """Whether all three albedos were given."""
        return self.widths[1] == GIVEN

    @property
    def light(self) -> Light:
        """What follows if the colours are not heard."""
        factor, lamp = self.middle[:2].tolist()
        return Light(LightOutcome.COMPUTED, self.albedo, factor, lamp)

    @property
    def middle(self) -> FloatArray:
        """Likeliest p, b and logarithms of the albedos, (5,)."""
        middles = [constants.FACTOR_PRIOR[0], constants.LAMP_PRIOR[0]]
        return np.array([*middles, *np.log(self.albedo)])

    @property
    def whitening(self) -> FloatArray:
        """What makes p, b and the albedos' logarithms independent and of unit variance, (5, 5)."""
        level, ratio = self.widths
        red_green_blue = np.array([[1, -1, 0], [0, ratio / level, 0], [0, -1, 1]]) / ratio
        widths = constants.FACTOR_PRIOR[1], constants.LAMP_PRIOR[1]
        return block_diag(*np.reciprocal(widths), red_green_blue)


def prior_of(endoscope: Calibration) -> AlbedoPrior:
    """Believe an endoscope's albedos in red, green and blue, or green's alone, as far as they can be."""
    albedo = np.asarray(getattr(endoscope.photometry.brdf, "albedo", 0.0), dtype=np.float64)
    if albedo.ndim == 0:
        possible = bool(LEAST_ALBEDO < albedo < MOST_ALBEDO)
    else:
        differ = np.ptp(albedo) >= ALIKE * albedo.max()
        possible = bool(differ and np.all((albedo > 0) & (albedo < 1)))
    return AlbedoPrior.of(albedo if possible else None)


class NoColour(ValueError):
    """The three colours of a picture are one, so that nothing of bounced light can be told from them."""


@dataclass(frozen=True, eq=False)
class Light:
    """What three colours tell of a wall and its light."""

    outcome: LightOutcome
    albedo: FloatArray  # (3,)
    factor: float  # p
    lamp: float  # b
    misfit: float = 0.0  # mean |log E_c - its mean over colours|
    reason: str = ""  # why the colours' word is not taken, in words; else ""

    def indirect_ratio(self, walls: Walls, k: float) -> FloatArray:
        """Return what is seen beside direct light, over it, (H, W, 3).

        k is the joint exponent of lamp and lens.
        """
        return self.factor * walls.under(self.lamp * k).indirect_ratio(self.albedo)


@dataclass(frozen=True, eq=False)
class Patches:
    """What the fit needs of a picture and its walls; P patches of it that show all three colours."""

    light: FloatArray  # (P, 3), log q_c
    direct: FloatArray  # (L, P), E under each of LAMPS
    orders: FloatArray  # (L, bounces, P) under each, see `Walls.orders`
    gamma: float

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
        return cls(np.log(means), direct, orders, photometry.gamma)

    def ratio_and_slopes(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return indirect over direct light, (P, 3), and its derivatives, (3, P, 3).

        They are those by the factor, the lamp's part and the logarithm of the colour's albedo; x is as of
        `residuals`.
        """
        factor, lamp = x[:2]
        albedo = np.exp(x[2:])
        place = lamp * (len(LAMPS) - 1)
        low = min(int(place), len(LAMPS) - 2)
        of_lamps = []
        for lit in (low, low + 1):
            both = bounced_light_and_slope(self.orders[lit], albedo)
            of_lamps.append(np.stack(both) / self.direct[lit][:, None])
        change = of_lamps[1] - of_lamps[0]
        ratio, by_albedo = of_lamps[0] + (place - low) * change
        by_lamp = factor * (len(LAMPS) - 1) * change[0]
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
    sigma = max(1.48 * float(np.median(np.abs(tint))), constants.LEAST_SPREAD)
    tint = constants.OUTLIER * np.tanh(tint / (constants.OUTLIER * sigma))
    bounced = ratio / (1 + ratio)  # as a share of all light
    slope = bounced @ whitening / sigma
    width = constants.WIDTH_PER_PIXEL * bounced[:, 0]
    s = (tint * slope).sum(axis=1) / ((slope**2).sum(axis=1) + 1 / width**2)
    corrected = indirect_ratio.copy()
    corrected[exact] *= np.exp(s)[:, None]
    return corrected


def _tint_whitening() -> FloatArray:
    """Return two sums of the colours' logarithms, (2, 3).

    They are independent, of unit variance by texture, and know nothing of E.
    """
    covariance = np.diag(np.square(constants.TEXTURE))
    covariance[1, 2] = covariance[2, 1] = (
        constants.TOGETHER * constants.TEXTURE[1] * constants.TEXTURE[2]
    )
    differences = np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0]])
    return np.linalg.solve(
        np.linalg.cholesky(differences @ covariance @ differences.T), differences
    )


def residuals(
    x: FloatArray, patches: Patches, prior: AlbedoPrior
) -> tuple[FloatArray, FloatArray]:
    """Return how far the colours and the priors are from what light and albedos x make of them.

    x holds p, b and the logarithms of the albedos. Returned are two numbers of each patch, in units of
    texture, and one of each of x, (2 P + 5,); and their derivatives, a column for each of x.
    """
    ratio, slopes = patches.ratio_and_slopes(x)
    tint = _tint_whitening().T
    by_x = np.zeros((len(x), *ratio.shape))  # of log E
    by_x[:2] = slopes[:2]
    by_x[2:] = np.eye(3)[:, None] * (slopes[2] + 1 + ratio)
    by_x /= -(1 + ratio)
    apart = (patches.light - np.log1p(ratio) - x[2:]) @ tint
    by_colours = np.moveaxis(by_x @ tint, 0, -1).reshape(-1, len(x))
    return (
        np.append(apart, prior.whitening @ (x - prior.middle)),
        np.concatenate([by_colours, prior.whitening]),
    )


def fit_light(patches: Patches, prior: AlbedoPrior) -> Light:
    """Fit the light to the three colours; reject the fit where it is at a bound or they say no one E.

    Raises `NoColour` if albedos that are not given come out as good as equal.
    """
    if len(patches.light) < 30:
        return replace(prior.light, reason="too little of the picture shows all three")
    low = np.array([0.0, 0.0, *np.log(3 * [LEAST_ALBEDO])])
    high = np.array([2.5, 1.0, *np.log(3 * [MOST_ALBEDO])])
    x = prior.middle
    pieces = min(constants.PIECES / len(patches.light), 1.0)
    for _ in range(40):
        r, by_x = residuals(x, patches, prior)
        # What is large, of the colours in units of their spread, and of p, costs its size, not its square.
        tints = r[: -len(x)]
        spread = max(1.48 * float(np.median(np.abs(tints))), constants.LEAST_SPREAD)
        weight = np.ones(len(r))
        weight[: -len(x)] = pieces / (spread * np.hypot(spread, tints))
        weight[-len(x)] = 1 / np.hypot(1, r[-len(x)])
        # Gauss-Newton's step; what would leave its bounds stays at them.
        slope = (weight * r) @ by_x
        bend = (weight * by_x.T) @ by_x
        free = np.where(slope > 0, x > low, x < high)
        before = x.copy()
        x[free] -= np.linalg.solve(bend[np.ix_(free, free)], slope[free])
        x = np.clip(x, low, high)
        if np.abs(x - before).max() < 1e-3:
            break
    log_direct = patches.light - np.log1p(patches.ratio_and_slopes(x)[0]) - x[2:]
    misfit = float(np.abs(log_direct - log_direct.mean(axis=1, keepdims=True)).mean())
    albedo = np.exp(x[2:])
    if not prior.is_given and np.ptp(albedo) < ALIKE * albedo.max():
        raise NoColour("they are as good as equal")
    reason = ""
    if x[0] >= high[0]:
        reason = "more light than can have bounced"
    elif ((x <= low) | (x >= high))[2:].any():
        reason = "albedos that no tissue has"
    elif misfit > constants.MOST_MISFIT * patches.gamma:
        reason = "the channels disagree on the direct light"
    if reason:
        return replace(prior.light, misfit=misfit, reason=reason)
    light = Light(LightOutcome.REMOVED, albedo, float(x[0]), float(x[1]), misfit)
    if light.factor < 0.05:
        known = prior.light if prior.is_given else light
        none = LightOutcome.NONE_BOUNCED
        return replace(known, outcome=none, factor=0.0, misfit=misfit)
    return light
