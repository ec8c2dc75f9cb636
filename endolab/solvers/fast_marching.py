"""One pass from the nearest points outwards: the viscosity solution by fast marching.

With y = d² and y₀ = d₀² = 1/I_c the simplified model I_c = cos θ / d² becomes

    ∇yᵀ G⁻¹ ∇y = 4 (y₀² - y²),

an eikonal equation whose discrete form is a quadratic: no logarithm, no iteration. Its
viscosity solution (Prados and Faugeras, "Shape from shading: a well-posed problem?", CVPR
2005) grows from the local minima of y₀, where the surface faces the camera. A pixel is
updated from the triangles that it makes with two accepted neighbours,

    p = ∇y from the differences along both,   -G⁻¹ p inside the triangle (upwind),

or, if none is upwind, along one neighbour. Differences are of second order where the next
pixel out is accepted and lower, else of first. Other BRDFs change the right-hand side to
4 y² P(y/y₀), P = tan²θ read off a table, and the quadratic to a bracketed root.

Where the march enters the picture from its border, or from behind an occluding contour, the
true value is not in the picture: `inflow` gives it where it is known. Over a contour the surface
is cut, so that a march across it is wrong on the far side: a problem's `cuts` forbid it, and the
far side starts from its own local minima of y₀.
"""

from __future__ import annotations

from heapq import heapify, heappop, heappush

import numpy as np
from numpy.typing import NDArray

from endolab.numerics.arrays import BoolArray, FloatArray, IntArray
from endolab.numerics.compiled import kernel
from endolab.numerics.stencils import links, shift

# Neighbours in turn around a pixel (row, column): consecutive ones make the eight triangles.
_NEIGHBOURS = np.array(
    [(0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1)]
)

BitArray = NDArray[np.uint8]
Offset = tuple[int, int]  # column, row
# s, t of the difference s y + t of the unknown y at a pixel to a neighbour.
Difference = tuple[float, float]
Terms = tuple[float, float, float]  # a, b, c of a y² + 2 b y + c
# Log c and log(1 + P), both empty for a Lambertian surface.
Table = tuple[FloatArray, FloatArray]


@kernel
def _excess(y: float, terms: Terms, y0: float, table: Table) -> float:
    """a y² + 2 b y + c - 4 y² P(y/y0), P interpolated in logarithms."""
    (a, b, c), (log_c, log_p) = terms, table
    x = np.log(y / y0)
    i = min(max(int(np.searchsorted(log_c, x)), 1), log_c.size - 1)
    between = min(max((x - log_c[i - 1]) / (log_c[i] - log_c[i - 1]), 0.0), 1.0)
    p = np.exp(log_p[i - 1] + between * (log_p[i] - log_p[i - 1])) - 1
    return a * y * y + 2 * b * y + c - 4 * y * y * p


@kernel
def _root(terms: Terms, low: float, y0: float, table: Table) -> float:
    """Largest y in [low, y0] with a y² + 2 b y + c = 4 y² P(y/y0); nan if there is none."""
    if table[0].size == 0:  # Lambertian: 4 y² P = 4 (y0² - y²)
        a, b, c = terms
        discriminant = b * b - (a + 4) * (c - 4 * y0 * y0)
        y = (np.sqrt(discriminant) - b) / (a + 4) if discriminant >= 0 else np.nan
        return y if low <= y <= y0 else np.nan
    left = low
    right = y0
    at_left = _excess(left, terms, y0, table)
    at_right = _excess(right, terms, y0, table)
    if at_left > 0 or at_right < 0:
        return np.nan
    for _ in range(100):  # regula falsi, the stale end's value halved (Illinois)
        y = (
            (left * at_right - right * at_left) / (at_right - at_left)
            if at_right > at_left
            else left
        )
        excess = _excess(y, terms, y0, table)
        if abs(excess) <= 1e-14 * y0 * y0 or right - left <= 1e-14 * y0:
            return y
        if excess < 0:
            left = y
            at_left = excess
            at_right = 0.5 * at_right
        else:
            right = y
            at_right = excess
            at_left = 0.5 * at_left
    return 0.5 * (left + right)


@kernel
def _difference(
    value: FloatArray,
    order: IntArray,
    reachable: BitArray,
    neighbour: int,
    k: int,
    width: int,
) -> tuple[Difference, float]:
    """Difference of a pixel to its accepted k-th neighbour, and that one's value.

    First order: neighbour - y. Second order: 2 neighbour - next/2 - 3y/2, if the next pixel out
    can be stepped to, is accepted and lower.
    """
    if reachable[neighbour] >> k & 1:
        far = neighbour + _NEIGHBOURS[k, 0] * width + _NEIGHBOURS[k, 1]
        if order[far] >= 0 and value[far] <= value[neighbour]:
            return (-1.5, 2 * value[neighbour] - 0.5 * value[far]), value[neighbour]
    return (-1.0, value[neighbour]), value[neighbour]


@kernel
def _along_edge(
    along: Difference, low: float, nearness: float, y0: float, table: Table
) -> float:
    """Value at a pixel if ∇y pointed along one neighbour, 1/`nearness` being its squared length."""
    s, t = along
    return _root((s * s * nearness, s * t * nearness, t * t * nearness), low, y0, table)


@kernel
def _across_triangle(
    a: Offset,
    b: Offset,
    along_a: Difference,
    along_b: Difference,
    low: float,
    g: tuple[float, float, float],
    y0: float,
    table: Table,
) -> float:
    """Value at a pixel from two neighbours at offsets a, b (column, row); nan if not upwind."""
    (sa, ta), (sb, tb) = along_a, along_b
    turn = a[0] * b[1] - a[1] * b[0]  # ±1 for neighbouring neighbours, so its own inverse
    # p·a = sa y + ta, p·b = sb y + tb  =>  p = α y + β
    alpha_u = (b[1] * sa - a[1] * sb) * turn
    alpha_v = (a[0] * sb - b[0] * sa) * turn
    beta_u = (b[1] * ta - a[1] * tb) * turn
    beta_v = (a[0] * tb - b[0] * ta) * turn
    raised_u = g[0] * alpha_u + g[1] * alpha_v
    raised_v = g[1] * alpha_u + g[2] * alpha_v
    constant = g[0] * beta_u * beta_u + 2 * g[1] * beta_u * beta_v + g[2] * beta_v * beta_v
    terms = (
        raised_u * alpha_u + raised_v * alpha_v,
        raised_u * beta_u + raised_v * beta_v,
        constant,
    )
    y = _root(terms, low, y0, table)
    p_u = alpha_u * y + beta_u
    p_v = alpha_v * y + beta_v
    down_u = -(g[0] * p_u + g[1] * p_v)
    down_v = -(g[1] * p_u + g[2] * p_v)
    weight_a = (down_u * b[1] - down_v * b[0]) * turn
    weight_b = (a[0] * down_v - a[1] * down_u) * turn
    slack = -1e-9 * (abs(weight_a) + abs(weight_b))
    return y if weight_a >= slack and weight_b >= slack else np.nan


@kernel
def _advance(
    value: FloatArray,
    order: IntArray,
    fixed: BoolArray,
    reachable: BitArray,
    y0: FloatArray,
    metric: FloatArray,
    table: Table,
) -> None:
    """March on from the pixels whose value is finite; write the others', and the order in which all came."""
    width = y0.shape[1]
    upper = y0.ravel()
    inverse_metric = metric.reshape(-1, 3)
    heap = [(value[seed], seed) for seed in np.flatnonzero(np.isfinite(value))]
    heapify(heap)
    count = 0
    while heap:
        accepted = heappop(heap)[1]
        if order[accepted] >= 0:  # since then it came by a shorter way
            continue
        order[accepted] = count
        count += 1
        seen = reachable[accepted]
        for k in range(8):
            if not seen >> (k + 4 & 7) & 1:
                continue
            pixel = accepted - _NEIGHBOURS[k, 0] * width - _NEIGHBOURS[k, 1]
            if pixel < 0:  # never; but, told so, the loop needs no indices from the end
                continue
            limit = upper[pixel]
            if order[pixel] >= 0 or fixed[pixel] or value[accepted] >= limit:
                continue
            guu = inverse_metric[pixel, 0]
            guv = inverse_metric[pixel, 1]
            gvv = inverse_metric[pixel, 2]
            g = (guu, guv, gvv)
            a = (_NEIGHBOURS[k, 1], _NEIGHBOURS[k, 0])
            along_a, ya = _difference(value, order, reachable, accepted, k, width)
            nearness = (guu * gvv - guv * guv) / (
                gvv * a[0] * a[0] - 2 * guv * a[0] * a[1] + guu * a[1] * a[1]
            )
            least = value[pixel]
            y = _along_edge(along_a, ya, nearness, limit, table)
            if np.isnan(y):
                y = _along_edge((-1.0, ya), ya, nearness, limit, table)
            if y < least:
                least = y
            for side in (1, 7):
                # All three sides of the triangle: y is interpolated along the third too.
                j = k + side & 7
                third = k + side * (2 + (k & 1)) & 7
                if not reachable[pixel] >> j & seen >> third & 1:
                    continue
                other = pixel + _NEIGHBOURS[j, 0] * width + _NEIGHBOURS[j, 1]
                if order[other] < 0:
                    continue
                b = (_NEIGHBOURS[j, 1], _NEIGHBOURS[j, 0])
                along_b, yb = _difference(value, order, reachable, other, j, width)
                low = max(ya, yb)
                y = _across_triangle(a, b, along_a, along_b, low, g, limit, table)
                if np.isnan(y):
                    y = _across_triangle(a, b, (-1.0, ya), (-1.0, yb), low, g, limit, table)
                if y < least:
                    least = y
            if least < value[pixel]:
                value[pixel] = least
                heappush(heap, (least, pixel))


def _reachable_neighbours(mask: BoolArray, cuts: BoolArray | None) -> BitArray:
    """Bit k of a pixel, (H, W) uint8: whether it and its k-th neighbour (`_NEIGHBOURS`) may see each other.

    A diagonal step cuts the corner of two steps: where there are cuts, one of the two ways around
    must be there. A contour of cuts that passes the point where four pixels meet sets them apart,
    and a diagonal from one part to another meets it on both ways around: no contour leaks, straight
    or staircase. Diagonals within a part, and around the end of a contour, stay open. Holes of the
    mask alone set nothing apart: behind a highlight the surface goes on.
    """
    right, lower = links(mask, cuts)
    left = shift(right, -1, 1, False)
    upper = shift(lower, -1, 0, False)
    beside = (shift(mask, 1, 1, False), shift(mask, -1, 1, False))
    to_right, to_left = (mask & shift(side, 1, 0, False) for side in beside)
    if cuts is not None:
        near_cut = (
            cuts[0] | shift(cuts[0], 1, 0, False) | cuts[1] | shift(cuts[1], 1, 1, False)
        )
        around = right & shift(lower, 1, 1, False) | lower & shift(right, 1, 0, False)
        to_right &= around | ~near_cut
        around = left & shift(lower, -1, 1, False) | lower & shift(left, 1, 0, False)
        to_left &= around | ~shift(near_cut, -1, 1, False)
    from_right = shift(to_right, -1, 0, False)
    from_left = shift(to_left, -1, 0, False)
    up_left = shift(from_right, -1, 1, False)
    up_right = shift(from_left, 1, 1, False)
    turns = (right, to_right, lower, to_left, left, up_left, upper, up_right)
    return np.packbits(np.stack(turns), axis=0, bitorder="little")[0]


def _is_lowest_around(y0: FloatArray, mask: BoolArray, reachable: BitArray) -> BoolArray:
    """Where no neighbour that may be seen is lower."""
    padded = np.pad(y0, 1)
    height, width = y0.shape
    lowest = mask.copy()
    for k, (r, c) in enumerate(_NEIGHBOURS):
        lowest &= (y0 <= padded[1 + r : 1 + r + height, 1 + c : 1 + c + width]) | (
            reachable >> k & 1 == 0
        )
    return lowest


def march(
    log_d0: FloatArray,
    mask: BoolArray,
    metric: FloatArray,
    table: Table | None,
    inflow: FloatArray | None = None,
    cuts: BoolArray | None = None,
) -> tuple[FloatArray, IntArray]:
    """March from the local minima of d₀ and from the pixels whose value is given.

    `metric` is that of `RayField.inverse_metric`, `table` that of `Photometry.slant_table`. Returns
    v = log d, (H, W), and when each pixel was reached: 0, 1, 2, ...; d₀, an upper bound, and -1 elsewhere.
    """
    y0 = np.where(mask, np.exp(2 * log_d0), 1.0)
    reachable = _reachable_neighbours(mask, cuts)
    value = np.where(_is_lowest_around(y0, mask, reachable), y0, np.inf).ravel()
    fixed = np.zeros(value.shape, dtype=bool)
    if inflow is not None:
        fixed = (mask & ~np.isnan(inflow)).ravel()
        value[fixed] = np.exp(2 * inflow.ravel()[fixed])
    order = np.full(y0.shape, -1)
    table = table or (np.empty(0), np.empty(0))
    metric = np.ascontiguousarray(metric)
    _advance(value, order.ravel(), fixed, reachable.ravel(), y0, metric, table)
    return 0.5 * np.log(np.where(order >= 0, value.reshape(y0.shape), y0)), order
