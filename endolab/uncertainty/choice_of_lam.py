"""λ of one frame, chosen by the roughness of what the surface leaves unexplained.

Nobody knows how large the residual should be: a wall's texture leaves much more than the sensor's noise, so
that a discrepancy of the usual kind has no number to compare with. What noise looks like is known: it is
independent from pixel to pixel, but for the blur that the picture went through. So the principle compares
not the size of the residual but how alike neighbours in it are,

    q(λ) = mean e(u) e(u') / mean e²,    u' the pixel to the right of u or below.

With too small a λ the surface follows the noise, and what is left of that is rough; with too large a one it
no longer follows the wall, and what is left looks like the wall, smooth. Between them, the surface leaves of
the picture what it would leave of noise alone: of noise n a surface leaves, to first order,

    e = (1 - S) n,    S = J (JᵀWJ + λQ)⁻¹ JᵀW,

J being the model's derivative by log d, W and Q the weights of data and regulariser as Gauss-Newton has
them. One draw of n is enough, since the mean is over all pixels; it is white noise, blurred as the picture
was, the same for each λ, and gives qₙ(λ). Chosen is the largest λ, the smoothest surface, with

    c(λ) = q(λ) - qₙ(λ) ≤ 0.

There is no constant in it, and no noise level. It is tried for `LAMS`, each solved from the surface before.

Discrepancy of sizes, L-curve, balance, cross-validation and evidence were tried beside it on 53 frames,
model's own, path-traced and real. Evidence and cross-validation, which take pixels for independent, end at
the least λ; the L-curve breaks down with `regulariser` "first"; and no size of the residual suits both walls
with a texture and plain ones.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from endolab.depth.energy import contradicted, model_image
from endolab.depth.gauss_newton import gauss_newton
from endolab.depth.grid import Grid
from endolab.depth.multigrid import Multigrid
from endolab.depth.problem import Problem
from endolab.depth.result import Iterate, staged
from endolab.numerics.arrays import BoolArray, FloatArray, frozen
from endolab.numerics.compiled import inner, padded
from endolab.numerics.derivatives import gradient, links

CHOICE = "choice of λ"  # stage
LAMS = tuple(float(one) for one in 10 ** np.linspace(-1.5, 1.5, 7))  # a wider range did no better
FAINT = 1e-5  # stored value of the drawn noise: no weight of a Huber penalty changes by it
PRECISION, MOST = 1e-2, 40  # of what a surface makes of it: residual left, steps


@dataclass(frozen=True)
class LamCurve:
    """What each λ that was tried leaves, and the one that was chosen."""

    chosen: float
    lam: FloatArray  # (L,), ascending
    data: FloatArray  # (L,), the energy's term
    regulariser: FloatArray  # (L,), the same without λ
    alike: FloatArray  # (L,), q: how alike neighbours in the residual are, -1 to 1
    alike_of_noise: FloatArray  # (L,), qₙ: the same of what a surface with this λ leaves of noise

    @property
    def criterion(self) -> FloatArray:
        """c = q - qₙ, whose last zero is the λ that is chosen."""
        return self.alike - self.alike_of_noise

    @property
    def told(self) -> str:
        """What was chosen and why, in a sentence."""
        why = "there what the surface leaves unexplained is as rough as what it would leave of noise"
        if not np.isfinite(self.criterion).all():
            why = "the picture does not tell"
        elif self.criterion.min() > 0:
            why = "even there what the surface leaves unexplained is smoother than noise"
        elif self.criterion[-1] <= 0:
            why = "even there what the surface leaves unexplained is as rough as noise"
        return f"λ = {self.chosen:.3g} was chosen: {why}."

    @property
    def numbers(self) -> dict[str, list[float]]:
        """The curve in plain numbers, for a report."""
        names = "lam", "data", "regulariser", "alike", "alike_of_noise"
        return {name: [float(f"{one:.5g}") for one in getattr(self, name)] for name in names}


def choose_lam(
    problem: Problem,
    start: FloatArray | None = None,
    smooth: float = 0.0,
    lams: Sequence[float] = LAMS,
    settled: float = 0.0,
) -> Generator[Iterate, None, LamCurve]:
    """Choose λ of a problem; every solve's iterates are yielded, those of each λ as a round.

    Parameters
    ----------
    problem : Problem
        Its own λ does not count. What is noise and what is wall depends on the size of a pixel; 160 columns
        are enough and take a tenth of a second or two for all λ.
    start : (H, W) float array, optional
        log d to start from.
    smooth : float
        Standard deviation of the Gaussian that the picture's light was averaged with, px.
    lams : sequence of float
        λ to try, positive and ascending, two at least.
    settled : float
        See `gauss_newton`.

    Returns
    -------
    LamCurve
        What was chosen and why.
    """
    noise = _noise(problem.mask.shape, smooth)
    middle = len(lams) // 2
    found: dict[int, tuple[Iterate, tuple[float, float]]] = {}

    def solve(lam: float, near: FloatArray | None, number: int) -> Generator[Iterate, None, Iterate]:
        solver = gauss_newton(replace(problem, lam=lam), start=near, settled=settled)
        return (yield from staged(solver, CHOICE, number))

    for side in (range(middle, len(lams)), range(middle - 1, -1, -1)):
        near = start if middle not in found else found[middle][0].log_distance
        for i in side:
            surface = yield from solve(lams[i], near, i + 1)
            found[i], near = (surface, _likeness(surface, noise)), surface.log_distance
    surfaces, likeness = zip(*(found[i] for i in range(len(lams))), strict=True)
    weights = np.array(lams, dtype=np.float64)
    alike, of_noise = np.array(likeness).T
    chosen = _last_zero(np.log(weights), alike - of_noise, np.log(weights[middle]))
    return LamCurve(
        float(f"{np.exp(chosen):.3g}"),  # as it is printed, so that it can be given again
        frozen(weights),
        frozen(np.array([one.terms["data"] for one in surfaces])),
        frozen(np.array([one.terms["regulariser"] for one in surfaces]) / weights),
        frozen(alike),
        frozen(of_noise),
    )


def _last_zero(x: FloatArray, y: FloatArray, otherwise: float) -> float:
    """Where y rises above 0 for good, linearly between; the end to which it points, if it does not."""
    if not np.isfinite(y).all():
        return otherwise
    below = np.flatnonzero(y <= 0)
    if below.size == 0 or below[-1] == y.size - 1:
        return float(x[0] if below.size == 0 else x[-1])
    i = int(below[-1])
    return float(x[i] - (x[i + 1] - x[i]) * y[i] / (y[i + 1] - y[i]))


def _noise(shape: tuple[int, ...], smooth: float) -> FloatArray:
    """Noise of one, blurred; the same each time."""
    white = np.random.default_rng(0).standard_normal(shape)
    noise = cv2.GaussianBlur(white, (0, 0), smooth) if smooth > 0 else white
    return np.asarray(noise / noise.std(), dtype=np.float64)


def _alike(residual: FloatArray, mask: BoolArray) -> float:
    """q: how alike neighbours are, by rows and by columns; nan if there is nothing to compare."""
    r = np.where(mask, residual, 0.0)
    along_u, along_v = links(mask)
    pairs = np.concatenate(
        [(r[:, :-1] * r[:, 1:])[along_u[:, :-1]], (r[:-1] * r[1:])[along_v[:-1]]],
    )
    size = np.mean(r[mask] ** 2) if pairs.size else 0.0
    return float(pairs.mean() / size) if size > 0 else np.nan


def _likeness(surface: Iterate, noise: FloatArray) -> tuple[float, float]:
    """q of what a surface leaves of its picture, and qₙ of what it would leave of noise."""
    problem = surface.problem
    residual = np.where(problem.mask, model_image(problem, surface.log_distance) - problem.image, 0.0)
    said = contradicted(problem, residual)
    drawn = FAINT * np.where(said, noise, 0.0)
    return _alike(residual, said), _alike(drawn - _followed(surface, drawn), said)


def _followed(surface: Iterate, noise: FloatArray) -> FloatArray:
    """S n: how a surface's picture changes with the picture it explains, to first order."""
    problem, grid = surface.problem, Grid.of(surface.problem)
    v = padded(np.where(problem.mask, surface.log_distance, 0.0))
    coefficients, pull = grid.linearised(v, problem.lam)
    pull = pull.copy()  # the next call overwrites it
    _, pulled = replace(grid, image=grid.image + padded(noise)).linearised(v, problem.lam)
    step, _, _ = Multigrid(coefficients).solve(pulled - pull, PRECISION, MOST)
    moved = inner(step)
    moved_u, moved_v = gradient(moved, problem.mask, problem.cuts, edge_order=1)
    by = [inner(one) for one in (coefficients.by_v, coefficients.by_v_u, coefficients.by_v_v)]
    return by[0] * moved + by[1] * np.nan_to_num(moved_u) + by[2] * np.nan_to_num(moved_v)
