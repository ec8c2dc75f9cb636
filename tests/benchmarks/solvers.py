"""The iterative solvers as tables, all or some by name: `python -m tests.benchmarks.solvers sizes`.

Not a test: it asserts nothing and depends on the machine.
"""

import gc
import sys
import tracemalloc
from dataclasses import replace
from itertools import product
from statistics import median

import endolab as el
from endolab import datasets
from endolab.reconstruction.channels import make_problem
from endolab.solvers.problem import Problem
from endolab.solvers.solvers import solve
from tests.benchmarks.report import both, ended, table
from tests.tools.problems import Shot

SIZES = (80, 160, 320, 640, 1440)
PRIMAL_DUAL_SIZES = (80, 160, 320)  # its iterations grow with the pixels
PAPER = (  # Table I: scene, ξ, order, iterations, mean / median %, mean / median °
    ("plane", "1/z", "first", "1148", "0.90 / 0.04", "1.19 / 0.20"),
    ("plane", "1/z", "second", "73", "0.32 / 0.09", "0.62 / 0.18"),
    ("curved", "1/z", "first", "102", "0.35 / 0.37", "1.00 / 0.50"),
    ("curved", "1/z", "second", "64", "0.25 / 0.21", "0.95 / 0.39"),
    ("tube", "1/z", "first", ">5550", "7.30 / 6.73", "12.17 / 9.44"),
    ("tube", "1/z", "second", ">1500", "5.83 / 5.31", "11.07 / 8.00"),
    ("tube", "d", "second", "301", "5.85 / 4.99", "12.92 / 9.15"),
    ("tube", "1/d", "second", "78", "5.78 / 5.21", "11.55 / 8.30"),
)


def shot_of(scene, width=320, **how):
    """A frame of one albedo and its truth."""
    calibration = datasets.load_calibration("simple", width)
    return Shot(scene, calibration, calibration.photometry.channel("green"), **how)


def problem_of(shot: Shot) -> Problem:
    """What `reconstruct` would solve."""
    return make_problem(shot.frame, shot.calibration)


def fresh(problem: Problem) -> Problem:
    """Return the problem without what it has cached but for its camera's rays."""
    _ = problem.field.rays
    return replace(problem)


def table_one() -> None:
    """Table I of the paper, row by row, and the default solver."""
    rows = []
    for scene, xi, order, iterations, theirs, their_degrees in PAPER:
        shot = shot_of(scene)
        for solver in ("primal_dual", "gauss_newton"):
            how = {
                "solver": solver,
                "xi": xi,
                "regulariser": order,
                "max_iterations": 20000,
            }
            how["channel"] = "grey"
            result = shot.reconstruct(**how)
            e = shot.errors(result)
            ours = (
                ended(result),
                f"{result.seconds:.2f}",
                both(e, "percent"),
                both(e, "degrees", 3),
            )
            rows.append(
                [scene, xi, order, solver, *ours, iterations, theirs, their_degrees]
            )
    heads = (
        "scene",
        "ξ",
        "order",
        "solver",
        "iterations",
        "s",
        "% mean / median",
        "° mean / median",
    )
    heads += ("paper: iterations", "%", "°")
    table("Table I at 320x240, exact frames", heads, rows)


def sizes() -> None:
    """Solver by scene by size: iterations, seconds, energy, errors, peak memory."""
    rows = []
    for width, scene in product(SIZES, el.SCENES):
        shot = shot_of(scene, width)
        problem = problem_of(shot)
        solvers = ("fast_marching", "gauss_newton", "primal_dual")
        for solver in solvers if width in PRIMAL_DUAL_SIZES else solvers[:2]:
            result = el.run(solve(fresh(problem), solver))
            repeats = 1 if solver == "primal_dual" or width > 640 else 3
            seconds = median(
                el.run(solve(fresh(problem), solver)).seconds for _ in range(repeats)
            )
            measured = fresh(problem)
            gc.collect()
            tracemalloc.start()
            el.run(
                solve(measured, solver),
                max_iterations=400 if solver == "primal_dual" else None,
            )
            peak = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
            warm = ""
            if solver == "gauss_newton":
                moved = replace(problem, lam=1.1 * problem.lam)
                start = result.iterate.log_distance
                again = [
                    el.run(solve(fresh(moved), solver, start=start)).seconds
                    for _ in range(repeats)
                ]
                warm = f"{1e3 * median(again):.0f}"
            e = shot.errors(result)
            pixels = int(problem.mask.sum())
            times = f"{1e3 * seconds:.0f}", warm, f"{1e6 * seconds / pixels:.2f}"
            errors = f"{result.energy:.3e}", both(e, "percent"), both(e, "degrees", 3)
            size = f"{width}x{problem.camera.height}"
            rows.append(
                [size, scene, solver, ended(result), *times, *errors, f"{peak / 2**20:.0f}"]
            )
            print(".", end="", flush=True)
    heads = ("size", "scene", "solver", "iterations", "ms", "warm ms", "µs/pixel", "energy")
    heads += ("% mean / median", "° mean / median", "peak MiB")
    table(
        "Solver, scene, size (ms: solver alone, median of 3, or of 1 where slow)",
        heads,
        rows,
    )


TABLES = {one.__name__: one for one in (table_one, sizes)}

if __name__ == "__main__":
    for name in sys.argv[1:] or TABLES:
        TABLES[name]()
