"""What the same frame would be if a choice were another: solved again, a few steps from the estimate.

Where a region is weakly connected, another λ or another contour moves it farther than its linear model says,
and elsewhere: so these two are not asked of `linearised`.
"""

from collections.abc import Generator

import numpy as np

from endolab.numerics.arrays import FloatArray
from endolab.solvers.gauss_newton import gauss_newton
from endolab.solvers.problem import Problem

ANSWER_STEPS = 4  # that a surface is given to answer; it goes most of its way
LARGEST_CHANGE = 1.0  # of an answer, in log d: what goes farther is lost anyway


def re_solve(
    problem: Problem, log_distance: FloatArray
) -> Generator[None, None, FloatArray]:
    """Log d (H, W) after a few steps from a map, a step of the solver each, so that who waits can stop."""
    last = log_distance
    for iterate in gauss_newton(problem, start=log_distance, max_iterations=ANSWER_STEPS):
        last = iterate.log_distance
        yield None
    return np.where(problem.mask, last, 0.0)
