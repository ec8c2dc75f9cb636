"""The iterative solvers as tables, all or some by name: `python -m tests.benchmarks.solvers sizes`.

Not a test: it asserts nothing and depends on the machine.
"""

import gc
import sys
import tracemalloc
from dataclasses import replace
from itertools import product
from statistics import median

import numpy as np

import endolab as el
from endolab import datasets
from endolab.depth import multigrid
from endolab.depth.energy import energy_terms
from endolab.depth.fast_marching import March
from endolab.depth.grid import Grid
from endolab.depth.primal_dual import _Path
from endolab.depth.problem import Problem
from endolab.depth.solvers import solve
from endolab.metrics.depth_errors import occlusion_cuts
from endolab.numerics.compiled import inner
from endolab.reconstruction.problem_setup import make_problem
from tests.benchmarks.report import bandwidth, both, ended, seconds_of, table
from tests.depth import primal_dual_model
from tests.depth.gauss_newton_model import GaussNewtonModel
from tests.tools.problems import Shot

SIZES = (80, 160, 320, 640, 1440)
PRIMAL_DUAL_SIZES = (80, 160, 320)  # its iterations grow with the pixels
LAMBDAS = (1e-3, 1e-2, 1e-1, 1.0, 10.0)
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
            how = {"solver": solver, "xi": xi, "regulariser": order, "max_iterations": 20000}
            how["channel"] = "grey"
            result = shot.reconstruct(**how)
            e = shot.errors(result)
            ours = ended(result), f"{result.seconds:.2f}", both(e, "percent"), both(e, "degrees", 3)
            rows.append([scene, xi, order, solver, *ours, iterations, theirs, their_degrees])
    heads = ("scene", "ξ", "order", "solver", "iterations", "s", "% mean / median", "° mean / median")
    heads += ("paper: iterations", "%", "°")
    table("Table I at 320x240, exact frames", heads, rows)


def colons() -> None:
    """Colons of several shapes, clean and not, with and without their true contours as cuts."""
    shapes = {
        "default": el.Colon(),
        "wide": el.Colon(radius=28.0, fold_spacing=34.0),
        "low folds": el.Colon(fold_height=0.25),
        "winding": el.Colon(winding=24.0),
    }
    rows = []
    for name, shape in shapes.items():
        for seed in range(3):
            how = {"texture": 0.08, "noise": 1.5} if seed else {}
            shot = shot_of(shape, seed=seed, **how)
            cuts = occlusion_cuts(shot.truth.distance)
            cells = [
                both(shot.errors(shot.reconstruct(solver=solver, cuts=chosen, channel="grey")), "percent", 2)
                for chosen, solver in product((None, cuts), ("fast_marching", "gauss_newton"))
            ]
            rows.append([name, f"8 % texture, 1.5 grey, seed {seed}" if how else "clean", *cells])
    heads = ("colon", "frame", "marching", "Gauss-Newton", "marching, true cuts", "Gauss-Newton, true cuts")
    table("Colons at 320x240: mean / median error of distance, %", heads, rows)


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
            seconds = median(el.run(solve(fresh(problem), solver)).seconds for _ in range(repeats))
            measured = fresh(problem)
            gc.collect()
            tracemalloc.start()
            el.run(solve(measured, solver), max_iterations=400 if solver == "primal_dual" else None)
            peak = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
            warm = ""
            if solver == "gauss_newton":
                moved, start = replace(problem, lam=1.1 * problem.lam), result.iterate.log_distance
                again = [el.run(solve(fresh(moved), solver, start=start)).seconds for _ in range(repeats)]
                warm = f"{1e3 * median(again):.0f}"
            e, pixels = shot.errors(result), int(problem.mask.sum())
            times = f"{1e3 * seconds:.0f}", warm, f"{1e6 * seconds / pixels:.2f}"
            errors = f"{result.energy:.3e}", both(e, "percent"), both(e, "degrees", 3)
            size = f"{width}x{problem.camera.height}"
            rows.append([size, scene, solver, ended(result), *times, *errors, f"{peak / 2**20:.0f}"])
            print(".", end="", flush=True)
    heads = ("size", "scene", "solver", "iterations", "ms", "warm ms", "µs/pixel", "energy")
    heads += ("% mean / median", "° mean / median", "peak MiB")
    table("Solver, scene, size (ms: solver alone, median of 3, or of 1 where slow)", heads, rows)


def sensitivity() -> None:
    """Error against λ for each ξ, and against the start."""
    rows = []
    for noise in (0.0, 3.0):
        shot = shot_of("tube", 160, noise=noise, **({"bits": 8} if noise else {}))
        for xi, order in product(("1/z", "d", "1/d"), ("first", "second")):
            how = {"xi": xi, "regulariser": order, "channel": "grey"}
            results = [shot.reconstruct(lam=lam, **how) for lam in LAMBDAS]
            cells = [f"{shot.errors(result).mean_percent:.2f}" for result in results]
            rows.append([f"{noise:g} grey", xi, order, *cells])
    heads = ("noise", "ξ", "order", *(f"λ {lam:g}" for lam in LAMBDAS))
    table("Gauss-Newton, tube at 160x120: mean error of distance, %, against λ", heads, rows)

    rows = []
    for scene in el.SCENES:
        shot = shot_of(scene)
        problem = problem_of(shot)
        middle = np.full(problem.mask.shape, float(np.median(problem.log_facing)))
        march = el.run(solve(problem, "fast_marching")).iterate.log_distance
        starts = {"none": None, "march": march, "d₀": problem.log_facing, "constant": middle}
        for name, start in starts.items():
            result = el.run(solve(problem, "gauss_newton", start=start))
            e, least = shot.errors(result), f"{result.energy:.3e}"
            rows.append([scene, name, ended(result), least, both(e, "percent"), both(e, "degrees", 3)])
    heads = ("scene", "start", "iterations", "energy", "% mean / median", "° mean / median")
    table("Gauss-Newton at 320x240 from other starts (none: coarse to fine)", heads, rows)


def kernels() -> None:
    """A march, and a Gauss-Newton step's compiled loops beside NumPy twins, and beside the memory's speed."""
    rate, rows = bandwidth(), []
    for width in (320, 1440):
        problem = problem_of(shot_of("colon", width))
        grid = Grid.of(problem)
        v = grid.march()
        coefficients, b = grid.linearised(v, 1.0)
        m, x, out = coefficients.matrix(0.0), b.copy(), b.copy()
        model = GaussNewtonModel.at(problem, inner(v))
        inverse = 1 / np.where(m[0] > 0, m[0], np.inf)
        cycles = multigrid.Multigrid(coefficients)
        given = problem.log_facing, problem.mask, problem.field.inverse_metric, None
        delta = inner(b).copy()
        twin = {"energy": lambda p=problem, v=v: energy_terms(p, inner(v))}
        twin["normal equations"] = lambda p=problem, v=v: GaussNewtonModel.at(p, inner(v))
        twin["matrix times x"] = lambda model=model, delta=delta: model.multiply(delta)
        timed = {  # what is run, and the bytes that it must read and write for each pixel
            "energy": (lambda g=grid, v=v: g.terms(v, 1.0), 75),
            "normal equations": (lambda g=grid, v=v: g.linearised(v, 1.0), 131),
            "assembly": (lambda c=coefficients: c.matrix(0.0), 107),
            "matrix times x": (lambda m=m, x=x, out=out: multigrid.multiply(m, x, out), 72),
            "sweep": (lambda m=m, i=inverse, x=x, b=b: multigrid.sweep_forwards(m, i, x.copy(), b), 88),
            "V-cycle": (lambda c=cycles: c._cycle(), 0),
            # d₀² and three of the metric read (32 B); d², heap, place read and written (32 B), fixed (1 B).
            "march": (lambda given=given: March.seeded(*given).advance(given[1].size), 65),
        }
        for name, (call, size) in timed.items():
            seconds = seconds_of(call)
            plain = f"{1e3 * seconds_of(twin[name], 3):.2f}" if name in twin else ""
            share = f"{100 * size * problem.mask.size / seconds / rate:.0f} %" if size else ""
            times = f"{1e3 * seconds:.2f}", f"{1e9 * seconds / problem.mask.size:.1f}"
            rows.append([f"{width}x{problem.camera.height}", name, *times, share, plain])
    heads = ("size", "loop", "ms", "ns/pixel", "of the memory's bandwidth", "NumPy twin ms")
    table(f"A march and the loops of a step; a large copy moves {rate / 1e9:.1f} GB/s", heads, rows)


def primal_dual_steps() -> None:
    """One step of the paper's path, compiled and in NumPy, without its energy."""
    problem = problem_of(shot_of("tube"))
    rows = []
    for radius in (0, 8):
        path = _Path.at(problem, problem.log_facing, radius, 0.7)
        ours = seconds_of(lambda path=path: path.advance(10, 1.0, 1.0), 5) / 10
        rows.append([f"{radius} px", f"{1e3 * ours:.2f}", ""])
    # Patches and s are written there for reading, in loops that take seconds.
    primal_dual_model.patch_means = lambda p, *_: p
    twin = primal_dual_model.PrimalDualModel(problem, problem.log_facing, 0, 0.7)
    twin.gain = lambda *_: 1.0
    rows[0][-1] = f"{1e3 * seconds_of(lambda: twin.step(1.0), 5):.1f}"
    heads = ("patch", "compiled ms", "NumPy ms, without s and patches")
    table("Primal-dual step, tube at 320x240", heads, rows)


TABLES = {one.__name__: one for one in (table_one, colons, sizes, sensitivity, kernels, primal_dual_steps)}

if __name__ == "__main__":
    for name in sys.argv[1:] or TABLES:
        TABLES[name]()
