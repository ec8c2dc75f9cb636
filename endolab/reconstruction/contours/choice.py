"""Where the surface is cut: at the picture's steep lines, if the evidence says that it pays.

A contour that is really there lets the picture be explained by a much smoother surface. The steeper a line
of a picture (`lines`), the more likely it is a contour: nine of ten that are steeper than .07 are in traced
colons, and six to eight of ten that are steeper than .035; among polyps these are two or three of ten. So a
surface is solved uncut and then cut at ever less steep lines. Where light bounced, the first two of these
start from the uncut one, so that two cores can solve them side by side, and others from the one before:

    uncut --+--> cut at lines > .07
            +--> cut at lines > .035 --> cut at lines > .018 --> ...        which of them?

`ContourChoice` answers. Where three colours see one wall, the right surface is the one on whose light they
agree best; of one channel, the energy tells whether there is anything to be cut at all.

A cut surface begins as the uncut one: what lies behind an open line comes loose only as far as the energy
wants. A start on the far side would not do: regions that are held by little stay as far as they are put.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.reconstruction.channels import Task, start_from
from endolab.reconstruction.contours.lines import find_contours
from endolab.solvers.gauss_newton import DESCENT, gauss_newton
from endolab.solvers.problem import Problem
from endolab.solvers.provenance import (
    ContourOutcome,
    ContourReport,
    LightOutcome,
    Provenance,
)
from endolab.solvers.result import Iterate, Result, name_stage, with_provenance

SMOOTH = "smooth"  # stage: before anything is cut
CONTOURS = "contours"  # stage: cut


@dataclass(frozen=True)
class Trial:
    """A surface that is cut, or not, and what speaks for it."""

    surface: Iterate
    # Of the lines that are cut; None of the uncut surface.
    min_steepness: float | None = None
    light: LightOutcome | None = None  # what its colours tell; None without three colours
    factor: float = 0.0  # indirect light over what the surface predicts
    misfit: float = 0.0  # mean disagreement of the three colours' log E

    @property
    def cut_length(self) -> float:
        """How long its cuts are, in heights of the picture."""
        cuts = self.surface.problem.cuts
        if cuts is None:
            return 0.0
        mask = self.surface.mask
        return float(cuts.sum()) * max(mask.shape) / float(mask.sum())


@dataclass(frozen=True)
class ContourChoice:
    """Which of several surfaces is taken: the uncut one, or one of those that are cut.

    The constants were chosen on the open frames of `tests/benchmarks/unseen.py` and on path-traced ones.
    """

    # How steep lines must be to be cut, one trial after the other: log d₀ per 1/320 of the longer side.
    min_steepness: tuple[float, ...] = (0.07, 0.035, 0.018)
    # Share of the uncut surface's energy that a cut as long as the picture's height must save, if only the
    # energy speaks for it: so gentle folds of a real phantom stay whole. And where no light bounced: there
    # the picture is the model's own, and its lines are to be trusted.
    price: float = 0.1
    clean_price: float = 0.02
    # The least cut surface is taken whose misfit is at most so many times the least, or as many times more
    # as the colours ask for indirect light.
    misfit_limit: float = 1.08

    def goes_on(self, trials: Sequence[Trial]) -> bool:
        """Whether less steep lines might do better than those that were tried; the uncut surface is first."""
        if trials[0].light is LightOutcome.NONE_BOUNCED:
            return True
        limit = self._misfit_limit(trials, trials)
        return self.colours_are_reliable(trials) and trials[-1].misfit <= limit

    def choose(
        self, trials: Sequence[Trial], always: bool = False
    ) -> tuple[int, ContourOutcome]:
        """Return the number of the surface that is taken, and what decided.

        The uncut one is the first; it is not taken if there are to be contours `always`.
        """
        if len(trials) == 1:
            return 0, ContourOutcome.NONE_CLEAR
        number, outcome = self._choose_among(trials, 1 if always else 0)
        return number, outcome if number else ContourOutcome.NONE_CLEAR

    def _choose_among(
        self, trials: Sequence[Trial], first: int
    ) -> tuple[int, ContourOutcome]:
        allowed = range(first, len(trials))
        by_energy = ContourOutcome.BY_ENERGY
        if trials[0].light is LightOutcome.NONE_BOUNCED:  # its energy is the picture's own
            return self._cheapest(trials, allowed, self.clean_price), by_energy
        if not self.colours_are_reliable(trials):
            is_cut = first == 1 or is_worth_cutting(trials[1], trials[0], self.price)
            return int(is_cut), by_energy
        limit = self._misfit_limit(trials, trials[first:])
        as_good = [number for number in allowed if trials[number].misfit <= limit]
        if as_good[0] == 0:  # the colours do not tell it from those that are cut
            return self._cheapest(trials, as_good, self.price), by_energy
        return as_good[0], ContourOutcome.BY_COLOURS

    def colours_are_reliable(self, trials: Sequence[Trial]) -> bool:
        """Whether what the colours say of the first two surfaces can be."""
        return all(trial.light is not LightOutcome.COMPUTED for trial in trials[:2])

    def _misfit_limit(self, trials: Sequence[Trial], allowed: Sequence[Trial]) -> float:
        """Largest misfit at which a surface is as good as the best."""
        least = min(trial.misfit for trial in allowed)
        return self.misfit_limit * max(trials[0].factor, 1.0) * least

    @staticmethod
    def _cheapest(trials: Sequence[Trial], allowed: Sequence[int], price: float) -> int:
        """Return the number of the surface whose log energy and cuts cost least."""

        def cost(number: int) -> float:
            trial = trials[number]
            return float(np.log(trial.surface.energy)) + price * trial.cut_length

        return min(allowed, key=cost)


CHOICE = ContourChoice()


def is_worth_cutting(cut: Trial, uncut: Trial, price: float = CHOICE.price) -> bool:
    """Whether cuts save this price."""
    return cut.surface.energy / uncut.surface.energy + price * cut.cut_length < 1


def cut_at_contours(
    problem: Problem,
    min_steepness: float = CHOICE.min_steepness[0],
    lines: FloatArray | None = None,
) -> Problem:
    """Cut the surface at the picture's lines that are steeper than this, if there are any."""
    if lines is None:
        lines = find_contours(problem.log_d0, problem.mask)
    cuts = lines > min_steepness
    return replace(problem, cuts=cuts if cuts.any() else None)


def enlarge_cuts(cuts: BoolArray, shape: tuple[int, ...]) -> BoolArray:
    """Return cuts (2, h, w), as `Problem` has them, on more pixels (H, W).

    A pixel halfway between two of the fewer counts as the one nearer to the picture's middle.
    """

    def source(fewer: int, more: int) -> np.ndarray:
        middle = np.arange(more) + 0.5 - more / 2
        return np.floor(fewer / 2 + (1 - 1e-9) * fewer / more * middle).astype(int)

    rows = source(cuts.shape[1], shape[0])
    columns = source(cuts.shape[2], shape[1])
    enlarged = cuts[:, rows[:, None], columns]
    enlarged[0] &= np.diff(columns, append=columns[-1]) > 0
    enlarged[1] &= np.diff(rows, append=rows[-1])[:, None] > 0
    return enlarged


def min_steepness_of(result: Result) -> float | None:
    """Return how steep the lines are at which a surface is cut; the steepest, if cuts were given."""
    if result.problem.cuts is None:
        return None
    report = result.provenance.contours
    known = None if report is None else report.min_steepness
    return known or CHOICE.min_steepness[0]


def solve_stage(
    problem: Problem, provenance: Provenance, stage: str, number: int = 0, **options: Any
) -> Generator[Iterate, None, Iterate]:
    """Solve a problem as a round of a stage, from the surface of the one before; return the answer.

    A cut one is near: what moves far hangs by few pixels, and coarser grids do not see these.
    """
    halvings = 0 if problem.cuts is not None else DESCENT.like_halvings
    options = {"halvings": halvings} | options
    steps = with_provenance(gauss_newton(problem, **options), provenance)
    return (yield from name_stage(steps, stage, number))


def solve_cut(
    uncut: Iterate, always: bool = False, price: float = CHOICE.price
) -> Generator[Iterate, None, Iterate]:
    """Solve a problem of one channel again, cut at its steepest lines; return the surface that is taken.

    It is the `uncut` one if there are no such lines, or if cuts do not save their `price`, unless they are
    asked for `always`.
    """
    problem = cut_at_contours(uncut.problem)
    if problem.cuts is None:
        return uncut
    surface = yield from solve_stage(
        problem, uncut.provenance, CONTOURS, start=uncut.log_distance
    )
    is_cut = always or is_worth_cutting(Trial(surface), Trial(uncut), price)
    return surface if is_cut else uncut


def choose_contours(
    task: Task, contours: bool | None, before: Result | None = None
) -> Generator[Iterate, None, Task]:
    """Cut the surface of one channel where contours are found in its picture, before it is solved.

    `contours` says whether to, by default if that explains the picture much better. What was cut in an
    earlier result, `before`, is cut without asking. A task that knows its contours is returned as it is.
    """
    problem = task.problem
    if task.provenance.contours is not None:
        return task
    if problem.cuts is not None:
        return with_contours(task, problem, ContourOutcome.GIVEN)
    if contours is False:
        return with_contours(task, problem, ContourOutcome.NOT_ASKED)
    if before is not None:
        steepness = min_steepness_of(before)
        cut = problem if steepness is None else cut_at_contours(problem, steepness)
        outcome = (
            ContourOutcome.NONE_CLEAR if cut.cuts is None else ContourOutcome.AS_BEFORE
        )
        return with_contours(task, cut, outcome, steepness)
    uncut = yield from solve_stage(task.small, task.provenance, SMOOTH)
    surface = yield from solve_cut(uncut, always=bool(contours))
    if surface.problem.cuts is None:
        return with_contours(task, problem, ContourOutcome.NONE_CLEAR)
    steepness = CHOICE.min_steepness[0]
    cut = cut_at_contours(problem, steepness)
    task = replace(task, start=start_from(surface, cut))
    return with_contours(task, cut, ContourOutcome.BY_ENERGY, steepness)


def with_contours(
    task: Task,
    problem: Problem,
    outcome: ContourOutcome,
    min_steepness: float | None = None,
) -> Task:
    """Return a task whose problem is cut, with the report on it."""
    report = ContourReport(outcome, count_cuts(problem), min_steepness)
    provenance: Provenance = replace(task.provenance, contours=report)
    return replace(task, problem=problem, provenance=provenance)


def count_cuts(problem: Problem) -> int:
    """Return over how many steps a surface is cut."""
    return 0 if problem.cuts is None else int(problem.cuts.sum())
