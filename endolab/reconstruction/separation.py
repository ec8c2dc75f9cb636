"""Direct light out of a colour picture: what bounced is computed from the surface, and taken out.

A wall of albedo ρ shows I_c = g ρ/π (E + S), the lamp's light E and light S from other walls. The
three colours see one E, but the more a colour is reflected, the more of it bounces. From a surface
that is known roughly follows S/E for each colour (`bounces`); divided by 1 + S/E, the three pictures
are three measurements of E, which are merged and solved, and S/E follows anew from a better surface.

Albedos that are not given are found from the colours: the tissue looks more alike all over the
picture the better the bounced light is known.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from endolab.depth.fast_marching import fast_marching
from endolab.depth.gauss_newton import gauss_newton
from endolab.depth.problem import EXACT, NONE, Problem
from endolab.depth.result import Result, run
from endolab.model.interreflection import Walls
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.preprocessing.contours import find_contours
from endolab.preprocessing.frame import QUIET, noise_level

DOUBT = 0.3  # share of S/E that may be wrong
TEXTURE = (0.05, 0.2, 0.2)  # of the albedos' logarithms: blood takes green and blue light, hardly red
TISSUE = (0.7, 0.35, 0.28)  # red, green and blue of mucosa, before anything is known
GUESS = 0.5  # of f in S/E = f ρ/(1 - f ρ), before there is a surface
GAIN = 0.5  # contours are kept if tearing the surface there leaves less than this share of the energy
LEVELS = np.linspace(0.05, 0.95, 13)  # albedos for which S/E is computed, to be interpolated
TRIED = np.arange(0.2, 0.96, 0.05)  # albedos of the brightest colour
SAME = 0.01  # median difference of stored values, as a share, up to which two colours are one
STEPS = 10, 10, 30  # of the solves, the last of which is the result; islands behind contours are slow
ALIKE = 0.1  # albedos that differ by no more, as a share, tell nothing


class NoColour(ValueError):
    """The three colours of a picture are one, so that nothing of bounced light can be told from them."""


@dataclass(frozen=True)
class Separation:
    """What was found of a picture's bounced light.

    Attributes
    ----------
    inflation : (H, W, 3) float array
        S/E in red, green and blue; 0 where nothing is known.
    albedo : (3,) float array
    cuts : (2, H, W) bool array or None
        Steps over which the surface is torn, see `Problem`.
    surface : Result
        Of the last problem that was solved.
    """

    inflation: FloatArray
    albedo: FloatArray
    cuts: BoolArray | None
    surface: Result


def merged(colours: Sequence[Problem], inflation: FloatArray, albedo: FloatArray) -> Problem:
    """Merge three colours into one problem of direct light.

    Parameters
    ----------
    colours : sequence of 3 Problem
        Red, green and blue of one picture.
    inflation : (H, W, 3) float array
        S/E.
    albedo : (3,) float array

    Returns
    -------
    Problem
        Green's, with the picture that direct light alone would have made. Each colour counts by its
        noise, its texture and what may be wrong with S/E; what is saturated does not.
    """
    gamma = colours[1].photometry.gamma
    mask = np.any([one.mask for one in colours], axis=0)
    said = np.stack([np.where(one.mask, _evidence(one), NONE) for one in colours])
    evidence = said.min(axis=0).astype(np.int8)  # EXACT before AT_LEAST before NONE
    total, weights = np.zeros(mask.shape), np.zeros(mask.shape)
    shares = np.moveaxis(inflation, -1, 0)
    for one, speaks, rho, s, texture in zip(colours, said == evidence, albedo, shares, TEXTURE, strict=True):
        noise = max(noise_level(one.image, one.mask), QUIET)
        shade = np.maximum(one.image, noise)
        doubt = (gamma * noise / shade) ** 2 + (DOUBT * s / (1 + s)) ** 2 + texture**2
        weight = np.where(one.mask & speaks, 1 / doubt, 0.0)
        log_light = gamma * np.log(shade) - np.log1p(s) + np.log(albedo[1] / rho)
        total, weights = total + weight * log_light, weights + weight
    light = np.where(mask, np.exp(total / np.where(mask, weights, 1.0)), 0.0)
    return replace(
        colours[1],
        image=light ** (1 / gamma),
        mask=mask,
        evidence=np.where(mask, evidence, EXACT).astype(np.int8) if evidence[mask].any() else None,
    )


def _evidence(problem: Problem) -> NDArray[np.int8]:
    return np.zeros(problem.mask.shape, np.int8) if problem.evidence is None else problem.evidence


def estimated_albedo(colours: Sequence[Problem], inflation: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Find the albedos that make the tissue's colour most alike all over the picture.

    Parameters
    ----------
    colours : sequence of 3 Problem
        Red, green and blue of one picture.
    inflation : callable
        Gives S/E (H, W, 3) for three albedos.

    Returns
    -------
    (3,) float array

    Raises
    ------
    NoColour
        If the colours are one.
    """
    gamma = colours[1].photometry.gamma
    exact = np.all([one.mask & (_evidence(one) == EXACT) for one in colours], axis=0)
    if not exact.any():
        raise NoColour("no pixel shows all three of them")
    log = gamma * np.log(np.stack([one.image[exact] for one in colours], axis=-1))

    def corrected(albedo: FloatArray) -> FloatArray:
        return log - np.log1p(inflation(albedo)[exact])

    def of_level(level: float) -> FloatArray:
        """Albedos whose largest is this, in the ratio that the picture's medians have."""
        light = np.median(log, axis=0)
        for _ in range(4):
            albedo = np.clip(level * np.exp(light - light.max()), LEVELS[0], LEVELS[-1])
            light = np.median(corrected(albedo), axis=0)
        return albedo

    def spread(albedo: FloatArray) -> float:
        light = corrected(albedo)
        apart = light - light.mean(axis=-1, keepdims=True)
        return float(np.abs(apart - np.median(apart, axis=0)).mean())

    best = min((of_level(level) for level in TRIED), key=spread)
    if np.ptp(best) < ALIKE * best.max():
        raise NoColour("they are as good as equal")
    return best


def separate(
    colours: Sequence[Problem], albedo: FloatArray | None = None, contours: bool | None = None
) -> Separation:
    """Find the bounced light of a picture, its surface, and where it is torn.

    Parameters
    ----------
    colours : sequence of 3 Problem
        Red, green and blue of one picture.
    albedo : (3,) float array, optional
        Of the wall; estimated from the colours if it is not given.
    contours : bool, optional
        Whether to tear the surface at the occluding contours that are found; by default if that
        explains the picture much better.

    Returns
    -------
    Separation

    Raises
    ------
    NoColour
        If the colours are one.
    """
    _check_colours(colours)
    known = albedo
    albedo = np.array(TISSUE) if known is None else np.asarray(known, dtype=np.float64)
    inflation = np.broadcast_to(GUESS * albedo / (1 - GUESS * albedo), (*colours[1].mask.shape, 3))
    surface = _solved(merged(colours, inflation, albedo), contours, STEPS[0])
    for steps in STEPS[1:]:
        inflation, albedo = _bounced(colours, surface.iterate.log_distance, surface.problem.cuts, known)
        surface = _solved(merged(colours, inflation, albedo), contours, steps)
    return Separation(inflation, albedo, surface.problem.cuts, surface)


def continued(
    colours: Sequence[Problem], albedo: FloatArray | None, contours: bool, log_distance: FloatArray
) -> Separation:
    """Do the same with a surface that is nearly the right one, the last frame's say: one round.

    Parameters
    ----------
    colours, albedo
        See `separate`.
    contours : bool
        Whether to tear the surface at the occluding contours that are found.
    log_distance : (H, W) float array
        log d of that surface wherever a colour is known, in the unit that the gain of `colours` gives.

    Returns
    -------
    Separation
    """
    cuts = None
    if contours:
        edges, found = find_contours(colours[1].log_facing, colours[1].mask)
        cuts = found if edges.any() else None
    inflation, albedo = _bounced(colours, log_distance, cuts, albedo)
    problem = merged(colours, inflation, albedo)
    if contours:
        edges, found = find_contours(problem.log_facing, problem.mask)
        problem = replace(problem, cuts=found if edges.any() else None)
    start = np.where(np.isfinite(log_distance), log_distance, problem.log_facing)
    surface = run(gauss_newton(problem, start=start, max_iterations=STEPS[0]))
    return Separation(inflation, albedo, problem.cuts, surface)


def _check_colours(colours: Sequence[Problem]) -> None:
    """Raise NoColour if the three are one picture, such as a grey one that was stored as RGB."""
    mask = np.all([one.mask for one in colours], axis=0)
    if mask.any():
        images = [one.image[mask] for one in colours]
        if max(np.median(np.abs(one / images[1] - 1)) for one in images) < SAME:
            raise NoColour("red, green and blue are one")


def _bounced(
    colours: Sequence[Problem], log_distance: FloatArray, cuts: BoolArray | None, albedo: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """S/E (H, W, 3) of a surface, and the albedos, estimated if they are not known."""
    green = colours[1]
    mask = np.any([one.mask for one in colours], axis=0) & np.isfinite(log_distance)
    walls = Walls.of(log_distance, mask, green.field, green.photometry.k, cuts)
    if albedo is not None:
        return walls.inflation(albedo), albedo
    table = walls.inflation(LEVELS)

    def inflation(albedo: FloatArray) -> FloatArray:
        place = np.interp(albedo, LEVELS, np.arange(len(LEVELS)))
        low = np.minimum(place.astype(int), len(LEVELS) - 2)
        parts = [
            (1 - p) * table[..., i] + p * table[..., i + 1] for p, i in zip(place - low, low, strict=True)
        ]
        return np.stack(parts, axis=-1)

    found = estimated_albedo(colours, inflation)
    return inflation(found), found


def _solved(problem: Problem, contours: bool | None, steps: int) -> Result:
    """Solve with and without the contours that are found, and choose."""
    smooth = run(gauss_newton(problem, max_iterations=steps))
    if contours is False:
        return smooth
    edges, cuts = find_contours(problem.log_facing, problem.mask)
    if not edges.any():
        return smooth
    torn = replace(problem, cuts=cuts)
    # Half-way between the two: what lies between two contours is held by neither.
    starts = [run(fast_marching(one)).iterate.log_distance for one in (problem, torn)]
    result = run(gauss_newton(torn, start=(starts[0] + starts[1]) / 2, max_iterations=steps))
    return result if contours or result.energy < GAIN * smooth.energy else smooth
