"""A problem on a grid of its own or fewer pixels, and the way from one grid to the next.

A `Grid` keeps what the compiled energy needs of a `Problem` in padded arrays (see
`numerics.compiled`), such that a grid of half the rows and columns has the same form: block means,
and a metric in its own pixels. Maps of log-distance go down as means too; up by their own
gradient, which is right to the second order to the very rim and never reaches over a cut.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from endolab.depth.energy_kernels import (
    Penalties,
    Picture,
    Wall,
    differences,
    fill_xi,
    linearise,
    shading_table,
    sums,
)
from endolab.depth.fast_marching import March
from endolab.depth.normal_equations import Coefficients
from endolab.depth.problem import AT_LEAST, CURVATURE, EXACT, NONE, REGULARISERS, Problem
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.compiled import PAD, block_sums, halved, halved_links, inner, kernel, padded
from endolab.numerics.derivatives import links


@kernel
def _finer(v: FloatArray, link: Any, out: FloatArray) -> None:
    """Values of the pixels of every 2×2 block, from the block's value and gradient; out is not padded."""
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            i, j = PAD + row // 2, PAD + column // 2
            along_u, along_v = differences(v, link, i, j)
            out[row, column] = v[i, j] + (column % 2 - 0.5) / 2 * along_u + (row % 2 - 0.5) / 2 * along_v


@kernel
def _enters(v: FloatArray, metric: Any, active: Any, link: Any, out: Any) -> None:
    """Mark the pixels that a march down to v enters over the mask's border; out is not padded.

    What lies behind a cut is not taken from a coarser grid, whose blocks mix both sides of it.
    """
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            i, j = PAD + row, PAD + column
            u, w = differences(v, link, i, j)
            up = metric[0, i, j] * u + metric[1, i, j] * w
            wp = metric[1, i, j] * u + metric[2, i, j] * w
            from_sides = (up < 0 and not active[i, j + 1]) or (up > 0 and not active[i, j - 1])
            from_ends = (wp < 0 and not active[i + 1, j]) or (wp > 0 and not active[i - 1, j])
            out[row, column] = active[i, j] and (from_sides or from_ends)


@dataclass(frozen=True)
class Grid:
    """A problem on a grid; arrays are padded unless said otherwise."""

    problem: Problem
    image: FloatArray  # stored values
    log_scale: FloatArray  # logarithm of the image of a facing surface at one unit of distance
    metric: FloatArray  # (3, ...): uu, uv, vv of G⁻¹, in this grid's pixels squared
    factor: FloatArray  # ξ/ξ̃ is this times e^±v
    edge: FloatArray  # edge weight g
    active: Any  # the mask, int8
    link: Any  # (2, ...) int8: steps that derivatives take, see `numerics.derivatives.links`
    evidence: Any  # see `Problem`, int8; (0, 0) for exact pixels
    rays: FloatArray  # (3, ...), of which second differences make planes free; (3, 0, 0) where none does
    inflow: FloatArray  # (H, W), not padded: log d where it is given and no unknown, else nan
    cuts: BoolArray | None  # (2, H, W), not padded: see `Problem`
    scale: float  # what a derivative of ξ per pixel of this grid is multiplied by
    table: FloatArray  # of `energy_kernels.shading_table`, as is the step
    step: float

    @classmethod
    def of(cls, problem: Problem, inflow: FloatArray | None = None) -> Grid:
        """Grid of a problem's own pixels."""
        mask, field = problem.mask, problem.field
        cos_alpha = np.where(mask, field.cos_alpha, 1.0)
        return cls(
            problem,
            padded(np.where(mask, problem.image, 0.0)),
            padded(np.log(problem.photometry.shade(0.0, 0.0, cos_alpha)[0])),
            padded(np.where(mask, np.moveaxis(field.inverse_metric, -1, 0), 0.0)),
            padded((1 / cos_alpha if problem.xi == "1/z" else np.ones(mask.shape)) / problem.xi_median),
            padded(problem.edge_weight),
            padded(mask.astype(np.int8)),
            padded(links(mask, problem.cuts).astype(np.int8)),
            np.empty((0, 0), np.int8) if problem.evidence is None else padded(problem.evidence),
            padded(np.where(mask, np.moveaxis(field.rays, -1, 0), 0.0))
            if problem.regulariser == "curvature"
            else np.empty((3, 0, 0)),
            np.full(mask.shape, np.nan) if inflow is None else np.where(mask, inflow, np.nan),
            problem.cuts,
            problem.derivative_scale,
            *shading_table(problem.photometry),
        )

    def coarser(self) -> Grid:
        """Grid of half the rows and columns."""
        given = padded(np.isfinite(self.inflow).astype(np.int8))
        inflow = inner(_block_means(padded(np.nan_to_num(self.inflow)), given))
        active, link = halved(self.active), halved_links(self.link)
        torn = links(inner(active) > 0) & (inner(link) == 0)
        image, evidence = self._coarser_evidence()
        return replace(
            self,
            image=image,
            log_scale=self.restrict(self.log_scale),
            metric=np.stack([self.restrict(one) for one in self.metric]) / 4,
            factor=self.restrict(self.factor),
            edge=self.restrict(self.edge),
            active=active,
            link=link,
            evidence=evidence,
            # A plane's 1/d is linear in the ray, so that block means of both stay a plane.
            rays=np.stack([self.restrict(one) for one in self.rays]) if self.rays.size else self.rays,
            inflow=np.where(inner(halved(given)) > 0, inflow, np.nan),
            cuts=None if self.cuts is None else torn,
            scale=self.scale / (2 if self.problem.regulariser == "first" else 4),
        )

    def _coarser_evidence(self) -> tuple[FloatArray, Any]:
        """Image and evidence on half the pixels.

        A block has the mean of its pixels that say something and says nothing only if they all do;
        it is a lower bound if more than half of those that speak are.
        """
        image = self.restrict(self.image)
        if self.evidence.size == 0:
            return image, self.evidence
        speaks = self.active * (self.evidence != NONE)
        count, bounds = block_sums(speaks), block_sums(speaks * (self.evidence == AT_LEAST))
        evidence = np.where(count == 0, NONE, np.where(2 * bounds > count, AT_LEAST, EXACT))
        return np.where(count > 0, _block_means(self.image, speaks), image), evidence.astype(np.int8)

    def restrict(self, a: FloatArray) -> FloatArray:
        """Mean of a map over the active pixels of each 2×2 block."""
        return _block_means(a, self.active)

    def finer(self, v: FloatArray, fine: Grid) -> FloatArray:
        """A map of this grid on the finer one that it came from."""
        out = np.empty(fine.mask.shape)
        _finer(v, self.link, out)
        return padded(np.where(fine.mask, out, 0.0))

    @property
    def mask(self) -> BoolArray:
        """Pixels that take part, (H, W)."""
        return inner(self.active) > 0

    @property
    def _kind(self) -> int:
        return REGULARISERS.index(self.problem.regulariser)

    def march(self, guess: FloatArray | None = None) -> FloatArray:
        """Fast march on this grid.

        Values are taken from the guess where the march enters the picture and where the picture is
        not exact, and from `inflow` where that is given.
        """
        mask, gamma = self.mask, self.problem.photometry.gamma
        dark = np.log(np.where(mask, inner(self.image), 1.0))
        log_facing = np.where(mask, 0.5 * gamma * (inner(self.log_scale) - dark), 0.0)
        inflow = self.inflow
        if guess is not None:
            enters = np.empty(mask.shape, dtype=np.bool_)
            _enters(guess, self.metric, self.active, self.link, enters)
            # The facing distance is an upper bound; a guess beyond it would explain nothing.
            bounded = np.minimum(inner(guess), log_facing)
            if self.evidence.size:
                said = inner(self.evidence)
                enters |= mask & (said != EXACT)
                bounded = np.where(said == NONE, inner(guess), bounded)
            inflow = np.where(np.isnan(inflow) & enters, bounded, inflow)
        metric = np.moveaxis(inner(self.metric), 0, -1)
        table = self.problem.photometry.slant_table()
        march = March.seeded(log_facing, mask, metric, table, inflow, self.cuts)
        march.advance(mask.size)
        return padded(np.where(mask, march.log_distance, 0.0))

    def _xi(self, v: FloatArray) -> FloatArray:
        xi = np.empty_like(v)
        fill_xi(v, self.factor, self.active, 1.0 if self.problem.xi == "d" else -1.0, xi)
        return xi

    def _energy(self) -> tuple[Picture, Wall, Penalties]:
        """What the compiled energy takes beside the map."""
        p = self.problem
        arrays = (self.image, self.log_scale, self.metric, self.edge, self.active, self.link, self.evidence)
        wall = Wall(p.photometry.gamma, self.table, self.step)
        return Picture(*arrays, self.rays), wall, Penalties(p.threshold, p.epsilon, self.scale, self._kind)

    def terms(self, v: FloatArray, lam: float) -> dict[str, float]:
        """The energy's terms, as `energy_terms` gives them, of the map v."""
        data, rough = sums(v, self._xi(v), *self._energy())
        count = int(self.active.sum())
        return {"data": data / count, "regulariser": lam * rough / count}

    def linearised(self, v: FloatArray, lam: float) -> tuple[Coefficients, FloatArray]:
        """Normal equations of a Gauss-Newton step, as of the sum over pixels: matrix, right-hand side."""
        xi = self._xi(v)
        by_v, by_v_u, by_v_v, weight, descent, smooth = np.zeros((6, *v.shape))
        smoothness = np.zeros((6 if self._kind == CURVATURE else 1, *v.shape))
        out = (by_v, by_v_u, by_v_v, weight, smoothness, descent, smooth)
        linearise(v, xi, *self._energy(), lam, out)
        slope = xi if self.problem.xi == "d" else -xi
        free = self.active * padded(np.isnan(self.inflow).astype(np.int8))
        fields = (by_v, by_v_u, by_v_v, weight, slope, smoothness, self.link, free)
        return Coefficients(*fields, self.rays, self._kind), (descent - slope * smooth) * free


def _block_means(a: FloatArray, inside: Any) -> FloatArray:
    return block_sums(a * inside) / np.maximum(block_sums(inside), 1)
