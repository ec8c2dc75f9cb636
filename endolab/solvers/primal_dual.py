"""The paper's path: a primal-dual solver after DTAM, with the normals lagged by one step.

Newcombe, Lovegrove and Davison (DTAM, ICCV 2011) split the energy by an auxiliary map ζ, on a spring 1/χ,

    Σ ρ(I_model(ζ, n) - I) + (ξ - ζ)²/2χ + λ w ‖D ξ‖_ε,

and take in turn (ξ in units of its median ξ̃, K the energy's derivative of it, n from the last ξ)

    p ← Π[(p + τ_d K ξ̄) / (1 + τ_d ε/λw)],  |p| ≤ λ w       dual ascent, Huber
    ζ ← ξ - W e I′ / (1/χ + c),        c = W I′²             data, one Gauss-Newton step per pixel
    ξ ← (ξ - τ_p Kᵀp + τ_p ζ/χ) / (1 + τ_p/χ)                primal descent
    ξ̄ ← 2 ξ_new - ξ_old

**Why it is slow, and stable.** With the normals given, a pixel's data wants v = v₀ + ½ log C(P),
P = ∇vᵀ G⁻¹ ∇v of the last map, C = cos θ f_r(θ)/f_r(0). A ripple δ of v comes back as i A δ: its slope is
out of phase, and central differences pass at most one per pixel, so that

    A = -∂(log C)/∂P Σ_j |(G⁻¹∇v)_j|,

tens at 320 columns and growing with them. The data update goes the part τ = χc/(1 + χc) of the way
and makes δ (1 - τ + i τ A) δ, which shrinks only for τ < 2/(1 + A²). So every pixel's χ is limited to a share
of that. News then travels 2/A pixels a step: hence the paper's thousands of iterations. Normals of a patch
(Hinterstoisser et al., ICCV 2011) make A smaller: the mean over n pixels, taken twice so that it hides no
ripple, passes 1.5/n of a slope at most.

**Where it ends.** Not at the energy's minimum: its data pulls with normals that are of a patch and held.
Started at the minimum it leaves it, for some 3 % of the distance and ten times the energy; and with patches
that shrink to a pixel ripples grow, and the energy a hundredfold. From either side it then creeps: twice as
many steps move half of the wall by 1 %, and that much again the next time. So it settles and never converges.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from endolab.numerics.arrays import FloatArray, SingleArray, Span
from endolab.numerics.checks import check_int, number
from endolab.numerics.compiled import inner, pad_maps
from endolab.numerics.elementary import exp
from endolab.numerics.iteration import Status
from endolab.numerics.stencils import (
    CENTRAL,
    adjoint_padded,
    apply_padded,
    px_per_reference,
)
from endolab.numerics.threads import on_cores
from endolab.solvers.energy_kernels import shade_row
from endolab.solvers.grid import Grid
from endolab.solvers.problem import EXACT, LOWER_BOUND, REGULARISERS, Problem, check_maps
from endolab.solvers.result import Iterate, Solver


class Pixels(NamedTuple):
    """What a descent needs of each pixel, padded maps."""

    image: FloatArray
    exact: FloatArray  # 1 where the image says how bright the wall is
    bounded: FloatArray  # 1 where it says that the wall is that bright or brighter
    log_scale: FloatArray  # log I of a facing wall where v = 0
    log_factor: FloatArray  # log ξ where v = 0
    metric: FloatArray  # (3, ...): uu, uv, vv of G⁻¹
    tau_p: FloatArray
    spring: FloatArray  # 1/χ, the least


@on_cores(cost=8)
def ascend(
    rows: Span,
    p: FloatArray,
    K_x: FloatArray,
    bound: FloatArray,
    tau_d: FloatArray,
    epsilon: float,
) -> None:
    """p ← Π[(p + τ_d K ξ̄) / (1 + τ_d ε/λw)]."""
    for i in range(rows[0], rows[1]):
        for j in range(p.shape[2]):
            shrink = bound[i, j] / (bound[i, j] + tau_d[i, j] * epsilon)
            size = 0.0
            for k in range(3):
                p[k, i, j] = shrink * (p[k, i, j] + tau_d[i, j] * K_x[k, i, j])
                size += p[k, i, j] ** 2
            shrink = bound[i, j] / max(bound[i, j], np.sqrt(size), 1e-30)
            for k in range(3):
                p[k, i, j] *= shrink


@on_cores(cost=25)
def descend(
    rows: Span,
    x: FloatArray,
    x_ahead: FloatArray,
    v: FloatArray,
    K_p: FloatArray,
    slopes: SingleArray,
    pixels: Pixels,
    table: FloatArray,
    step: float,
    gamma: float,
    threshold: float,
    passes: float,
    sign: float,
) -> None:
    """Data, primal descent and extrapolation."""
    image, exact, bounded, log_scale, log_factor, metric, tau_p, stiffness = pixels
    work = np.empty((5, x.shape[1]))
    slant = work[0]
    size = work[1]
    shading = work[2]
    by_t = work[3]
    model = work[4]
    for i in range(rows[0], rows[1]):
        for j in range(x.shape[1]):
            u = slopes[0, i, j]
            w = slopes[2, i, j]
            raised_u = metric[0, i, j] * u + metric[1, i, j] * w
            raised_w = metric[1, i, j] * u + metric[2, i, j] * w
            slant[j] = raised_u * u + raised_w * w
            size[j] = abs(raised_u) + abs(raised_w)
        shade_row(slant, table, step, shading, by_t)
        for j in range(x.shape[1]):
            model[j] = exp(log_scale[i, j] + (shading[j] - 2 * v[i, j]) / gamma)
        for j in range(x.shape[1]):
            e = model[j] - image[i, j]
            W = exact[i, j] + bounded[i, j] * (e < 0)
            W *= threshold / max(threshold, abs(e))
            slope = -2 * sign / gamma * model[j] / x[i, j]
            c = W * slope**2
            A = by_t[j] / (1 + slant[j]) * size[j] * passes
            least = max((1 + A**2) / (2 * 0.7) - 1, 1e-3)  # 0.7 of the bound on τ
            spring = max(stiffness[i, j], least * c)
            tau = tau_p[i, j]
            old = x[i, j]

            # ζ ← ξ - W e I′ / (1/χ + c)
            zeta = old - W * e * slope / (spring + c)
            # ξ ← (ξ - τ_p Kᵀp + τ_p ζ/χ) / (1 + τ_p/χ)
            new = (old - tau * K_p[i, j] + tau * spring * zeta) / (1 + tau * spring)
            new = min(max(new, 0.5 * old), 2 * old)
            # ξ̄ ← 2 ξ_new - ξ_old
            x_ahead[i, j] = 2 * new - old
            x[i, j] = new
        for j in range(x.shape[1]):
            v[i, j] = sign * (np.log(x[i, j]) - log_factor[i, j])


def primal_dual(
    problem: Problem,
    start: FloatArray | None = None,
    *,
    patch: float = 8.0,
    tolerance: float = 0.005,
    every: int = 10,
    max_iterations: int = 3000,
) -> Solver:
    """Follow the paper's path down the energy; see the head of this file.

    Islands of the mask are solved apart. The first order wants a small λ, 0.1 say. The energy may rise, and
    Gauss-Newton finds lower ones: the averaged normals that keep this path stable lead past the minimum. So
    it never ends as CONVERGED. Areas of no `evidence` fill slowly. ValueError if the start or an option
    cannot be used, or the BRDF has two slants for one brightness.

    - start: (H, W), log d to begin with, finite inside the mask; the paper's d₀ by default.
    - patch: radius of the box over which slopes are averaged, twice, for the normals; in 1/320 of the
      longer side. 0 takes two neighbours, as the energy does: then ripples grow on steep walls.
    - tolerance: the run has settled when 500 steps moved half of the pixels by no more than this share of
      their distance.
    - every, max_iterations: steps from one iterate to the next, and the most to take.

    χ is 1/c at the start, or what is stable; in DTAM it falls with every step, here it stays. Iterates count
    steps (`k`).
    """
    number("patch", patch, 0, 32)
    number("tolerance", tolerance, 0)
    check_int("every", every, 1)
    check_int("max_iterations", max_iterations)
    check_maps(problem.mask, start)
    grid = Grid.of(problem)
    inside = pad_maps(problem.mask)
    v = pad_maps(np.where(problem.mask, problem.log_d0 if start is None else start, 0.0))
    sign = 1.0 if problem.xi == "d" else -1.0  # ξ = factor e^±v
    log_factor = np.log(np.where(inside, grid.factor, 1.0))
    x = np.exp(log_factor + sign * v)
    x_ahead = x.copy()

    # λ‖s D ξ‖_ε = s λ ‖D ξ‖_ε/s, s the unit of derivatives
    scale = problem.derivative_scale
    kind = REGULARISERS.index(problem.regulariser)
    image = np.where(inside, grid.image, 1.0)
    gamma = problem.photometry.gamma
    spring = (2 * image / (gamma * x)) ** 2
    tau_p = 0.1 / spring
    # τ_d τ_p ‖K‖² ≤ 1 for every pair of pixels that K joins
    tau_d = 1 / ((8, 64)[kind] * cv2.dilate(tau_p, np.ones((3, 3))))
    bound = scale * problem.lam * inside * grid.edge
    evidence = grid.evidence if grid.evidence.size else np.full(x.shape, EXACT)
    exact = 1.0 * inside * (evidence == EXACT)
    bounded = 1.0 * inside * (evidence == LOWER_BOUND)
    pixels = Pixels(
        image, exact, bounded, grid.log_scale, log_factor, grid.metric, tau_p, spring
    )
    p, K_x = np.zeros((2, 3, *x.shape))
    K_p = np.zeros_like(x)
    slopes = np.zeros((3, *x.shape), np.float32)

    side = 2 * round(patch * px_per_reference(problem.mask.shape)) + 1
    whole = inside.astype(np.float32)
    share = cv2.blur(whole, (side, side), borderType=cv2.BORDER_CONSTANT)
    share = whole / np.maximum(share, 1e-12)

    iterate = Iterate.of(problem, inner(v))
    yield iterate
    before = v.copy()
    for step in range(1, max_iterations + 1):
        apply_padded(slopes, v, grid.link, CENTRAL)
        for slope in (*slopes[::2], *slopes[::2]):  # twice
            cv2.blur(slope, (side, side), slope, borderType=cv2.BORDER_CONSTANT)
            slope *= share
        apply_padded(K_x, x_ahead, grid.link, kind)
        ascend(p, K_x, bound, tau_d, problem.epsilon / scale)
        adjoint_padded(K_p, p, grid.link, kind)
        descend(
            x,
            x_ahead,
            v,
            K_p,
            slopes,
            pixels,
            grid.table,
            grid.step,
            gamma,
            problem.threshold,
            min(1, 1.5 / side),
            sign,
        )
        settled = False
        if step % 500 == 0:
            settled = bool(np.median(np.abs(v - before)[inside]) <= tolerance)
            before[:] = v
        if settled or step % every == 0 or step == max_iterations:
            terms = grid.terms(v, problem.lam)
            iterate = replace(Iterate.of(problem, inner(v), iterate, terms), k=step)
            yield iterate
        if settled:
            return Status.SETTLED
    return Status.MAX_ITERATIONS
