"""Accuracy and speed as tables: `make bench`.

Not a test: it asserts nothing and depends on the machine.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterable
from statistics import median

import numpy as np

import endolab as el
from endolab import datasets
from endolab.depth.fast_marching import March
from endolab.depth.problem import Problem
from endolab.metrics.depth_errors import Errors, compare

SOLVERS = ("facing", "fast_marching", "gauss_newton")


def table(title: str, heads: Iterable[str], rows: Iterable[Iterable[str]]) -> None:
    """Print an aligned table."""
    lines = [list(heads), *(list(row) for row in rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    print(f"\n{title}")
    for line in lines:
        print("  " + "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)))
    sys.stdout.flush()


def errors_of(result: el.Result, truth: np.ndarray, **options: object) -> Errors:
    """Errors of a result."""
    return compare(result.distance, truth, result.problem.field.cos_alpha, normals=result.normals, **options)


def scenes() -> None:
    """The solvers on the four scenes, exact and as a real camera would give them; λ is the same for all."""
    rows = []
    calibration = datasets.load_calibration("simple")
    for noise, bits in ((0.0, None), (3.0, 8)):
        for name, scene in el.SCENES.items():
            seen = el.render(scene, calibration.camera, calibration.photometry, noise=noise, bits=bits)
            frame = el.Frame(seen.image, seen.mask, name)
            known = el.Calibration(calibration.camera, seen.photometry)
            for solver in SOLVERS:
                result = el.reconstruct(frame, known, solver=solver)
                e = errors_of(result, seen.distance, true_normals=seen.normals)
                rows.append(
                    [
                        name,
                        "exact" if bits is None else f"{noise:g} grey, {bits} bit",
                        solver,
                        f"{result.iterations} {result.status.name}",
                        f"{e.mean_mm:.4f} / {e.median_mm:.4f}",
                        f"{e.mean_percent:.4f} / {e.median_percent:.4f}",
                        f"{e.mean_degrees:.3f} / {e.median_degrees:.3f}",
                    ]
                )
    heads = ("scene", "frame", "solver", "iterations", "distance [mm]", "distance [%]", "normals [°]")
    table("Scenes at 320x240, 90° pinhole: mean / median errors", heads, rows)


def published() -> None:
    """The solvers on the published frames, where they are."""
    folder = datasets.data_folder()
    if folder is None:
        print("\nPublished frames: not found; set ENDOLAB_DATA to their folder.")
        return
    samples = {f"C3VD {i}": datasets.read_c3vd(folder / "c3vd_trans_t1_a", i) for i in (1, 6)}
    samples |= {f"SimCol3D {i}": datasets.read_simcol3d(folder / "simcol3d", i) for i in range(5)}
    rows = []
    for name, sample in samples.items():
        for channel in ("red", "green", "blue", "grey"):
            for solver in SOLVERS:
                result = el.reconstruct(sample.frame, sample.calibration, solver=solver, channel=channel)
                near_axis = result.problem.field.cos_alpha > np.cos(np.deg2rad(55))
                e = errors_of(result, sample.distance, mask=near_axis, scale="median")
                rows.append(
                    [
                        name,
                        channel,
                        solver,
                        f"{result.iterations} {result.status.name}",
                        f"{e.mean_percent:.2f} / {e.median_percent:.2f}",
                        f"{e.mean_mm:.2f} / {e.median_mm:.2f}",
                        f"{e.rmse_z_mm:.2f}",
                    ]
                )
    heads = (
        "frame",
        "channel",
        "solver",
        "iterations",
        "mean / median [%]",
        "mean / median [mm]",
        "RMSE of z [mm]",
    )
    table("Published frames, k 2.5, γ 2.2, median-scaled, within 55° of the axis", heads, rows)


def _marching_seconds(problem: Problem, repeats: int = 5) -> float:
    log_facing, metric = problem.log_facing, problem.field.inverse_metric
    seconds = []
    for _ in range(repeats):
        started = time.perf_counter()
        march = March.seeded(log_facing, problem.mask, metric, None)
        march.advance(problem.mask.size)
        seconds.append(time.perf_counter() - started)
    return median(seconds)


def _bandwidth() -> float:
    """Bytes a second that a large copy reads and writes."""
    source, target = np.ones(16_000_000), np.empty(16_000_000)
    seconds = []
    for _ in range(7):
        started = time.perf_counter()
        np.copyto(target, source)
        seconds.append(time.perf_counter() - started)
    return 2 * source.nbytes / median(seconds)


def speed() -> None:
    """Time of a march per pixel, beside the time it takes to touch its arrays once."""
    # Per pixel: d₀² and three of the metric read (32 B); d², heap, place read and written (32 B), fixed.
    bound = 65 / _bandwidth()
    rows = []
    for width in (160, 320, 640, 1280, 1440):
        calibration = datasets.load_calibration("simple", width)
        seen = el.render(el.SCENES["colon"], calibration.camera, calibration.photometry.channel("green"))
        problem = Problem(seen.image, seen.mask, seen.camera, seen.photometry)
        _marching_seconds(problem, 1)
        seconds, pixels = _marching_seconds(problem), int(seen.mask.sum())
        started = time.perf_counter()
        el.reconstruct(
            el.Frame(seen.image, seen.mask),
            el.Calibration(seen.camera, seen.photometry),
            solver="fast_marching",
        )
        whole = time.perf_counter() - started
        rows.append(
            [
                f"{width}x{seen.camera.height}",
                f"{1e3 * seconds:.1f}",
                f"{1e6 * seconds / pixels:.3f}",
                f"{1e9 * seconds / (pixels * np.log2(pixels)):.1f}",
                f"{1e6 * bound:.4f}",
                f"{1e3 * whole:.0f}",
            ]
        )
    heads = (
        "size",
        "march [ms]",
        "µs/pixel",
        "ns/(pixel·log₂ n)",
        "bandwidth bound µs/pixel",
        "reconstruct [ms]",
    )
    table("Fast marching, colon, after compilation (median of 5)", heads, rows)


def imports() -> None:
    """Seconds to import endolab, and to have its main call ready, in a fresh interpreter."""
    rows = []
    for code in ("import endolab", "import endolab; endolab.reconstruct", "import endolab; endolab.record"):
        timed = f"import time; t = time.perf_counter(); {code}; print(time.perf_counter() - t)"
        runs = [
            float(subprocess.run([sys.executable, "-c", timed], capture_output=True, check=True).stdout)
            for _ in range(5)
        ]
        rows.append([code, f"{median(runs):.3f}"])
    table("Import time", ("code", "seconds (median of 5)"), rows)


if __name__ == "__main__":
    scenes()
    published()
    speed()
    imports()
