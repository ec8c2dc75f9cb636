"""The energy and its Gauss-Newton model, compiled.

The energy stands in the head of `energy.py`. Arrays are padded, see `numerics.compiled`; what is meant by
each is in `grid.Grid`. Loops are over rows without their padding, j, of arrays of their own with it, j + 2,
so that they take many pixels at once.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from endolab.model.photometry import Photometry
from endolab.numerics.arrays import ByteArray, FloatArray, Span
from endolab.numerics.compiled import PAD, clear_row, copy_row, kernel
from endolab.numerics.elementary import exp, log
from endolab.numerics.stencils import square, step_means, step_sums, steps
from endolab.numerics.threads import BAND_ROWS, on_cores, rows_within
from endolab.solvers.normal_equations import (
    BY_V,
    SMOOTHNESS,
    WEIGHT,
)
from endolab.solvers.problem import EXACT, FIRST, LOWER_BOUND


class Picture(NamedTuple):
    """What the energy needs of a grid's pixels; padded arrays, see `grid.Grid`."""

    image: FloatArray
    log_scale: FloatArray
    metric: FloatArray
    edge: FloatArray
    active: ByteArray
    link: ByteArray
    evidence: ByteArray


class Wall(NamedTuple):
    """How a wall's brightness falls with its slant: γ and the table of `shading_table`."""

    gamma: float
    table: FloatArray
    step: float


class Penalties(NamedTuple):
    """λ, Huber's threshold of the data, ε, the unit of a derivative of ξ, which of `problem.REGULARISERS`."""

    lam: float
    threshold: float
    epsilon: float
    scale: float
    kind: int


@kernel
def _shade_row(
    slant: FloatArray,
    table: FloatArray,
    step: float,
    shading: FloatArray,
    slope: FloatArray,
) -> None:
    """log(cos θ f_r(θ)/f_r(0)) and its derivative by t = log(1 + tan²θ), on a row."""
    for j in range(slant.size):
        shading[j] = log(1 + slant[j])
    if table.shape[1] == 0:  # Lambertian
        for j in range(slant.size):
            shading[j] *= -0.5
            slope[j] = -0.5
        return
    for j in range(slant.size):
        w = np.sqrt(shading[j])
        k = min(int(w / step), table.shape[1] - 2)
        s = w / step - k
        y0 = table[0, k]
        y1 = table[0, k + 1]
        d0 = step * table[1, k]
        d1 = step * table[1, k + 1]
        # Hermite's cubic
        a = 2 * (y0 - y1) + d0 + d1
        b = 3 * (y1 - y0) - 2 * d0 - d1
        slope[j] = (d0 + s * (2 * b + 3 * s * a)) / step / max(2 * w, 1e-9)
        shading[j] = y0 + s * (d0 + s * (b + s * a))


@kernel
def _slopes_row(
    v: FloatArray,
    metric: FloatArray,
    link: ByteArray,
    i: int,
    raised_u: FloatArray,
    raised_w: FloatArray,
    slant: FloatArray,
) -> None:
    """G⁻¹ ∇v and tan²θ on a row, ∇v being the mean of the differences that there are."""
    for j in range(slant.size):
        along, down = step_sums(v, link, i, j + 2)
        mean_u, mean_w = step_means(link, i, j + 2)
        u = mean_u * along
        w = mean_w * down
        raised_u[j] = metric[0, i, j + 2] * u + metric[1, i, j + 2] * w
        raised_w[j] = metric[1, i, j + 2] * u + metric[2, i, j + 2] * w
        slant[j] = raised_u[j] * u + raised_w[j] * w


@on_cores(cost=3)
def fill_xi(
    rows: Span,
    v: FloatArray,
    factor: FloatArray,
    active: ByteArray,
    sign: float,
    xi: FloatArray,
) -> None:
    """ξ/ξ̃ where the mask is, 0 elsewhere."""
    for i in range(rows[0], rows[1]):
        for j in range(v.shape[1]):
            xi[i, j] = active[i, j] * factor[i, j] * exp(sign * v[i, j])


@on_cores(cost=3)
def fill_slopes(
    rows: Span, v: FloatArray, metric: FloatArray, link: ByteArray, out: FloatArray
) -> None:
    """G⁻¹ ∇v and tan² of the angle between ray and normal, (3, ...)."""
    first, last = rows_within(rows, PAD, v.shape[0] - PAD)
    for i in range(first, last):
        raised_u = out[0, i, PAD:-PAD]
        raised_w = out[1, i, PAD:-PAD]
        _slopes_row(v, metric, link, i, raised_u, raised_w, out[2, i, PAD:-PAD])


@on_cores(cost=3)
def fill_slants(
    rows: Span, out: FloatArray, v: FloatArray, metric: FloatArray, link: ByteArray
) -> None:
    """tan² of that angle alone: three maps of fresh memory take ten times as long."""
    first, last = rows_within(rows, PAD, v.shape[0] - PAD)
    raised_u, raised_w = np.empty((2, v.shape[1] - 2 * PAD))
    for i in range(first, last):
        _slopes_row(v, metric, link, i, raised_u, raised_w, out[i, PAD:-PAD])


@kernel
def _predict_row(
    v: FloatArray, picture: Picture, wall: Wall, i: int, rows: FloatArray
) -> None:
    """On a row: the residual, how much it counts (0 or 1), the model, and what the last two come from."""
    image, log_scale, metric, _, active, link, evidence = picture
    gamma, table, step = wall
    residual = rows[0]
    counts = rows[1]
    model = rows[2]
    slope = rows[3]
    slant = rows[4]
    raised_u = rows[5]
    raised_w = rows[6]
    shading = rows[7]
    _slopes_row(v, metric, link, i, raised_u, raised_w, slant)
    _shade_row(slant, table, step, shading, slope)
    for j in range(model.size):
        log_image = log_scale[i, j + 2] + (shading[j] - 2 * v[i, j + 2]) / gamma
        model[j] = exp(log_image)
    for j in range(model.size):
        residual[j] = model[j] - image[i, j + 2]
        counts[j] = active[i, j + 2]
    if evidence.size > 0:
        for j in range(model.size):
            kind = evidence[i, j + 2]
            one_sided = kind == LOWER_BOUND and residual[j] < 0
            counts[j] = counts[j] if kind == EXACT or one_sided else 0.0


@kernel
def _square_difference(x: FloatArray, link: ByteArray, i: int, j: int) -> float:
    """Mixed difference of the square to the lower right of a pixel; 0 where a step is missing."""
    difference = x[i + 1, j + 1] - x[i + 1, j] - x[i, j + 1] + x[i, j]
    return square(link, i, j) * difference


@kernel
def _fill_differences(
    x: FloatArray, link: ByteArray, kind: int, i: int, out: FloatArray, size: FloatArray
) -> None:
    """D x on a row: along it and down, and of the squares to the lower and upper right; and ‖D x‖.

    A pixel has half of the squared mixed difference of each square around it.
    """
    along = out[0]
    down = out[1]
    lower = out[2]
    upper = out[3]
    for j in range(size.size):
        right, left, south, north = steps(link, i, j + 2)
        here = x[i, j + 2]
        if kind == FIRST:
            along[j] = right * (x[i, j + 3] - here)
            down[j] = south * (x[i + 1, j + 2] - here)
        else:
            along[j] = right * left * (x[i, j + 3] - 2 * here + x[i, j + 1])
            down[j] = south * north * (x[i + 1, j + 2] - 2 * here + x[i - 1, j + 2])
    if kind == FIRST:
        for j in range(size.size):
            size[j] = np.sqrt(along[j] * along[j] + down[j] * down[j])
        return
    squares = np.zeros(size.size + 1)  # of mixed differences, to the left of each pixel
    for j in range(size.size):
        lower[j] = _square_difference(x, link, i, j + 2)
        upper[j] = _square_difference(x, link, i - 1, j + 2)
        squares[j + 1] = lower[j] * lower[j] + upper[j] * upper[j]
    for j in range(size.size):
        mixed = 0.5 * (squares[j] + squares[j + 1])
        size[j] = np.sqrt(along[j] * along[j] + down[j] * down[j] + mixed)


@kernel
def _add_smooth_row(
    weight: FloatArray, differences: FloatArray, kind: int, i: int, out: FloatArray
) -> None:
    """Add the slope of ½ Σ weight ‖D x‖² over a row to a map; spoils the differences."""
    along = differences[0]
    down = differences[1]
    lower = differences[2]
    upper = differences[3]
    here = out[i]
    over = out[i - 1]
    under = out[i + 1]
    own = 1.0 if kind == FIRST else 2.0
    for j in range(weight.size):
        along[j] *= weight[j]
        down[j] *= weight[j]
        here[j + 2] -= own * along[j] + own * down[j]
        under[j + 2] += down[j]
    for j in range(weight.size):
        here[j + 3] += along[j]
    if kind == FIRST:
        return
    for j in range(weight.size):
        here[j + 1] += along[j]
        over[j + 2] += down[j]
    for j in range(weight.size - 1):
        half = 0.5 * (weight[j] + weight[j + 1])
        lower[j] *= half
        upper[j] *= half
    for j in range(weight.size):
        under[j + 2] -= lower[j]
        here[j + 2] += lower[j] - upper[j]
        over[j + 2] += upper[j]
    for j in range(weight.size):
        under[j + 3] += lower[j]
        here[j + 3] += upper[j] - lower[j]
        over[j + 3] -= upper[j]


@on_cores(cost=15)
def _fill_sums(
    rows: Span,
    v: FloatArray,
    xi: FloatArray,
    picture: Picture,
    wall: Wall,
    penalties: Penalties,
    out: FloatArray,
) -> None:
    """Each band's part of `sums`."""
    edge = picture[3]
    link = picture[5]
    _, threshold, epsilon, scale, kind = penalties
    count = v.shape[1] - 2 * PAD
    work = np.empty((8, count))
    differences = np.empty((4, count))
    sizes = np.empty(count)
    totals = np.empty((2, count))
    residual = work[0]
    counts = work[1]
    data = totals[0]
    rough = totals[1]
    for start in range(rows[0], rows[1], BAND_ROWS):
        first, last = rows_within((start, start + BAND_ROWS), PAD, v.shape[0] - PAD)
        totals[:] = 0.0
        for i in range(first, last):
            _predict_row(v, picture, wall, i, work)
            for j in range(count):
                r = abs(residual[j])
                small = min(r, threshold)
                data[j] += counts[j] * small * (r - 0.5 * small)
            weight = edge[i]
            _fill_differences(xi, link, kind, i, differences, sizes)
            for j in range(count):
                size = scale * sizes[j]
                small = min(size, epsilon)
                rough[j] += weight[j + 2] * small * (size - 0.5 * small) / epsilon
        out[start // BAND_ROWS, 0] = data.sum()
        out[start // BAND_ROWS, 1] = rough.sum()


def sums(
    v: FloatArray, xi: FloatArray, picture: Picture, wall: Wall, penalties: Penalties
) -> tuple[float, float]:
    """Sums over the mask of the data's penalty and of the regulariser's without λ."""
    parts = np.zeros((-(-v.shape[0] // BAND_ROWS), 2))
    _fill_sums(v, xi, picture, wall, penalties, parts)
    data, rough = parts.sum(axis=0)
    return float(data), float(rough)


@kernel
def _pull_row(
    residual: FloatArray,
    weight: FloatArray,
    factors: FloatArray,
    link: ByteArray,
    i: int,
    out: FloatArray,
) -> None:
    """Subtract Jᵀ W r of a row from a map; `factors` are a and b of J, which it spoils."""
    by_v = factors[0]
    by_u = factors[1]
    by_w = factors[2]
    here = out[i]
    up = out[i - 1]
    down = out[i + 1]
    for j in range(residual.size):
        right, left, south, north = steps(link, i, j + 2)
        mean_u, mean_w = step_means(link, i, j + 2)
        forced = weight[j] * residual[j]
        by_u[j] *= forced * mean_u
        by_w[j] *= forced * mean_w
        beside = by_u[j] * (left - right)
        here[j + 2] -= forced * by_v[j] + beside + by_w[j] * (north - south)
        down[j + 2] -= by_w[j] * south
        up[j + 2] += by_w[j] * north
    for j in range(residual.size):
        here[j + 3] -= by_u[j] * link[0, i, j + 2]
    for j in range(residual.size):
        here[j + 1] += by_u[j] * link[0, i, j + 1]


@kernel
def _differentiate_row(
    rows: FloatArray, gamma: float, threshold: float, factors: FloatArray
) -> None:
    """a and b of J on a row, from what `_predict_row` wrote; the counts become the weights W."""
    residual = rows[0]
    counts = rows[1]
    model = rows[2]
    slope = rows[3]
    slant = rows[4]
    raised_u = rows[5]
    raised_w = rows[6]
    by_slant = rows[7]
    by_v = factors[0]
    by_u = factors[1]
    by_w = factors[2]
    for j in range(model.size):
        by_v[j] = -2 * counts[j] * model[j] / gamma
    for j in range(model.size):
        by_slant[j] = -by_v[j] * slope[j] / (1 + slant[j])
    for j in range(model.size):
        by_u[j] = by_slant[j] * raised_u[j]
        by_w[j] = by_slant[j] * raised_w[j]
    for j in range(model.size):
        counts[j] *= threshold / max(abs(residual[j]), threshold)


@on_cores(cost=10, turns=3)
def linearise(
    rows: Span,
    turns: Span,
    v: FloatArray,
    xi: FloatArray,
    picture: Picture,
    wall: Wall,
    penalties: Penalties,
    out: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    """Maps of `Coefficients` but for slope and caution, -Jᵀ W r and Dᵀ Q D ξ."""
    _, _, _, edge, active, link, _ = picture
    lam, threshold, epsilon, scale, kind = penalties
    parts, descent, smooth = out
    count = v.shape[1] - 2 * PAD
    work = np.empty((8, count))
    factors = np.empty((3, count))
    differences = np.empty((4, count))
    sizes = np.empty(count)
    weight = work[1]
    for turn in range(turns[0], turns[1]):
        if turn == 0:
            for i in range(rows[0], rows[1]):
                clear_row(descent[i])
                clear_row(smooth[i])
            continue
        # Every second band: what a row adds to its neighbours' must not meet.
        odd = turn - 1
        for start in range(rows[0] + odd * BAND_ROWS, rows[1], 2 * BAND_ROWS):
            first, last = rows_within((start, start + BAND_ROWS), PAD, v.shape[0] - PAD)
            for i in range(first, last):
                _predict_row(v, picture, wall, i, work)
                _differentiate_row(work, wall.gamma, threshold, factors)
                copy_row(weight, parts[WEIGHT, i, PAD:])
                for part in range(3):
                    copy_row(factors[part], parts[BY_V + part, i, PAD:])
                _pull_row(work[0], weight, factors, link, i, descent)
                for j in range(count):
                    weight[j] = active[i, j + 2] * lam * edge[i, j + 2]
                _fill_differences(xi, link, kind, i, differences, sizes)
                # the parabola that touches the penalty
                for j in range(count):
                    weight[j] *= scale * scale / max(scale * sizes[j], epsilon)
                copy_row(weight, parts[SMOOTHNESS, i, PAD:])
                _add_smooth_row(weight, differences, kind, i, smooth)


def shading_table(photometry: Photometry, size: int = 4096) -> tuple[FloatArray, float]:
    """Shading of a BRDF against slant, for `_shade_row`: table (2, size) and the step between its nodes.

    The rows are log(cos θ f_r(θ)/f_r(0)) and its derivative, at equal steps of √log(1 + tan²θ), which
    is nearly θ: a BRDF may have a cusp at θ = 0. A Lambertian surface has none, (2, 0).
    """
    if photometry.slant_table(2) is None:
        return np.empty((2, 0)), 1.0
    w = np.linspace(0.0, 4.0, size)  # to cos θ = e⁻⁸
    w[0] = 1e-6
    unit = replace(photometry, k=0.0, gain=1.0, gamma=1.0)
    intensity, _, by_slant = unit.shade(np.zeros(size), np.expm1(w**2), np.ones(size))
    shading = np.log(intensity / unit.shade(0.0, 0.0, 1.0)[0])
    return np.stack([shading, 2 * w * by_slant * np.exp(w**2) / intensity]), float(
        w[2] - w[1]
    )
