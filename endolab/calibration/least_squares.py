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
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Protocol

import numpy as np
import scipy

from endolab.numerics.arrays import BoolArray, FloatArray, IntArray, freeze
from endolab.numerics.checks import check_int
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
    max_rounds: int = 20  # of freezing σ and the outliers
    # σ is never less, be it of pixels or stored values: rounding would count.
    smallest_sigma: float = 1e-4
    # Eigenvalue, relative to the diagonal, of a direction that the data do not tell.
    lost_eigenvalue: float = 1e-13
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

    def residual(self, unknowns: Any) -> tuple[FloatArray, FloatArray]:
        """Residuals (n, m) and, in standard deviations, all that is off from what is known beforehand."""
        ...

    def take_step(self, unknowns: Any, common: FloatArray, own: FloatArray) -> Any:
        """Return the unknowns after a step, (p,) and (groups, b); None if it leads out of bounds."""
        ...

    def usable(self, unknowns: Any) -> BoolArray:
        """Which measurements can be believed at all, (n,): not saturated, in front of the camera."""
        ...


# Normal equations -----------------------------------------------------------------------
def _sums(values: FloatArray, group: IntArray, groups: int) -> FloatArray:
    """Sum over the measurements of each group; the groups are in order, none is empty."""
    return np.add.reduceat(values, np.searchsorted(group, np.arange(groups)), axis=0)


def _inverses(matrices: FloatArray, diagonal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Invert symmetric matrices (..., n, n) where they tell something, after scaling to the diagonal.

    Returns the pseudo-inverses and, as columns (..., n, n), the directions they do not tell, else zero.
    """
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(matrices * scale[..., None] * scale[..., None, :])
    gone = values < ROBUST.lost_eigenvalue
    vectors = vectors * scale[..., None]
    scaled = vectors / np.sqrt(np.where(gone, np.inf, values))[..., None, :]
    return scaled @ np.swapaxes(scaled, -1, -2), vectors * gone[..., None, :]


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
        groups = int(group[-1]) + 1
        root = np.sqrt(weight)[:, None]
        r = lin.residual * root
        a = lin.by_common * root[..., None]
        b = lin.by_own * root[..., None]
        flat = a.reshape(r.size, a.shape[-1])
        self.common = product(flat, flat) + lin.prior_by_common.T @ lin.prior_by_common
        self.common_gradient = (
            product(flat, r.reshape(-1, 1))[:, 0] + lin.prior_by_common.T @ lin.prior
        )
        self.own = _sums(np.swapaxes(b, 1, 2) @ b, group, groups)
        self.own += np.eye(b.shape[-1]) * lin.own_stiffness
        self.own_gradient = (
            _sums(np.einsum("nmi,nm->ni", b, r), group, groups)
            + lin.own_stiffness * lin.own
        )
        self.cross = _sums(np.swapaxes(b, 1, 2) @ a, group, groups)  # (groups, b, p)

    def solve(self, damping: float) -> tuple[FloatArray, FloatArray]:
        """Solve for the step with the diagonal grown by a factor 1 + damping (Levenberg-Marquardt)."""
        own = self.own.copy()
        common = self.common.copy()
        for matrix in (own, common):
            diagonal = np.einsum("...ii->...i", matrix)
            diagonal += damping * diagonal + (diagonal == 0)
        gain = np.linalg.solve(own, self.cross)
        rest = np.linalg.solve(own, self.own_gradient[..., None])[..., 0]
        scale = 1 / np.sqrt(np.diag(common))
        reduced = common - np.einsum("gbi,gbj->ij", self.cross, gain)
        right = self.common_gradient - np.einsum("gbi,gb->i", gain, self.own_gradient)
        step = (
            -scale
            * np.linalg.lstsq(reduced * scale * scale[:, None], right * scale, rcond=1e-14)[
                0
            ]
        )
        return step, -rest - gain @ step

    def length(self, common: FloatArray, own: FloatArray) -> float:
        """Length of a step in standard errors; no unknown moves by more of its own."""
        square = common @ self.common @ common + 2 * np.einsum(
            "gb,gbp,p->", own, self.cross, common
        )
        return float(
            np.sqrt(max(square + np.einsum("gi,gij,gj->", own, self.own, own), 0.0))
        )

    def covariance(self) -> Covariance:
        """Invert the normal equations; unknowns that they do not tell get inf."""
        alone, lost_own = _inverses(self.own, np.einsum("gii->gi", self.own))
        gain = alone @ self.cross
        reduced = self.common - np.einsum("gbi,gbj->ij", self.cross, gain)
        diagonal = np.diag(self.common)
        common, lost = _inverses(reduced, diagonal)
        own = alone + gain @ common @ np.swapaxes(gain, 1, 2)
        # What a lost direction moves, in units of what is known of it without the others, is lost too.
        unknown = np.any(np.abs(lost) * np.sqrt(diagonal)[:, None] > 1e-3, axis=1)
        common[unknown, unknown] = np.inf
        spread = np.sqrt(np.einsum("gii->gi", alone))
        unknown = np.any(np.abs(gain @ lost) > 1e-3 * spread[..., None], axis=-1)
        unknown |= np.any(lost_own != 0, axis=-1) & (spread == 0)
        group, index = np.nonzero(unknown)
        own[group, index, index] = np.inf
        return Covariance(common, own)


# The fit --------------------------------------------------------------------------------
@dataclass(frozen=True)
class FitIterate:
    """One step of a fit."""

    k: int  # from 0, the start
    stage: Literal["huber", "final"]
    round: int  # of the stage
    unknowns: Any  # as the model keeps them
    residual: FloatArray  # (n, m), read-only
    used: BoolArray  # (n,), measurements that count in this round
    sigma: (
        float  # standard deviation of one number of a residual, as estimated for this round
    )
    cost: float  # what this round minimises: Σ ρ(|r|/σ) + ½ Σ prior²
    change: float = float("nan")


@dataclass(frozen=True)
class Fit:
    """What a fit found; `status` says why it ended."""

    iterate: FitIterate
    status: Status
    covariance: Covariance
    history: list[dict[str, float]] = field(default_factory=list)


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
    kept = scipy.special.gammainc(
        m / 2 + 1, ROBUST.outlier**2 / 2
    ) / scipy.special.gammainc(m / 2, ROBUST.outlier**2 / 2)
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


@dataclass(frozen=True)
class _Round:
    """What is frozen while one function is minimised."""

    stage: Literal["huber", "final"]
    number: int
    used: BoolArray
    sigma: float

    def cost(self, residual: FloatArray, prior: FloatArray) -> float:
        size = np.linalg.norm(residual[self.used], axis=1) / self.sigma
        rho = huber(size, ROBUST.huber) if self.stage == "huber" else 0.5 * size**2
        return float(np.sum(rho) + 0.5 * np.sum(prior**2))

    def weight(self, residual: FloatArray) -> FloatArray:
        """Weights of the equivalent least squares."""
        weight = self.used / self.sigma**2
        if self.stage == "huber":
            size = np.linalg.norm(residual, axis=1)
            weight = weight * np.minimum(
                1.0, ROBUST.huber * self.sigma / np.maximum(size, ROBUST.smallest_sigma)
            )
        return weight

    def next(
        self, model: Model, unknowns: Any, residual: FloatArray, count: int, smallest: float
    ) -> _Round:
        """Choose anew at what this round has found."""
        used = model.usable(unknowns)
        sigma = robust_sigma(residual, used, count, smallest)
        if self.stage == "final":
            # A measurement on the border would go in and out for ever: who is in stays a little longer.
            limit = np.where(self.used, 1.01, 1.0) * ROBUST.outlier * sigma
            used = used & (np.linalg.norm(residual, axis=1) < limit)
        return _Round(self.stage, self.number + 1, used, sigma)

    def is_same(self, later: _Round) -> bool:
        """Whether another round would find nothing new; the first stage only has to come near."""
        if self.stage == "huber":
            return abs(self.sigma - later.sigma) < 0.1 * self.sigma
        return (
            np.array_equal(self.used, later.used)
            and abs(self.sigma - later.sigma) < 1e-3 * self.sigma
        )


def _descend(
    model: Model, last: FitIterate, choice: _Round, max_iterations: int
) -> Generator[FitIterate, None, tuple[FitIterate, Status]]:
    """Minimise the cost of one round by Levenberg-Marquardt steps."""
    damping = 1e-10
    tolerance = ROBUST.tolerance if choice.stage == "final" else ROBUST.rough_tolerance
    while last.k < max_iterations:
        lin = model.linearise(last.unknowns)
        arrow = Arrow(lin, choice.weight(lin.residual), model.group)
        # An increase that is nothing against the tolerance is rounding.
        limit = last.cost * (1 + 1e-12) + 0.5 * ROBUST.tolerance**2
        while True:
            step, own = arrow.solve(damping)
            unknowns = model.take_step(last.unknowns, step, own)
            if unknowns is not None:
                residual, prior = model.residual(unknowns)
                cost = choice.cost(residual, prior)
                if cost <= limit:
                    break
            if damping < 1e-3 and arrow.length(step, own) < tolerance:
                return last, Status.CONVERGED
            damping = max(10 * damping, 1e-6)
            if damping > 1e12:
                return last, Status.STALLED
        length = arrow.length(step, own)
        last = replace(
            last,
            k=last.k + 1,
            unknowns=unknowns,
            residual=freeze(residual),
            cost=cost,
            change=length,
        )
        yield last
        # A step that is short because it was damped proves nothing.
        if last.change < tolerance and damping < 1e-3:
            return last, Status.CONVERGED
        damping = max(damping / 10, 1e-10)
    return last, Status.MAX_ITERATIONS


def iterate_fit(
    model: Model,
    start: Any,
    max_iterations: int = 200,
    smallest: float = ROBUST.smallest_sigma,
) -> Generator[FitIterate, None, Status]:
    """Fit a model from its unknowns `start`, step by step, `max_iterations` after the start in all.

    σ is never taken to be below `smallest`: what the measurements are good for at best. ValueError if no
    measurement is usable, or too few are left.
    """
    check_int("max_iterations", max_iterations)
    unknowns = start
    k = 0
    status = Status.STALLED
    lin = model.linearise(start)
    loose = lin.by_own.shape[-1] - np.count_nonzero(lin.own_stiffness)
    count = lin.by_common.shape[-1] + loose * (int(model.group[-1]) + 1)
    residual, _ = model.residual(start)
    nobody = np.zeros(len(model.group), bool)
    stages: tuple[Literal["huber", "final"], ...] = ("huber", "final")
    for stage in stages:
        choice = _Round(stage, -1, nobody, 0.0).next(
            model, unknowns, residual, count, smallest
        )
        seen: list[_Round] = []
        while True:
            cost = choice.cost(*model.residual(unknowns))
            last = FitIterate(
                k,
                stage,
                choice.number,
                unknowns,
                freeze(residual),
                choice.used,
                choice.sigma,
                cost,
            )
            yield last
            last, status = yield from _descend(model, last, choice, max_iterations)
            unknowns = last.unknowns
            residual = last.residual
            k = last.k
            if status is Status.MAX_ITERATIONS:
                return status
            again = choice.next(model, unknowns, residual, count, smallest)
            # A measurement on the border may come and go for ever: a choice that recurs is the last.
            seen.append(choice)
            if any(again.is_same(earlier) for earlier in seen):
                break
            if again.number == ROBUST.max_rounds:
                status = Status.STALLED
                break
            choice = again
    return status


def fit(
    model: Model,
    start: Any,
    observers: Iterable[Callable[[FitIterate], bool | None]] = (),
    max_iterations: int = 200,
    smallest: float = ROBUST.smallest_sigma,
) -> Fit:
    """Fit a model to its end, or until one of the observers, who are shown every iterate, returns True.

    Parameters as of `iterate_fit`. A keyboard interrupt, too, leaves the last iterate, of status STOPPED.
    """
    history: list[dict[str, float]] = []
    last: FitIterate | None = None

    def keep(step: FitIterate, _: float) -> None:
        nonlocal last
        last = step
        history.append(
            {"k": step.k, "cost": step.cost, "sigma": step.sigma, "change": step.change}
        )

    status = drive(iterate_fit(model, start, max_iterations, smallest), observers, keep)
    assert last is not None
    lin = model.linearise(last.unknowns)
    choice = _Round(last.stage, last.round, last.used, last.sigma)
    covariance = Arrow(lin, choice.weight(lin.residual), model.group).covariance()
    return Fit(last, status, covariance, history)
