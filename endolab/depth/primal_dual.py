"""The paper's path: a primal-dual solver after DTAM, with the normals lagged by one step.

Newcombe, Lovegrove and Davison (DTAM, ICCV 2011) split the energy by an auxiliary map a,

    Σ ρ(I_model(a, n) - I) + (ξ - a)²/2θ + λ g ‖D ξ‖_ε,

and take in turn (ξ in units of its median ξ̃, K the energy's derivative of it, n from the last ξ)

    q ← Π[(q + σ K ξ̄) / (1 + σ ε/λg)],  |q| ≤ λ g           dual ascent, Huber
    a ← ξ - θ ρ′ I′ / (1 + θ c),        c = ρ″ I′²           data, one Gauss-Newton step per pixel
    ξ ← (ξ - τ_p Kᵀq + τ_p a/θ) / (1 + τ_p/θ)               primal descent
    ξ̄ ← 2 ξ_new - ξ_old

**Why it is slow, and stable.** With the normals given, a pixel's data wants v = v₀ + ½ log C(P),
P = ∇vᵀ G⁻¹ ∇v of the last map, C = cos θ f_r(θ)/f_r(0) (Lambertian: C² = 1/(1 + P)). A ripple δ of
v comes back as i s δ: its slope is out of phase, and central differences pass at most one per pixel,
so that for a Lambertian surface

    s = ½ Σ_j |(G⁻¹∇v)_j| / (1 + P),

tens at 320 columns and growing with them. The data update goes the part τ = θc/(1 + θc) of the way
and makes δ (1 - τ + i τ s) δ, which shrinks only for τ < 2/(1 + s²). The same bound is Condat's and
Vũ's for a primal-dual step, 1/τ_p + 1/θ - σ‖K‖² ≥ ½ (1 + s²) c/(1 + θc), with τ_p σ ‖K‖² = 1. So
every pixel's θ is limited to a share of it. News then travels 2/s pixels a step: hence the paper's
thousands of iterations. Normals of a patch (Hinterstoisser et al., ICCV 2011) make s smaller: the
mean of n slopes in a row, taken twice so that it hides no ripple, passes 1.5/n of one at most.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from endolab.depth.energy_kernels import listen
from endolab.depth.grid import Grid
from endolab.depth.problem import Problem, check_maps
from endolab.depth.result import Iterate, Solver
from endolab.model.surface import from_xi, to_xi
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import number, whole
from endolab.numerics.compiled import framed, kernel, padded
from endolab.numerics.derivatives import REFERENCE_WIDTH, gradient, hessian_stencils, links
from endolab.numerics.iteration import Status

BALANCE, LEAST = 0.1, 1e-3  # τ_p and the least θ in units of 1/c at the start
RANGES = {"coupling": (LEAST, 1e6), "decay": (0, 1), "safety": (1e-3, 1), "patch": (0, 32)}


# The loops below each write one row and read few: so compilers can tell that they may use vectors.
# Pictures have a frame of one pixel that no step leads to, and outside the mask ξ = ξ₀ = I = 1.
@kernel
def _slope(p: Any, low: Any, x: Any, high: Any, to_low: Any, to_high: Any, share: Any, offset: Any) -> None:
    """Central difference of v = ± log ξ by 2 artanh((b - a)/(b + a)) = log b/a; `share` is ±1/steps."""
    for j in range(p.size):
        a = x[j] + to_low[j] * (low[j] - x[j])
        b = x[j] + to_high[j] * (high[j] - x[j])
        z = (b - a) / (b + a)
        s = z * z
        odd = 1 + s * (1 / 3 + s * (1 / 5 + s * (1 / 7 + s * (1 / 9 + s / 11))))
        p[j] = 2 * share[j] * z * odd + offset[j]


@kernel
def _slopes(x: Any, steps: Any, shares: Any, offsets: Any, p: Any) -> None:
    """Gradient of v, into p (2, ...)."""
    for i in range(1, x.shape[0] - 1):
        out, share, offset = p[0, i, 1:-1], shares[0, i, 1:-1], offsets[0, i, 1:-1]
        left, right = steps[0, i, :-2], steps[0, i, 1:-1]
        _slope(out, x[i, :-2], x[i, 1:-1], x[i, 2:], left, right, share, offset)
        out, share, offset = p[1, i], shares[1, i], offsets[1, i]
        _slope(out, x[i - 1], x[i], x[i + 1], steps[1, i - 1], steps[1, i], share, offset)


@kernel
def _average(p: Any, reach: Any, work: Any, sums: Any) -> None:
    """Mean of a map, in place, over the rows and then the columns that `reach` allows."""
    height, width = p.shape
    line = np.zeros(width + 1)
    for i in range(height):
        for j in range(width):
            line[j + 1] = line[j] + p[i, j]
        for j in range(width):
            first, last = j - reach[0, i, j], j + reach[1, i, j] + 1
            work[i, j] = (line[last] - line[first]) / (last - first)
        for j in range(width):
            sums[i + 1, j] = sums[i, j] + work[i, j]
    for i in range(height):
        for j in range(width):
            first, last = i - reach[2, i, j], i + reach[3, i, j] + 1
            p[i, j] = (sums[last, j] - sums[first, j]) / (last - first)


@kernel
def _ascend(q: Any, a: Any, b: Any, c: Any, d: Any, weight: Any, shrink: Any) -> None:
    """q ← shrink (q + weight (a - b - c + d)) on a row."""
    for j in range(q.size):
        q[j] = shrink[j] * (q[j] + weight[j] * ((a[j] - b[j]) - (c[j] - d[j])))


@kernel
def _project(q: Any, i: int, bound: Any, factor: Any) -> None:
    """Bring |q| ≤ bound on a row."""
    q0, q1, q2 = q[0, i], q[1, i], q[2, i]
    for j in range(factor.size):
        size = np.sqrt(q0[j] * q0[j] + q1[j] * q1[j] + q2[j] * q2[j])
        factor[j] = min(1.0, bound[j] / max(size, 1e-300))
    for k in range(3):
        row = q[k, i]
        for j in range(factor.size):
            row[j] *= factor[j]


@kernel
def _dual(q: Any, x: Any, weight: Any, shrink: Any, bound: Any, first: bool, factor: Any) -> None:
    """Dual ascent on all rows; `weight` is that of the differences, 0 where one has not all its steps."""
    for i in range(1, x.shape[0] - 1):
        above, here, below, s = x[i - 1, 1:-1], x[i, 1:-1], x[i + 1, 1:-1], shrink[i, 1:-1]
        q0, q1, q2 = q[0, i, 1:-1], q[1, i, 1:-1], q[2, i, 1:-1]
        w0, w1, w2 = weight[0, i, 1:-1], weight[1, i, 1:-1], weight[2, i, 1:-1]
        if first:
            _ascend(q0, x[i, 2:], here, here, here, w0, s)
            _ascend(q1, below, here, here, here, w1, s)
        else:
            _ascend(q0, x[i, 2:], here, here, x[i, :-2], w0, s)
            _ascend(q1, x[i + 1, 2:], below, x[i, 2:], here, w1, s)
            _ascend(q2, below, here, here, above, w2, s)
        _project(q, i, bound[i], factor)


@kernel
def _pull(pull: Any, q: Any, i: int, scale: float, first: bool) -> None:
    """Kᵀq on a row; q is 0 where a difference has not all its steps."""
    q0, q1, q2, above1 = q[0, i], q[1, i], q[2, i], q[1, i - 1]
    last = pull.size - 1
    if first:
        for j in range(1, last):
            pull[j] = scale * (q0[j - 1] - q0[j] + above1[j] - q1[j])
        return
    above2, below2, mixed = q[2, i - 1], q[2, i + 1], np.sqrt(2) * scale
    for j in range(1, last):
        pull[j] = scale * (q0[j - 1] - 2 * q0[j] + q0[j + 1] + above2[j] - 2 * q2[j] + below2[j])
    for j in range(1, last):
        pull[j] += mixed * (q1[j] - q1[j - 1] - above1[j] + above1[j - 1])


@kernel
def _tilt(dark: Any, turn: Any, p: Any, metric: Any, i: int, log_c: Any, log_p: Any) -> None:
    """C² and -∂(log C)/∂P on a row: for a Lambertian surface 1/(1 + P) and half of it."""
    p_u, p_v, guu, guv, gvv = p[0, i], p[1, i], metric[0, i], metric[1, i], metric[2, i]
    for j in range(dark.size):
        raised_u, raised_v = guu[j] * p_u[j] + guv[j] * p_v[j], guv[j] * p_u[j] + gvv[j] * p_v[j]
        dark[j] = 1 / (1 + raised_u * p_u[j] + raised_v * p_v[j])
    for j in range(dark.size):
        turn[j] = 0.5 * dark[j]
    if log_c.size > 0:
        for j in range(dark.size):
            wanted = -np.log(dark[j])  # the table of log(1 + P) falls
            k = min(max(log_p.size - np.searchsorted(log_p[::-1], wanted), 1), log_p.size - 1)
            slope = (log_c[k] - log_c[k - 1]) / (log_p[k] - log_p[k - 1])
            turn[j] = -slope * dark[j]
            dark[j] = np.exp(2 * (log_c[k] + slope * (wanted - log_p[k])))


@kernel
def _limit(limit: Any, turn: Any, p: Any, metric: Any, passes: Any, i: int, safety: float) -> None:
    """Largest τ on a row: `safety` times 2/(1 + s²), less than 1."""
    p_u, p_v, guu, guv, gvv = p[0, i], p[1, i], metric[0, i], metric[1, i], metric[2, i]
    pass_u, pass_v = passes[0, i], passes[1, i]
    for j in range(limit.size):
        along_u = abs(guu[j] * p_u[j] + guv[j] * p_v[j]) * pass_u[j]
        along_v = abs(guv[j] * p_u[j] + gvv[j] * p_v[j]) * pass_v[j]
        s = turn[j] * (along_u + along_v)
        limit[j] = min(2 * safety / (1 + s * s), 0.999)


@kernel
def _predict(model: Any, x: Any, unit: Any, image: Any, dark: Any, sign: float, gamma: float) -> None:
    """I_model on a row; `sign` is d log ξ/dv, `unit` is 1/ξ₀."""
    for j in range(model.size):
        # I_model/I = w^(1/γ), w = (d₀/d)² C, by u = w^(1/4), log u = 2 artanh z and exp(8 y) = exp(y)⁸
        near = x[j] * unit[j]
        near = 1 / near if sign > 0 else near
        u = np.sqrt(near * np.sqrt(np.sqrt(dark[j])))
        z = (u - 1) / (u + 1)
        s = z * z
        y = z * (1 + s * (1 / 3 + s * (1 / 5 + s * (1 / 7 + s * (1 / 9 + s / 11))))) / gamma
        even, odd = 120 + 12 * y * y, y * (60 + y * y)
        e = (even + odd) / (even - odd)
        e = (e * e) * (e * e)
        model[j] = image[j] * e * e


@kernel
def _descend(
    new: Any, x: Any, image: Any, limit: Any, pull: Any, tau_p: Any, theta: float, numbers: Any
) -> None:
    """Data update and primal descent of a row, from the model image to the new ξ."""
    sign, gamma, threshold, _, _ = numbers
    for j in range(new.size):
        residual, slope = new[j] - image[j], -2 * sign / gamma * new[j] / x[j]
        weight = threshold / max(threshold, abs(residual))
        c = max(weight * slope * slope, 1e-300)
        th = min(theta * tau_p[j], limit[j] / ((1 - limit[j]) * c))
        force = weight * residual * slope / (1 + th * c)  # (ξ - a)/θ
        step = tau_p[j] * th / (th + tau_p[j]) * (pull[j] + force)
        new[j] = x[j] - max(min(step, 0.5 * x[j]), -x[j])


@kernel
def _advance(
    count: int, theta: float, decay: float, state: Any, grid: Any, regulariser: Any, data: Any, numbers: Any
) -> float:
    """Take `count` steps, in place; return θ (in units of τ_p) after them."""
    x, ahead, q, limit, p, work, sums = state
    steps, shares, offsets, reach, passes, metric = grid
    weight, shrink, bound, scale, first = regulariser
    image, evidence, unit, tau_p, log_c, log_p = data
    sign, gamma, _, safety, radius = numbers
    rows = np.zeros((6, x.shape[1]))
    factor, pull, dark, turn, new, wanted = rows[0], rows[1], rows[2], rows[3], rows[4], rows[5]
    for _ in range(count):
        _slopes(x, steps, shares, offsets, p)
        if radius > 0:
            for k in (0, 0, 1, 1):
                _average(p[k], reach, work, sums)
        _dual(q, ahead, weight, shrink, bound, first, factor)
        for i in range(1, x.shape[0] - 1):
            row = x[i]
            _pull(pull, q, i, scale, first)
            _tilt(dark, turn, p, metric, i, log_c, log_p)
            _limit(limit[i], turn, p, metric, passes, i, safety)
            _predict(new, row, unit[i], image[i], dark, sign, gamma)
            if evidence.size > 0:
                listen(new, image[i], evidence[i], wanted, limit[i])
                _descend(new, row, wanted, limit[i], pull, tau_p[i], theta, numbers)
            else:
                _descend(new, row, image[i], limit[i], pull, tau_p[i], theta, numbers)
            for j in range(new.size):
                ahead[i, j] = 2 * new[j] - row[j]
                row[j] = new[j]
        theta = max(decay * theta, LEAST / BALANCE)
    return theta


def _reach(steps: FloatArray, radius: int) -> Any:
    """How far each pixel's patch extends to the left, right, up and down before a step is missing."""
    out = np.zeros((4, *steps.shape[1:]), dtype=np.int32)
    for axis, joined, (backward, forward) in ((1, steps[0], out[:2]), (0, steps[1], out[2:])):
        ahead = behind = np.ones(joined.shape, dtype=bool)
        for k in range(radius):  # the frame has no steps, so nothing comes round from the other side
            ahead = ahead & (np.roll(joined, -k, axis) > 0)
            behind = behind & (np.roll(joined, k + 1, axis) > 0)
            forward += ahead
            backward += behind
    return out


@dataclass
class _Path:
    """The state of the scheme and what its steps need, framed by one pixel."""

    problem: Problem
    state: tuple[FloatArray, ...]
    rest: tuple[Any, ...]

    @classmethod
    def at(cls, problem: Problem, start: FloatArray, radius: int, safety: float) -> _Path:
        """Begin at a depth map, the dual at rest."""
        mask, cosine, scale = problem.mask, problem.field.cos_alpha, problem.derivative_scale
        first, sign = problem.regulariser == "first", 1.0 if problem.xi == "d" else -1.0

        def framed_xi(v: FloatArray) -> FloatArray:
            xi = to_xi(np.where(mask, v, 0.0), problem.xi, cosine) / problem.xi_median
            return framed(np.where(mask, xi, 1.0), 1.0)

        joined = links(mask, problem.cuts)
        steps = framed(joined)
        reach = _reach(steps, radius)
        passes = np.minimum(1.0, 1.5 / (1 + np.stack([reach[0] + reach[1], reach[2] + reach[3]])))
        count = steps + np.stack([np.roll(steps[0], 1, 1), np.roll(steps[1], 1, 0)])
        shares = sign / np.maximum(count, 1)
        beside = -np.log(np.where(mask & (problem.xi == "1/z"), cosine, 1.0))
        offsets = np.nan_to_num(framed(np.stack(gradient(beside, mask, problem.cuts, edge_order=1))))
        metric = framed(np.where(mask, np.moveaxis(problem.field.inverse_metric, -1, 0), 0.0))

        x, image = framed_xi(start), framed(np.where(mask, problem.image, 1.0), 1.0)
        tau_p = BALANCE * (0.5 * problem.photometry.gamma * x / image) ** 2
        # σ τ_p ‖K‖² ≤ 1 for every pair of pixels that K joins
        widest = framed(np.where(mask, tau_p[1:-1, 1:-1], 0.0))
        for axis in (0, 1):
            widest = np.max([np.roll(widest, k, axis) for k in (-1, 0, 1)], axis=0)
        sigma = 1 / ((8 if first else 64) * scale**2 * np.where(widest > 0, widest, 1.0))
        bound = framed(np.where(mask, problem.lam * problem.edge_weight, 0.0))
        shrink = np.where(bound > 0, bound / (bound + sigma * problem.epsilon), 0.0)
        weight = np.stack([*steps, 0 * steps[0]]) if first else framed(np.stack(hessian_stencils(joined)))
        weight[1] *= 1 if first else np.sqrt(2)

        evidence = np.empty((0, 0)) if problem.evidence is None else framed(problem.evidence)
        table = problem.photometry.slant_table() or (np.empty(0), np.empty(0))
        shapes = (3, *x.shape), x.shape, (2, *x.shape), x.shape, (x.shape[0] + 1, x.shape[1])
        return cls(
            problem,
            (x, x.copy(), *map(np.zeros, shapes)),
            (
                (steps, shares, offsets, reach, passes, metric),
                (sigma * scale * weight, shrink, bound, scale, first),
                (image, evidence, 1 / framed_xi(problem.log_facing), tau_p, *table),
                (sign, problem.photometry.gamma, problem.threshold, safety, radius),
            ),
        )

    def advance(self, count: int, theta: float, decay: float) -> float:
        """Take steps with θ, in units of 1/c at the start; return θ after them."""
        return BALANCE * _advance(count, theta / BALANCE, float(decay), self.state, *self.rest)

    @property
    def log_distance(self) -> FloatArray:
        """v = log d, (H, W)."""
        problem = self.problem
        xi = np.where(problem.mask, self.state[0][1:-1, 1:-1] * problem.xi_median, 1.0)
        return from_xi(xi, problem.xi, np.where(problem.mask, problem.field.cos_alpha, 1.0))

    def share(self, theta: float) -> float:
        """Part of the way to its data that a pixel went in the last step, on average, c as at first."""
        limit = self.state[3][1:-1, 1:-1][self.problem.mask]
        t = np.minimum(limit / (1 - limit), theta)  # θc
        return float(np.mean(t / (1 + t) * BALANCE / (BALANCE + t)))


def primal_dual(
    problem: Problem,
    start: FloatArray | None = None,
    *,
    coupling: float = 1.0,
    decay: float = 1.0,
    patch: float = 8.0,
    safety: float = 0.7,
    tolerance: float = 2e-3,
    every: int = 10,
    max_iterations: int = 2000,
) -> Solver:
    """Minimise the energy by the paper's path; see the head of this file.

    Islands of the mask are solved apart. The first order wants a small λ, 0.1 say. The energy may rise:
    its normals are not of a patch. So where it converges is no minimum either, and Gauss-Newton finds lower
    ones. Areas of no `evidence` fill slowly. ValueError if the start or an option cannot be used, the
    regulariser is "curvature", or the BRDF has two slants for one brightness.

    - start: (H, W), log d to begin with, finite inside the mask; the paper's d₀ by default.
    - coupling: θ in units of 1/c at the start; what is stable limits it further.
    - decay: what θ is multiplied by after each step, down to 0.001. In DTAM it falls; here it stays.
    - patch: radius of the box over which slopes are averaged, twice, for the normals; in 1/320 of the
      width. 0 takes two neighbours, as the energy does, and thousands of steps.
    - safety: share of the bound on τ that is taken, in (0, 1].
    - tolerance: the run has converged when v has less than this to go (root mean square): its change in
      a step over the part of the way that a step takes.
    - every, max_iterations: steps from one iterate to the next, and the most to take.

    Iterates count steps (`k`); their scalars are steps, theta, and tau, the part of its way that a pixel
    goes in one.
    """
    if problem.regulariser == "curvature":
        raise ValueError("primal_dual takes regulariser='first' or 'second', got 'curvature'")
    for (name, (low, high)), value in zip(RANGES.items(), (coupling, decay, safety, patch), strict=True):
        number(name, value, low, high)
    number("tolerance", tolerance, 0)
    whole("every", every, 1)
    whole("max_iterations", max_iterations)
    check_maps(problem.mask, start)
    v = problem.log_facing if start is None else start
    radius = round(patch * problem.camera.width / REFERENCE_WIDTH)
    path, theta, steps, grid = _Path.at(problem, v, radius, safety), float(coupling), 0, Grid.of(problem)
    iterate = Iterate.of(problem, v)
    yield iterate
    while steps < max_iterations:
        count = int(min(every, max_iterations - steps))
        theta, steps = path.advance(count, theta, decay), steps + count
        shown = {"steps": steps, "theta": theta, "tau": path.share(theta)}
        terms = grid.terms(padded(path.log_distance), problem.lam)
        after = Iterate.of(problem, path.log_distance, iterate, terms=terms, scalars=shown)
        iterate = replace(after, k=steps)
        yield iterate
        if iterate.change <= tolerance * count * shown["tau"]:
            return Status.CONVERGED
    return Status.MAX_ITERATIONS
