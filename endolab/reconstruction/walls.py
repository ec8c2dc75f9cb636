r"""Light that has bounced: how much of what a wall shows came from other walls, not from the lamp.

In a colon it is a quarter of the green light and half of the red, more than any other error of the
model I_c = cos θ / d². Once a surface is known roughly, it follows: patches of the surface exchange
light (radiosity; Goral et al., "Modeling the interaction of light between diffuse surfaces",
SIGGRAPH 1984),

    S_i = Σ_j F_ij a (E_j + S_j),     F_ij = cos θ_ij cos θ_ji A_j / (π r_ij²)  where i sees j,

E being the irradiance straight from the lamp and S that of bounced light:

      drawn back  |  in the picture
    ======j=======|=======i=========.
           \      |      / \        |    lamp to i:  E_i
            `-----|-----'   \       |    j to i:     F_ij a (E_j + S_j), a term of S_i,
    - - - - - - - lamp ------'- - - |    unless a nearer wall stands between them
                  |                 |
    ==============|================='

Both fall with the square of the scene's size, so that the ratio ι = S/E asks for its shape only. A
picture divided by 1 + ι is one that the model explains: solve it, compute ι again; two rounds do.

The walls beside and behind the camera are not in the picture, but half of the bounced light comes
from them: the picture's rim is drawn back along the axis, as a colon goes on as it came. Behind folds,
too, there are walls: what a patch looks at where it sees no other is mostly one that the lamp does not
reach, and that is taken to get as much bounced light as the patch itself.

A picture fades by cos^k α whether the lamp shines so or the lens lets so much pass, but only the lamp's
part of k lights the walls (`Walls.under`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import ArrayLike

from endolab.model.cameras import RayField
from endolab.model.surface import normals_from_gradient, slant
from endolab.numerics.arrays import BoolArray, FloatArray, IntArray, Span
from endolab.numerics.resampling import resample
from endolab.numerics.stencils import gradient
from endolab.numerics.threads import on_cores
from endolab.reconstruction import constants

GRAZING = 1e-3  # cos α below which a lamp's light no longer falls


@on_cores(cost=9)
def _fill_exchange(
    rows: Span,
    factors: FloatArray,
    x: FloatArray,
    n: FloatArray,
    area: FloatArray,
    cell: IntArray,
    limit: FloatArray,
) -> None:
    """F between patches at x, (3, N), with normals n, (3, N), into `factors`, zero, (N, N).

    `cell` (2, N) is where they lie on the grid of `limit`, the inverse of how far a chord reaches before a
    wall blocks it.
    """
    count = len(area)
    x0, x1, x2 = x
    n0, n1, n2 = n
    down_at, across_at = cell
    inverse = 1 / np.sqrt(x0**2 + x1**2 + x2**2)
    facing = np.empty(count)
    for turn in range(rows[0], rows[1]):
        # Row i has i pairs: one from either end in turn.
        i = count - 1 - turn // 2 if turn % 2 else turn // 2
        a0 = x0[i]
        a1 = x1[i]
        a2 = x2[i]
        m0 = n0[i]
        m1 = n1[i]
        m2 = n2[i]
        own = area[i]
        for j in range(i):
            d0 = x0[j] - a0
            d1 = x1[j] - a1
            d2 = x2[j] - a2
            square = d0 * d0 + d1 * d1 + d2 * d2
            here = m0 * d0 + m1 * d1 + m2 * d2
            there = -(n0[j] * d0 + n1[j] * d1 + n2[j] * d2)
            # A patch is no point: half of each area bounds the part that its neighbour gets.
            both = here * there / (square * (np.pi * square + 0.5 * (own + area[j])))
            facing[j] = both if min(here, there) > 0.0 else 0.0
        row = down_at[i]
        column = across_at[i]
        nearness = inverse[i]
        for j in range(i):
            if facing[j] > 0.0:
                down = down_at[j] - row
                across = across_at[j] - column
                change = inverse[j] - nearness
                cells = max(abs(down), abs(across))
                k = 1
                # In a picture 1/distance is nearly linear along a straight chord.
                while k < cells:
                    part = k / cells  # of the chord
                    i_at = int(row + part * down + 0.5)
                    j_at = int(column + part * across + 0.5)
                    if nearness + part * change < limit[i_at, j_at]:
                        break
                    k += 1
                if k >= cells:
                    factors[i, j] = facing[j] * area[j]
                    factors[j, i] = facing[j] * own


def exchange_between(
    x: FloatArray, n: FloatArray, area: FloatArray, cell: IntArray, nearest: FloatArray
) -> FloatArray:
    """F between patches at x (mm) with normals n; `cell` is where they lie on the grid of `nearest` walls."""
    factors = np.zeros((len(x), len(x)))
    columns = [np.ascontiguousarray(a.T) for a in (x, n, cell.astype(np.int64))]
    limit = 1 / (constants.NEARER * nearest)
    _fill_exchange(factors, columns[0], columns[1], area, columns[2], limit)
    return factors


@dataclass(frozen=True, eq=False)
class Walls:
    """A surface as patches that exchange light: the picture's patches first, then the walls behind them."""

    points: FloatArray  # (N, 3), centres
    normals: FloatArray  # (N, 3), unit normals
    area: FloatArray  # (N,), in squares of the unit of distance
    lit: FloatArray  # (N,), E of the patches, for a lamp of unit intensity along the axis
    exchange: FloatArray  # (N, N), F: how much of what i receives is from j; rows sum to 1 at most
    seen: BoolArray  # (rows, columns), which cells of the picture's coarse grid are patches
    direct: FloatArray  # (H, W), E of every pixel, cosᵏ α cos θ / d²; 0 outside the mask
    cos_alpha: FloatArray  # (H, W), positive; 1 outside the mask
    k: float  # exponent of the lamp's spread

    @classmethod
    def of(
        cls,
        log_distance: FloatArray,
        mask: BoolArray,
        field: RayField,
        k: float,
        cuts: BoolArray | None = None,
        lamp_ratio: FloatArray | None = None,
    ) -> Walls:
        """Cut a depth map, v = log d in any unit, (H, W), into patches.

        k is the exponent of the lamp's spread; `cuts` (2, H, W) are links over which the
        surface is cut, and `lamp_ratio` is ω, (H, W), see `Problem`.
        """
        f_u, f_v = gradient(log_distance, mask, cuts)
        guu, guv, gvv = np.moveaxis(field.inverse_metric, -1, 0)
        with np.errstate(invalid="ignore", divide="ignore"):
            solid = 1 / np.sqrt(guu * gvv - guv**2)
        cosine = 1 / np.sqrt(1 + slant(f_u, f_v, field))
        distance = np.exp(log_distance)
        cos_alpha = np.where(mask, np.maximum(field.cos_alpha, GRAZING), 1.0)
        light = cos_alpha**k * (1.0 if lamp_ratio is None else lamp_ratio)
        area = solid * distance**2 / cosine

        # Twice as many patches change ι by a hundredth.
        step = max(1.0, np.sqrt(mask.sum() / 500))
        rows, columns = (max(1, round(length / step)) for length in mask.shape)
        layers = [
            mask,
            area,
            light * solid,
            (area * distance)[..., None] * field.rays,
            area[..., None] * normals_from_gradient(f_u, f_v, field),
        ]
        layered = np.where(mask[..., None], np.dstack(layers), 0.0)
        sums = _cell_sums(layered, (rows, columns))
        seen = sums[..., 0] > 0.5 * mask.size / (rows * columns)
        sums = sums[seen]
        area = sums[:, 1]
        points = sums[:, 3:6] / area[:, None]
        normals = sums[:, 6:] / np.linalg.norm(sums[:, 6:], axis=-1, keepdims=True)
        nearest = np.full(seen.shape, np.inf)
        nearest[seen] = np.linalg.norm(points, axis=-1)
        places = np.argwhere(seen)

        rim, ring_points, ring_normals, ring_area = _draw_back(points)
        # E = cos^k α cos θ / d², 0 behind the lamp
        far = np.linalg.norm(ring_points, axis=-1)
        forwards = np.maximum(ring_points[:, 2] / far, 0.0)
        facing = np.maximum(-np.sum(ring_points * ring_normals, axis=-1) / far, 0.0)
        ring_lit = np.where(forwards > 0, forwards**k, 0.0) * facing / far**2
        lit = np.append(sums[:, 2] / area, ring_lit)
        points = np.concatenate([points, ring_points])
        normals = np.concatenate([normals, ring_normals])
        area = np.append(area, ring_area)
        places = np.concatenate([places, places[rim]])
        exchange = exchange_between(points, normals, area, places, nearest)
        exchange /= np.maximum(exchange.sum(axis=1), 1.0)[:, None]
        direct = np.where(mask, light * cosine / distance**2, 0.0)
        return cls(points, normals, area, lit, exchange, seen, direct, cos_alpha, k)

    def under(self, k: float) -> Walls:
        """Return the same walls under a lamp of another spread."""
        more = k - self.k
        nearness = 1 / np.linalg.norm(self.points, axis=-1)
        fall = np.maximum(self.points[:, 2] * nearness, GRAZING) ** more
        direct = self.direct * self.cos_alpha**more
        return replace(self, lit=self.lit * fall, direct=direct, k=k)

    @property
    def count(self) -> int:
        """How many patches are in the picture."""
        return int(self.seen.sum())

    def averages(
        self, maps: FloatArray, usable: BoolArray, exponents: Iterable[float]
    ) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
        """Average maps (H, W, C), and the light under lamps of these exponents, over the usable pixels.

        Returns, of the P patches of the picture half of which is usable: means (P, C), E (L, P), `orders`
        (L, bounces, P) under each lamp, and which patches they are, (count,).
        """
        lit = [self.under(k) for k in exponents]
        layers = np.dstack([usable, maps, *(walls.direct for walls in lit)])
        layers = np.where(usable[..., None], layers, 0.0)
        sums = _cell_sums(layers, self.seen.shape)[self.seen]
        full = sums[:, 0] > 0.5 * self.direct.size / self.seen.size
        means = sums[full, 1:] / sums[full, :1]
        orders = self.orders_of([walls.lit for walls in lit])[..., : self.count]
        return means[:, : -len(lit)], means[:, -len(lit) :].T, orders[..., full], full

    @cached_property
    def orders(self) -> FloatArray:
        """What every patch receives after one bounce, two, ..., (bounces, N), of walls of albedo 1."""
        return np.asarray(self.orders_of([self.lit])[0])

    def orders_of(self, lit: Sequence[FloatArray]) -> FloatArray:
        """Return the same of several lamps' E, each (N,), (L, bounces, N)."""
        hidden = constants.HIDDEN * np.maximum(1 - self.exchange.sum(axis=1), 0.0)
        orders = [self.exchange @ np.stack(lit, axis=1)]
        for _ in range(15):  # those after them fall by a constant factor
            orders.append(self.exchange @ orders[-1] + hidden[:, None] * orders[-1])
        return np.moveaxis(np.stack(orders), -1, 0)

    def bounced_light(self, albedo: float) -> FloatArray:
        """S of every patch, (N,), for walls of one albedo."""
        return bounced_light_and_slope(self.orders, np.array([albedo]))[0][:, 0]

    def indirect_ratio(self, albedo: ArrayLike) -> FloatArray:
        """ι of pixels, (H, W), or (H, W, n) for n albedos: bounced over direct light; 0 off the mask."""
        light, _ = bounced_light_and_slope(self.orders, np.ravel(albedo).astype(float))
        coarse = np.zeros((*self.seen.shape, light.shape[1]))
        coarse[self.seen] = light[: self.count]
        # Light that has bounced is smooth: what patches make of it is blurred a little, and spread
        # to the cells that are no patches.
        known = self.seen.astype(np.float64)
        spread, weight = (cv2.GaussianBlur(a, (0, 0), 1.0) for a in (coarse, known))
        coarse = spread.reshape(coarse.shape) / np.maximum(weight, 1e-6)[..., None]
        lit = self.direct[..., None]
        ratio = resample(coarse, lit.shape[:2]) / np.where(lit > 0, lit, np.inf)
        return ratio if np.ndim(albedo) else ratio[..., 0]


def bounced_light_and_slope(
    orders: FloatArray, albedo: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """S of patches, (N, n), given their `Walls.orders` and the walls' albedos (n,).

    And its derivative by the albedo's logarithm. Albedos are below 1: so is what a bounce leaves of another.
    """
    number = np.arange(1, len(orders) + 1)[:, None]
    powers = albedo**number
    before, last = orders[-2:]
    left = np.minimum(last / np.where(before > 0, before, 1.0), 1.0)[:, None] * albedo
    tail = last[:, None] * powers[-1] * left / (1 - left)
    growth = len(orders) + 1 + left / (1 - left)
    return orders.T @ powers + tail, orders.T @ (number * powers) + tail * growth


def _cell_sums(maps: FloatArray, cells: tuple[int, ...]) -> FloatArray:
    """Sum maps (H, W, C) over (rows, columns) cells of one size; a pixel may be shared by several."""
    rows, columns = cells
    means = [
        cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA)
        for part in cv2.split(maps)
    ]
    return np.stack(means, axis=-1) * (maps.shape[0] / rows * maps.shape[1] / columns)


def _draw_back(points: FloatArray) -> tuple[np.ndarray, FloatArray, FloatArray, FloatArray]:
    """Draw the rim of the patches back along the axis, past the camera.

    Returns of each new patch the one from which it was drawn, (M,), its centre and normal, (M, 3), and its
    area, (M,).
    """
    across = np.hypot(points[:, 0], points[:, 1])
    outwards = np.argsort(np.arctan2(across, points[:, 2]))
    rim = np.full(20, -1)
    rim[sectors(points, rim.size)[outwards]] = outwards  # the last in each sector stays
    rim = rim[rim >= 0]
    start = points[rim]
    radius = np.maximum(across[rim], 1e-9)
    side = (np.roll(start, -1, axis=0) - np.roll(start, 1, axis=0))[:, :2] / 2
    length = np.linalg.norm(side, axis=-1)
    step = float(np.median(length))
    deep = np.median(start[:, 2]) + constants.BACK * np.median(radius)
    # A view of 5° to the side needs 100.
    rings = int(np.clip(np.ceil(deep / step), 0, 100)) if step > 0 else 0
    normal = np.column_stack([-start[:, :2] / radius[:, None], np.zeros(len(rim))])
    drawn = np.tile(start, (rings, 1))
    drawn[:, 2] -= np.repeat((np.arange(rings) + 0.5) * step, len(rim))
    area = np.tile(length * step, rings)
    return np.tile(rim, rings), drawn, np.tile(normal, (rings, 1)), area


def sectors(points: FloatArray, count: int) -> IntArray:
    """Number of the sector around the axis in which each of points (N, 3) lies."""
    turn = np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi)
    return np.floor(turn * count).astype(int) % count
