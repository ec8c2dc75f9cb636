"""What the same frame would be if a choice were another: solved anew, a few steps from the estimate.

Where a surface hangs by little, another λ or another contour moves it farther than its linear model says, and
elsewhere: so these two are not asked of `linearised`.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from endolab.depth.gauss_newton import gauss_newton
from endolab.depth.problem import Problem
from endolab.model.ranges import RANGES
from endolab.numerics.arrays import BoolArray, FloatArray

STEPS = 3  # that a surface is given to answer; it goes most of its way in two
LONGEST = 1.0  # of an answer, in log d: what goes farther is lost anyway

Answer = Generator[None, None, FloatArray]


class Anew:
    """A problem and a map v = log d that solves it, or nearly.

    Answers are generators, a step of a solver each, so that who waits can stop; they return how log d moves.
    """

    def __init__(self, problem: Problem, log_distance: FloatArray) -> None:
        self._problem, self._start = problem, np.where(problem.mask, log_distance, 0.0)
        self._still: FloatArray | None = None

    def with_lam(self, times: float) -> Answer:
        """How log d answers to λ that is so many times as large."""
        lam = min(self._problem.lam * times, RANGES["lam"][1])
        return self._moved(replace(self._problem, lam=lam))

    def with_cuts(self, cuts: BoolArray) -> Answer:
        """How log d answers to a surface that is torn there."""
        return self._moved(replace(self._problem, cuts=cuts))

    def _moved(self, problem: Problem) -> Answer:
        if self._still is None:  # a map that was stopped, or thinned, moves in any case
            self._still = yield from self._solved(self._problem)
        found = yield from self._solved(problem)
        return np.clip(found - self._still, -LONGEST, LONGEST)

    def _solved(self, problem: Problem) -> Answer:
        last = self._start
        for iterate in gauss_newton(problem, start=self._start, max_iterations=STEPS):
            last = iterate.log_distance
            yield None
        return np.where(problem.mask, last, 0.0)
