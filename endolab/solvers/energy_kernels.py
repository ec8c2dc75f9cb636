"""The energy and its Gauss-Newton model, compiled.

What is computed here is written readably in `energy.py`; the tests hold the two together. Arrays
are padded, see `numerics.compiled`; what is meant by each is in `grid.Grid`. Loops are over rows without
their padding, j, of arrays of their own with it, j + 2, so that they take many pixels at once.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from endolab.model.photometry import Photometry
from endolab.numerics.arrays import ByteArray, FloatArray, Span
from endolab.numerics.compiled import PAD, clear_row, copy_row, kernel
from endolab.numerics.elementary import exp, log
from endolab.numerics.threads import BAND_ROWS, on_cores, rows_within
from endolab.solvers.curvature_kernels import (
    add_bending_row,
    add_unbent_row,
    bend_row,
    square,
    weigh_bending_row,
)
from endolab.solvers.normal_equations import (
    BY_V,
    SLOPE,
    SLOPE_DAMPING_U,
    SLOPE_DAMPING_W,
    SMOOTHNESS,
    WEIGHT,
)
from endolab.solvers.problem import CURVATURE, EXACT, FIRST, LOWER_BOUND


class Picture(NamedTuple):
    """What the energy needs of a grid's pixels; padded arrays, see `grid.Grid`."""

    image: FloatArray
    log_scale: FloatArray
    metric: FloatArray
    edge: FloatArray
    active: ByteArray
    link: ByteArray
    evidence: ByteArray
    shares: FloatArray  # of `curvature_kernels`


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
def slopes_row(
    v: FloatArray,
    metric: FloatArray,
    link: ByteArray,
    i: int,
    raised_u: FloatArray,
    raised_w: FloatArray,
    slant: FloatArray,
) -> None:
    """G⁻¹ ∇v and tan²θ on a row, ∇v being the mean of the differences that there are."""
    row = v[i]
    up = v[i - 1]
    down = v[i + 1]
    across = link[0, i]
    below = link[1, i]
    above = link[1, i - 1]
    guu = metric[0, i]
    guv = metric[1, i]
    gvv = metric[2, i]
    for j in range(slant.size):
        right = across[j + 2]
        left = across[j + 1]
        south = below[j + 2]
        north = above[j + 2]
        both = 1 - 0.5 * (float(right) * left)
        along = 1 - 0.5 * (float(south) * north)
        u = both * (
            float(right) * (row[j + 3] - row[j + 2])
            + float(left) * (row[j + 2] - row[j + 1])
        )
        w = along * (
            float(south) * (down[j + 2] - row[j + 2])
            + float(north) * (row[j + 2] - up[j + 2])
        )
        raised_u[j] = guu[j + 2] * u + guv[j + 2] * w
        raised_w[j] = guv[j + 2] * u + gvv[j + 2] * w
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
        row = v[i]
        by = factor[i]
        there = active[i]
        out = xi[i]
        for j in range(row.size):
            out[j] = float(there[j]) * by[j] * exp(sign * row[j])


@on_cores(cost=0.5)
def advance(
    rows: Span,
    v: FloatArray,
    delta: FloatArray,
    share: float,
    longest: float,
    ceiling: FloatArray,
    out: FloatArray,
) -> None:
    """Go a share of a step of which nothing is longer than `longest`, no higher than a ceiling, if any."""
    for i in range(rows[0], rows[1]):
        row = v[i]
        step = delta[i]
        there = out[i]
        for j in range(row.size):
            there[j] = row[j] + share * min(max(step[j], -longest), longest)
        if ceiling.size > 0:
            most = ceiling[i]
            for j in range(row.size):
                there[j] = min(there[j], most[j])


@on_cores(cost=3)
def fill_slants(
    rows: Span, v: FloatArray, metric: FloatArray, link: ByteArray, out: FloatArray
) -> None:
    """tan² of the angle between ray and normal where the mask is, 0 elsewhere."""
    first, last = rows_within(rows, PAD, v.shape[0] - PAD)
    raised = np.empty((2, v.shape[1] - 2 * PAD))
    for i in range(first, last):
        slopes_row(v, metric, link, i, raised[0], raised[1], out[i, PAD:-PAD])


@kernel
def _predict_row(
    v: FloatArray, picture: Picture, wall: Wall, i: int, rows: FloatArray
) -> None:
    """On a row: the residual, how much it counts (0 or 1), the model, and what the last two come from."""
    image, log_scale, metric, _, active, link, evidence, _ = picture
    gamma, table, step = wall
    residual = rows[0]
    counts = rows[1]
    model = rows[2]
    slope = rows[3]
    slant = rows[4]
    raised_u = rows[5]
    raised_w = rows[6]
    shading = rows[7]
    slopes_row(v, metric, link, i, raised_u, raised_w, slant)
    _shade_row(slant, table, step, shading, slope)
    row = v[i]
    brightness = log_scale[i]
    seen = image[i]
    there = active[i]
    for j in range(model.size):
        model[j] = exp(brightness[j + 2] + (shading[j] - 2 * row[j + 2]) / gamma)
    for j in range(model.size):
        residual[j] = model[j] - seen[j + 2]
        counts[j] = float(there[j + 2])
    if evidence.size > 0:
        kinds = evidence[i]
        for j in range(model.size):
            one_sided = kinds[j + 2] == LOWER_BOUND and residual[j] < 0
            counts[j] = counts[j] if kinds[j + 2] == EXACT or one_sided else 0.0


@kernel
def _roughness_row(
    x: FloatArray, link: ByteArray, kind: int, i: int, size: FloatArray
) -> None:
    """‖D x‖ on a row, per pixel or per pixel squared."""
    row = x[i]
    up = x[i - 1]
    down = x[i + 1]
    across = link[0, i]
    below = link[1, i]
    above = link[1, i - 1]
    if kind == FIRST:
        for j in range(size.size):
            right = row[j + 3] - row[j + 2]
            south = down[j + 2] - row[j + 2]
            right = float(across[j + 2]) * right
            south = float(below[j + 2]) * south
            size[j] = np.sqrt(right * right + south * south)
        return
    squares = np.zeros(size.size + 1)  # of mixed differences, to the left of each pixel
    for j in range(squares.size):
        lower = square(link, i, j + 1) * (
            down[j + 2] - down[j + 1] - row[j + 2] + row[j + 1]
        )
        upper = square(link, i - 1, j + 1) * (
            row[j + 2] - row[j + 1] - up[j + 2] + up[j + 1]
        )
        squares[j] = lower * lower + upper * upper
    for j in range(size.size):
        uu = (
            float(across[j + 2])
            * float(across[j + 1])
            * (row[j + 3] - 2 * row[j + 2] + row[j + 1])
        )
        vv = (
            float(below[j + 2])
            * float(above[j + 2])
            * (down[j + 2] - 2 * row[j + 2] + up[j + 2])
        )
        size[j] = np.sqrt(uu * uu + vv * vv + 0.5 * (squares[j] + squares[j + 1]))


@kernel
def _add_smooth_row(
    x: FloatArray, weight: FloatArray, link: ByteArray, kind: int, i: int, out: FloatArray
) -> None:
    """Add the slope of ½ Σ weight ‖D x‖² over a row to a map."""
    row = x[i]
    up = x[i - 1]
    down = x[i + 1]
    across = link[0, i]
    below = link[1, i]
    above = link[1, i - 1]
    here = out[i]
    over = out[i - 1]
    under = out[i + 1]
    n = weight.size
    uu = np.empty(n)
    if kind == FIRST:
        for j in range(n):
            right = weight[j] * float(across[j + 2]) * (row[j + 3] - row[j + 2])
            south = weight[j] * float(below[j + 2]) * (down[j + 2] - row[j + 2])
            here[j + 2] -= right + south
            under[j + 2] += south
            uu[j] = right
        for j in range(n):
            here[j + 3] += uu[j]
        return
    for j in range(n):
        both = float(across[j + 2]) * float(across[j + 1])
        along = float(below[j + 2]) * float(above[j + 2])
        uu[j] = weight[j] * both * (row[j + 3] - 2 * row[j + 2] + row[j + 1])
        vv = weight[j] * along * (down[j + 2] - 2 * row[j + 2] + up[j + 2])
        here[j + 2] -= 2 * uu[j] + 2 * vv
        under[j + 2] += vv
        over[j + 2] += vv
    for j in range(n):
        here[j + 3] += uu[j]
    for j in range(n):
        here[j + 1] += uu[j]
    lower = np.empty(n + 1)
    upper = np.empty(n + 1)
    for j in range(n + 1):
        beside = 0.5 * ((weight[j - 1] if j > 0 else 0.0) + (weight[j] if j < n else 0.0))
        lower[j] = (
            beside
            * square(link, i, j + 1)
            * (down[j + 2] - down[j + 1] - row[j + 2] + row[j + 1])
        )
        upper[j] = (
            beside
            * square(link, i - 1, j + 1)
            * (row[j + 2] - row[j + 1] - up[j + 2] + up[j + 1])
        )
    for j in range(n + 1):
        under[j + 1] -= lower[j]
        here[j + 1] += lower[j] - upper[j]
        over[j + 1] += upper[j]
    for j in range(n + 1):
        under[j + 2] += lower[j]
        here[j + 2] += upper[j] - lower[j]
        over[j + 2] -= upper[j]


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
    metric = picture[2]
    edge = picture[3]
    link = picture[5]
    shares = picture[7]
    _, threshold, epsilon, scale, kind = penalties
    count = v.shape[1] - 2 * PAD
    work = np.empty((8, count))
    form = np.empty((3, count))
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
            if kind == CURVATURE:
                bend_row(xi, link, shares, i, form)
                add_bending_row(form, metric, link, i, epsilon, weight, rough)
                continue
            _roughness_row(xi, link, kind, i, form[0])
            for j in range(count):
                size = scale * form[0, j]
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
    across = link[0, i]
    below = link[1, i]
    above = link[1, i - 1]
    here = out[i]
    up = out[i - 1]
    down = out[i + 1]
    for j in range(residual.size):
        right = across[j + 2]
        left = across[j + 1]
        south = below[j + 2]
        north = above[j + 2]
        forced = weight[j] * residual[j]
        by_u[j] *= forced * (1 - 0.5 * (float(right) * left))
        by_w[j] *= forced * (1 - 0.5 * (float(south) * north))
        own = (
            forced * by_v[j]
            + by_u[j] * (float(left) - right)
            + by_w[j] * (float(north) - south)
        )
        here[j + 2] -= own
        down[j + 2] -= by_w[j] * float(south)
        up[j + 2] += by_w[j] * float(north)
    for j in range(residual.size):
        here[j + 3] -= by_u[j] * float(across[j + 2])
    for j in range(residual.size):
        here[j + 1] += by_u[j] * float(across[j + 1])


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


@kernel
def _weight_row(
    active: ByteArray, edge: FloatArray, lam: float, i: int, out: FloatArray
) -> None:
    """λ w on a row, 0 outside the mask."""
    there = active[i]
    g = edge[i]
    for j in range(out.size):
        out[j] = float(there[j + 2]) * lam * g[j + 2]


@kernel
def _weigh_row(size: FloatArray, scale: float, epsilon: float, weight: FloatArray) -> None:
    """Weights become those of the parabola that touches the penalty of D ξ, whose sizes are given."""
    for j in range(weight.size):
        weight[j] *= scale * scale / max(scale * size[j], epsilon)


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
    metric = picture[2]
    edge = picture[3]
    active = picture[4]
    link = picture[5]
    shares = picture[7]
    gamma = wall[0]
    lam, threshold, epsilon, scale, kind = penalties
    parts, descent, smooth = out
    count = v.shape[1] - 2 * PAD
    work = np.empty((8, count))
    form = np.empty((3, count))
    factors = np.empty((3, count))
    residual = work[0]
    weight_row = work[1]
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
                _differentiate_row(work, gamma, threshold, factors)
                copy_row(weight_row, parts[WEIGHT, i, PAD:])
                for part in range(3):
                    copy_row(factors[part], parts[BY_V + part, i, PAD:])
                _pull_row(residual, weight_row, factors, link, i, descent)
                _weight_row(active, edge, lam, i, weight_row)
                if kind == CURVATURE:
                    bend_row(xi, link, shares, i, form)
                    weigh_bending_row(
                        form, metric, link, i, epsilon, weight_row, parts[SMOOTHNESS:]
                    )
                    add_unbent_row(form, link, shares, i, smooth)
                    continue
                _roughness_row(xi, link, kind, i, form[0])
                _weigh_row(form[0], scale, epsilon, weight_row)
                copy_row(weight_row, parts[SMOOTHNESS, i, PAD:])
                _add_smooth_row(xi, weight_row, link, kind, i, smooth)


@on_cores(cost=0.5)
def subtract_smooth(
    rows: Span,
    descent: FloatArray,
    smooth: FloatArray,
    xi: FloatArray,
    sign: float,
    free: ByteArray,
    parts: FloatArray,
) -> None:
    """Subtract X Dᵀ Q D ξ from -Jᵀ W r, for pixels that are free, and write X."""
    for i in range(rows[0], rows[1]):
        down = descent[i]
        rough = smooth[i]
        here = xi[i]
        known = free[i]
        slope = parts[SLOPE, i]
        for j in range(down.size):
            slope[j] = sign * here[j]
            down[j] = float(known[j]) * (down[j] - sign * here[j] * rough[j])


@on_cores(cost=3)
def fill_slope_damping(
    rows: Span,
    parts: FloatArray,
    v: FloatArray,
    metric: FloatArray,
    link: ByteArray,
    slants: FloatArray,
) -> None:
    """Write what slopes of a step are charged for beforehand, see `grid.Grid.equations_at`."""
    first, last = rows_within(rows, PAD, v.shape[0] - PAD)
    count = v.shape[1] - 2 * PAD
    raised_u = np.empty(count)
    raised_w = np.empty(count)
    slant = np.empty(count)
    for i in range(first, last):
        slopes_row(v, metric, link, i, raised_u, raised_w, slant)
        by_v = parts[BY_V, i]
        weight = parts[WEIGHT, i]
        likely = slants[i]
        u = parts[SLOPE_DAMPING_U, i]
        w = parts[SLOPE_DAMPING_W, i]
        guu = metric[0, i]
        gvv = metric[2, i]
        for j in range(count):
            # ∂²M by the slope, as of a Lambertian wall that faces.
            bend = by_v[j + 2] / (2 * (1 + slant[j]))
            cost = 0.5 * weight[j + 2] * bend * bend * likely[j + 2]
            u[j + 2] = cost * guu[j + 2]
            w[j + 2] = cost * gvv[j + 2]


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
