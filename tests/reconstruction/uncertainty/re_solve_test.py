"""What becomes of a surface if a choice were another: a few steps against a whole run."""

from dataclasses import replace

import numpy as np
import pytest

from endolab.reconstruction.contours.choice import cut_at_contours
from endolab.reconstruction.uncertainty.re_solve import re_solve
from endolab.solvers.gauss_newton import gauss_newton
from tests.tools.problems import finish, problem_of


def settled(problem, start=None):
    """Log d once there is nothing left to do, 0 outside the mask."""
    *_, last = gauss_newton(problem, start=start, tolerance=1e-4, max_iterations=100)
    return np.where(problem.mask, last.log_distance, 0.0)


@pytest.mark.parametrize("choice", ["λ", "contours"])
def test_it_moves_as_a_whole_run_does(choice):
    problem, _ = problem_of("colon", 100)
    v = settled(problem)
    other = (
        replace(problem, lam=4 * problem.lam) if choice == "λ" else cut_at_contours(problem)
    )
    found = finish(re_solve(other, v)) - v
    there = settled(other, v) - v
    assert np.std(there) > 0.005
    assert np.corrcoef(found.ravel(), there.ravel())[0, 1] > 0.8
    assert np.std(found) == pytest.approx(np.std(there), rel=0.3)
    assert np.all(found[~problem.mask] == 0)
