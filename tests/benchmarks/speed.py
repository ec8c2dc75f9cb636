"""Accuracy on scenes and published frames, and seconds: `python -m tests.benchmarks.speed [seconds]`.

Not a test: it asserts nothing and depends on the machine.
"""

import subprocess
import sys
from collections.abc import Callable
from statistics import median

import numpy as np

import endolab as el
from endolab import datasets
from endolab.metrics.depth_errors import compare
from endolab.numerics.threads import cores, limit_threads
from tests.benchmarks.report import both, ended, seconds_of, table
from tests.tools.problems import Shot, moved_colon

SOLVERS = ("facing", "fast_marching", "gauss_newton")


def scenes() -> None:
    """The solvers on the four scenes, exact and as a real camera would give them; λ is the same for all."""
    rows = []
    for kind, how in (("exact", {}), ("3 grey, 8 bit", {"noise": 3.0, "bits": 8})):
        for name in el.SCENES:
            shot = Shot(name, datasets.load_calibration("simple"), **how)
            for solver in SOLVERS:
                result = shot.reconstruct(solver=solver, channel="green")
                e = shot.errors(result)
                errors = both(e, "mm"), both(e, "percent"), both(e, "degrees", 3)
                rows.append([name, kind, solver, ended(result), *errors])
    heads = (
        "scene",
        "frame",
        "solver",
        "iterations",
        "distance [mm]",
        "distance [%]",
        "normals [°]",
    )
    table("Scenes at 320x240, 90° pinhole: mean / median errors", heads, rows)


def published() -> None:
    """The solvers on the published frames, where they are."""
    folder = datasets.data_folder()
    if folder is None:
        print("\nPublished frames: not found; set ENDOLAB_DATA to their folder.")
        return
    samples = {
        f"C3VD {i}": datasets.read_c3vd(folder / "c3vd_trans_t1_a", i) for i in (1, 6)
    }
    samples |= {
        f"SimCol3D {i}": datasets.read_simcol3d(folder / "simcol3d", i) for i in range(5)
    }
    rows = []
    for name, sample in samples.items():
        for channel in ("red", "green", "blue", "grey"):
            for solver in SOLVERS:
                result = el.reconstruct(
                    sample.frame, sample.calibration, solver=solver, channel=channel
                )
                cosine = result.problem.field.cos_alpha
                near_axis = cosine > np.cos(np.deg2rad(55))
                e = compare(
                    result.distance, sample.distance, cosine, mask=near_axis, scale="median"
                )
                errors = both(e, "percent", 2), both(e, "mm", 2), f"{e.rmse_z_mm:.2f}"
                rows.append([name, channel, solver, ended(result), *errors])
    heads = (
        "frame",
        "channel",
        "solver",
        "iterations",
        "mean / median [%]",
        "mean / median [mm]",
    )
    heads += ("RMSE of z [mm]",)
    table(
        "Published frames, k 2.5, γ 2.2, median-scaled, within 55° of the axis", heads, rows
    )


def imports() -> None:
    """Seconds to import endolab, and to have its main call ready, in a fresh interpreter."""
    rows = []
    for code in (
        "import endolab",
        "import endolab; endolab.reconstruct",
        "import endolab; endolab.record",
    ):
        timed = (
            f"import time; t = time.perf_counter(); {code}; print(time.perf_counter() - t)"
        )
        runs = [
            float(
                subprocess.run(
                    [sys.executable, "-c", timed], capture_output=True, check=True
                ).stdout
            )
            for _ in range(5)
        ]
        rows.append([code, f"{median(runs):.3f}"])
    table("Import time", ("code", "seconds (median of 5)"), rows)


def runs(width: int) -> dict[str, Callable[[], object]]:
    """What people wait for, of a colon that moves on by a millimetre a frame."""
    calibration = datasets.load_calibration("simple", width)
    lit = el.render(moved_colon(0), calibration.camera, calibration.photometry).photometry
    known = el.Calibration(calibration.camera, lit)
    video = []
    for t in range(4):
        seen = el.render(moved_colon(t), calibration.camera, lit, noise=1, bits=8, seed=t)
        video.append((str(t), el.Frame(seen.image, seen.mask, str(t))))
    frame = video[0][1]
    one = {"channel": "green", "regulariser": "second"}
    found = el.reconstruct(frame, known, **one)
    steps = {"solver": "primal_dual", "max_iterations": 100, "channel": "green"}
    return {
        "cold": lambda: el.reconstruct(frame, known, **one),
        "warm, λ × 1.1": lambda: el.reconstruct(frame, known, lam=1.1, start=found, **one),
        "curvature": lambda: el.reconstruct(
            frame, known, channel="green", regulariser="curvature"
        ),
        "the default": lambda: el.reconstruct(frame, known),
        "fast marching": lambda: el.reconstruct(frame, known, solver="fast_marching"),
        "4 frames, 1 mm apart": lambda: list(el.reconstruct_sequence(video, known, **one)),
        "100 primal-dual steps": lambda: el.reconstruct(frame, known, **steps),
    }


def seconds() -> None:
    """Milliseconds on one core, two, ..., all, at three sizes."""
    counts = sorted({1, 2, cores()})
    rows = []
    for width in (320, 640, 1440):
        for name, call in runs(width).items():
            times = []
            for count in counts:
                with limit_threads(count):
                    times.append(1e3 * seconds_of(call, 7 if width < 1440 else 3))
            rows.append([f"{width} px", name, *(f"{one:.0f}" for one in times)])
    table(
        "Milliseconds, medians",
        ("size", "what", *(f"on {count}" for count in counts)),
        rows,
    )


TABLES = {one.__name__: one for one in (scenes, published, imports, seconds)}

if __name__ == "__main__":
    for name in sys.argv[1:] or TABLES:
        TABLES[name]()
