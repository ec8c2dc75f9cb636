"""What `curvature.py` says, compiled: a pixel's stencils, its two costs and their parabolas.

The form at a pixel is linear in w at six: itself and the neighbours to the right, left, below, above and
below right, in this order. `rays` are padded, (3, ...), as are the maps, see `numerics.compiled`.
"""

from typing import Any

import numpy as np

from endolab.depth.curvature import ANGLE, CREASE, SLIGHT, TWOFOLD
from endolab.numerics.arrays import FloatArray
from endolab.numerics.compiled import kernel

ROWS, COLUMNS = (0, 0, 0, 1, -1, 1), (0, 1, -1, 0, 0, 1)  # of the six, from the pixel


@kernel
def form_stencils(rays: FloatArray, link: Any, i: int, j: int, t: Any) -> bool:
    """Write weights of the six pixels for uu, uv and vv into t (3, 6), 0 if unknown; say if all are known."""
    right, left, below, above = link[0, i, j], link[0, i, j - 1], link[1, i, j], link[1, i - 1, j]
    t[:] = 0.0
    across, along = max(right + left, 1), max(below + above, 1)
    known_uu, known_vv = right * left * min(below + above, 1), below * above * min(right + left, 1)
    known_uv = right * below * link[0, i + 1, j] * link[1, i, j + 1]
    if known_uu:
        t[0, 0], t[0, 1], t[0, 2] = -2.0, 1.0, 1.0
    if known_uv:
        t[1, 0], t[1, 1], t[1, 3], t[1, 5] = 1.0, -1.0, -1.0, 1.0
    if known_vv:
        t[2, 0], t[2, 3], t[2, 4] = -2.0, 1.0, 1.0
    if not (known_uu or known_uv or known_vv):
        return False
    x, y, z = rays[0, i, j], rays[1, i, j], rays[2, i, j]
    ux = (right * (rays[0, i, j + 1] - x) + left * (x - rays[0, i, j - 1])) / across
    uy = (right * (rays[1, i, j + 1] - y) + left * (y - rays[1, i, j - 1])) / across
    uz = (right * (rays[2, i, j + 1] - z) + left * (z - rays[2, i, j - 1])) / across
    vx = (below * (rays[0, i + 1, j] - x) + above * (x - rays[0, i - 1, j])) / along
    vy = (below * (rays[1, i + 1, j] - y) + above * (y - rays[1, i - 1, j])) / along
    vz = (below * (rays[2, i + 1, j] - z) + above * (z - rays[2, i - 1, j])) / along
    # Cramer's rule for a r_u + b r_v + c r
    ax, ay, az = vy * z - vz * y, vz * x - vx * z, vx * y - vy * x
    bx, by, bz = y * uz - z * uy, z * ux - x * uz, x * uy - y * ux
    cx, cy, cz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    volume = ux * ax + uy * ay + uz * az
    for k in range(3):
        sx = t[k, 0] * x + t[k, 1] * rays[0, i, j + 1] + t[k, 2] * rays[0, i, j - 1]
        sy = t[k, 0] * y + t[k, 1] * rays[1, i, j + 1] + t[k, 2] * rays[1, i, j - 1]
        sz = t[k, 0] * z + t[k, 1] * rays[2, i, j + 1] + t[k, 2] * rays[2, i, j - 1]
        sx += t[k, 3] * rays[0, i + 1, j] + t[k, 4] * rays[0, i - 1, j] + t[k, 5] * rays[0, i + 1, j + 1]
        sy += t[k, 3] * rays[1, i + 1, j] + t[k, 4] * rays[1, i - 1, j] + t[k, 5] * rays[1, i + 1, j + 1]
        sz += t[k, 3] * rays[2, i + 1, j] + t[k, 4] * rays[2, i - 1, j] + t[k, 5] * rays[2, i + 1, j + 1]
        a = (sx * ax + sy * ay + sz * az) / volume / across
        b = (sx * bx + sy * by + sz * bz) / volume / along
        c = (sx * cx + sy * cy + sz * cz) / volume
        t[k, 0] -= a * (left - right) + b * (above - below) + c
        t[k, 1] -= a * right
        t[k, 2] += a * left
        t[k, 3] -= b * below
        t[k, 4] += b * above
    return known_uu and known_uv and known_vv


@kernel
def form_of(x: FloatArray, i: int, j: int, t: Any) -> tuple[float, float, float]:
    """uu, uv and vv of a map by the stencils t."""
    c, e, w = x[i, j], x[i, j + 1], x[i, j - 1]
    s, n, d = x[i + 1, j], x[i - 1, j], x[i + 1, j + 1]
    uu = t[0, 0] * c + t[0, 1] * e + t[0, 2] * w + t[0, 3] * s + t[0, 4] * n + t[0, 5] * d
    uv = t[1, 0] * c + t[1, 1] * e + t[1, 2] * w + t[1, 3] * s + t[1, 4] * n + t[1, 5] * d
    vv = t[2, 0] * c + t[2, 1] * e + t[2, 2] * w + t[2, 3] * s + t[2, 4] * n + t[2, 5] * d
    return uu, uv, vv


@kernel
def _huber(size: float, epsilon: float) -> float:
    small = min(abs(size), epsilon)
    return small * (abs(size) - 0.5 * small) / epsilon


@kernel
def _measures(form: Any, metric: Any, all_known: bool) -> tuple[float, float]:
    """See `curvature.size_and_twofold`."""
    (uu, uv, vv), (p, q, r) = form, metric
    here, there = uu * p + uv * q, uv * q + vv * r
    size = ANGLE**2 * np.sqrt(here * here + 2 * (uu * q + uv * r) * (uv * p + vv * q) + there * there)
    product = ANGLE**4 * (uu * vv - uv * uv) * (p * r - q * q)
    return size, product / np.sqrt(size * size + SLIGHT * SLIGHT) if all_known else 0.0


@kernel
def bending_cost(form: Any, metric: Any, all_known: bool, epsilon: float) -> float:
    """What a pixel's bending costs, by Huber's penalty, without λ and g."""
    size, twofold = _measures(form, metric, all_known)
    epsilon *= CREASE
    return _huber(size, epsilon) + TWOFOLD * _huber(twofold, epsilon)


@kernel
def bending_weights(
    form: Any, metric: Any, all_known: bool, epsilon: float, weight: float, i: int, j: int, out: Any
) -> None:
    """Write Q, six numbers: the cost is about ½ formᵀ Q form, and its slope is Q form.

    Parabolas touch both penalties; `twofold` is linearised: it is its slope times the form.
    """
    (uu, uv, vv), (p, q, r) = form, metric
    size, twofold = _measures(form, metric, all_known)
    epsilon *= CREASE
    one = weight * ANGLE**4 / max(size, epsilon)
    out[0, i, j], out[1, i, j], out[2, i, j] = one * p * p, one * 2 * p * q, one * q * q
    out[3, i, j], out[4, i, j], out[5, i, j] = one * 2 * (p * r + q * q), one * 2 * q * r, one * r * r
    if all_known:
        softened = size * size + SLIGHT * SLIGHT
        raised_u, raised_m, raised_l = p * uu + q * uv, p * uv + q * vv, q * uv + r * vv
        cross = q * uu + r * uv
        falls = ANGLE**4 * twofold / softened
        rises = ANGLE**4 * (p * r - q * q) / np.sqrt(softened)
        a = rises * vv - falls * (raised_u * p + raised_m * q)
        b = -2 * rises * uv - 2 * falls * (raised_u * q + raised_m * r)
        c = rises * uu - falls * (cross * q + raised_l * r)
        # The form times the slope is `twofold` by this factor, 1 to 2.
        two = weight * TWOFOLD / max(abs(twofold), epsilon) / (1 + SLIGHT * SLIGHT / softened)
        out[0, i, j] += two * a * a
        out[1, i, j] += two * a * b
        out[2, i, j] += two * a * c
        out[3, i, j] += two * b * b
        out[4, i, j] += two * b * c
        out[5, i, j] += two * c * c
