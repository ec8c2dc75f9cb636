"""Robust least squares with many small blocks of unknowns: the solver of both calibrations.

The unknowns are a few *common* ones (the camera, or k, γ and the BRDF) and, for each group of
residuals (a view, or a frame), a few of its *own* (its pose, or its gain). The normal equations
then have the shape of an arrow: the own unknowns are eliminated block by block (Schur complement),
so the cost grows with the number of groups and not with its cube.

Stages: "huber" brings the start near; "final" keeps the residuals below `CUT` standard deviations,
all alike, and forgets the others, because a Huber penalty is still pulled by outliers. Within a
round of a stage, the scale σ and the choice of residuals are frozen, so that what is minimised is
one function; rounds repeat until the choice no longer changes.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from scipy.special import chdtri, gammainc

from endolab.iteration import Status
from endolab.operators import BoolArray, FloatArray, IntArray
from endolab.penalties import huber

HUBER = 1.5  # standard deviations where the parabola becomes a line
CUT = 3.5  # standard deviations beyond which a residual is an outlier
TOLERANCE = 1e-4  # a step is the last if it moves no unknown by more of its standard error
ROUNDS = 20  # of freezing σ and the outliers, at most


@dataclass(frozen=True)
class Linearised:
    """Residuals and their derivatives.

    Attributes
    ----------
    residual : (n, m) float array
        n measurements of m numbers each (2 for pixels, 1 for grey levels).
    by_common : (n, m, p) float array
        Derivatives by the common unknowns.
    by_own : (n, m, b) float array
        Derivatives by the unknowns of the measurement's own group.
    prior : (q,) float array
        Residuals of what is known beforehand, in standard deviations.
    prior_by_common : (q, p) float array
        Their derivatives.
    """

    residual: FloatArray
    by_common: FloatArray
    by_own: FloatArray
    prior: FloatArray
    prior_by_common: FloatArray


class Model(Protocol):
    """What the solver asks of a calibration problem.

    Attributes
    ----------
    group : (n,) int array
        Group of each measurement, in ascending order, without gaps from 0.
    """

    group: IntArray

    def linearise(self, unknowns: Any) -> Linearised:
        """Residuals and derivatives at the unknowns."""
        ...

    def residual(self, unknowns: Any) -> tuple[FloatArray, FloatArray]:
        """Residuals (n, m) and those of the priors (q,) alone."""
        ...

    def moved(self, unknowns: Any, common: FloatArray, own: FloatArray) -> Any:
        """Return the unknowns after a step, (p,) and (groups, b); None if it leads out of bounds."""
        ...

    def usable(self, unknowns: Any) -> BoolArray:
        """Which measurements can be believed at all, (n,): not saturated, in front of the camera."""
        ...


@dataclass(frozen=True)
class FitIterate:
    """One step of a fit.

    Attributes
    ----------
    k : int
        Counts from 0, the start.
    stage : {"huber", "final"}
    round : int
        Of the stage.
    unknowns
        As the model keeps them.
    residual : (n, m) float array
        Read-only.
    used : (n,) bool array
        Measurements that count in this round.
    sigma : float
        Standard deviation of one number of a residual, as estimated for this round.
    cost : float
        What this round minimises: Σ ρ(|r|/σ) + ½ Σ prior².
    change : float
        Largest move of an unknown of the step, in its standard errors; nan at a round's start.
    """

    k: int
    stage: str
    round: int
    unknowns: Any
    residual: FloatArray
    used: BoolArray
    sigma: float
    cost: float
    change: float = float("nan")


@dataclass(frozen=True)
class Covariance:
    """Uncertainty of a fit, at its end.

    Attributes
    ----------
    common : (p, p) float array
        Covariance of the common unknowns; inf on the diagonal of one that the data do not tell.
    own : (groups, b, b) float array
        Covariance of each group's own unknowns.
    """

    common: FloatArray
    own: FloatArray


@dataclass(frozen=True)
class Fit:
    """What a fit found; `status` says why it ended."""

    iterate: FitIterate
    status: Status
    covariance: Covariance
    history: list[dict[str, float]] = field(default_factory=list)


def _sums(values: FloatArray, group: IntArray, groups: int) -> FloatArray:
    """Sum over the measurements of each group; the groups are in order, none is empty."""
    total: FloatArray = np.add.reduceat(values, np.searchsorted(group, np.arange(groups)), axis=0)
    return total


def robust_sigma(residual: FloatArray, used: BoolArray, unknowns: int) -> float:
    """Estimate σ of one number of a residual, from measurements that may hold outliers.

    Parameters
    ----------
    residual : (n, m) float array
    used : (n,) bool array
    unknowns : int
        Number of unknowns that were fitted to them.

    Returns
    -------
    float
        The standard deviation of the residuals below `CUT` σ, corrected for the tail that this
        leaves out and for the number of unknowns.
    """
    size, m = np.linalg.norm(residual[used], axis=1), residual.shape[1]
    if size.size == 0:
        raise ValueError("no measurement is left to fit")
    sigma = float(np.median(size)) / np.sqrt(chdtri(m, 0.5))
    # E[r² | r < CUT σ] of a chi-squared variable, per number.
    kept = gammainc(m / 2 + 1, CUT**2 / 2) / gammainc(m / 2, CUT**2 / 2)
    for _ in range(30):
        inner = size < CUT * sigma
        count = m * inner.sum()
        if sigma == 0 or count <= unknowns:
            break
        new = float(np.sqrt(np.sum(size[inner] ** 2) / (count - unknowns) / kept))
        if abs(new - sigma) < 1e-9 * sigma:
            break
        sigma = new
    return max(sigma, float(np.finfo(float).tiny) ** 0.25)


class _Arrow:
    """Normal equations of a linearised model with weights, own unknowns eliminated."""

    def __init__(self, lin: Linearised, weight: FloatArray, group: IntArray) -> None:
        groups = int(group[-1]) + 1
        root = np.sqrt(weight)[:, None]
        r = lin.residual * root
        a, b = lin.by_common * root[..., None], lin.by_own * root[..., None]
        flat = a.reshape(-1, a.shape[-1])
        self.common = flat.T @ flat + lin.prior_by_common.T @ lin.prior_by_common
        self.common_gradient = flat.T @ r.ravel() + lin.prior_by_common.T @ lin.prior
        self.own = _sums(np.einsum("nmi,nmj->nij", b, b), group, groups)
        self.own_gradient = _sums(np.einsum("nmi,nm->ni", b, r), group, groups)
        self.cross = _sums(np.einsum("nmi,nmj->nij", b, a), group, groups)  # (groups, b, p)

    def solve(self, damping: float) -> tuple[FloatArray, FloatArray]:
        """Solve for the step with the diagonal grown by a factor 1 + damping (Levenberg-Marquardt)."""
        own = self.own.copy()
        index = np.arange(own.shape[1])
        diagonal = own[:, index, index]
        own[:, index, index] += damping * diagonal + (diagonal == 0)
        common = self.common.copy()
        index = np.arange(len(common))
        diagonal = common[index, index]
        common[index, index] += damping * diagonal + (diagonal == 0)
        gain = np.linalg.solve(own, self.cross)
        reduced = common - np.einsum("gbi,gbj->ij", self.cross, gain)
        right = self.common_gradient - np.einsum("gbi,gb->i", gain, self.own_gradient)
        scale = 1 / np.sqrt(np.maximum(np.diag(common), np.finfo(float).tiny))
        step = -scale * np.linalg.lstsq(reduced * scale * scale[:, None], right * scale, rcond=1e-14)[0]
        rest = np.linalg.solve(own, self.own_gradient[..., None])[..., 0]
        return step, -rest - np.einsum("gbp,p->gb", gain, step)

    def covariance(self) -> Covariance:
        """Invert the normal equations; unknowns that they do not tell get inf."""
        own = self.own.copy()
        index = np.arange(own.shape[1])
        empty = own[:, index, index] == 0
        own[:, index, index] += empty
        gain = np.linalg.solve(own, self.cross)
        reduced = self.common - np.einsum("gbi,gbj->ij", self.cross, gain)
        scale = 1 / np.sqrt(np.maximum(np.diag(self.common), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(reduced * scale * scale[:, None])
        lost = values < 1e-13
        inverse = (vectors / np.where(lost, np.inf, values)) @ vectors.T * scale * scale[:, None]
        unknown = (
            np.any(np.abs(vectors[:, lost]) > 1e-3, axis=1) if lost.any() else np.zeros(len(scale), bool)
        )
        inverse[unknown, unknown] = np.inf
        finite = np.where(np.isfinite(inverse), inverse, 0.0)
        blocks = np.linalg.inv(own) + gain @ finite @ np.swapaxes(gain, 1, 2)
        group, unknown_own = np.nonzero(empty)
        blocks[group, unknown_own, unknown_own] = np.inf
        return Covariance(inverse, blocks)


def _cost(residual: FloatArray, prior: FloatArray, used: BoolArray, sigma: float, stage: str) -> float:
    size = np.linalg.norm(residual[used], axis=1) / sigma
    rho = huber(size, HUBER) if stage == "huber" else 0.5 * size**2
    return float(np.sum(rho) + 0.5 * np.sum(prior**2))


def _weight(residual: FloatArray, used: BoolArray, sigma: float, stage: str) -> FloatArray:
    """Weights of the equivalent least squares, in units of 1/σ²."""
    weight = used / sigma**2
    if stage == "huber":
        size = np.linalg.norm(residual, axis=1)
        weight = weight * np.minimum(1.0, HUBER * sigma / np.maximum(size, np.finfo(float).tiny))
    return weight


def iterate_fit(model: Model, start: Any, max_iterations: int = 200) -> Generator[FitIterate, None, Status]:
    """Fit a model, step by step.

    Parameters
    ----------
    model : Model
    start
        Its unknowns to begin with.
    max_iterations : int
        Steps after the start, in all.

    Yields
    ------
    FitIterate

    Returns
    -------
    Status
    """
    unknowns, k = start, 0
    keep_all = np.ones(len(model.group), bool)
    for stage in ("huber", "final"):
        used = model.usable(unknowns) & keep_all
        for turn in range(ROUNDS):
            residual, prior = model.residual(unknowns)
            count = _degrees(model, unknowns)
            sigma = robust_sigma(residual, used, count)
            if stage == "final":
                used = model.usable(unknowns) & (np.linalg.norm(residual, axis=1) < CUT * sigma)
            cost = _cost(residual, prior, used, sigma, stage)
            yield FitIterate(k, stage, turn, unknowns, _frozen(residual), used, sigma, cost)
            damping, settled = 1e-8, False
            while not settled:
                lin = model.linearise(unknowns)
                arrow = _Arrow(lin, _weight(lin.residual, used, sigma, stage), model.group)
                while True:
                    step, own = arrow.solve(damping)
                    moved = model.moved(unknowns, step, own)
                    if moved is not None:
                        residual, prior = model.residual(moved)
                        new = _cost(residual, prior, used, sigma, stage)
                        if np.isfinite(new) and new <= cost * (1 + 1e-12):
                            break
                    damping = max(damping * 10, 1e-6)
                    if damping > 1e12:
                        return Status.STALLED
                # In standard errors, without the inverse: √(stepᵀ H step) bounds every one of them.
                change = float(
                    np.sqrt(
                        max(
                            step @ arrow.common @ step
                            + 2 * np.einsum("gb,gbp,p->", own, arrow.cross, step)
                            + np.einsum("gi,gij,gj->", own, arrow.own, own),
                            0.0,
                        )
                    )
                )
                unknowns, cost, k = moved, new, k + 1
                damping = damping / 10 if damping > 1e-8 else 1e-8
                yield FitIterate(k, stage, turn, unknowns, _frozen(residual), used, sigma, cost, change)
                if k >= max_iterations:
                    return Status.MAX_ITERATIONS
                settled = change < TOLERANCE * (1 if stage == "final" else 100)
            again = model.usable(unknowns)
            fresh = robust_sigma(residual, again, count)
            if stage == "final":
                again = again & (np.linalg.norm(residual, axis=1) < CUT * fresh)
            done = np.array_equal(again, used) and abs(fresh - sigma) < 1e-3 * sigma
            used = again
            if done:
                break
        else:
            if stage == "final":
                return Status.STALLED
    return Status.CONVERGED


def _degrees(model: Model, unknowns: Any) -> int:
    lin = model.linearise(unknowns)
    return lin.by_common.shape[-1] + lin.by_own.shape[-1] * (int(model.group[-1]) + 1)


def _frozen(array: FloatArray) -> FloatArray:
    array.flags.writeable = False
    return array


def fit(
    model: Model,
    start: Any,
    observers: Iterable[Callable[[FitIterate], bool | None]] = (),
    max_iterations: int = 200,
) -> Fit:
    """Fit a model to its end.

    Parameters
    ----------
    model : Model
    start
        Its unknowns to begin with.
    observers : iterable of callables
        Each is shown every iterate; True stops the fit.
    max_iterations : int
        Steps after the start.

    Returns
    -------
    Fit
        Also after a keyboard interrupt: the last iterate, of status STOPPED.
    """
    steps = iterate_fit(model, start, max_iterations)
    watching, history = list(observers), []
    last: FitIterate | None = None
    status = Status.STOPPED
    try:
        while True:
            try:
                last = next(steps)
            except StopIteration as stop:
                status = stop.value
                break
            history.append({"k": last.k, "cost": last.cost, "sigma": last.sigma, "change": last.change})
            wishes = [observer(last) for observer in watching]  # all see it, whatever one says
            if any(wishes):
                break
    except KeyboardInterrupt:
        if last is None:
            raise
    assert last is not None
    lin = model.linearise(last.unknowns)
    weight = _weight(lin.residual, last.used, last.sigma, last.stage)
    return Fit(last, status, _Arrow(lin, weight, model.group).covariance(), history)
