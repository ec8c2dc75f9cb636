"""A problem on a grid of its own or fewer pixels, and the way from one grid to the next.

A `Grid` keeps what the compiled energy needs of a `Problem` in padded arrays (see `numerics.compiled`),
such that a grid of half the rows and columns has the same form:

    . . . . . . . .
    . . . . . . . .               . . . . . .
    . . a a b b . .   `coarser`   . . . . . .
    . . a a b b . .   -------->   . . A B . .
    . . c c d d . .   <--------   . . C D . .
    . . c c d d . .    `finer`    . . . . . .
    . . . . . . . .               . . . . . .
    . . . . . . . .

Maps go down as means of blocks. A slope per pixel is twice as large there, so that with s the unit of
derivatives of ξ the energy,

    Σ ρ(I_model(v, ∇vᵀ G⁻¹ ∇v) - I) + λ Σ g ‖s D ξ‖_ε,

takes G⁻¹/4, and s/2 for first or s/4 for second derivatives. Log-distances go up by their own gradient,
which is right to the second order to the very rim and never reaches over a cut.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from endolab.numerics.arrays import BoolArray, ByteArray, FloatArray
from endolab.numerics.compiled import (
    PAD,
    active_blocks,
    block_sums,
    inner,
    pad_maps,
)
from endolab.numerics.stencils import links, shift
from endolab.solvers.energy_kernels import (
    Penalties,
    Picture,
    Wall,
    fill_slopes,
    fill_xi,
    linearise,
    shading_table,
    sums,
)
from endolab.solvers.fast_marching import march
from endolab.solvers.interpolation import Structure
from endolab.solvers.normal_equations import (
    BY_V,
    PARTS,
    SLOPE,
    SLOPE_DAMPING_U,
    SLOPE_DAMPING_W,
    WEIGHT,
    Coefficients,
)
from endolab.solvers.problem import (
    EXACT,
    LOWER_BOUND,
    NONE,
    REGULARISERS,
    Problem,
)

# How far a surface may go where cuts leave islands, of log d above d₀, an upper bound; chosen by hand.
# A factor of two, more than noise and mottles ask for.
CEILING = 0.7


@dataclass(frozen=True, eq=False)
class Grid(Structure):
    """A problem on a grid; arrays are padded unless said otherwise."""

    problem: Problem
    image: FloatArray  # stored values
    # Logarithm of the image of a facing surface at one unit of distance
    log_scale: FloatArray
    metric: FloatArray  # (3, ...): uu, uv, vv of G⁻¹, in this grid's pixels squared
    factor: FloatArray  # ξ/ξ̃ is this times e^±v
    edge: FloatArray  # edge weight g
    evidence: ByteArray  # see `Problem`; (0, 0) for exact pixels
    # (H, W), not padded: log d where it is given and no unknown, else nan
    inflow: FloatArray
    scale: float  # what a derivative of ξ per pixel of this grid is multiplied by
    table: FloatArray  # of `energy_kernels.shading_table`, as is the step
    step: float

    @classmethod
    def of(cls, problem: Problem, inflow: FloatArray | None = None) -> Grid:
        """Grid of a problem's own pixels."""
        mask = problem.mask
        uncut_links = pad_maps(links(mask).astype(np.int8))
        is_cut = problem.cuts is not None and bool((problem.cuts & links(mask)).any())
        return cls(
            pad_maps(mask.astype(np.int8)),
            pad_maps(links(mask, problem.cuts).astype(np.int8)) if is_cut else uncut_links,
            uncut_links,
            REGULARISERS.index(problem.regulariser),
            metric=pad_maps(
                np.where(mask, np.moveaxis(problem.field.inverse_metric, -1, 0), 0.0)
            ),
            edge=pad_maps(problem.edge_weight),
            evidence=np.empty((0, 0), np.int8)
            if problem.evidence is None
            else pad_maps(problem.evidence),
            inflow=np.full(mask.shape, np.nan)
            if inflow is None
            else np.where(mask, inflow, np.nan),
            scale=problem.derivative_scale,
            **_light_of(problem),
        )

    def coarser_under(self, problem: Problem) -> Grid:
        """The coarser grid for a problem that differs by its light and penalties alone; edges stay."""
        maps = _light_of(problem)
        maps["image"], _ = replace(self, **maps)._coarser_evidence()
        for name in ("log_scale", "factor"):
            maps[name] = self.restrict(maps[name])
        return replace(self.coarser, **maps)

    def coarser_maps(self) -> dict[str, Any]:
        """Those of half the rows and columns."""
        given = pad_maps(np.isfinite(self.inflow).astype(np.int8))
        inflow = inner(_block_means(pad_maps(np.nan_to_num(self.inflow)), given))
        image, evidence = self._coarser_evidence()
        return {
            "image": image,
            "log_scale": self.restrict(self.log_scale),
            "metric": np.stack([self.restrict(part) for part in self.metric]) / 4,
            "factor": self.restrict(self.factor),
            "edge": self.restrict(self.edge),
            "evidence": evidence,
            "inflow": np.where(inner(active_blocks(given)) > 0, inflow, np.nan),
            "scale": self.scale / (2 if self.problem.regulariser == "first" else 4),
        }

    def _coarser_evidence(self) -> tuple[FloatArray, ByteArray]:
        """Image and evidence on half the pixels.

        A block has the mean of its pixels that say something and says nothing only if they all do;
        it is a lower bound if more than half of those that speak are.
        """
        image = self.restrict(self.image)
        if self.evidence.size == 0:
            return image, self.evidence
        speaks = self.main * (self.evidence != NONE)
        count = block_sums(speaks)
        bounds = block_sums(speaks * (self.evidence == LOWER_BOUND))
        evidence = np.where(
            count == 0, NONE, np.where(2 * bounds > count, LOWER_BOUND, EXACT)
        )
        return np.where(
            count > 0, _block_means(self.image, speaks), image
        ), evidence.astype(np.int8)

    def restrict(self, a: FloatArray) -> FloatArray:
        """Mean of a map over the active pixels for which each 2×2 block stands."""
        return _block_means(a, self.main)

    def interpolate(self, v: FloatArray) -> FloatArray:
        """A map of the coarser grid on this one."""
        interpolation = self.interpolation
        out = np.zeros(self.active.shape)
        interpolation.add(v, out)
        if self.is_cut:
            is_alone = np.diff(interpolation.start).reshape(out.shape) == 0
            i, j = np.nonzero((self.active > 0) & (interpolation.regular == 0) & is_alone)
            out[i, j] = v[PAD + (i - PAD) // 2, PAD + (j - PAD) // 2]
            left_out = (self.active > 0) & (self.main == 0)
            out[left_out] = np.minimum(out, pad_maps(self.log_d0))[left_out]
        given = pad_maps(np.nan_to_num(self.inflow))
        return np.where(pad_maps(np.isfinite(self.inflow)), given, out)

    @property
    def mask(self) -> BoolArray:
        """Pixels that take part, (H, W)."""
        return inner(self.active) > 0

    @property
    def cuts(self) -> BoolArray | None:
        """Steps that are cut, (2, H, W), see `Problem`."""
        return inner(self.link) < inner(self.uncut_links) if self.is_cut else None

    @cached_property
    def log_d0(self) -> FloatArray:
        """log d₀, (H, W), see `Problem`; 0 outside the mask."""
        dark = np.log(np.where(self.mask, inner(self.image), 1.0))
        gamma = self.problem.photometry.gamma
        return np.where(self.mask, 0.5 * gamma * (inner(self.log_scale) - dark), 0.0)

    @cached_property
    def ceiling(self) -> FloatArray:
        """What a map may not exceed, padded: d₀ and a little where cuts leave islands; (0, 0) if none are."""
        if not self.is_cut:
            return np.empty((0, 0))
        silent = inner(self.evidence) == NONE if self.evidence.size else ~self.mask
        return pad_maps(np.where(silent, np.inf, self.log_d0 + CEILING))

    def below_ceiling(self, v: FloatArray) -> FloatArray:
        """Return the map no higher than the ceiling."""
        return np.minimum(v, self.ceiling) if self.is_cut else v

    def inflow_pixels(self, v: FloatArray) -> BoolArray:
        """Pixels, (H, W), that a march down to the map v enters over the mask's border or a cut."""
        slopes = np.zeros((3, *v.shape))
        fill_slopes(slopes, v, self.metric, self.link)
        enters = np.zeros(v.shape, np.bool_)
        cut = self.link < self.uncut_links
        for axis in range(2):
            slope = slopes[axis]
            ahead = (shift(self.active, 1, 1 - axis, 0) == 0) | cut[axis]
            behind = shift(self.active, -1, 1 - axis, 0) == 0
            behind |= shift(cut[axis], -1, 1 - axis, False)
            enters |= ((slope < 0) & ahead) | ((slope > 0) & behind)
        return inner(enters) & self.mask

    def march(self, guess: FloatArray | None = None) -> FloatArray:
        """Fast march on this grid.

        Values are taken from the guess where the march enters the picture and where the picture is
        not exact, and from `inflow` where that is given.
        """
        mask = self.mask
        log_d0 = self.log_d0
        inflow = self.inflow
        if guess is not None:
            enters = self.inflow_pixels(guess)
            # The facing distance is an upper bound; a guess beyond it would explain nothing.
            bounded = np.minimum(inner(guess), log_d0)
            if self.evidence.size:
                evidence = inner(self.evidence)
                enters |= mask & (evidence != EXACT)
                bounded = np.where(evidence == NONE, inner(guess), bounded)
            inflow = np.where(np.isnan(inflow) & enters, bounded, inflow)
        metric = np.moveaxis(inner(self.metric), 0, -1)
        table = self.problem.photometry.slant_table()
        v, _ = march(log_d0, mask, metric, table, inflow, self.cuts)
        return pad_maps(np.where(mask, v, 0.0))

    @cached_property
    def _workspace(self) -> FloatArray:
        """Memory for ξ and two maps of `equations_at`: fresh pages take longer than what is written there."""
        return np.empty((3, *self.image.shape))

    def _xi(self, v: FloatArray) -> FloatArray:
        """ξ/ξ̃, until the next call."""
        xi = self._workspace[0]
        fill_xi(v, self.factor, self.active, 1.0 if self.problem.xi == "d" else -1.0, xi)
        return xi

    def _energy(self, lam: float) -> tuple[Picture, Wall, Penalties]:
        """What the compiled energy takes beside the map."""
        p = self.problem
        picture = Picture(
            self.image,
            self.log_scale,
            self.metric,
            self.edge,
            self.active,
            self.link,
            self.evidence,
        )
        wall = Wall(p.photometry.gamma, self.table, self.step)
        penalties = Penalties(
            lam,
            p.threshold,
            p.epsilon,
            self.scale,
            self.kind,
        )
        return picture, wall, penalties

    def terms(self, v: FloatArray, lam: float) -> dict[str, float]:
        """The energy's terms, as `energy_terms` gives them, of the map v."""
        data, rough = sums(v, self._xi(v), *self._energy(lam))
        return {"data": data / self.count, "regulariser": lam * rough / self.count}

    @cached_property
    def count(self) -> int:
        """How many pixels take part."""
        return int(self.active.sum())

    def slants(self, v: FloatArray) -> FloatArray:
        """tan² of a map's slope, padded."""
        out = np.zeros((1, *v.shape))  # three maps of fresh memory take ten times as long
        fill_slopes(out, v, self.metric, self.link)
        return out[0]

    def structure(self, free: ByteArray, old: Structure | None = None) -> Structure:
        """That of equations for pixels that are free: the old one, if it is of the same."""
        if old is not None and old.link is self.link and np.array_equal(old.active, free):
            return old
        return Structure(free, self.link, self.uncut_links, self.kind)

    def equations_at(
        self,
        v: FloatArray,
        lam: float,
        slants: FloatArray | None = None,
        old: Coefficients | None = None,
    ) -> tuple[Coefficients, FloatArray]:
        """Normal equations of a Gauss-Newton step, as of the sum over pixels: matrix, right-hand side.

        The model is far from linear in the slope of v where the wall faces the camera. A step whose own slope
        has tan² = S darkens it by ½ |∂²M| S beside what is linear; half the square of that, as it would be
        for `slants`, those of a likely step, is added: see `descent`. Pixels near the ceiling that
        are drawn beyond it are held. The memory of `old` is used; it is spoilt, as is the right-hand side by
        the next call.
        """
        parts = np.zeros((PARTS, *v.shape)) if old is None else old.parts
        xi, (_, descent, smooth) = self._xi(v), self._workspace
        sign = 1.0 if self.problem.xi == "d" else -1.0
        linearise(descent, smooth, parts, v, xi, *self._energy(lam))
        np.multiply(xi, sign, out=parts[SLOPE])
        smooth *= parts[SLOPE]
        free = self.free
        if self.is_cut:
            free = free * ~((v > self.ceiling - 0.008) & (descent > smooth))
        descent -= smooth
        descent *= free
        if slants is None:
            parts[SLOPE_DAMPING_U : SLOPE_DAMPING_W + 1] = 0.0
        else:
            # ∂²M by the slope, as of a Lambertian wall that faces.
            bend = self.slants(v)
            bend += 1
            bend *= 2
            np.divide(parts[BY_V], bend, out=bend)
            cost = 0.5 * parts[WEIGHT]
            cost *= bend
            cost *= bend
            cost *= slants
            np.multiply(cost, self.metric[0], out=parts[SLOPE_DAMPING_U])
            np.multiply(cost, self.metric[2], out=parts[SLOPE_DAMPING_W])
        return Coefficients(
            parts, self.structure(free, None if old is None else old.structure)
        ), descent

    @cached_property
    def free(self) -> ByteArray:
        """Pixels that are unknown, int8."""
        return self.active * pad_maps(np.isnan(self.inflow).astype(np.int8))


def _light_of(problem: Problem) -> dict[str, Any]:
    """What of a problem's grid follows from its light."""
    mask = problem.mask
    cos_alpha = np.where(mask, problem.field.cos_alpha, 1.0)
    light = problem.photometry
    facing = light.brightness(0.0, 0.0, light.attenuation(cos_alpha))
    xi = 1 / cos_alpha if problem.xi == "1/z" else np.ones(mask.shape)
    table, step = shading_table(light)
    return {
        "problem": problem,
        "image": pad_maps(np.where(mask, problem.image, 0.0)),
        "log_scale": pad_maps(np.log(facing)),
        "factor": pad_maps(xi / problem.xi_median),
        "table": table,
        "step": step,
    }


def _block_means(a: FloatArray, inside: ByteArray) -> FloatArray:
    return block_sums(a * inside) / np.maximum(block_sums(inside), 1)
