"""Robust least squares with many small blocks of unknowns: the solver of both calibrations.

The unknowns are a few *common* ones c (the camera, or k, γ and the BRDF) and, for each group g of
residuals (a view, or a frame), a few of its *own* o_g (its pose, or its gain). What is minimised is

    Σ ρ(|r| / σ) + ½ |prior(c)|² + ½ Σ o_gᵀ S o_g        over all measurements, S: `own_stiffness`

No two groups' own unknowns meet, so that the normal equations have the shape of an arrow:

    | A    C₁ᵀ  C₂ᵀ  … |   | δc  |       | a  |        A    `common`, with the priors
    | C₁   B₁          |   | δo₁ |       | b₁ |        B_g  `own`, small: of one group
    | C₂        B₂     | · | δo₂ |  =  - | b₂ |        C_g  `cross`
    | …             …  |   |  …  |       | …  |        a, b_g  the gradients

`Arrow` eliminates the own unknowns, group by group, solves for the common ones and goes back:

    (A - Σ C_gᵀ B_g⁻¹ C_g) δc = -(a - Σ C_gᵀ B_g⁻¹ b_g),      δo_g = -B_g⁻¹ (b_g + C_g δc)

Stages: "huber" brings the start near; "final" keeps the residuals below `outlier` standard deviations,
all alike, and forgets the others, because a Huber penalty is still pulled by outliers. Within a
round of a stage, the scale σ and the choice of residuals are frozen, so that what is minimised is
one function; rounds repeat until the choice no longer changes.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, Protocol

import numpy as np
import scipy

from endolab.numerics.arrays import BoolArray, FloatArray, IntArray, freeze
from endolab.numerics.iteration import Status, drive
from endolab.numerics.penalties import huber


@dataclass(frozen=True)
class RobustFit:
    """When a residual is an outlier, and when a fit has come to its end: both calibrations' rules."""

    huber: float = 1.5  # standard deviations where the parabola becomes a line
    outlier: float = 3.5  # standard deviations beyond which a residual is an outlier
    # A step is the last if it moves no unknown by more of its standard error than this; in the first
    # stage, which only has to come near, than that.
    tolerance: float = 1e-4
    rough_tolerance: float = 1.0
    max_iterations: int = 200
    max_rounds: int = 20  # of freezing σ and the outliers
    # σ is never less, be it of pixels or stored values: rounding would count.
    smallest_sigma: float = 1e-4
    # What the diagonal grows by, relatively, before it is inverted; an unknown whose variance is so many
    # times that which it would have alone is not told.
    ridge: float = 1e-13
    lost_inflation: float = 1e11
    rows_at_once: int = 256  # of a tall matrix, that are multiplied


ROBUST = RobustFit()


# The problem ----------------------------------------------------------------------------
@dataclass(frozen=True)
class Linearised:
    """Residuals and their derivatives: n measurements of m numbers (2 for pixels, 1 for grey levels)."""

    residual: FloatArray  # (n, m)
    by_common: FloatArray  # (n, m, p), derivatives by the common unknowns
    by_own: FloatArray  # (n, m, b), by the unknowns of the measurement's own group
    prior: FloatArray  # (q,), residuals of what is known beforehand, in standard deviations
    prior_by_common: FloatArray  # (q, p)
    # (groups, b), the own unknowns that are known to be near 0 ...
    own: FloatArray | float = 0.0
    # (b,), ... and the inverse of their variance, 0 of the others.
    own_stiffness: FloatArray | float = 0.0


class Model(Protocol):
    """What the solver asks of a calibration problem."""

    @property
    def group(self) -> IntArray:
        """Group of each measurement, (n,), in ascending order, without gaps from 0."""
        ...

    def linearise(self, unknowns: Any) -> Linearised:
        """Residuals and derivatives at the unknowns."""
        ...

    def take_step(self, unknowns: Any, common: FloatArray, own: FloatArray) -> Any:
        """Return the unknowns after a step, (p,) and (groups, b); None if it leads out of bounds."""
        ...

    def usable(self, unknowns: Any) -> BoolArray:
        """Which measurements can be believed at all, (n,): not saturated, in front of the camera."""
        ...


# Normal equations -----------------------------------------------------------------------
def _sums(values: FloatArray, group: IntArray) -> FloatArray:
    """Sum over the measurements of each group; the groups are in order, none is empty."""
    first = np.searchsorted(group, np.arange(group[-1] + 1))
    return np.add.reduceat(values, first, axis=0)


def product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return aᵀ b for two tall matrices, (n, p) and (n, q), by pieces of rows.

    The pieces are so small that BLAS keeps to one thread. On a whole tall matrix it takes several,
    and on a busy machine these wait for each other ten times longer than they work.
    """
    rows = ROBUST.rows_at_once
    pieces = len(a) // rows
    whole = pieces * rows
    left, right = (m[:whole].reshape(pieces, rows, m.shape[1]) for m in (a, b))
    return np.matmul(np.swapaxes(left, 1, 2), right).sum(axis=0) + a[whole:].T @ b[whole:]


@dataclass(frozen=True)
class Covariance:
    """Uncertainty of a fit, at its end; inf on the diagonal of what the data do not tell."""

    common: FloatArray  # (p, p)
    own: FloatArray  # (groups, b, b), the common unknowns' uncertainty included


class Arrow:
    """Normal equations of a linearised model with weights, own unknowns eliminated."""

    def __init__(self, lin: Linearised, weight: FloatArray, group: IntArray) -> None:
        root = np.sqrt(weight)[:, None]
        r = lin.residual * root
        a = lin.by_common * root[..., None]
        b = lin.by_own * root[..., None]
        across = np.swapaxes(b, 1, 2)
        flat = a.reshape(r.size, a.shape[-1])
        known = lin.prior_by_common
        self.common = product(flat, flat) + known.T @ known
        self.common_gradient = product(flat, r.reshape(-1, 1))[:, 0] + known.T @ lin.prior
        self.own = _sums(across @ b, group) + np.eye(b.shape[-1]) * lin.own_stiffness
        self.own_gradient = _sums(np.einsum("nmi,nm->ni", b, r), group)
        self.own_gradient += lin.own_stiffness * lin.own
        self.cross = _sums(across @ a, group)  # (groups, b, p)

    def _eliminate(
        self, damping: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Take the own unknowns out of equations whose diagonal has grown by a factor 1 + damping.

        Returns B⁻¹, B⁻¹ C, what is left for the common unknowns, scaled to A's diagonal, and that scale.
        """
        own = self.own.copy()
        common = self.common.copy()
        for matrix in (own, common):
            diagonal = np.einsum("...ii->...i", matrix)
            diagonal += damping * diagonal + (diagonal == 0)
        alone = np.asarray(np.linalg.inv(own), dtype=np.float64)
        gain = alone @ self.cross
        reduced: FloatArray = common - np.einsum("gbi,gbj->ij", self.cross, gain)
        scale = 1 / np.sqrt(np.diag(common))
        return alone, gain, reduced * scale * scale[:, None], scale

    def solve(self, damping: float) -> tuple[FloatArray, FloatArray]:
        """Solve for the step of Levenberg and Marquardt."""
        alone, gain, reduced, scale = self._eliminate(damping)
        right = self.common_gradient - np.einsum("gbi,gb->i", gain, self.own_gradient)
        step = -scale * np.linalg.lstsq(reduced, right * scale, rcond=1e-14)[0]
        return step, -np.einsum("gij,gj->gi", alone, self.own_gradient) - gain @ step

    def length(self, common: FloatArray, own: FloatArray) -> float:
        """Length of a step in standard errors; no unknown moves by more of its own."""
        square = common @ self.common @ common
        square += 2 * np.einsum("gb,gbp,p->", own, self.cross, common)
        square += np.einsum("gi,gij,gj->", own, self.own, own)
        return float(np.sqrt(np.maximum(square, 0.0)))

    def covariance(self) -> Covariance:
        """Invert the normal equations; unknowns that they do not tell get inf."""
        alone, gain, reduced, scale = self._eliminate(ROBUST.ridge)
        common = np.linalg.inv(reduced) * scale * scale[:, None]
        own = alone + gain @ common @ np.swapaxes(gain, 1, 2)
        for matrix, equations in ((common, self.common), (own, self.own)):
            variance = np.einsum("...ii->...i", matrix)
            inflation = variance * np.einsum("...ii->...i", equations)
            is_determined = (inflation > 0) & (inflation < ROBUST.lost_inflation)
            variance[~is_determined] = np.inf
        return Covariance(common, own)


# The fit --------------------------------------------------------------------------------
@dataclass(frozen=True)
class FitIterate:
    """One step of a fit."""

    k: int  # from 0, the start
    stage: Literal["huber", "final"]
    unknowns: Any  # as the model keeps them
    linearised: Linearised
    used: BoolArray  # (n,), measurements that count in this round
    # Standard deviation of one number of a residual, as estimated for this round.
    sigma: float
    change: float = float("nan")

    @property
    def residual(self) -> FloatArray:
        """(n, m), read-only."""
        return self.linearised.residual

    @cached_property
    def cost(self) -> float:
        """What this round minimises."""
        lin = self.linearised
        size = np.linalg.norm(lin.residual[self.used], axis=1) / self.sigma
        rho = huber(size, ROBUST.huber) if self.stage == "huber" else 0.5 * size**2
        known = np.sum(lin.prior**2) + np.sum(lin.own_stiffness * np.square(lin.own))
        return float(np.sum(rho) + 0.5 * known)

    @property
    def weight(self) -> FloatArray:
        """Weights of the equivalent least squares, (n,)."""
        weight = self.used / self.sigma**2
        if self.stage == "huber":
            size = np.maximum(np.linalg.norm(self.residual, axis=1), ROBUST.smallest_sigma)
            weight = weight * np.minimum(1.0, ROBUST.huber * self.sigma / size)
        return weight


@dataclass(frozen=True)
class Fit:
    """What a fit found; `status` says why it ended."""

    iterate: FitIterate
    status: Status
    covariance: Covariance


def robust_sigma(
    residual: FloatArray,
    used: BoolArray,
    unknowns: int,
    smallest: float = ROBUST.smallest_sigma,
) -> float:
    """Estimate σ of one number of a residual, (n, m), from measurements that may hold outliers.

    It is the standard deviation of the residuals below `outlier` σ, corrected for the tail that this leaves
    out and for the number of `unknowns` fitted to them; never below `smallest`.
    """
    size = np.linalg.norm(residual[used], axis=1)
    m = residual.shape[1]
    if size.size == 0:
        raise ValueError("no measurement is left to fit")
    sigma = float(np.median(size)) / np.sqrt(scipy.special.chdtri(m, 0.5))
    # E[r² | r < outlier σ] of a chi-squared variable, per number.
    limit = ROBUST.outlier**2 / 2
    kept = scipy.special.gammainc(m / 2 + 1, limit) / scipy.special.gammainc(m / 2, limit)
    for _ in range(30):
        inner = size < ROBUST.outlier * sigma
        count = m * inner.sum()
        if sigma <= smallest or count <= unknowns:
            break
        new = float(np.sqrt(np.sum(size[inner] ** 2) / (count - unknowns) / kept))
        if abs(new - sigma) < 1e-9 * sigma:
            break
        sigma = new
    return max(sigma, smallest)


def _choose(model: Model, last: FitIterate, smallest: float) -> FitIterate:
    """Choose σ and the measurements anew at what a round has found."""
    lin = last.linearised
    loose = lin.by_own.shape[-1] - np.count_nonzero(lin.own_stiffness)
    count = lin.by_common.shape[-1] + loose * (int(model.group[-1]) + 1)
    used = model.usable(last.unknowns)
    sigma = robust_sigma(lin.residual, used, count, smallest)
    if last.stage == "final":
        # A measurement on the border would go in and out for ever: who is in stays a little longer.
        limit = np.where(last.used, 1.01, 1.0) * ROBUST.outlier * sigma
        used = used & (np.linalg.norm(lin.residual, axis=1) < limit)
    return replace(last, used=used, sigma=sigma, change=float("nan"))


def _is_same(choice: FitIterate, later: FitIterate) -> bool:
    """Whether another round would find nothing new; the first stage only has to come near."""
    apart = abs(choice.sigma - later.sigma) / choice.sigma
    if choice.stage == "huber":
        return apart < 0.1
    return apart < 1e-3 and np.array_equal(choice.used, later.used)


def _descend(
    model: Model, last: FitIterate
) -> Generator[FitIterate, None, tuple[FitIterate, Status]]:
    """Minimise the cost of one round by Levenberg-Marquardt steps."""
    damping = 1e-10
    tolerance = ROBUST.tolerance if last.stage == "final" else ROBUST.rough_tolerance
    while last.k < ROBUST.max_iterations:
        arrow = Arrow(last.linearised, last.weight, model.group)
        # An increase that is nothing against the tolerance is rounding.
        limit = last.cost * (1 + 1e-12) + 0.5 * ROBUST.tolerance**2
        while True:
            step = arrow.solve(damping)
            length = arrow.length(*step)
            # A step that is short because it was damped proves nothing.
            is_last = damping < 1e-3 and length < tolerance
            unknowns = model.take_step(last.unknowns, *step)
            if unknowns is not None:
                there = model.linearise(unknowns)
                trial = replace(last, unknowns=unknowns, linearised=there, change=length)
                if trial.cost <= limit:
                    break
            if is_last:
                return last, Status.CONVERGED
            damping = max(10 * damping, 1e-6)
            if damping > 1e12:
                return last, Status.STALLED
        freeze(trial.residual)
        last = replace(trial, k=last.k + 1)
        yield last
        if is_last:
            return last, Status.CONVERGED
        damping = max(damping / 10, 1e-10)
    return last, Status.MAX_ITERATIONS


def iterate_fit(
    model: Model, start: Any, smallest: float = ROBUST.smallest_sigma
) -> Generator[FitIterate, None, Status]:
    """Fit a model from its unknowns `start`, step by step.

    σ is never taken to be below `smallest`: what the measurements are good for at best. ValueError if no
    measurement is usable, or too few are left.
    """
    nobody = np.zeros(len(model.group), bool)
    lin = model.linearise(start)
    freeze(lin.residual)
    last = FitIterate(0, "huber", start, lin, nobody, 0.0)
    status = Status.STALLED
    stages: tuple[Literal["huber", "final"], ...] = ("huber", "final")
    for stage in stages:
        choice = _choose(model, replace(last, stage=stage, used=nobody), smallest)
        seen: list[FitIterate] = []
        while True:
            yield choice
            last, status = yield from _descend(model, choice)
            if status is Status.MAX_ITERATIONS:
                return status
            # A measurement on the border may come and go for ever: a choice that recurs is the last.
            seen.append(choice)
            choice = _choose(model, last, smallest)
            if any(_is_same(choice, earlier) for earlier in seen):
                break
            if len(seen) == ROBUST.max_rounds:
                status = Status.STALLED
                break
    return status


def fit(
    model: Model,
    start: Any,
    observers: Iterable[Callable[[FitIterate], bool | None]] = (),
    smallest: float = ROBUST.smallest_sigma,
) -> Fit:
    """Fit a model to its end, or until one of the observers, who are shown every iterate, returns True.

    Parameters as of `iterate_fit`. A keyboard interrupt, too, leaves the last iterate, of status STOPPED.
    """
    steps: list[FitIterate] = []

    def keep(step: FitIterate, _: float) -> None:
        steps[:] = [step]

    status = drive(iterate_fit(model, start, smallest), observers, keep)
    (last,) = steps
    arrow = Arrow(last.linearised, last.weight, model.group)
    return Fit(last, status, arrow.covariance())
