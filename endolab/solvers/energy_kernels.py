"""The energy and its Gauss-Newton model, compiled: what `energy` says, with the derivatives of each step.

Arrays are padded, see `numerics.compiled`; what each means stands in `grid.Grid`. Loops are over rows without
their padding, j, of arrays of their own with it, j + 2, so that they take many pixels at once. K are the
differences of `numerics.stencils`.
"""

from typing import NamedTuple

import numpy as np

from endolab.model.photometry import Photometry
from endolab.numerics.arrays import ByteArray, FloatArray, Span
from endolab.numerics.compiled import PAD, copy_row, kernel
from endolab.numerics.elementary import exp
from endolab.numerics.stencils import CENTRAL, DOWN, adjoint_row, apply_row, stencil_row
from endolab.numerics.threads import BAND_ROWS, on_cores, rows_within
from endolab.solvers.normal_equations import BY_V, SMOOTHNESS, WEIGHT
from endolab.solvers.problem import EXACT, LOWER_BOUND


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
    """λ, Huber's threshold of the data, ε, the unit of a derivative of ξ, the kind of differences."""

    lam: float
    threshold: float
    epsilon: float
    scale: float
    kind: int


@kernel
def shade_row(
    slant: FloatArray,
    table: FloatArray,
    step: float,
    shading: FloatArray,
    slope: FloatArray,
) -> None:
    """log(cos θ f_r(θ)/f_r(0)) and its derivative by t = log(1 + tan²θ), on a row."""
    for j in range(slant.size):
        shading[j] = np.log(1 + slant[j])
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
    y: FloatArray,
    slopes: FloatArray,
) -> None:
    """G⁻¹ ∇v and tan²θ on a row, (3, W); y becomes the gradient."""
    apply_row(link, CENTRAL, v, i, y)
    for j in range(y.shape[1]):
        u = y[0, j]
        w = y[2, j]
        raised_u = metric[0, i, j + 2] * u + metric[1, i, j + 2] * w
        raised_w = metric[1, i, j + 2] * u + metric[2, i, j + 2] * w
        slopes[0, j] = raised_u
        slopes[1, j] = raised_w
        slopes[2, j] = raised_u * u + raised_w * w


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
    rows: Span,
    out: FloatArray,
    v: FloatArray,
    metric: FloatArray,
    link: ByteArray,
) -> None:
    """G⁻¹ ∇v and tan² of the angle between ray and normal, (3, ...); of one map, (1, ...), tan² alone."""
    first, last = rows_within(rows, PAD, v.shape[0] - PAD)
    y = np.zeros((3, v.shape[1] - 2 * PAD))
    slopes = np.zeros((3, v.shape[1] - 2 * PAD))
    for i in range(first, last):
        _slopes_row(v, metric, link, i, y, slopes)
        for k in range(len(out)):
            for j in range(y.shape[1]):
                out[k, i, j + 2] = slopes[3 - len(out) + k, j]


@kernel
def _predict_row(
    v: FloatArray,
    picture: Picture,
    wall: Wall,
    i: int,
    y: FloatArray,
    rows: FloatArray,
) -> None:
    """On a row: the residual, how much it counts (0 or 1), the model, and what the last two come from."""
    image, log_scale, metric, _, active, link, evidence = picture
    gamma, table, step = wall
    residual = rows[0]
    counts = rows[1]
    model = rows[2]
    slope = rows[3]
    shading = rows[4]
    slant = rows[7]
    _slopes_row(v, metric, link, i, y, rows[5:8])
    shade_row(slant, table, step, shading, slope)
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
def _sizes_row(
    y: FloatArray, above: FloatArray, squares: FloatArray, size: FloatArray
) -> None:
    """|K x| on a row, of its differences and those of the row above: see `Differences.norm`."""
    for j in range(size.size):
        squares[j + 1] = 0.25 * (y[1, j] * y[1, j] + above[1, j] * above[1, j])
    for j in range(size.size):
        own = y[0, j] * y[0, j] + y[2, j] * y[2, j]
        size[j] = np.sqrt(own + (squares[j] + squares[j + 1]))


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
    _, threshold, epsilon, scale, kind = penalties
    count = v.shape[1] - 2 * PAD
    work = np.empty((8, count))
    differences = np.zeros((2, 3, count))
    y = np.zeros((3, count))
    data = np.zeros(count)
    rough = np.zeros(count)
    squares = np.zeros(count + 1)
    size = np.empty(count)
    residual = work[0]
    counts = work[1]
    edge = picture.edge
    for start in range(rows[0], rows[1], BAND_ROWS):
        first, last = rows_within((start, start + BAND_ROWS), PAD, v.shape[0] - PAD)
        data[:] = 0.0
        rough[:] = 0.0
        for i in range(first - 1, last):
            apply_row(picture.link, kind, xi, i, differences[i % 2])
            if i < first:
                continue
            _sizes_row(differences[i % 2], differences[1 - i % 2], squares, size)
            _predict_row(v, picture, wall, i, y, work)
            for j in range(count):
                r = abs(residual[j])
                small = min(r, threshold)
                data[j] += counts[j] * small * (r - 0.5 * small)
            for j in range(count):
                s = scale * size[j]
                small = min(s, epsilon)
                rough[j] += edge[i, j + 2] * small * (s - 0.5 * small) / epsilon
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


@on_cores(cost=20)
def linearise(
    rows: Span,
    descent: FloatArray,
    smooth: FloatArray,
    parts: FloatArray,
    v: FloatArray,
    xi: FloatArray,
    picture: Picture,
    wall: Wall,
    penalties: Penalties,
) -> None:
    """Write these rows of -Jᵀ W r, of Kᵀ Q K ξ, and of the maps of `Coefficients` that do not damp.

    A row of J is a + b ∇, with a = ∂M/∂v and b = ∂M/∂∇v; W and Q are the parabolas that touch the penalties.
    """
    lam, threshold, epsilon, scale, kind = penalties
    gamma = wall.gamma
    count = v.shape[1] - 2 * PAD
    work = np.empty((8, count))
    t = np.zeros((3, len(DOWN), count))
    y = np.zeros((3, count))
    # Of a row and of the one above, whose squares wait for this row's weights:
    differences = np.zeros((2, 3, count))
    weights = np.zeros((2, count + 1))
    squares = np.zeros(count + 1)
    size = np.empty(count)
    active = picture.active
    edge = picture.edge
    descent[rows[0] : rows[1]] = 0.0
    smooth[rows[0] : rows[1]] = 0.0
    first, last = rows_within((rows[0] - 1, rows[1] + 1), PAD, v.shape[0] - PAD)
    for i in range(first - 1, last + 1):
        is_own = rows[0] <= i < rows[1]
        now = i % 2
        above = 1 - now
        q = weights[now]
        apply_row(picture.link, kind, xi, i, differences[now])
        _sizes_row(differences[now], differences[above], squares, size)
        for j in range(count):
            q[j] = lam * active[i, j + 2] * edge[i, j + 2]
            q[j] *= scale * scale / max(scale * size[j], epsilon)
        if is_own:
            copy_row(q[:-1], parts[SMOOTHNESS, i, PAD:])
        if i > first - 1:
            # Q K ξ of the row above: a square has a quarter of the weight of each of its pixels.
            p = weights[above]
            for j in range(count):
                square = 0.25 * ((p[j] + q[j + 1]) + (p[j + 1] + q[j]))
                y[0, j] = p[j] * differences[above, 0, j]
                y[1, j] = square * differences[above, 1, j]
                y[2, j] = p[j] * differences[above, 2, j]
            stencil_row(picture.link, kind, i - 1, t)
            adjoint_row(t, kind, y, i - 1, rows, smooth)
        if not first <= i < last:
            continue
        _predict_row(v, picture, wall, i, y, work)
        residual = work[0]
        weight = work[1]
        by_v = work[2]
        for j in range(count):
            by_v[j] = -2 * weight[j] * work[2, j] / gamma
            by_slant = -by_v[j] * work[3, j] / (1 + work[7, j])
            work[5, j] *= by_slant
            work[6, j] *= by_slant
            weight[j] *= threshold / max(abs(residual[j]), threshold)
        if is_own:
            copy_row(weight, parts[WEIGHT, i, PAD:])
            copy_row(by_v, parts[BY_V, i, PAD:])
            copy_row(work[5], parts[BY_V + 1, i, PAD:])
            copy_row(work[6], parts[BY_V + 2, i, PAD:])
            for j in range(count):
                descent[i, j + 2] -= by_v[j] * weight[j] * residual[j]
        for j in range(count):
            forced = -weight[j] * residual[j]
            y[0, j] = forced * work[5, j]
            y[1, j] = 0.0
            y[2, j] = forced * work[6, j]
        stencil_row(picture.link, CENTRAL, i, t)
        adjoint_row(t, CENTRAL, y, i, rows, descent)


def shading_table(photometry: Photometry) -> tuple[FloatArray, float]:
    """Shading of a BRDF against slant, for `shade_row`: table (2, 4096) and the step between its nodes.

    The rows are log(cos θ f_r(θ)/f_r(0)) and its derivative, at equal steps of √log(1 + tan²θ), which
    is nearly θ: a BRDF may have a cusp at θ = 0. A Lambertian surface has none, (2, 0).
    """
    if photometry.slant_table(2) is None:
        return np.empty((2, 0)), 1.0
    w = np.linspace(0.0, 4.0, 4096)  # to cos θ = e⁻⁸
    step = float(w[1])
    w[0] = 1e-6
    cosine = np.exp(-(w**2) / 2)
    f = photometry.brdf.value(cosine, cosine)
    shading = np.log(cosine * f / photometry.brdf.value(1.0, 1.0))
    return np.stack([shading, -w * (1 + cosine * photometry.brdf.slope(cosine) / f)]), step
