"""The paper's path: a primal-dual solver after DTAM, with the normals lagged by one step.

Newcombe, Lovegrove and Davison (DTAM, ICCV 2011) split the energy by an auxiliary map ζ, on a spring 1/χ,

    Σ ρ(I_model(ζ, n) - I) + (ξ - ζ)²/2χ + λ w ‖D ξ‖_ε,

and take in turn (ξ in units of its median ξ̃, K the energy's derivative of it, n from the last ξ)

    p ← Π[(p + τ_d K ξ̄) / (1 + τ_d ε/λw)],  |p| ≤ λ w       dual ascent, Huber
    ζ ← ξ - χ ρ′ I′ / (1 + χ c),        c = ρ″ I′²           data, one Gauss-Newton step per pixel
    ξ ← (ξ - τ_p Kᵀp + τ_p ζ/χ) / (1 + τ_p/χ)               primal descent
    ξ̄ ← 2 ξ_new - ξ_old

**Why it is slow, and stable.** With the normals given, a pixel's data wants v = v₀ + ½ log C(P),
P = ∇vᵀ G⁻¹ ∇v of the last map, C = cos θ f_r(θ)/f_r(0) (Lambertian: C² = 1/(1 + P)). A ripple δ of
v comes back as i A δ: its slope is out of phase, and central differences pass at most one per pixel,
so that for a Lambertian surface

    A = ½ Σ_j |(G⁻¹∇v)_j| / (1 + P),

tens at 320 columns and growing with them. The data update goes the part τ = χc/(1 + χc) of the way
and makes δ (1 - τ + i τ A) δ, which shrinks only for τ < 2/(1 + A²). The same bound is Condat's and
Vũ's for a primal-dual step, 1/τ_p + 1/χ - τ_d‖K‖² ≥ ½ (1 + A²) c/(1 + χc), with τ_p τ_d ‖K‖² = 1. So
every pixel's χ is limited to a share of it. News then travels 2/A pixels a step: hence the paper's
thousands of iterations. Normals of a patch (Hinterstoisser et al., ICCV 2011) make A smaller: the
mean of n slopes in a row, taken twice so that it hides no ripple, passes 1.5/n of one at most. Slopes
themselves reach over no cut; their means do.

**Precision.** Memory is what a step waits for, so that maps are of single precision: results differ from
double's by some 1e-6. Only ξ, a sum of steps that may each be too small for its last digit, keeps a rest of
what is lost, or it would stand still before it has converged; and sums down a column, which run, are double.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

from endolab.model.photometry import Photometry
from endolab.model.surface import from_xi, to_xi
from endolab.numerics.arrays import ByteArray, FloatArray, SingleArray, Span
from endolab.numerics.checks import check_int, number
from endolab.numerics.compiled import add_frame, kernel, pad_maps
from endolab.numerics.derivatives import gradient, hessian_stencils, links, px_per_reference
from endolab.numerics.iteration import Status
from endolab.numerics.threads import BAND_ROWS, on_cores, rows_within
from endolab.solvers.grid import Grid
from endolab.solvers.problem import LOWER_BOUND, NONE, Problem, check_maps
from endolab.solvers.result import Iterate, Solver

BALANCE = 0.1  # τ_p in units of 1/c at the start; χ is 1
# Share of the energy that ten steps may still take off where a run has converged: what nobody sees.
LARGEST_FALL = 1e-3


# Numbers of single precision keep a loop's so.
SINGLE = np.float32
INDEX = np.uint64
HALF = SINGLE(0.5)
ONE = SINGLE(1)
TWO = SINGLE(2)
THREE = SINGLE(3)
ROOT_HALF = SINGLE(np.sqrt(0.5))
# Artanh z = z (1 + z²/3 + z⁴/5 ...).
ODD = tuple(SINGLE(1 / k) for k in (3, 5, 7, 9, 11, 13))
PASSES = SINGLE(1.5)  # what a patch of n pixels passes of a ripple's slope, times n
# 1/χc of pixels that nothing limits; a size above 0
FREE = SINGLE(1 / 999)
TINY = SINGLE(1e-30)
STRIP_COLUMNS = 128  # columns that are averaged together, at least
PHASES = 5  # of a step: slopes and means along rows, means along columns, rows, columns, and the descent
BRDF_TABLE_SIZE = 4096
# Of each component of D ξ, the row of `_differences` that has it, and how many columns to the left.
COMPONENT_ROW = (0, 1, 2, 2, 3, 3)
COMPONENT_SHIFT = (0, 0, 0, 1, 0, 1)


class Slopes(NamedTuple):
    """How slopes of v follow from ξ, over what they are averaged, and how slants follow from them."""

    sign: np.float32
    steps: ByteArray
    offsets: SingleArray
    metric: SingleArray
    radius: int
    share: (
        SingleArray  # (2, ...) one over the pixels of a patch, along rows and along columns
    )


class Rule(NamedTuple):
    """The dual's steps; `valid_stencil` is where a difference has all its steps."""

    sigma: SingleArray
    valid_stencil: ByteArray
    shrink: SingleArray
    bound: SingleArray
    scale: np.float32
    first: bool


class Data(NamedTuple):
    """The picture, and how brightness falls; `away` is whether ξ grows with d."""

    image: SingleArray
    unit: SingleArray
    pace: SingleArray
    evidence: ByteArray
    table: SingleArray
    away: bool
    gamma: np.float32
    threshold: np.float32
    safety: np.float32


class Room(NamedTuple):
    """What is written anew on every row."""

    works: SingleArray
    lines: SingleArray
    running: FloatArray


class State(NamedTuple):
    """ξ and what is too small for it, ξ̄, the dual, the least 1/χc, slopes and their averages."""

    x: SingleArray
    rest: SingleArray
    ahead: SingleArray
    q: SingleArray
    limit: SingleArray
    p: SingleArray
    averages: SingleArray


# Pictures have a frame of one pixel that no step leads to, and outside the mask ξ = ξ₀ = I = 1. Compilers use
# vectors where no index of a column may be negative, some are unsigned therefore, and nothing is branched on.
@kernel
def _artanh(z: np.float32) -> np.float32:
    """Artanh of a number between -½ and ½."""
    s = z * z
    return z * (
        ONE
        + s
        * (ODD[0] + s * (ODD[1] + s * (ODD[2] + s * (ODD[3] + s * (ODD[4] + s * ODD[5])))))
    )


@kernel
def _log_slope(
    before: np.float32, here: np.float32, after: np.float32, back: int, on: int
) -> np.float32:
    """Slope of log ξ from the neighbours to which there are steps: log b/a = 2 artanh((b - a)/(b + a))."""
    a = here + SINGLE(back) * (before - here)
    b = here + SINGLE(on) * (after - here)
    return (THREE - SINGLE(back) - SINGLE(on)) * _artanh((b - a) / (b + a))


@kernel
def _slopes(p: SingleArray, x: SingleArray, slopes: Slopes, i: int) -> None:
    """Gradient of v = ± log ξ on a row, into p (2, ...), by central differences."""
    sign, steps, offsets, _, _, _ = slopes
    for j in range(x.shape[1] - 2):
        here = x[i, j + 1]
        p[0, i, j + 1] = sign * _log_slope(
            x[i, j], here, x[i, j + 2], steps[0, i, j], steps[0, i, j + 1]
        )
        p[1, i, j + 1] = sign * _log_slope(
            x[i - 1, j + 1],
            here,
            x[i + 1, j + 1],
            steps[1, i - 1, j + 1],
            steps[1, i, j + 1],
        )
    if offsets.size > 0:
        for k in range(2):
            for j in range(x.shape[1]):
                p[k, i, j] += offsets[k, i, j]


@kernel
def _average_row(p: SingleArray, i: int, slopes: Slopes, lines: SingleArray) -> None:
    """Means of both slopes along a row, in place: a window's sum is that of some of 2, 4, 8... pixels."""
    width = INDEX(p.shape[2])
    reach = INDEX(slopes.radius)
    share = slopes.share
    for k in range(2):
        at = 0
        span = INDEX(1)
        done = INDEX(1)
        length = width + reach + reach
        for j in range(width):
            lines[0, j + reach] = p[k, i, j]
        for j in range(width):
            lines[3, j] = lines[0, j]
        while span <= reach:
            to = 2 if at == 1 else 1
            length -= span
            for j in range(length):
                lines[to, j] = lines[at, j] + lines[at, j + span]
            span = span + span
            at = to
            if (reach + reach) & span:
                for j in range(width):
                    lines[3, j] += lines[at, j + done]
                done += span
        for j in range(width):
            p[k, i, j] = share[0, i, j] * lines[3, j]


@kernel
def _average_strip(
    p: SingleArray,
    k: int,
    columns: Span,
    slopes: Slopes,
    running: FloatArray,
    out: SingleArray,
) -> None:
    """Means of a slope along some columns."""
    begin = INDEX(columns[0])
    end = INDEX(columns[1])
    radius = slopes.radius
    share = slopes.share
    height = p.shape[1]
    for j in range(begin, end):
        running[k, j] = 0.0
    for i in range(radius + 1):
        for j in range(begin, end):
            running[k, j] += p[k, min(i, height - 1), j]
    for i in range(1, height - 1):
        # both ends are 0
        above = max(i - radius - 1, 0)
        below = min(i + radius, height - 1)
        for j in range(begin, end):
            total = running[k, j] + (p[k, below, j] - p[k, above, j])
            running[k, j] = total
            out[k, i, j] = share[1, i, j] * SINGLE(total)


@kernel
def _average_columns(
    rows: Span, p: SingleArray, slopes: Slopes, running: FloatArray, out: SingleArray
) -> None:
    """Means of both slopes along columns, on strips of them: as large a share as `rows` are of all."""
    height, width = p.shape[1:]
    several = max(width // STRIP_COLUMNS, 1)
    for strip in range(rows[0] * 2 * several // height, rows[1] * 2 * several // height):
        first = strip // 2 * width // several
        last = (strip // 2 + 1) * width // several
        _average_strip(p, strip % 2, (first, last), slopes, running, out)


@kernel
def _mixed_differences(
    x: SingleArray, valid_stencil: ByteArray, i: int, out: SingleArray
) -> None:
    """f_uv/√2 of the squares to the lower right of a row's pixels."""
    for j in range(x.shape[1] - 1):
        part = (x[i + 1, j + 1] - x[i + 1, j]) - (x[i, j + 1] - x[i, j])
        out[j] = ROOT_HALF * SINGLE(valid_stencil[1, i, j]) * part


@kernel
def _differences(x: SingleArray, rule: Rule, i: int, out: SingleArray) -> None:
    """D ξ on a row: to the right and below; or uu, vv, and uv of the squares below and above."""
    valid_stencil = rule.valid_stencil
    if not rule.first:
        _mixed_differences(x, valid_stencil, i, out[2])
        _mixed_differences(x, valid_stencil, i - 1, out[3])
    for j in range(x.shape[1] - 2):
        here = x[i, j + 1]
        along = x[i, j + 2] - here
        down = x[i + 1, j + 1] - here
        if not rule.first:
            along -= here - x[i, j]
            down -= here - x[i - 1, j + 1]
        out[0, j + 1] = SINGLE(valid_stencil[0, i, j + 1]) * along
        out[1, j + 1] = SINGLE(valid_stencil[-1, i, j + 1]) * down


@kernel
def _ascend(q: SingleArray, x: SingleArray, rule: Rule, i: int, work: SingleArray) -> None:
    """Dual ascent on a row."""
    sigma, _, shrink, bound, _, _ = rule
    _differences(x, rule, i, work)
    factor = work[4]
    count = x.shape[1] - 2
    factor[:] = 0
    for k in range(len(q)):
        row = COMPONENT_ROW[k]
        left = INDEX(1 - COMPONENT_SHIFT[k])
        for j in range(count):
            step = sigma[i, j + 1] * work[row, j + left]
            q[k, i, j + 1] = shrink[i, j + 1] * (q[k, i, j + 1] + step)
    for k in range(0, len(q), 2):
        for j in range(count):
            one = q[k, i, j + 1]
            two = q[k + 1, i, j + 1]
            factor[j] += one * one + two * two
    for j in range(count):
        factor[j] = min(ONE, bound[i, j + 1] / max(np.sqrt(factor[j]), TINY))
    for k in range(len(q)):
        for j in range(count):
            q[k, i, j + 1] *= factor[j]


@kernel
def _pull_first(pull: SingleArray, q: SingleArray, rule: Rule, i: int) -> None:
    """Kᵀq on a row; q is 0 where a step is missing."""
    scale = rule[4]
    for j in range(pull.size - 2):
        along = q[0, i, j] - q[0, i, j + 1]
        pull[j + 1] = scale * (along + q[1, i - 1, j + 1] - q[1, i, j + 1])


@kernel
def _pull_squares(q: SingleArray, i: int, out: SingleArray) -> None:
    """What the four pixels of each square to the lower right of a row's make of it."""
    for j in range(out.size - 1):
        out[j] = ROOT_HALF * (
            (q[2, i, j] + q[3, i, j + 1]) + (q[4, i + 1, j] + q[5, i + 1, j + 1])
        )


@kernel
def _pull_second(
    pull: SingleArray,
    q: SingleArray,
    rule: Rule,
    i: int,
    above: SingleArray,
    below: SingleArray,
) -> None:
    """Kᵀq on a row; q is 0 where a difference has not all its steps."""
    scale = rule[4]
    _pull_squares(q, i - 1, above)
    _pull_squares(q, i, below)
    for j in range(pull.size - 2):
        along = q[0, i, j] - TWO * q[0, i, j + 1] + q[0, i, j + 2]
        down = q[1, i - 1, j + 1] - TWO * q[1, i, j + 1] + q[1, i + 1, j + 1]
        mixed = (below[j + 1] - below[j]) - (above[j + 1] - above[j])
        pull[j + 1] = scale * (along + down + mixed)


@kernel
def _tilt(
    dark: SingleArray,
    turn: SingleArray,
    p: SingleArray,
    metric: SingleArray,
    table: SingleArray,
    i: int,
) -> None:
    """C² and -∂(log C)/∂P on a row: for a Lambertian surface 1/(1 + P) and half of it."""
    for j in range(dark.size):
        p_u = p[0, i, j]
        p_v = p[1, i, j]
        slant = (
            metric[0, i, j] * p_u * p_u
            + TWO * metric[1, i, j] * p_u * p_v
            + metric[2, i, j] * p_v * p_v
        )
        dark[j] = ONE / (ONE + slant)
        turn[j] = HALF * dark[j]
    if table.size > 0:
        for j in range(dark.size):
            place = SINGLE(BRDF_TABLE_SIZE - 1) * np.sqrt(max(ONE - np.sqrt(dark[j]), TINY))
            k = min(int(place), BRDF_TABLE_SIZE - 2)
            part = place - SINGLE(k)
            dark[j] *= table[0, k] + part * (table[0, k + 1] - table[0, k])
            turn[j] *= table[1, k] + part * (table[1, k + 1] - table[1, k])


@kernel
def _descend(
    i: int, theta: float, state: State, work: SingleArray, slopes: Slopes, data: Data
) -> None:
    """Data update and primal descent on a row."""
    x, rest, ahead, _, limit, p, _ = state
    pull = work[0]
    dark = work[1]
    turn = work[2]
    metric = slopes.metric
    share = slopes.share
    image, unit, pace, evidence, table, away, gamma, threshold, safety = data
    _tilt(dark, turn, p, metric, table, i)
    per_gamma = ONE / gamma
    per_theta = ONE / theta
    lift = HALF / safety
    sign = -TWO / gamma if away else TWO / gamma
    for j in range(pull.size):
        # 1/χc = 1/τ - 1 at least, of τ = `safety` times 2/(1 + A²), less than 1
        p_u = p[0, i, j]
        p_v = p[1, i, j]
        along_u = abs(metric[0, i, j] * p_u + metric[1, i, j] * p_v) * min(
            ONE, PASSES * share[0, i, j]
        )
        along_v = abs(metric[1, i, j] * p_u + metric[2, i, j] * p_v) * min(
            ONE, PASSES * share[1, i, j]
        )
        s = turn[j] * (along_u + along_v)
        least = max((ONE + s * s) * lift - ONE, FREE)
        # I_model/I = w^(1/γ), w = (d₀/d)² C = u², log u = 2 artanh z, exp(4 y) = exp(y)⁴
        here = x[i, j]
        wanted = image[i, j]
        ratio = here * unit[i, j]
        fourth = np.sqrt(np.sqrt(dark[j]))
        over, under = (fourth, ratio) if away else (fourth * ratio, ONE)
        y = _artanh((over - under) / (over + under)) * per_gamma
        even = SINGLE(120) + SINGLE(12) * y * y
        odd = y * (SINGLE(60) + y * y)
        e = (even + odd) / (even - odd)
        model = wanted * (e * e) * (e * e)
        # What the picture wants is the model's own value where no residual counts.
        silent = (evidence[i, j] == NONE) | (
            (evidence[i, j] == LOWER_BOUND) & (model > wanted)
        )
        wanted = model if silent else wanted
        least = FREE if silent else least
        limit[i, j] = least
        # The slope is that by log ξ, and what is per ξ² is times ξ²: c, 1/τ_p and 1/χ.
        residual = model - wanted
        slope = sign * model
        own = pace[i, j] * here * here
        weight = threshold / max(threshold, abs(residual))
        c = weight * slope * slope
        stiff = max(own * per_theta, least * c)
        force = weight * residual * slope * stiff  # (ξ - ζ)/χ, times 1/χ + c
        step = here * (pull[j] * here * (stiff + c) + force) / ((stiff + c) * (own + stiff))
        step = max(min(step, HALF * here), -here)
        # ξ is x and a rest too small for it.
        less = rest[i, j] - step
        new = here + less
        x[i, j] = new
        rest[i, j] = less - (new - here)
        ahead[i, j] = new - step


@on_cores(cost=3)
def _advance(
    rows: Span,
    turns: Span,
    xi: SingleArray,
    theta: float,
    state: State,
    slopes: Slopes,
    rule: Rule,
    data: Data,
    room: Room,
) -> None:
    """Take steps, of `PHASES` turns each, in place, with χ in units of τ_p."""
    x, _, ahead, q, _, p, averages = state
    band = rows[0] // BAND_ROWS
    work = room.works[band]
    lines = room.lines[band]
    first, last = rows_within(rows, 1, xi.shape[0] - 1)
    current = SINGLE(theta)
    for turn in range(turns[0], turns[1]):
        phase = turn % PHASES
        if slopes.radius == 0 and 0 < phase < 4:
            continue
        if phase == 0:
            for i in range(first, last):
                _slopes(p, x, slopes, i)
                _ascend(q, ahead, rule, i, work)
                _average_row(p, i, slopes, lines)
        elif phase == 1:
            _average_columns(rows, p, slopes, room.running, averages)
        elif phase == 2:
            for i in range(first, last):
                _average_row(averages, i, slopes, lines)
        elif phase == 3:
            _average_columns(rows, averages, slopes, room.running, p)
        else:
            for i in range(first, last):
                if rule.first:
                    _pull_first(work[0], q, rule, i)
                else:
                    _pull_second(work[0], q, rule, i, work[1], work[2])
                _descend(i, current, state, work, slopes, data)


def _brdf_table(photometry: Photometry) -> SingleArray:
    """Factors of C² and -∂(log C)/∂P, (2, n) at equal steps of √(1 - cos θ); (2, 0) if Lambertian."""
    if photometry.slant_table() is None:
        return np.empty((2, 0), SINGLE)
    cosine = np.maximum(
        1 - np.linspace(0, 1, BRDF_TABLE_SIZE) ** 2, np.cos(np.deg2rad(89.9))
    )
    f = photometry.brdf.value(cosine, cosine)
    slope = photometry.brdf.slope(cosine)
    return np.stack([(f / f[0]) ** 2, 1 + cosine * slope / f]).astype(SINGLE)


def _single(array: FloatArray) -> SingleArray:
    """A copy in single precision."""
    return array.astype(SINGLE)


@dataclass
class _Path:
    """The state of the scheme and what its steps need, framed by one pixel."""

    problem: Problem
    state: State
    setup: tuple[Slopes, Rule, Data, Room]

    @classmethod
    def at(cls, problem: Problem, start: FloatArray, radius: int, safety: float) -> _Path:
        """Begin at a depth map, the dual at rest; `safety` is the share of the bound on τ that is taken."""
        mask = problem.mask
        cosine = np.where(mask, problem.field.cos_alpha, 1.0)
        first = problem.regulariser == "first"
        away = problem.xi == "d"
        evidence = problem.evidence
        joined = links(mask, problem.cuts)

        def frame(a: FloatArray, fill: float = 0.0) -> FloatArray:
            return add_frame(np.where(mask, a, fill), fill)

        def frame_xi(v: FloatArray) -> FloatArray:
            xi = to_xi(np.where(mask, v, 0.0), problem.xi, cosine)
            return frame(xi / problem.xi_median, 1.0)

        def frame_marks(marks: Any) -> ByteArray:
            framed: ByteArray = add_frame(marks).astype(np.int8)
            return framed

        x = frame_xi(start)
        height, width = x.shape
        offsets = np.empty((2, 0, 0))
        if problem.xi == "1/z":
            beside = gradient(-np.log(cosine), mask, problem.cuts, edge_order=1)
            offsets = frame(np.stack(beside))
        share = []
        for axis in (1, 0):
            patch = np.ones(2 * radius + 1)
            count = ndimage.convolve1d(1.0 * mask, patch, axis=axis, mode="constant")
            share.append(frame(1 / np.maximum(count, 1)))
        slopes = Slopes(
            SINGLE(1 if away else -1),
            frame_marks(joined),
            _single(offsets),
            _single(frame(np.moveaxis(problem.field.inverse_metric, -1, 0))),
            radius,
            _single(np.stack(share)),
        )
        image = frame(problem.image, 1.0)
        tau_p = BALANCE * (0.5 * problem.photometry.gamma * x / image) ** 2
        # τ_d τ_p ‖K‖² ≤ 1 for every pair of pixels that K joins
        widest = ndimage.maximum_filter(frame(tau_p[1:-1, 1:-1]), 3)
        norm = 8 if first else 64  # ‖K‖² of differences per pixel, at most
        scale = problem.derivative_scale
        sigma = 1 / (norm * scale**2 * np.where(widest > 0, widest, 1.0))
        bound = frame(problem.lam * problem.edge_weight)
        shrink = np.where(bound > 0, bound / (bound + sigma * problem.epsilon), 0.0)
        rule = Rule(
            _single(sigma * scale),
            frame_marks(joined if first else np.stack(hessian_stencils(joined))),
            _single(shrink),
            _single(bound),
            SINGLE(scale),
            first,
        )
        data = Data(
            _single(image),
            _single(1 / frame_xi(problem.log_d0)),
            _single(1 / tau_p),
            frame_marks(np.zeros(mask.shape) if evidence is None else evidence),
            _brdf_table(problem.photometry),
            away,
            SINGLE(problem.photometry.gamma),
            SINGLE(problem.threshold),
            SINGLE(safety),
        )
        bands = -(-height // BAND_ROWS)
        room = Room(
            np.zeros((bands, 5, width), SINGLE),
            np.zeros((bands, 4, width + 2 * radius), SINGLE),
            np.zeros((2, width)),
        )
        state = State(
            _single(x),
            _single(x - _single(x)),
            _single(x),
            np.zeros((2 if first else 6, height, width), SINGLE),
            np.zeros((height, width), SINGLE),
            np.zeros((2, height, width), SINGLE),
            np.zeros((2, height, width), SINGLE),
        )
        return cls(problem, state, (slopes, rule, data, room))

    def advance(self, count: int, theta: float = 1.0) -> None:
        """Take steps with χ, in units of 1/c at the start."""
        turns = count * PHASES
        _advance(self.state.x, theta / BALANCE, self.state, *self.setup, turns=turns)

    @property
    def log_distance(self) -> FloatArray:
        """v = log d, (H, W)."""
        problem = self.problem
        x = self.state.x.astype(np.float64) + self.state.rest
        xi = np.where(problem.mask, x[1:-1, 1:-1] * problem.xi_median, 1.0)
        return from_xi(xi, problem.xi, np.where(problem.mask, problem.field.cos_alpha, 1.0))

    @property
    def tau(self) -> float:
        """Part of the way to its data that a pixel went in the last step, on average, c as at first."""
        limit = self.state.limit[1:-1, 1:-1][self.problem.mask].astype(np.float64)
        t = np.minimum(1 / limit, 1.0)  # χc
        return float(np.mean(t / (1 + t) * BALANCE / (BALANCE + t)))


def _fall_in_ten(before: float, after: float, count: int) -> float:
    """Share of an energy that ten steps take off, if `count` took it from `before` to `after`."""
    fall = (before - after) / max(before, float(TINY))
    return max(fall, 0.0) * 10 / count


def primal_dual(
    problem: Problem,
    start: FloatArray | None = None,
    *,
    patch: float = 8.0,
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
    - patch: radius of the box over which slopes are averaged, twice, for the normals; in 1/320 of the
      longer side. 0 takes two neighbours, as the energy does, and thousands of steps.
    - tolerance: the run has converged when v has less than this to go (root mean square): its change in
      a step over the part of the way that a step takes; and ten steps lower the energy by at most .1 %.
    - every, max_iterations: steps from one iterate to the next, and the most to take.

    χ is 1/c at the start, or what is stable; in DTAM it falls with every step, here it stays. Iterates count
    steps (`k`); their scalars are steps; tau, the part of its way that a pixel goes in one; and fall, the
    share of the energy that ten took off.
    """
    if problem.regulariser == "curvature":
        raise ValueError(
            "primal_dual takes regulariser='first' or 'second', got 'curvature'"
        )
    number("patch", patch, 0, 32)
    number("tolerance", tolerance, 0)
    check_int("every", every, 1)
    check_int("max_iterations", max_iterations)
    check_maps(problem.mask, start)
    v = problem.log_d0 if start is None else start
    radius = round(patch * px_per_reference(problem.mask.shape))
    path = _Path.at(problem, v, radius, safety=0.7)
    steps = 0
    grid = Grid.of(problem)
    iterate = Iterate.of(problem, v)
    yield iterate
    while steps < max_iterations:
        count = int(min(every, max_iterations - steps))
        path.advance(count)
        steps += count
        shown = {"steps": steps, "tau": path.tau}
        v = path.log_distance
        terms = grid.terms(pad_maps(v), problem.lam)
        after = Iterate.of(problem, v, iterate, terms=terms)
        shown["fall"] = _fall_in_ten(iterate.energy, after.energy, count)
        iterate = replace(after, k=steps, scalars=shown)
        yield iterate
        still = iterate.change <= tolerance * count * shown["tau"]
        if still and shown["fall"] <= LARGEST_FALL:
            return Status.CONVERGED
    return Status.MAX_ITERATIONS
