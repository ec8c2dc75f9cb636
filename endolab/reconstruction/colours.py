"""What three colours of one wall tell: how much light bounced, the wall's albedos, how much it mirrors.

A wall of albedo a_c shows, of the lamp's light E,

    q_c = g/π E (a_c (1 + p ι_c) + m M),        ι_c = S_c/E,

where S, light that bounced, follows from a surface and the albedos (`interreflection`) and M is the lobe
of a rough wet film. E is the same in red, green and blue, so that the colours, in level and in tint, tell
how right S is: a factor p for walls that are not in the picture, the share b of the light's fall cos^k α
that is the lamp's (the lens's part lights no walls), the albedos, and m. All have priors, so that what
the colours do not tell stays as it was: given albedos as given, others those of mucosa. The priors of p
and m are lines, not squares, far from their middle, so that a picture in which nothing bounces is heard.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import ArrayLike

from endolab.depth.problem import EXACT, Problem
from endolab.model.interreflection import MOST_INDIRECT, Walls, bounced_and_slope
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.preprocessing.frame import QUIET

TISSUE = (0.7, 0.35, 0.28)  # red, green and blue of mucosa, before anything is known
TEXTURE = (0.05, 0.2, 0.2)  # of the albedos' logarithms: blood takes green and blue light, hardly red
TOGETHER = 0.8  # correlation of green's texture with blue's
FACTOR = 0.9, 0.2  # p before and its width; 0.8 to 1.1 for the true surfaces of traced cavities
LAMP = 1.0, 0.3  # b before and its width: all the lamp's, or any share
GIVEN = 0.03, 0.03  # widths of given albedos' logarithms: of green's, of red's and blue's against green's
GREEN = 0.1, 0.35  # the same where green's alone is given
UNKNOWN = 0.35, 0.35  # and where none is
FILM = 0.0, 0.15  # m before and its width; 1 mirrors 4 % at normal incidence, as water does
ROUGHNESS = 0.3  # of the film, GGX's α
PIECES = 20.0  # errors of S go on over many patches: so many of them are independent
FLOOR = 0.25  # of the robust standard deviation, in units of TEXTURE: S is never exact
LARGEST_FACTOR, SHINIEST = 2.5, 3.0  # p and m at most
AT_BOUND = 0.98  # share of a bound beyond which an estimate is at it
ALBEDOS = 0.02, 0.95  # least and greatest
MISFIT = 0.1  # mean difference of the colours' log E beyond which they say no one E
NONE_BOUNCED = 0.05  # of p, below which nothing is taken to have bounced
SEEN = 0.2  # of m, beyond which a film is spoken of
LEAST_PATCHES = 30  # patches that show all three colours
ROUNDS = 3  # of the robust weights' scale
ALIKE = 0.1  # albedos that differ by no more, as a share, tell nothing
LAMPS = (0.0, 0.5, 1.0)  # shares b for which S is computed, to be interpolated
# Width of log ι from place to place, as a share of ι/(1 + ι) in red: the surface's errors are those of S/E,
# most of all deep down. And how many widths a tint may be off before it counts for texture only.
FROM_PLACE_TO_PLACE, OUTLIER = 0.25, 1.5


@dataclass(frozen=True)
class Belief:
    """What is taken of a wall's albedos before the colours are asked."""

    albedo: FloatArray  # (3,)
    widths: tuple[float, float]  # of the logarithm of green's, and of red's and blue's against green's

    @classmethod
    def of(cls, given: ArrayLike | None) -> Belief:
        """Three albedos, green's alone, or nothing but that it is tissue."""
        tissue = np.array(TISSUE)
        if given is None:
            return cls(tissue, UNKNOWN)
        albedo = np.asarray(given, dtype=np.float64)
        if albedo.ndim == 1:
            return cls(albedo, GIVEN)
        return cls(np.minimum(tissue * albedo / tissue[1], 0.9 * ALBEDOS[1]), GREEN)

    @property
    def light(self) -> Light:
        """What follows if the colours are not heard."""
        return Light(self.albedo, FACTOR[0], LAMP[0], FILM[0])

    @property
    def whitening(self) -> FloatArray:
        """What makes the albedos' logarithms independent and of unit variance, (3, 3)."""
        level, ratio = self.widths
        return np.array([[1 / ratio, -1 / ratio, 0.0], [0.0, 1 / level, 0.0], [0.0, -1 / ratio, 1 / ratio]])


class NoColour(ValueError):
    """The three colours of a picture are one, so that nothing of bounced light can be told from them."""


@dataclass(frozen=True)
class Light:
    """What three colours tell of a wall and its light."""

    albedo: FloatArray  # (3,)
    factor: float  # p
    lamp: float  # b
    film: float  # m
    misfit: float = 0.0  # mean |log E_c - its mean over colours|
    refused: str = ""  # why the colours' word is not taken, in words; else ""

    def describe(self, given: bool, medians: FloatArray) -> str:
        """Say what was found; `medians` are those of the direct light's shares that bounced, in per cent."""
        albedos = ", ".join(f"{value:.2f}" for value in self.albedo)
        red, green, blue = medians
        shares = f"red {red:.0f} %, green {green:.0f} %, blue {blue:.0f} % of the direct light"
        if self.refused:
            whose = "given albedos" if given else "albedos of tissue"
            why = f"The colours do not tell how much there is ({self.refused})"
            return f"Indirect light removed: {shares}. {why}, so it was computed with {whose}: {albedos}."
        if self.factor == self.film == 0:
            return "The colours show no indirect light, and none was removed."
        film = " and a wet film's sheen" if self.film > SEEN else ""
        return (
            f"Indirect light removed: {shares} (medians){film}. By the colours it is {self.factor:.2f} times "
            f"what the surface predicts with {'given' if given else 'estimated'} albedos {albedos}; "
            f"{100 * self.lamp:.0f} % of k is the lamp's."
        )

    def indirect_ratio(self, walls: Walls, k: float) -> FloatArray:
        """What is seen beside the direct light of a matt wall, as a share of it, (H, W, 3).

        k is the joint exponent of lamp and lens.
        """
        share = self.factor * walls.under(self.lamp * k).indirect_ratio(self.albedo)
        mirrored = self.film * np.where(walls.cosine > 0, lobe(walls.cosine), 0.0)
        return share + mirrored[..., None] / self.albedo


def lobe(cosine: FloatArray) -> FloatArray:
    """π times the film's BRDF towards the lamp, at cos θ: GGX of ROUGHNESS, 4 % at normal incidence."""
    slope = 1 / np.maximum(cosine, 0.1) ** 2 - 1  # tan² θ
    seen = 2 / (1 + np.sqrt(1 + ROUGHNESS**2 * slope))  # of its facets, and lit (Smith)
    return 0.01 * ROUGHNESS**2 * (1 + slope) ** 3 * (seen / (ROUGHNESS**2 + slope)) ** 2


@dataclass(frozen=True)
class Patches:
    """What the estimate needs of a picture and its walls; P patches of it that show all three colours."""

    light: FloatArray  # (P, 3), log q_c
    direct: FloatArray  # (L, P), E under each of LAMPS
    orders: list[FloatArray]  # (BOUNCES, P) under each, see `Walls.orders`
    lobe: FloatArray  # (P,), M

    @classmethod
    def of(cls, colours: Sequence[Problem], walls: Walls) -> Patches:
        """Average a picture over the patches of its walls."""
        gamma, k = colours[1].photometry.gamma, colours[1].photometry.k
        exact = all_exact(colours) & (walls.direct > 0)
        lit = [walls.under(lamp * k) for lamp in LAMPS]
        maps = (
            [colour.image**gamma for colour in colours]
            + [colour.direct for colour in lit]
            + [lobe(walls.cosine)]
        )
        sums = walls.sums(np.where(exact[..., None], np.dstack([np.ones(exact.shape), *maps]), 0.0))
        full = np.all(sums[:, :4] > 0, axis=1) & (sums[:, 0] > walls.full / 2)
        means = sums[full, 1:] / sums[full, :1]
        orders = [colour.orders[:, : walls.count][:, full] for colour in lit]
        return cls(np.log(means[:, :3]), means[:, 3:-1].T, orders, means[:, -1])

    def beside_and_slopes(
        self, factor: float, lamp: float, albedo: FloatArray, film: float
    ) -> tuple[FloatArray, FloatArray]:
        """What is seen beside direct light, and its derivatives, (4, P, 3).

        They are those by the factor, the lamp's share, the film and the logarithm of the colour's albedo.
        """
        place = lamp * (len(LAMPS) - 1)
        low = min(int(place), len(LAMPS) - 2)
        shares, slopes = [], []
        for index in (low, low + 1):
            light, slope = bounced_and_slope(self.orders[index], albedo)
            share, slope = light / self.direct[index][:, None], slope / self.direct[index][:, None]
            shares.append(np.minimum(share, MOST_INDIRECT))
            slopes.append(np.where(share < MOST_INDIRECT, slope, 0.0))
        change = shares[1] - shares[0]
        share = shares[0] + (place - low) * change
        by_albedo = slopes[0] + (place - low) * (slopes[1] - slopes[0])
        mirrored = self.lobe[:, None] / albedo
        by_lamp, by_albedo = factor * (len(LAMPS) - 1) * change, factor * by_albedo - film * mirrored
        return factor * share + film * mirrored, np.stack([share, by_lamp, mirrored, by_albedo])


def all_exact(colours: Sequence[Problem]) -> BoolArray:
    """Where all three colours say how bright the wall is, (H, W)."""
    return np.all(
        [
            colour.mask if colour.evidence is None else colour.mask & (colour.evidence == EXACT)
            for colour in colours
        ],
        axis=0,
    )


def by_tint(colours: Sequence[Problem], indirect_ratio: FloatArray, light: Light) -> FloatArray:
    """Correct ι (H, W, 3) where the wall's own tint tells that there is more of it, or less.

    Where the surface is wrong, S/E is wrong by one factor e^s in all colours, and what bounces too much is
    redder than the wall. The most likely s is told by least squares, with a prior and the wall's texture, as
    strong as the picture shows it.
    """
    if light.refused or not indirect_ratio.any():
        return indirect_ratio
    exact = all_exact(colours) & (indirect_ratio[..., 0] > 0)
    if not exact.any():
        return indirect_ratio
    share, gamma = indirect_ratio[exact], colours[1].photometry.gamma
    picture = np.stack([colour.image[exact] for colour in colours], axis=-1)
    wall = gamma * np.log(np.maximum(picture, QUIET)) - np.log1p(share) - np.log(light.albedo)
    tint = wall @ _whitened_tint().T
    sigma = max(1.48 * float(np.median(np.abs(tint))), FLOOR)
    tint = OUTLIER * np.tanh(tint / (OUTLIER * sigma))
    slope = (share / (1 + share)) @ _whitened_tint().T / sigma
    width = FROM_PLACE_TO_PLACE * share[:, 0] / (1 + share[:, 0])
    s = (tint * slope).sum(axis=1) / ((slope**2).sum(axis=1) + 1 / width**2)
    corrected = indirect_ratio.copy()
    corrected[exact] *= np.exp(s)[:, None]
    return corrected


def _whitened_tint() -> FloatArray:
    """Two sums of the colours' logarithms (2, 3): independent, of unit variance by texture, without E."""
    covariance = np.diag(np.square(TEXTURE))
    covariance[1, 2] = covariance[2, 1] = TOGETHER * TEXTURE[1] * TEXTURE[2]
    differences = np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0]])
    return np.linalg.solve(np.linalg.cholesky(differences @ covariance @ differences.T), differences)


def _tempered(r: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What half the square of is Charbonnier's penalty, √(1 + r²) - 1: a square, but for large r a line.

    And its derivative.
    """
    root = np.sqrt(1 + r**2)
    size = np.sqrt(2 * (root - 1))
    small = np.abs(r) < 1e-4  # where the root says nothing
    slope = np.where(small, 1.0, np.abs(r) / (root * np.where(small, 1.0, size)))
    return np.sign(r) * size, slope


class _Disagreement:
    """How far the colours and what is believed are from what light and albedos x make of them.

    x holds p, b, m and the logarithms of the albedos.
    """

    def __init__(self, patches: Patches, belief: Belief, sigma: float) -> None:
        self._patches, self._belief = patches, belief
        self._tint = _whitened_tint().T / sigma
        self._pieces = float(np.sqrt(min(PIECES / len(patches.light), 1.0)))
        self._last: tuple[FloatArray, FloatArray, FloatArray] | None = None

    def residual(self, x: FloatArray) -> FloatArray:
        """What least squares are of."""
        return self._at(x)[1]

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Its derivatives, a column for each of x."""
        return self._at(x)[2]

    def _at(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        if self._last is None or not np.array_equal(self._last[0], x):
            self._last = x.copy(), *self._computed(x)
        return self._last

    def _computed(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        beside, slopes = self._patches.beside_and_slopes(x[0], x[1], np.exp(x[3:]), x[2])
        apart = (self._patches.light - np.log1p(beside) - x[3:]) @ self._tint
        slopes = -slopes / (1 + beside)
        turned = np.empty((*apart.shape, len(x)))
        turned[..., :3] = np.moveaxis(slopes[:3] @ self._tint, 0, -1)
        turned[..., 3:] = (slopes[3] - 1)[:, None] * self._tint.T
        apart, bend = _tempered(apart)
        turned *= self._pieces * bend[..., None]
        middle, wide = np.transpose([FACTOR, LAMP, FILM])
        held, prior = (x[:3] - middle) / wide, self._belief.whitening
        by_held = np.diag(1 / wide)
        for i in (0, 2):  # a line far from the middle, for all but the lamp
            held[i], bend_i = _tempered(held[i])
            by_held[i, i] *= bend_i
        by_held = np.block([[by_held, np.zeros((3, 3))], [np.zeros((3, 3)), prior]])
        held = np.concatenate([held, prior @ (x[3:] - np.log(self._belief.albedo))])
        residual = np.concatenate([self._pieces * apart.ravel(), held])
        return residual, np.concatenate([turned.reshape(-1, len(x)), by_held])


def found_light(patches: Patches, belief: Belief) -> Light:
    """Ask the colours; what they tell is refused where it is at a bound or the colours say no one E.

    Raises `NoColour` if albedos that are not given come out as good as equal.
    """
    if len(patches.light) < LEAST_PATCHES:
        return replace(belief.light, refused="too little of the picture shows all three")

    def unexplained(x: FloatArray) -> FloatArray:
        """log E_c but for a constant, (P, 3)."""
        return patches.light - np.log1p(patches.beside_and_slopes(x[0], x[1], np.exp(x[3:]), x[2])[0]) - x[3:]

    low = np.array([0.0, 0.0, 0.0, *np.log(3 * [ALBEDOS[0]])])
    high = np.array([LARGEST_FACTOR, 1.0, SHINIEST, *np.log(3 * [ALBEDOS[1]])])
    tint = _whitened_tint()
    x, sigma = np.array([FACTOR[0], LAMP[0], FILM[1], *np.log(belief.albedo)]), 1.0
    for _ in range(ROUNDS):
        inside = np.clip(x, low + 1e-3, high - 1e-3)  # where its steps to bounds begin
        apart = _Disagreement(patches, belief, sigma)
        solved = scipy.optimize.least_squares(
            apart.residual, inside, apart.jacobian, bounds=(low, high), xtol=1e-5, ftol=1e-5
        )
        x = solved.x
        sigma = max(1.48 * float(np.median(np.abs(unexplained(x) @ tint.T))), FLOOR)
    light = unexplained(x)
    misfit = float(np.abs(light - light.mean(axis=1, keepdims=True)).mean())
    estimate = Light(np.exp(x[3:]), float(x[0]), float(x[1]), float(x[2]), misfit)
    if belief.widths != GIVEN and np.ptp(estimate.albedo) < ALIKE * estimate.albedo.max():
        raise NoColour("they are as good as equal")
    why = _unlikely(estimate)
    if not why and estimate.factor < NONE_BOUNCED and estimate.film < SEEN:
        estimate = replace(
            belief.light if belief.widths == GIVEN else estimate, factor=0.0, film=0.0, misfit=misfit
        )
    return replace(belief.light, misfit=misfit, refused=why) if why else estimate


def _unlikely(estimate: Light) -> str:
    """Why what was found is no answer, in words; else ""."""
    if estimate.factor > AT_BOUND * LARGEST_FACTOR:
        return "more light than can have bounced"
    if estimate.film > AT_BOUND * SHINIEST:
        return "more mirrored light than a film returns"
    if estimate.albedo.max() > AT_BOUND * ALBEDOS[1] or estimate.albedo.min() < ALBEDOS[0] / AT_BOUND:
        return "albedos that no tissue has"
    return "no one direct light" if estimate.misfit > MISFIT else ""
