"""The start that the paper uses: every normal faces the camera."""

from __future__ import annotations

from endolab.depth.energy import Problem
from endolab.iteration import Iterate, Solver, Status


def facing(problem: Problem) -> Solver:
    """Solve I_c = cos θ / d² as if cos θ = 1: d₀ = I_c^(-1/2) (paper, Section V-E).

    d₀ is an upper bound of the distance, reached where the surface faces the camera.

    Parameters
    ----------
    problem : Problem

    Yields
    ------
    Iterate
        One.
    """
    yield Iterate.of(problem, problem.log_facing)
    return Status.CONVERGED
