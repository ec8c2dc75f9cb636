"""The solvers by their names, and the simplest of them."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any

from endolab.depth.fast_marching import fast_marching
from endolab.depth.gauss_newton import gauss_newton
from endolab.depth.primal_dual import primal_dual
from endolab.depth.problem import Problem
from endolab.depth.result import Iterate, Solver
from endolab.model.schema import unknown_name
from endolab.numerics.iteration import Status


def facing(problem: Problem) -> Solver:
    """Solve I_c = cos θ / d² as if cos θ = 1: d₀ = I_c^(-1/2) (paper, Section V-E).

    One iterate: d₀ is an upper bound of the distance, reached where the surface faces the camera.
    """
    yield Iterate.of(problem, problem.log_facing)
    return Status.CONVERGED


SOLVERS: dict[str, Callable[..., Solver]] = {
    "facing": facing,
    "fast_marching": fast_marching,
    "gauss_newton": gauss_newton,
    "primal_dual": primal_dual,
}
DEFAULT_SOLVER = "gauss_newton"


def knows_curvature(solver: str, xi: str) -> bool:
    """Whether the regulariser "curvature" can be had: of ξ = 1/d, by all but `primal_dual`."""
    return xi == "1/d" and solver != "primal_dual"


def checked_solver(name: str, options: Mapping[str, Any]) -> Callable[..., Solver]:
    """Return the solver of that name, if there is one and it has these options."""
    known = options_of(name)
    for option in options:
        if option not in known:
            choice = f"it takes {', '.join(known)}" if known else "it takes none"
            raise ValueError(f"solver {name!r} has no option {option!r}; {choice}")
    return SOLVERS[name]


def options_of(solver: str) -> list[str]:
    """Names of the options that a solver takes."""
    if solver not in SOLVERS:
        raise unknown_name("solver", solver, SOLVERS)
    return list(inspect.signature(SOLVERS[solver]).parameters)[1:]


def solve(problem: Problem, solver: str = DEFAULT_SOLVER, **options: Any) -> Solver:
    """Iterates of one solver on a problem; the options are the solver's own."""
    return checked_solver(solver, options)(problem, **options)
