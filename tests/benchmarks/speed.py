"""Accuracy on scenes, and seconds: `python -m tests.benchmarks.speed [seconds]`.

Not a test: it asserts nothing and depends on the machine.
"""

import sys
from collections.abc import Callable

import endolab as el
from endolab import datasets
from endolab.numerics.threads import cores, limit_threads
from tests.benchmarks.report import seconds_of, table
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
                errors = (
                    f"{e.mean_mm:.4f} / {e.median_mm:.4f}",
                    f"{e.mean_percent:.4f} / {e.median_percent:.4f}",
                    f"{e.mean_degrees:.3f} / {e.median_degrees:.3f}",
                )
                ended = f"{result.iterations} {result.status.name}"
                rows.append([name, kind, solver, ended, *errors])
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


def runs(width: int) -> dict[str, Callable[[], object]]:
    """What people wait for, of a colon that moves on by a millimetre a frame."""
    calibration = datasets.load_calibration("simple", width)
    lit = el.render(
        moved_colon(0), calibration.camera, calibration.photometry
    ).photometry
    known = el.Calibration(calibration.camera, lit)
    video = []
    for t in range(4):
        seen = el.render(
            moved_colon(t), calibration.camera, lit, noise=1, bits=8, seed=t
        )
        video.append((str(t), el.Frame(seen.image, seen.mask, str(t))))
    frame = video[0][1]
    one = {"channel": "green", "regulariser": "second"}
    found = el.reconstruct(frame, known, **one)
    steps = {"solver": "primal_dual", "max_iterations": 100, "channel": "green"}
    return {
        "cold": lambda: el.reconstruct(frame, known, **one),
        "warm, λ × 1.1": lambda: el.reconstruct(
            frame, known, lam=1.1, start=found, **one
        ),
        "the default": lambda: el.reconstruct(frame, known),
        "fast marching": lambda: el.reconstruct(frame, known, solver="fast_marching"),
        "4 frames, 1 mm apart": lambda: list(
            el.reconstruct_sequence(video, known, **one)
        ),
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


TABLES = {one.__name__: one for one in (scenes, seconds)}

if __name__ == "__main__":
    for name in sys.argv[1:] or TABLES:
        TABLES[name]()
