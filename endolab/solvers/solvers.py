"""The solvers by their names, and those that never ask the regulariser."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import check_int, unknown_name
from endolab.numerics.compiled import pad_maps
from endolab.numerics.iteration import Status
from endolab.solvers.fast_marching import march
from endolab.solvers.gauss_newton import gauss_newton
from endolab.solvers.grid import Grid
from endolab.solvers.primal_dual import primal_dual
from endolab.solvers.problem import Problem, check_maps
from endolab.solvers.result import Iterate, Solver


def facing(problem: Problem) -> Solver:
    """Solve I_c = cos θ / d² as if cos θ = 1: d₀ = I_c^(-1/2) (paper, Section V-E).

    One iterate: d₀ is an upper bound of the distance, reached where the surface faces the camera.
    """
    grid = Grid.of(problem)
    yield Iterate.of(
        problem, grid.log_d0, terms=grid.terms(pad_maps(grid.log_d0), problem.lam)
    )
    return Status.CONVERGED


def fast_marching(
    problem: Problem, inflow: FloatArray | None = None, snapshots: int = 1
) -> Solver:
    """Viscosity solution of the simplified model in one pass; see `march`.

    `inflow` (H, W) is log d where it is known, at the picture's border say, nan elsewhere; `snapshots`
    is how many times to yield as the front advances. First comes the start d₀, then the march where it
    has arrived (`maps["arrived"]`) and d₀, an upper bound, elsewhere; the last is the solution. An island
    of the mask is solved by itself. n pixels cost O(n log n), and distances err by the second power of
    the pixel on smooth surfaces. ValueError if the BRDF cannot be inverted or `inflow` cannot be used.
    """
    check_maps(problem.mask, inflow=inflow)
    check_int("snapshots", snapshots, 1)
    mask = problem.mask
    metric = problem.field.inverse_metric
    grid = Grid.of(problem)
    table = problem.photometry.slant_table()
    v, order = march(problem.log_d0, mask, metric, table, inflow, problem.cuts)
    count = -(-int(mask.sum()) // snapshots)
    iterate = None
    for last in range(0, order.max() + 1 + count, count):
        arrived = (order >= 0) & (order < last)
        shown = np.where(arrived, v, problem.log_d0)
        terms = grid.terms(pad_maps(np.where(mask, shown, 0.0)), problem.lam)
        iterate = Iterate.of(problem, shown, iterate, terms, maps={"arrived": arrived})
        yield iterate
    return Status.CONVERGED


SOLVERS: dict[str, Callable[..., Solver]] = {
    "facing": facing,
    "fast_marching": fast_marching,
    "gauss_newton": gauss_newton,
    "primal_dual": primal_dual,
}
DEFAULT_SOLVER = "gauss_newton"


def check_solver_options(name: str, options: Mapping[str, Any]) -> Callable[..., Solver]:
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
    return check_solver_options(solver, options)(problem, **options)
