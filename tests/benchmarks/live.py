"""How many surfaces a second a camera gets, and how late they come: `python -m tests.benchmarks.live`.

Not a test: it asserts nothing and depends on the machine.
"""

import time
from dataclasses import replace
from statistics import median

import numpy as np

import endolab as el
from endolab import datasets
from endolab.batch.live import reconstruct_live
from tests.benchmarks.report import table
from tests.tools.problems import moved_colon

RATE = 30.0  # frames per second of the camera
SECONDS = 10.0
WAYS = {
    "green": {},
    "green, 240 px": {"width": 240},
    "separated, no contours": {"channel": "separated", "contours": False},
}


def camera(pictures: list[np.ndarray], seconds: float):
    """Pictures as a camera gives them, there and back again."""
    there_and_back = [*pictures, *pictures[-2:0:-1]]
    started = time.perf_counter()
    for number in range(round(seconds * RATE)):
        time.sleep(max(0.0, started + number / RATE - time.perf_counter()))
        yield f"{number:06d}", there_and_back[number % len(there_and_back)]


def main() -> None:
    """Follow a camera that moves 1 mm a frame through the colon, 320 x 240."""
    calibration = datasets.load_calibration("simple", 320)
    lit = el.render(moved_colon(0), calibration.camera, calibration.photometry).photometry
    known = el.Calibration(calibration.camera, replace(calibration.photometry, gain=None))
    seen = (
        el.render(moved_colon(t), known.camera, lit, noise=1, bits=8, seed=t)
        for t in range(12)
    )
    pictures = [one.image for one in seen]
    rows = []
    for name, options in WAYS.items():
        list(reconstruct_live(camera(pictures, 0.1), known, **options))  # compile
        steps = list(reconstruct_live(camera(pictures, SECONDS), known, **options))
        rate = f"{(len(steps) - 1) / SECONDS:.1f}"
        lag = f"{1000 * median(step.lag for step in steps):.0f}"
        rows.append([name, rate, lag, str(sum(step.dropped for step in steps))])
    head = ["way", "frames/s", "lag, ms", "dropped"]
    table(f"A camera of {RATE:g} frames/s, 320 x 240", head, rows)


if __name__ == "__main__":
    main()
