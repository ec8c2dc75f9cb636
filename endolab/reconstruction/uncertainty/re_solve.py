"""What the same frame would be if a choice were another: solved again, a few steps from the estimate.

Where a region is weakly connected, another λ or another contour moves it farther than its linear model says,
and elsewhere: so these two are not asked of `linearised`.
"""

from collections.abc import Generator

import numpy as np

from endolab.numerics.arrays import FloatArray
from endolab.solvers.gauss_newton import gauss_newton
from endolab.solvers.problem import Problem


def re_solve(
    problem: Problem, log_distance: FloatArray
) -> Generator[None, None, FloatArray]:
    """Log d (H, W) after a few steps from a map, a step of the solver each, so that who waits can stop.

    In four steps a surface goes most of its way.
    """
    last = log_distance
    for iterate in gauss_newton(problem, start=log_distance, max_iterations=4):
        last = iterate.log_distance
        yield None
    return np.where(problem.mask, last, 0.0)
