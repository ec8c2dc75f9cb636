"""Running a solver: what an iterate is, when to stop, and what comes out.

A solver is a generator that yields `Iterate`s and returns the `Status` with which it ended. A
reconstruction is one too, of several stages: iterates say which stage and round they are of.
`run` drives either, keeps the history and tells the observers, which are any callables
``Iterate -> bool | None``; one that returns True stops the run.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from endolab.model.surface import normals, points
from endolab.numerics.arrays import BoolArray, FloatArray, freeze
from endolab.numerics.iteration import Status, close_observers, drive
from endolab.numerics.resampling import resample
from endolab.solvers.descent import energy_left
from endolab.solvers.energy import energy_terms
from endolab.solvers.problem import Problem
from endolab.solvers.provenance import Report

# the stage whose answer counts, and the same in a known unit
SOLUTION = "solution"
SCALED = "scaled"


@dataclass(frozen=True, eq=False)
class Iterate:
    """One step of a solver."""

    problem: Problem  # what is being solved
    k: int  # counts from 0, the start
    log_distance: FloatArray  # (H, W), v = log d; nan outside the mask; read-only
    # Of the energy: "data" and "regulariser".
    terms: Mapping[str, float] = field(default_factory=dict)
    # Root mean square change of v since the last iterate; nan at the start.
    change: float = float("nan")
    # (H, W), whatever else there is to show.
    maps: Mapping[str, np.ndarray] = field(default_factory=dict)
    # Likewise: step, damping, inner iterations.
    scalars: Mapping[str, float] = field(default_factory=dict)
    # Of a reconstruction: "bounced light", "contours", "solution", "scaled".
    stage: str = SOLUTION
    round: int = 0  # of that stage, from 1 where there are several

    @classmethod
    def of(
        cls,
        problem: Problem,
        log_distance: FloatArray,
        previous: Iterate | None = None,
        terms: Mapping[str, float] | None = None,
        **shown: Any,
    ) -> Iterate:
        """Make the iterate that follows `previous`: evaluate the energy if not known, freeze the arrays."""
        v = freeze(np.where(problem.mask, log_distance, np.nan))
        for array in shown.get("maps", {}).values():
            freeze(array)
        change = float("nan")
        if previous is not None:
            change = float(np.sqrt(np.mean((v - previous.log_distance)[problem.mask] ** 2)))
        k = 0 if previous is None else previous.k + 1
        return cls(
            problem,
            k,
            v,
            energy_terms(problem, v) if terms is None else terms,
            change,
            **shown,
        )

    @property
    def energy(self) -> float:
        """Sum of the terms."""
        return sum(self.terms.values())

    @property
    def report(self) -> Report:
        """What was asked for and done on the way to it."""
        return self.problem.report

    @property
    def mask(self) -> BoolArray:
        """Pixels that take part, (H, W)."""
        return self.problem.mask

    @cached_property
    def distance(self) -> FloatArray:
        """Euclidean distance from the optical centre, (H, W), mm or relative; nan outside the mask."""
        return freeze(np.exp(self.log_distance))

    @cached_property
    def z(self) -> FloatArray:
        """z of the surface, (H, W), mm or relative; nan outside the mask."""
        return freeze(self.distance * self.problem.field.cos_alpha)

    @cached_property
    def normals(self) -> FloatArray:
        """Unit normals in the camera frame, towards the camera, (H, W, 3); nan outside the mask."""
        problem = self.problem
        return freeze(
            normals(self.log_distance, problem.field, self.mask, cuts=problem.cuts)
        )

    @cached_property
    def points(self) -> FloatArray:
        """Surface points in the camera frame, (H, W, 3), mm or relative; nan outside the mask."""
        return freeze(points(self.log_distance, self.problem.field))

    def resample(self, problem: Problem) -> FloatArray:
        """Return log d on a problem's grid, (H, W), at the scale of its gain; nan where unknown."""
        maps = np.dstack([self.mask, np.where(self.mask, self.log_distance, 0.0)])
        known, v = np.moveaxis(resample(maps, problem.mask.shape), -1, 0)
        gain = problem.photometry.gain or 1.0
        gain_before = self.problem.photometry.gain or 1.0
        mean = np.divide(v, known, out=np.full(v.shape, np.nan), where=known > 0)
        return mean + 0.5 * np.log(gain / gain_before)

    def start_of(self, problem: Problem) -> FloatArray:
        """Return log d on a problem's grid, (H, W), and log d₀ where it does not reach."""
        v = self.resample(problem)
        return np.where(np.isnan(v), problem.log_d0, v)


Observer = Callable[[Iterate], bool | None]
Found = TypeVar("Found")
Solving = Generator[Iterate, None, Found]  # yields what is solved on the way
Solver = Solving[Status]


@dataclass(frozen=True)
class Stage:
    """What came of one stage of a run."""

    name: str
    round: int
    iterations: int
    energy: float  # the least
    seconds: float  # observers apart


@dataclass(frozen=True, eq=False)
class Result:
    """What a run found.

    `distance`, `z`, `normals`, `points` and `mask` are those of the iterate that is the answer:
    the last one of a run that converged, else the one of least energy. The
    history has a row per iterate of the last stage that solved: k, energy, its terms, change, seconds and
    the solver's scalars.
    """

    iterate: Iterate  # the answer
    status: Status  # why the run ended
    history: list[dict[str, float]]
    seconds: float  # what all stages took, observers apart
    stages: tuple[Stage, ...] = ()  # all, in order

    def __post_init__(self) -> None:
        v = self.iterate.log_distance[self.mask]
        # In any unit; beyond, it is a slip of the pen. Their squares are numbers in single precision, too.
        if not np.all(np.abs(v) <= np.log(1e12)):
            with np.errstate(over="ignore"):
                span = f"{np.exp(v.min()):.3g} to {np.exp(v.max()):.3g} {self.problem.unit}"
            cause = (
                "the gain, or the length that fixes the scale, is wrong by powers of ten"
            )
            raise ValueError(f"distances would be {span}: {cause}")

    @property
    def problem(self) -> Problem:
        """What was solved."""
        return self.iterate.problem

    @property
    def report(self) -> Report:
        """What was asked for and done on the way to it, in numbers and enums."""
        return self.problem.report

    @property
    def iterations(self) -> int:
        """Number of steps from the start."""
        return int(self.history[-1]["k"])

    @property
    def energy(self) -> float:
        """Energy of the answer."""
        return self.iterate.energy

    @cached_property
    def left(self) -> float:
        """Share of the energy, from 0 to 1, that one Gauss-Newton step from the answer would still remove.

        Found when it is asked for: it takes such a step, whatever solved the problem.
        """
        return energy_left(self.problem, self.iterate.log_distance)

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


class _StageLog:
    """What is kept of one stage: its history, its last iterate and the one of least energy."""

    def __init__(self, first: Iterate) -> None:
        self.last = self.lowest = first
        self.history: list[dict[str, float]] = []

    def add(self, iterate: Iterate, seconds: float) -> None:
        self.last = iterate
        self.lowest = iterate if iterate.energy < self.lowest.energy else self.lowest
        row = {
            "k": iterate.k,
            "energy": iterate.energy,
            **iterate.terms,
            "change": iterate.change,
        }
        self.history.append(row | {"seconds": seconds, **iterate.scalars})

    def answer(self, status: Status) -> Iterate:
        return self.last if status.is_done else self.lowest


def limit_steps(steps: Solver, max_iterations: int | None = None) -> Solver:
    """Pass iterates on as long as they are finite and not too many."""
    try:
        while True:
            try:
                iterate = next(steps)
            except StopIteration as end:
                status: Status = end.value
                return status
            if not np.all(np.isfinite(iterate.log_distance[iterate.mask])):
                return Status.NON_FINITE
            yield iterate
            if (
                max_iterations is not None
                and iterate.stage == SOLUTION
                and iterate.k >= max_iterations
            ):
                return Status.MAX_ITERATIONS
    finally:
        steps.close()


def name_stage(steps: Solver, stage: str, round: int = 0) -> Solving[Iterate]:
    """Pass on the iterates of a solver whose energy only falls as those of a stage, and return the last."""
    for iterate in steps:
        named = replace(iterate, stage=stage, round=round)
        yield named
    return named


def run(
    iterates: Solver,
    observers: Iterable[Observer] = (),
    last: Callable[[Iterate], Iterate] | None = None,
) -> Result:
    """Drive a solver to its end.

    Parameters
    ----------
    iterates : generator of Iterate
        The solver.
    observers : iterable of callables
        Each is shown every iterate; True stops the run. One that has a method ``close`` is
        closed at the end, however the run ends.
    last : callable, optional
        What is made of the answer, such as the same in mm; observers are shown it too.

    Returns
    -------
    Result
        Also after a keyboard interrupt, if there is an iterate to return.
    """
    logs: list[_StageLog] = []
    stages: list[Stage] = []

    def keep(iterate: Iterate, seconds: float) -> None:
        if not logs or (logs[-1].last.stage, logs[-1].last.round) != (
            iterate.stage,
            iterate.round,
        ):
            logs.append(_StageLog(iterate))
        logs[-1].add(iterate, seconds)

    with close_observers(observers) as watching:
        status = drive(limit_steps(iterates), watching, keep)
        if not logs:
            raise ValueError("the solver produced no depth map that is finite")
        before = 0.0
        for stage in logs:
            shown = stage.last
            after = stage.history[-1]["seconds"]
            stages.append(
                Stage(
                    shown.stage, shown.round, shown.k, stage.lowest.energy, after - before
                )
            )
            before = after
        result = logs[-1].answer(status)
        answer = result if last is None else last(result)
        if answer is not result:
            for observer in watching:
                observer(answer)
    return Result(answer, status, logs[-1].history, before, tuple(stages))
