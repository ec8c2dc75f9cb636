"""endolab beside what one would take instead, beside itself on one core, and beside the memory's speed.

All in one run, in turn, so that ratios hold where seconds do not: `python -m tests.benchmarks.ratios`.
Not a test: it asserts nothing and depends on the machine.
"""

import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import spsolve

import endolab as el
from endolab import datasets
from endolab.depth import multigrid
from endolab.depth.gauss_newton import DAMPING, MOST, PRECISION, gauss_newton
from endolab.depth.grid import Grid
from endolab.depth.primal_dual import _Path
from endolab.depth.problem import Problem
from endolab.numerics.compiled import inner, padded
from endolab.numerics.threads import cores, limited_threads
from endolab.reconstruction.problem_setup import make_problem
from tests.benchmarks.report import bandwidth, seconds_of, table
from tests.depth import primal_dual_model
from tests.tools.problems import moved_colon

# (rows, columns) from a pixel to the other of each pair of its matrix's nine numbers.
OFFSETS = ((0, 0), (0, 1), (0, 2), (1, 0), (2, 0), (1, 1), (1, -1), (1, 2), (2, 1))
SWEEP_BYTES, MULTIPLY_BYTES = 36 + 12, 72 + 16  # a pixel: the matrix, and vectors read and written once


def shots(width: int, count: int = 1) -> tuple[list[el.Frame], el.Calibration]:
    """Frames of a colon, a millimetre apart."""
    calibration = datasets.load_calibration("simple", width)
    lit = el.render(moved_colon(0), calibration.camera, calibration.photometry).photometry
    seen = (el.render(moved_colon(t), calibration.camera, lit, noise=1, bits=8, seed=t) for t in range(count))
    frames = [el.Frame(one.image, one.mask, str(t)) for t, one in enumerate(seen)]
    return frames, el.Calibration(calibration.camera, lit)


def green(width: int) -> Problem:
    """What the paper's channel leaves to solve."""
    (frame,), calibration = shots(width)
    return make_problem(frame, calibration, channel="green")


def as_sparse(matrix: np.ndarray) -> csc_array:
    """SciPy's form of nine padded numbers a pixel, but for the padding."""
    wide, size = matrix.shape[2], matrix[0].size
    diagonals = [
        (down * wide + right, numbers.ravel()) for (down, right), numbers in zip(OFFSETS, matrix, strict=True)
    ]
    upper = [numbers[: size - offset] for offset, numbers in diagonals]
    offsets = [offset for offset, _ in diagonals]
    whole = diags_array(
        [*upper, *upper[1:]], offsets=[*offsets, *(-o for o in offsets[1:])], shape=(size, size)
    )
    kept = np.flatnonzero(matrix[0].ravel() > 0)
    return csc_array(whole.tocsc()[kept][:, kept])


def instead() -> None:
    """A step by multigrid beside SciPy's direct solver; a step of the paper's path beside plain NumPy."""
    rows = []
    for width in (80, 160, 320):
        grid = Grid.of(green(width))
        v = padded(np.where(grid.mask, grid.log_facing, 0.0))
        coefficients, b = grid.linearised(v, 1.0)
        cycles = multigrid.Multigrid(coefficients, DAMPING)
        sparse, right = as_sparse(cycles.matrix), b[cycles.matrix[0] > 0]
        ours = seconds_of(lambda c=cycles, b=b: c.solve(b, PRECISION, MOST))
        close = seconds_of(lambda c=cycles, b=b: c.solve(b, 1e-6, 500), 3)
        theirs = seconds_of(lambda s=sparse, r=right: spsolve(s, r), 1)
        for name, taken in ((f"to {PRECISION:g}, as in a step", ours), ("to 1e-6", close)):
            times = f"{1e3 * taken:.1f}", f"{1e3 * theirs:.0f}", f"{theirs / taken:.0f}"
            rows.append([f"normal equations {name}", f"{width} px", "SciPy's spsolve", *times])
    problem = green(320)
    path = _Path.at(problem, problem.log_facing, 0, 0.7)
    ours = seconds_of(lambda: path.advance(10, 1.0, 1.0)) / 10
    primal_dual_model.patch_means = lambda p, *_: p  # patches and s are there for reading, in slow loops
    twin = primal_dual_model.PrimalDualModel(problem, problem.log_facing, 0, 0.7)
    twin.gain = lambda *_: 1.0
    theirs = seconds_of(lambda: twin.step(1.0), 5)
    times = f"{1e3 * ours:.2f}", f"{1e3 * theirs:.1f}", f"{theirs / ours:.0f}"
    rows.append(["a step of the paper's path", "320 px", "NumPy, which leaves out patches", *times])
    table("What one would take instead", ("what", "size", "instead", "ms", "theirs", "times as long"), rows)


def runs(width: int) -> dict[str, Callable[[], object]]:
    """What people wait for."""
    (frame, *others), calibration = shots(width, 4)
    problem, one = green(width), {"channel": "green", "regulariser": "second"}
    found = el.reconstruct(frame, calibration, **one)
    path = _Path.at(problem, problem.log_facing, round(8 * width / 320), 0.7)
    video = [(each.name, each) for each in (frame, *others)]
    return {
        "cold": lambda: el.reconstruct(frame, calibration, **one),
        "warm, λ × 1.1": lambda: el.reconstruct(frame, calibration, lam=1.1, start=found, **one),
        "curvature, cold": lambda: el.run(gauss_newton(replace(problem, regulariser="curvature"))),
        "the default": lambda: el.reconstruct(frame, calibration),
        "4 frames, 1 mm apart": lambda: list(el.reconstruct_sequence(video, calibration, **one)),
        "10 steps of the paper's path": lambda: path.advance(10, 1.0, 1.0),
    }


def scaling() -> None:
    """The same on one core, two, four, ..., all."""
    counts = sorted({min(2**k, cores()) for k in range(cores().bit_length() + 1)})
    rows = []
    for width in (320, 640, 1440):
        for name, call in runs(width).items():
            seconds = []
            for count in counts:
                with limited_threads(count):
                    seconds.append(seconds_of(call, 3))
            ratios = [f"{seconds[0] / one:.2f}" for one in seconds[1:]]
            rows.append([f"{width} px", name, *(f"{1e3 * one:.1f}" for one in seconds), *ratios])
            print(".", end="", flush=True)
    heads = (*(f"ms on {count}" for count in counts), *(f"× on {count}" for count in counts[1:]))
    table("Scaling", ("size", "what", *heads), rows)


def bound() -> None:
    """How near loops come to the memory's speed: of frames that no cache holds, they cannot pass it."""
    rate, rows = bandwidth(), []
    for width in (320, 1440):
        grid = Grid.of(green(width))
        v = padded(np.where(grid.mask, grid.log_facing, 0.0))
        coefficients, b = grid.linearised(v, 1.0)
        cycles = multigrid.Multigrid(coefficients)
        top, out = cycles.levels[0], b.copy()
        equations = top.matrix, top.inverse, top.x, top.b
        timed = {
            "two sweeps, single precision": (lambda e=equations: multigrid.sweep_forwards(*e), SWEEP_BYTES),
            "matrix times x, double precision": (
                lambda c=cycles, b=b, out=out: multigrid.multiply(c.matrix, b, out),
                MULTIPLY_BYTES,
            ),
        }
        for name, (call, size) in timed.items():
            seconds, pixels = seconds_of(call), inner(b).size
            least = size * pixels / rate
            times = f"{1e3 * seconds:.2f}", f"{1e3 * least:.2f}", f"{seconds / least:.1f}"
            rows.append([f"{width} px", name, *times])
    heads = ("size", "loop", "ms", "the memory's ms", "times as long")
    table(f"Beside the memory, which copies {rate / 1e9:.1f} GB/s on one core", heads, rows)


TABLES = {one.__name__: one for one in (instead, scaling, bound)}

if __name__ == "__main__":
    for name in sys.argv[1:] or TABLES:
        TABLES[name]()
