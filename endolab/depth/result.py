"""Running a solver: what an iterate is, when to stop, and what comes out.

A solver is a generator that yields `Iterate`s and returns the `Status` with which it ended.
`run` drives it, keeps the history and tells the observers, which are any callables
``Iterate -> bool | None``; one that returns True stops the run.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from endolab.depth.energy import energy_terms
from endolab.depth.problem import Problem
from endolab.model.surface import normals, points
from endolab.numerics.arrays import BoolArray, FloatArray, frozen
from endolab.numerics.iteration import Status


@dataclass(frozen=True)
class Iterate:
    """One step of a solver.

    Attributes
    ----------
    problem : Problem
        What is being solved.
    k : int
        Counts from 0, the start.
    log_distance : (H, W) float array
        v = log d; nan outside the mask; read-only.
    energy : float
        Sum of the terms.
    terms : mapping of str to float
        "data" and "regulariser".
    change : float
        Root mean square change of v since the last iterate; nan at the start.
    maps : mapping of str to (H, W) array
        Whatever else the solver has to show.
    scalars : mapping of str to float
        Likewise: step, damping, inner iterations.
    """

    problem: Problem
    k: int
    log_distance: FloatArray
    terms: Mapping[str, float]
    change: float = float("nan")
    maps: Mapping[str, np.ndarray] = field(default_factory=dict)
    scalars: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        problem: Problem,
        log_distance: FloatArray,
        previous: Iterate | None = None,
        terms: Mapping[str, float] | None = None,
        **shown: Mapping,
    ) -> Iterate:
        """Make the iterate that follows `previous`: evaluate the energy if not known, freeze the arrays."""
        v = frozen(np.where(problem.mask, log_distance, np.nan))
        for array in shown.get("maps", {}).values():
            frozen(array)
        change = float("nan")
        if previous is not None:
            change = float(np.sqrt(np.mean((v - previous.log_distance)[problem.mask] ** 2)))
        k = 0 if previous is None else previous.k + 1
        return cls(problem, k, v, energy_terms(problem, v) if terms is None else terms, change, **shown)

    @property
    def energy(self) -> float:
        """Sum of the terms."""
        return sum(self.terms.values())

    @property
    def mask(self) -> BoolArray:
        """Pixels that take part, (H, W)."""
        return self.problem.mask

    @cached_property
    def distance(self) -> FloatArray:
        """Euclidean distance from the optical centre, (H, W), mm or relative; nan outside the mask."""
        return frozen(np.exp(self.log_distance))

    @cached_property
    def z(self) -> FloatArray:
        """z of the surface, (H, W), mm or relative; nan outside the mask."""
        return frozen(self.distance * self.problem.field.cos_alpha)

    @cached_property
    def normals(self) -> FloatArray:
        """Unit normals in the camera frame, towards the camera, (H, W, 3); nan outside the mask."""
        return frozen(normals(self.log_distance, self.problem.field, self.mask))

    @cached_property
    def points(self) -> FloatArray:
        """Surface points in the camera frame, (H, W, 3), mm or relative; nan outside the mask."""
        return frozen(points(self.log_distance, self.problem.field))


Observer = Callable[[Iterate], bool | None]
Solver = Generator[Iterate, None, Status]


@dataclass(frozen=True)
class Result:
    """What a run found.

    `distance`, `z`, `normals`, `points` and `mask` are those of the iterate that is the answer:
    the last one of a run that converged, else the one of least energy.

    Attributes
    ----------
    iterate : Iterate
        The answer.
    status : Status
        Why the run ended.
    history : list of dict
        Per iterate: k, energy, its terms, change, seconds and the solver's scalars.
    seconds : float
        What the solver took, observers apart.
    """

    iterate: Iterate
    status: Status
    history: list[dict[str, float]]
    seconds: float

    @property
    def problem(self) -> Problem:
        """What was solved."""
        return self.iterate.problem

    @property
    def iterations(self) -> int:
        """Number of steps from the start."""
        return int(self.history[-1]["k"])

    @property
    def energy(self) -> float:
        """Energy of the answer."""
        return self.iterate.energy

    @property
    def metric(self) -> bool:
        """Whether distances are in mm; else they are in relative units."""
        return self.problem.metric

    @property
    def mask(self) -> BoolArray:
        """Pixels that took part, (H, W)."""
        return self.problem.mask

    @property
    def distance(self) -> FloatArray:
        """See `Iterate.distance`."""
        return self.iterate.distance

    @property
    def z(self) -> FloatArray:
        """See `Iterate.z`."""
        return self.iterate.z

    @property
    def normals(self) -> FloatArray:
        """See `Iterate.normals`."""
        return self.iterate.normals

    @property
    def points(self) -> FloatArray:
        """See `Iterate.points`."""
        return self.iterate.points


def run(iterates: Solver, observers: Iterable[Observer] = (), max_iterations: int | None = None) -> Result:
    """Drive a solver to its end.

    Parameters
    ----------
    iterates : generator of Iterate
        The solver.
    observers : iterable of callables
        Each is shown every iterate; True stops the run. One that has a method ``close`` is
        closed at the end, however the run ends.
    max_iterations : int, optional
        The most steps to take after the start.

    Returns
    -------
    Result
        Also after a keyboard interrupt, if there is an iterate to return.
    """
    watching = list(observers)
    history: list[dict[str, float]] = []
    best: Iterate | None = None
    last: Iterate | None = None
    seconds = 0.0
    try:
        while True:
            started = time.perf_counter()
            try:
                current = next(iterates)
            except StopIteration as stop:
                status = stop.value
                break
            finally:
                seconds += time.perf_counter() - started
            if not np.all(np.isfinite(current.log_distance[current.mask])):
                status = Status.NON_FINITE
                break
            last = current
            best = current if best is None or current.energy < best.energy else best
            summary = {"k": current.k, "energy": current.energy, **current.terms}
            history.append(summary | {"change": current.change, "seconds": seconds, **current.scalars})
            wishes = [observer(current) for observer in watching]  # all see it, whatever one says
            if any(wishes):
                status = Status.STOPPED
                break
            if max_iterations is not None and current.k >= max_iterations:
                status = Status.MAX_ITERATIONS
                break
    except KeyboardInterrupt:
        if best is None:
            raise
        status = Status.STOPPED
    finally:
        with ExitStack() as ending:  # closes every observer, even if another fails to
            ending.callback(iterates.close)
            for observer in watching:
                if hasattr(observer, "close"):
                    ending.callback(observer.close)
    if best is None or last is None:
        raise ValueError("the solver produced no depth map that is finite")
    return Result(last if status is Status.CONVERGED else best, status, history, seconds)
