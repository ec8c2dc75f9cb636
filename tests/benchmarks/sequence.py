"""Videos and sweeps as tables: seconds a frame, memory, two cores against one.

Not a test: it asserts nothing and depends on the machine.
"""

import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np

import endolab as el
from endolab import datasets
from tests.tools.problems import moved_colon

SIZES = (("simple", 320), ("paper", 1440))  # 320x240 and 1440x1080
FRAMES = {320: 6, 1440: 4}


def shots(name: str, width: int) -> tuple[list[tuple[str, np.ndarray]], el.Calibration]:
    """A video of the colon, 1 mm a frame, and its calibration of unknown gain."""
    calibration = datasets.load_calibration(name, width)
    photometry = calibration.photometry
    camera, lit = calibration.camera, el.render(moved_colon(0), calibration.camera, photometry).photometry
    times = range(FRAMES[width])
    seen = (el.render(moved_colon(t), camera, lit, noise=1, bits=8, seed=t).image for t in times)
    return list(zip(map(str, times), seen, strict=True)), el.Calibration(
        camera, replace(photometry, gain=None)
    )


def peak() -> float:
    """Peak resident memory of this process, GB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def video(name: str, width: int) -> None:
    """Print seconds a frame, cold and within a video; in a process of its own, for its memory."""
    frames, calibration = shots(name, width)
    camera = calibration.camera
    _ = camera.field
    list(el.reconstruct_sequence(frames[:2], calibration, width=80))  # compile
    before, cold = peak(), []
    for title, image in frames[1:4]:
        started = time.perf_counter()
        el.reconstruct(el.Frame(image, np.ones(image.shape[:2], bool), title), calibration)
        cold.append(time.perf_counter() - started)
    steps = list(el.reconstruct_sequence(frames, calibration))
    warm = [step.seconds for step in steps[1:]]
    ratio = [step.result.iterations for step in steps if step.result is not None]
    print(
        f"{camera.width}x{camera.height}: cold {median(cold):.2f} s, within a video {median(warm):.2f} s, "
        f"{sum(step.warm for step in steps)} of {len(steps)} warm, iterations {ratio}, "
        f"peak {peak():.2f} GB ({before:.2f} before)",
        flush=True,
    )


def cores() -> None:
    """Print what a sweep takes on one core and on two."""
    frames, calibration = shots("simple", 320)
    pictures = [el.Frame(image, np.ones(image.shape[:2], bool), title) for title, image in frames]
    with tempfile.TemporaryDirectory() as folder:
        taken = {}
        for jobs, backend in ((1, "loky"), (2, "loky"), (2, "threading")):
            for turn in ("compile", "measure"):
                started = time.perf_counter()
                table = Path(folder) / f"{jobs}{backend}{turn}.csv"
                lam = (0.1, 0.3, 1.0, 3.0, 10.0) if turn == "measure" else (1.0,)
                el.sweep(pictures, calibration, lam=lam, table=table, n_jobs=jobs, backend=backend)
                taken[jobs, backend] = time.perf_counter() - started
    one = taken[1, "loky"]
    for (jobs, backend), seconds in taken.items():
        print(
            f"sweep of 30, {jobs} {backend}: {seconds:.2f} s, {one / seconds:.2f} times as fast", flush=True
        )


if __name__ == "__main__":
    if sys.argv[1:]:
        video(sys.argv[1], int(sys.argv[2]))
    else:
        for name, width in SIZES:
            subprocess.run([sys.executable, "-m", "tests.benchmarks.sequence", name, str(width)], check=True)
        cores()
