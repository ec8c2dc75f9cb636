"""Robust least squares with many small blocks of unknowns: the solver of both calibrations.

The unknowns are a few *common* ones (the camera, or k, γ and the BRDF) and, for each group of
residuals (a view, or a frame), a few of its *own* (its pose, or its gain); see `arrow`.

Stages: "huber" brings the start near; "final" keeps the residuals below `CUT` standard deviations,
all alike, and forgets the others, because a Huber penalty is still pulled by outliers. Within a
round of a stage, the scale σ and the choice of residuals are frozen, so that what is minimised is
one function; rounds repeat until the choice no longer changes.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Protocol

import numpy as np
from scipy.special import chdtri, gammainc

from endolab.calibration.arrow import Arrow, Covariance, Linearised
from endolab.iteration import Status
from endolab.operators import BoolArray, FloatArray, IntArray
from endolab.penalties import huber

HUBER = 1.5  # standard deviations where the parabola becomes a line
CUT = 3.5  # standard deviations beyond which a residual is an outlier
TOLERANCE = 1e-4  # a step is the last if it moves no unknown by more of its standard error
NEAR = 1.0  # the same for the first stage, which only has to come near
ROUNDS = 20  # of freezing σ and the outliers, at most
SMALLEST = 1e-4  # σ is never less, be it of pixels or stored values: rounding would count


class Model(Protocol):
    """What the solver asks of a calibration problem.

    Attributes
    ----------
    group : (n,) int array
        Group of each measurement, in ascending order, without gaps from 0.
    """

    @property
    def group(self) -> IntArray:
        """See above."""
        ...

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
        Length of the step in the metric of the normal equations: no unknown moved by more of its
        standard error. nan at a round's start.
    """

    k: int
    stage: Literal["huber", "final"]
    round: int
    unknowns: Any
    residual: FloatArray
    used: BoolArray
    sigma: float
    cost: float
    change: float = float("nan")


@dataclass(frozen=True)
class Fit:
    """What a fit found; `status` says why it ended."""

    iterate: FitIterate
    status: Status
    covariance: Covariance
    history: list[dict[str, float]] = field(default_factory=list)


def robust_sigma(residual: FloatArray, used: BoolArray, unknowns: int, smallest: float = SMALLEST) -> float:
    """Estimate σ of one number of a residual, from measurements that may hold outliers.

    Parameters
    ----------
    residual : (n, m) float array
    used : (n,) bool array
    unknowns : int
        Number of unknowns that were fitted to them.
    smallest : float
        σ is never less.

    Returns
    -------
    float
        The standard deviation of the residuals below `CUT` σ, corrected for the tail that this
        leaves out and for the number of unknowns.

    Raises
    ------
    ValueError
        If none is used.
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
        rho = huber(size, HUBER) if self.stage == "huber" else 0.5 * size**2
        return float(np.sum(rho) + 0.5 * np.sum(prior**2))

    def weight(self, residual: FloatArray) -> FloatArray:
        """Weights of the equivalent least squares."""
        weight = self.used / self.sigma**2
        if self.stage == "huber":
            size = np.linalg.norm(residual, axis=1)
            weight = weight * np.minimum(1.0, HUBER * self.sigma / np.maximum(size, SMALLEST))
        return weight

    def next(self, model: Model, unknowns: Any, residual: FloatArray, count: int, smallest: float) -> _Round:
        """Choose anew at what this round has found."""
        used = model.usable(unknowns)
        sigma = robust_sigma(residual, used, count, smallest)
        if self.stage == "final":
            # A measurement on the border would go in and out for ever: who is in stays a little longer.
            limit = np.where(self.used, 1.01, 1.0) * CUT * sigma
            used = used & (np.linalg.norm(residual, axis=1) < limit)
        return _Round(self.stage, self.number + 1, used, sigma)

    def same(self, other: _Round) -> bool:
        """Whether another round would find nothing new; the first stage only has to come near."""
        if self.stage == "huber":
            return abs(self.sigma - other.sigma) < 0.1 * self.sigma
        return np.array_equal(self.used, other.used) and abs(self.sigma - other.sigma) < 1e-3 * self.sigma


def _descend(
    model: Model, last: FitIterate, choice: _Round, max_iterations: int
) -> Generator[FitIterate, None, tuple[FitIterate, Status]]:
    """Minimise the cost of one round by Levenberg-Marquardt steps."""
    damping, tolerance = 1e-10, TOLERANCE if choice.stage == "final" else NEAR
    while last.k < max_iterations:
        lin = model.linearise(last.unknowns)
        arrow = Arrow(lin, choice.weight(lin.residual), model.group)
        # An increase that is nothing against the tolerance is rounding.
        limit = last.cost * (1 + 1e-12) + 0.5 * TOLERANCE**2
        while True:
            step, own = arrow.solve(damping)
            moved = model.moved(last.unknowns, step, own)
            if moved is not None:
                residual, prior = model.residual(moved)
                cost = choice.cost(residual, prior)
                if cost <= limit:
                    break
            if damping < 1e-3 and arrow.length(step, own) < tolerance:
                return last, Status.CONVERGED
            damping = max(10 * damping, 1e-6)
            if damping > 1e12:
                return last, Status.STALLED
        last = replace(
            last,
            k=last.k + 1,
            unknowns=moved,
            residual=_frozen(residual),
            cost=cost,
            change=arrow.length(step, own),
        )
        yield last
        # A step that is short because it was damped proves nothing.
        if last.change < tolerance and damping < 1e-3:
            return last, Status.CONVERGED
        damping = max(damping / 10, 1e-10)
    return last, Status.MAX_ITERATIONS


def iterate_fit(
    model: Model, start: Any, max_iterations: int = 200, smallest: float = SMALLEST
) -> Generator[FitIterate, None, Status]:
    """Fit a model, step by step.

    Parameters
    ----------
    model : Model
    start
        Its unknowns to begin with.
    max_iterations : int
        Steps after the start, in all.
    smallest : float
        σ is never taken to be less: what the measurements are good for at best.

    Yields
    ------
    FitIterate

    Returns
    -------
    Status

    Raises
    ------
    ValueError
        If no measurement is usable, or too few are left.
    """
    unknowns, k, status = start, 0, Status.STALLED
    lin = model.linearise(start)
    count = lin.by_common.shape[-1] + lin.by_own.shape[-1] * (int(model.group[-1]) + 1)
    residual, _ = model.residual(start)
    nobody = np.zeros(len(model.group), bool)
    stages: tuple[Literal["huber", "final"], ...] = ("huber", "final")
    for stage in stages:
        choice = _Round(stage, -1, nobody, 0.0).next(model, unknowns, residual, count, smallest)
        seen: list[_Round] = []
        while True:
            cost = choice.cost(*model.residual(unknowns))
            last = FitIterate(
                k, stage, choice.number, unknowns, _frozen(residual), choice.used, choice.sigma, cost
            )
            yield last
            last, status = yield from _descend(model, last, choice, max_iterations)
            unknowns, residual, k = last.unknowns, last.residual, last.k
            if status is Status.MAX_ITERATIONS:
                return status
            again = choice.next(model, unknowns, residual, count, smallest)
            # A measurement on the border may come and go for ever: a choice that recurs is the last.
            seen.append(choice)
            if any(again.same(one) for one in seen):
                break
            if again.number == ROUNDS:
                status = Status.STALLED
                break
            choice = again
    return status


def _frozen(array: FloatArray) -> FloatArray:
    array.flags.writeable = False
    return array


def fit(
    model: Model,
    start: Any,
    observers: Iterable[Callable[[FitIterate], bool | None]] = (),
    max_iterations: int = 200,
    smallest: float = SMALLEST,
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
    smallest : float
        σ is never taken to be less: what the measurements are good for at best.

    Returns
    -------
    Fit
        Also after a keyboard interrupt: the last iterate, of status STOPPED.
    """
    steps = iterate_fit(model, start, max_iterations, smallest)
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
    choice = _Round(last.stage, last.round, last.used, last.sigma)
    covariance = Arrow(lin, choice.weight(lin.residual), model.group).covariance()
    return Fit(last, status, covariance, history)
