"""The energy and its Gauss-Newton model, compiled.

What is computed here is written readably in `energy.py`; the tests hold the two together. Arrays
are padded, see `numerics.compiled`; what is meant by each is in `grid.Grid`.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from endolab.depth.curvature_kernels import (
    COLUMNS,
    ROWS,
    bending_cost,
    bending_weights,
    form_of,
    form_stencils,
)
from endolab.depth.problem import AT_LEAST, CURVATURE, EXACT, NONE, SECOND
from endolab.model.photometry import Photometry
from endolab.numerics.arrays import FloatArray
from endolab.numerics.compiled import PAD, kernel

TABLE_SIZE = 4096


class Picture(NamedTuple):
    """What the energy needs of a grid's pixels; padded arrays, see `grid.Grid`."""

    image: FloatArray
    log_scale: FloatArray
    metric: FloatArray
    edge: FloatArray
    active: Any
    link: Any
    evidence: Any
    rays: FloatArray


class Wall(NamedTuple):
    """How a wall's brightness falls with its slant: γ and the table of `shading_table`."""

    gamma: float
    table: FloatArray
    step: float


class Penalties(NamedTuple):
    """Huber's threshold of the data, ε, the unit of a derivative of ξ, which of `problem.REGULARISERS`."""

    threshold: float
    epsilon: float
    scale: float
    kind: int


@kernel
def _shading(t: float, table: Any, step: float) -> tuple[float, float]:
    """log(cos θ f_r(θ)/f_r(0)) and its derivative by t = log(1 + tan²θ)."""
    if table.shape[1] == 0:  # Lambertian
        return -0.5 * t, -0.5
    w = np.sqrt(t)
    k = min(int(w / step), table.shape[1] - 2)
    s = w / step - k
    y0, y1, d0, d1 = table[0, k], table[0, k + 1], step * table[1, k], step * table[1, k + 1]
    a, b = 2 * (y0 - y1) + d0 + d1, 3 * (y1 - y0) - 2 * d0 - d1  # Hermite's cubic
    slope = (d0 + s * (2 * b + 3 * s * a)) / step
    return y0 + s * (d0 + s * (b + s * a)), slope / max(2 * w, 1e-9)


@kernel
def fill_xi(v: FloatArray, factor: FloatArray, active: Any, sign: float, xi: FloatArray) -> None:
    """ξ/ξ̃ where the mask is, 0 elsewhere."""
    for i in range(v.shape[0]):
        for j in range(v.shape[1]):
            xi[i, j] = factor[i, j] * np.exp(sign * v[i, j]) if active[i, j] else 0.0


@kernel
def differences(v: FloatArray, link: Any, i: int, j: int) -> tuple[float, float]:
    """∇v at a pixel: the mean of the differences that there are."""
    right, left, below, above = link[0, i, j], link[0, i, j - 1], link[1, i, j], link[1, i - 1, j]
    u = right * (v[i, j + 1] - v[i, j]) + left * (v[i, j] - v[i, j - 1])
    w = below * (v[i + 1, j] - v[i, j]) + above * (v[i, j] - v[i - 1, j])
    return u * (0.5 if right and left else 1.0), w * (0.5 if below and above else 1.0)


@kernel
def fill_slants(v: FloatArray, metric: FloatArray, active: Any, link: Any, out: FloatArray) -> None:
    """tan² of the angle between ray and normal where the mask is, 0 elsewhere."""
    for i in range(PAD, v.shape[0] - PAD):
        for j in range(PAD, v.shape[1] - PAD):
            if active[i, j]:
                u, w = differences(v, link, i, j)
                out[i, j] = metric[0, i, j] * u * u + 2 * metric[1, i, j] * u * w + metric[2, i, j] * w * w


@kernel
def _second(x: FloatArray, link: Any, i: int, j: int) -> tuple[float, float, float]:
    """The three second differences at a pixel (√2 on the mixed one), 0 where a step is missing."""
    right, left, below, above = link[0, i, j], link[0, i, j - 1], link[1, i, j], link[1, i - 1, j]
    uu = right * left * (x[i, j + 1] - 2 * x[i, j] + x[i, j - 1])
    vv = below * above * (x[i + 1, j] - 2 * x[i, j] + x[i - 1, j])
    square = right * below * link[0, i + 1, j] * link[1, i, j + 1]
    uv = np.sqrt(2.0) * square * (x[i + 1, j + 1] - x[i + 1, j] - x[i, j + 1] + x[i, j])
    return uu, uv, vv


@kernel
def _size(x: FloatArray, link: Any, second: bool, i: int, j: int) -> float:
    """‖D x‖ at a pixel, per pixel or per pixel squared."""
    if second:
        uu, uv, vv = _second(x, link, i, j)
        return np.sqrt(uu * uu + uv * uv + vv * vv)
    u = link[0, i, j] * (x[i, j + 1] - x[i, j])
    w = link[1, i, j] * (x[i + 1, j] - x[i, j])
    return np.sqrt(u * u + w * w)


@kernel
def _counts(r: float, evidence: Any, i: int, j: int) -> bool:
    """Whether a pixel's residual counts; no evidence stands for exact pixels."""
    return evidence.size == 0 or evidence[i, j] == EXACT or (evidence[i, j] == AT_LEAST and r < 0)


@kernel
def listen(
    model: FloatArray, image: FloatArray, evidence: Any, wanted: FloatArray, limit: FloatArray
) -> None:
    """Write what the picture wants of a row: the model's own value where no residual counts.

    No data bind the step of such a pixel, so that its limit is lifted.
    """
    for j in range(wanted.size):
        above = evidence[j] == AT_LEAST and model[j] > image[j]
        silent = above or evidence[j] == NONE
        wanted[j] = model[j] if silent else image[j]
        limit[j] = 0.999 if silent else limit[j]


@kernel
def sums(v: FloatArray, xi: FloatArray, picture: Any, wall: Any, penalties: Any) -> tuple[float, float]:
    """Sums over the mask of the data's penalty and of the regulariser's without λ."""
    image, log_scale, metric, edge, active, link, evidence, rays = picture
    gamma, table, step = wall
    threshold, epsilon, scale, kind = penalties
    stencils = np.empty((3, 6))
    data, rough = 0.0, 0.0
    for i in range(PAD, v.shape[0] - PAD):
        for j in range(PAD, v.shape[1] - PAD):
            if active[i, j]:
                u, w = differences(v, link, i, j)
                slant = metric[0, i, j] * u * u + 2 * metric[1, i, j] * u * w + metric[2, i, j] * w * w
                shading = _shading(np.log(1 + slant), table, step)[0]
                r = np.exp(log_scale[i, j] + (shading - 2 * v[i, j]) / gamma) - image[i, j]
                if _counts(r, evidence, i, j):
                    r = abs(r)
                    small = min(r, threshold)
                    data += small * (r - 0.5 * small)
                if kind == CURVATURE:
                    all_known = form_stencils(rays, link, i, j, stencils)
                    around = (metric[0, i, j], metric[1, i, j], metric[2, i, j])
                    cost = bending_cost(form_of(xi, i, j, stencils), around, all_known, epsilon)
                    rough += edge[i, j] * cost
                    continue
                size = scale * _size(xi, link, kind == SECOND, i, j)
                small = min(size, epsilon)
                rough += edge[i, j] * small * (size - 0.5 * small) / epsilon
    return data, rough


@kernel
def linearise(
    v: FloatArray, xi: FloatArray, picture: Any, wall: Any, penalties: Any, lam: float, out: Any
) -> None:
    """Coefficients of the normal equations, -Jᵀ W r and Dᵀ Q D ξ."""
    image, log_scale, metric, edge, active, link, evidence, rays = picture
    gamma, table, step = wall
    threshold, epsilon, scale, kind = penalties
    stencils = np.empty((3, 6))
    by_v, by_v_u, by_v_v, weight, smoothness, descent, smooth = out
    for i in range(PAD, v.shape[0] - PAD):
        for j in range(PAD, v.shape[1] - PAD):
            if not active[i, j]:
                continue
            right, left, below, above = link[0, i, j], link[0, i, j - 1], link[1, i, j], link[1, i - 1, j]
            u, w = differences(v, link, i, j)
            up = metric[0, i, j] * u + metric[1, i, j] * w
            wp = metric[1, i, j] * u + metric[2, i, j] * w
            slant = up * u + wp * w
            shading, slope = _shading(np.log(1 + slant), table, step)
            intensity = np.exp(log_scale[i, j] + (shading - 2 * v[i, j]) / gamma)
            r = intensity - image[i, j]
            if _counts(r, evidence, i, j):
                by_slant = 2 * intensity * slope / (gamma * (1 + slant))
                a, b_u, b_v = -2 * intensity / gamma, by_slant * up, by_slant * wp
                k = 1 / max(abs(r) / threshold, 1.0)
                by_v[i, j], by_v_u[i, j], by_v_v[i, j], weight[i, j] = a, b_u, b_v, k
                u, w = k * r * b_u / max(right + left, 1), k * r * b_v / max(below + above, 1)
                descent[i, j] -= k * r * a + u * (left - right) + w * (above - below)
                descent[i, j + 1] -= u * right
                descent[i, j - 1] += u * left
                descent[i + 1, j] -= w * below
                descent[i - 1, j] += w * above
            if kind == CURVATURE:
                all_known = form_stencils(rays, link, i, j, stencils)
                form, around = (
                    form_of(xi, i, j, stencils),
                    (metric[0, i, j], metric[1, i, j], metric[2, i, j]),
                )
                bending_weights(form, around, all_known, epsilon, lam * edge[i, j], i, j, smoothness)
                q = smoothness[:, i, j]
                uu = q[0] * form[0] + q[1] * form[1] + q[2] * form[2]
                uv = q[1] * form[0] + q[3] * form[1] + q[4] * form[2]
                vv = q[2] * form[0] + q[4] * form[1] + q[5] * form[2]
                for k in range(6):
                    pull = stencils[0, k] * uu + stencils[1, k] * uv + stencils[2, k] * vv
                    smooth[i + ROWS[k], j + COLUMNS[k]] += pull
                continue
            if kind == SECOND:
                uu, uv, vv = _second(xi, link, i, j)
                size = np.sqrt(uu * uu + uv * uv + vv * vv)
                q = lam * edge[i, j] * scale * scale / max(scale * size, epsilon)
                uu, vv, uv = q * uu, q * vv, q * np.sqrt(2.0) * uv
                smooth[i, j] += uv - 2 * uu - 2 * vv
                smooth[i, j + 1] += uu - uv
                smooth[i, j - 1] += uu
                smooth[i + 1, j] += vv - uv
                smooth[i - 1, j] += vv
                smooth[i + 1, j + 1] += uv
            else:
                du = right * (xi[i, j + 1] - xi[i, j])
                dw = below * (xi[i + 1, j] - xi[i, j])
                size = np.sqrt(du * du + dw * dw)
                q = lam * edge[i, j] * scale * scale / max(scale * size, epsilon)
                smooth[i, j] -= q * (du + dw)
                smooth[i, j + 1] += q * du
                smooth[i + 1, j] += q * dw
            smoothness[0, i, j] = q


def shading_table(photometry: Photometry, size: int = TABLE_SIZE) -> tuple[FloatArray, float]:
    """Shading of a BRDF against slant, for `_shading`: table (2, size) and the step between its nodes.

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
    return np.stack([shading, 2 * w * by_slant * np.exp(w**2) / intensity]), float(w[2] - w[1])
