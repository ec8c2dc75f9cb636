"""What may be wrong, as changes of the picture: of the logarithm of its light, (H, W).

Most of it has a name and a number (`prior_sigma`). What has none is what the model leaves unexplained: the
wall's own texture, folds that are no contours, light that it does not know. It shows in the residual, of
which a fit takes most: a random field of the texture's length, fitted like the picture, tells how much it
leaves. The residual around a pixel over that share is how strong such a field must be there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.derivatives import links, px_per_reference
from endolab.reconstruction.lines import find_contours
from endolab.reconstruction.uncertainty.linearised import Linearised
from endolab.reconstruction.uncertainty.prior_sigma import PriorSigma
from endolab.reconstruction.walls import Walls
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
    # How much of the residual is texture: it holds folds and contours as well, whose errors end where they
    # do. Chosen, with the two of `PriorSigma` that are of borders, on rendered, path-traced and random open
    # frames, to bring all three near 68 and 95 %.
    texture_share: float = 0.76
    # Of the median of what fits leave, below which a pixel's own is not taken.
    least_left: float = 0.5
    grazing: float = 0.05  # cos θ below which a lamp's place tells nothing more, and cos α
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


def mean_square_around(values: FloatArray, weight: FloatArray, sigma: float) -> FloatArray:
    """Mean square around each pixel of those that are said."""
    share = np.maximum(_blur(weight, sigma), 1e-6)
    return np.asarray(np.maximum(_blur(weight * values**2, sigma), 0.0) / share)


def texture_strength(
    surface: Linearised, left: Sequence[FloatArray], noise: float, least: float
) -> FloatArray:
    """Standard deviation of the light's logarithm by texture and all else that the model does not explain.

    `left` is what fits leave of fields of unit variance; the rest of the residual is `noise`.
    """
    informative = surface.weight > 0
    sigma = CAUSES.around * px_per_reference(informative.shape)

    def around(field: FloatArray) -> FloatArray:
        return mean_square_around(field, informative.astype(np.float64), sigma)

    usual_left = np.sqrt(np.mean([around(field) for field in left], axis=0))
    usual = float(np.median(usual_left[informative])) if informative.any() else 1.0
    unexplained = around(surface.in_light(surface.residual))
    unexplained -= around(surface.in_light(noise))
    strength = np.sqrt(np.maximum(unexplained, 0.0))
    floor = CAUSES.least_left * max(usual, 1e-6)
    strength = CAUSES.texture_share * strength / np.maximum(usual_left, floor)
    return np.hypot(strength, least)


def light_changes(
    iterate: Iterate, prior_sigma: PriorSigma
) -> Iterator[tuple[str, FloatArray]]:
    """What one standard deviation of each named cause changes in the logarithm of the mask's light."""
    problem = iterate.problem
    field = problem.field
    if prior_sigma.k:
        yield "k", -prior_sigma.k * np.log(np.maximum(field.cos_alpha, CAUSES.grazing))
    if prior_sigma.gamma:
        yield "gamma", prior_sigma.gamma * np.log(np.maximum(problem.image, 0.5 / 255))
    removed = iterate.report.albedo is not None
    share = prior_sigma.bounced if removed else prior_sigma.left_in
    bounced = share * bounced_light(iterate)
    if bounced.any():
        yield "bounced light", bounced
    if prior_sigma.lamp and problem.metric:
        normals = iterate.normals
        cosine = np.maximum(-(normals * field.rays).sum(axis=-1), CAUSES.grazing)
        most = CAUSES.lamp_change
        for axis, name in enumerate("xy"):
            # Of cos θ/d² by the lamp's place: it is nearer, and the wall turned to it.
            slope = 3 * field.rays[..., axis] + normals[..., axis] / cosine
            slope = slope / iterate.distance
            yield f"lamp {name}", np.clip(prior_sigma.lamp * slope, -most, most)


def bounced_light(iterate: Iterate) -> FloatArray:
    """log(1 + ι) of the light that the wall's green bounces, as this surface makes it."""
    problem = iterate.problem
    albedo = iterate.report.albedo
    light = iterate.report.light
    if light is LightOutcome.NONE_BOUNCED:
        return np.zeros(problem.mask.shape)
    if albedo is None:
        facing = np.ones(1)
        rho = float(np.pi * problem.photometry.brdf.value(facing, facing)[0])
    else:
        rho = albedo[1]
    mask = problem.mask
    k = problem.photometry.k
    walls = Walls.of(iterate.log_distance, mask, problem.field, k, problem.cuts)
    return np.where(mask, np.log1p(walls.indirect_ratio(min(rho, 0.95))), 0.0)


def possible_cuts(problem: Problem) -> BoolArray | None:
    """Cuts at every line of the picture that may be a contour, with the problem's; None if there is none."""
    lines = find_contours(problem.log_d0, problem.mask)
    cuts = (lines > CAUSES.possible_steepness) & links(problem.mask, problem.cuts)
    if not cuts.any():
        return None
    return cuts if problem.cuts is None else cuts | problem.cuts
