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

**Where it ends.** Not at the energy's minimum: its data pulls with normals that are of a patch and held, so
that it rests elsewhere, at several times the energy. Started at the minimum it leaves it; and with patches
that shrink to a pixel ripples grow, and the energy a hundredfold. So it settles and never converges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import check_int, number
from endolab.numerics.compiled import inner, pad_maps
from endolab.numerics.iteration import Status
from endolab.numerics.stencils import hessian_stencils, links, px_per_reference
from endolab.solvers.grid import Grid
from endolab.solvers.problem import EXACT, LOWER_BOUND, Problem, check_maps
from endolab.solvers.result import Iterate, Solver

BALANCE = 0.1  # τ_p in units of 1/c at the start, where χ is 1
SAFETY = 0.7  # share of the bound on τ that is taken
LEAST_STEPS = 200  # before it is asked whether it has settled
# Stencils of differences, the pixel in the middle.
ALONG = ((0, 0, 0), (0, -1, 1), (0, 0, 0))
DOWN = ((0, 0, 0), (0, -1, 0), (0, 1, 0))
ALONG_TWICE = ((0, 0, 0), (1, -2, 1), (0, 0, 0))
DOWN_TWICE = ((0, 1, 0), (0, -2, 0), (0, 1, 0))
SQUARE = ((0, 0, 0), (0, 1, -1), (0, -1, 1))


def _single(a: Any) -> Any:
    """Single precision: memory is what a step waits for."""
    return np.asarray(a, np.float32)


class Differences:
    """K: differences of a map, (n, H, W), by 3×3 stencils; `weights` are 0 where a step is missing."""

    def __init__(self, stencils: Sequence[Any], weights: Any) -> None:
        self.stencils = _single(stencils)
        self.weights = _single(weights)

    @classmethod
    def of(cls, problem: Problem) -> Differences:
        """Those of the problem's regulariser."""
        joined = links(problem.mask, problem.cuts)
        scale = problem.derivative_scale
        if problem.regulariser == "first":
            return cls((ALONG, DOWN), scale * joined)
        uu, uv, vv = hessian_stencils(joined)
        weights = scale * np.stack([uu, np.sqrt(2) * uv, vv])
        return cls((ALONG_TWICE, SQUARE, DOWN_TWICE), weights)

    def __call__(self, x: Any) -> Any:
        """K x."""
        x = _single(x)
        out = np.empty_like(self.weights)
        for each, stencil in zip(out, self.stencils, strict=True):
            cv2.filter2D(x, -1, stencil, each, borderType=cv2.BORDER_CONSTANT)
        out *= self.weights
        return out

    def adjoint(self, p: Any) -> Any:
        """Kᵀ p, (H, W)."""
        out = np.zeros_like(self.weights[0])
        for each, stencil in zip(
            self.weights * p, self.stencils[:, ::-1, ::-1], strict=True
        ):
            out += cv2.filter2D(each, -1, stencil, borderType=cv2.BORDER_CONSTANT)
        return out


class PatchSlopes:
    """∇v by central differences: means over a patch of the mask, taken twice."""

    def __init__(self, problem: Problem, side: int) -> None:
        joined = _single(links(problem.mask, problem.cuts))
        self.side = side
        self.forward = Differences((ALONG, DOWN), joined)
        self.shares = 1 / np.maximum(self._add_before(joined), 1)
        inside = _single(problem.mask)
        self.weight = inside / np.maximum(self._blur(inside), 1e-12)

    def _add_before(self, steps: Any) -> Any:
        """Add to each step the one that leads to the pixel."""
        out = steps.copy()
        out[0, :, 1:] += steps[0, :, :-1]
        out[1, 1:] += steps[1, :-1]
        return out

    def _blur(self, a: Any) -> Any:
        return cv2.blur(a, (self.side, self.side), borderType=cv2.BORDER_CONSTANT)

    def __call__(self, v: Any) -> list[Any]:
        """Along rows and along columns."""
        slopes = self.shares * self._add_before(self.forward(v))
        once = [self.weight * self._blur(each) for each in slopes]
        return [self.weight * self._blur(each) for each in once]


def _shade(slant: Any, grid: Grid) -> tuple[Any, Any]:
    """log C and its slope by P = tan²θ; see `energy_kernels.shading_table`."""
    t = np.log1p(slant)
    if grid.table.shape[1] == 0:  # Lambertian
        return -0.5 * t, -0.5 / (1 + slant)
    w = np.sqrt(t)
    nodes = grid.step * np.arange(grid.table.shape[1])
    log_shading, by_w = (_single(np.interp(w, nodes, row)) for row in grid.table)
    return log_shading, by_w / np.maximum(2 * w, 1e-9) / (1 + slant)


def primal_dual(
    problem: Problem,
    start: FloatArray | None = None,
    *,
    patch: float = 8.0,
    tolerance: float = 0.05,
    every: int = 10,
    max_iterations: int = 2000,
) -> Solver:
    """Follow the paper's path down the energy; see the head of this file.

    Islands of the mask are solved apart. The first order wants a small λ, 0.1 say. The energy may rise, and
    Gauss-Newton finds lower ones: the averaged normals that keep this path stable lead past the minimum. So
    it never ends as CONVERGED. Areas of no `evidence` fill slowly. ValueError if the start or an option
    cannot be used, or the BRDF has two slants for one brightness.

    - start: (H, W), log d to begin with, finite inside the mask; the paper's d₀ by default.
    - patch: radius of the box over which slopes are averaged, twice, for the normals; in 1/320 of the
      longer side. 0 takes two neighbours, as the energy does: then ripples grow on steep walls.
    - tolerance: the run has settled when the second half of its steps lowered the energy by no more than
      this share.
    - every, max_iterations: steps from one iterate to the next, and the most to take.

    χ is 1/c at the start, or what is stable; in DTAM it falls with every step, here it stays. Iterates count
    steps (`k`).
    """
    number("patch", patch, 0, 32)
    number("tolerance", tolerance, 0)
    check_int("every", every, 1)
    check_int("max_iterations", max_iterations)
    check_maps(problem.mask, start)
    mask = problem.mask
    grid = Grid.of(problem)
    gamma = problem.photometry.gamma
    image = _single(np.where(mask, problem.image, 1.0))
    log_scale = _single(inner(grid.log_scale))
    guu, guv, gvv = _single(inner(grid.metric))
    evidence = np.full(mask.shape, EXACT) if problem.evidence is None else problem.evidence
    exact = mask & (evidence == EXACT)
    bounded = mask & (evidence == LOWER_BOUND)
    sign = 1 if problem.xi == "d" else -1  # ξ = factor e^±v
    log_factor = _single(np.log(inner(grid.factor)))
    v: Any = np.where(mask, problem.log_d0 if start is None else start, 0.0)
    x = np.where(mask, np.exp(log_factor + sign * v), 1.0)
    x_ahead = x

    side = 2 * round(patch * px_per_reference(mask.shape)) + 1
    slopes_of = PatchSlopes(problem, side)
    K = Differences.of(problem)
    c_start = _single((2 * image / (gamma * x)) ** 2)
    tau_p = BALANCE / c_start
    # τ_d τ_p ‖K‖² ≤ 1 for every pair of pixels that K joins
    norm = (8 if problem.regulariser == "first" else 64) * problem.derivative_scale**2
    tau_d = 1 / (norm * cv2.dilate(tau_p, np.ones((3, 3))))
    bound = _single(problem.lam * np.where(mask, problem.edge_weight, 0.0))
    shrink = bound / np.maximum(bound + tau_d * problem.epsilon, 1e-30)
    p = np.zeros_like(K.weights)

    iterate = Iterate.of(problem, v)
    yield iterate
    energies = [iterate.energy]
    for step in range(1, max_iterations + 1):
        # Normals of the last map, and A, what comes back of a ripple.
        u, w = slopes_of(v)
        raised_u = guu * u + guv * w
        raised_w = guv * u + gvv * w
        log_shading, by_slant = _shade(raised_u * u + raised_w * w, grid)
        back = by_slant * (abs(raised_u) + abs(raised_w)) * min(1, 1.5 / side)

        # p ← Π[(p + τ_d K ξ̄) / (1 + τ_d ε/λw)]
        p = shrink * (p + tau_d * K(x_ahead))
        size = np.sqrt(np.einsum("kij,kij->ij", p, p))
        p *= np.minimum(1, bound / np.maximum(size, 1e-30))

        # ζ ← ξ - W e I′ / (1/χ + c)
        model = np.exp(log_scale + (log_shading - 2 * v) / gamma)
        e = model - image
        counts = exact | (bounded & (e < 0))
        W = counts * (problem.threshold / np.maximum(problem.threshold, abs(e)))
        slope = -2 * sign / gamma * model / _single(x)
        c = W * slope**2
        least = np.maximum((1 + back**2) / (2 * SAFETY) - 1, 1e-3)
        spring = np.maximum(c_start, least * c)  # 1/χ
        to_zeta = W * e * slope / (spring + c)  # ξ - ζ

        # ξ ← (ξ - τ_p Kᵀp + τ_p ζ/χ) / (1 + τ_p/χ)
        change = tau_p * (K.adjoint(p) + spring * to_zeta) / (1 + tau_p * spring)
        change = np.clip(change, -_single(x), 0.5 * _single(x))
        x = x - change

        # ξ̄ ← 2 ξ_new - ξ_old
        x_ahead = _single(x) - change
        v = sign * (np.log(_single(x)) - log_factor)

        if step % every == 0 or step == max_iterations:
            found = np.where(mask, v.astype(np.float64), 0.0)
            terms = grid.terms(pad_maps(found), problem.lam)
            iterate = replace(Iterate.of(problem, found, iterate, terms), k=step)
            yield iterate
            energies.append(iterate.energy)
            half = min(energies[: len(energies) // 2 + 1])
            if step >= LEAST_STEPS and min(energies) >= (1 - tolerance) * half:
                return Status.SETTLED
    return Status.MAX_ITERATIONS
