"""Videos and sweeps as tables: seconds a frame, cold and within a video, and two cores against one.

Not a test: it asserts nothing and depends on the machine.
"""

import tempfile
import time
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np

import endolab as el
from endolab import datasets
from tests.tools.problems import moved_colon

FRAMES = {("simple", 320): 6, ("paper", 1440): 4}  # 320x240 and 1440x1080


def shots(
    name: str, width: int, count: int
) -> tuple[list[tuple[str, np.ndarray]], el.Calibration]:
    """A video of the colon, 1 mm a frame, and its calibration of unknown gain."""
    calibration = datasets.load_calibration(name, width)
    camera = calibration.camera
    photometry = calibration.photometry
    lit = el.render(moved_colon(0), camera, photometry).photometry
    seen = (
        el.render(moved_colon(t), camera, lit, noise=1, bits=8, seed=t).image
        for t in range(count)
    )
    unknown = el.Calibration(camera, replace(photometry, gain=None))
    return [(str(number), image) for number, image in enumerate(seen)], unknown


def framed(shot: tuple[str, np.ndarray]) -> el.Frame:
    """A picture as a frame without a mask."""
    return el.Frame(shot[1], np.ones(shot[1].shape[:2], bool), shot[0])


def main() -> None:
    """Print what a frame takes, and what a sweep of thirty rows takes on one core and on two."""
    for (name, width), count in FRAMES.items():
        frames, calibration = shots(name, width, count)
        list(el.reconstruct_sequence(frames[:2], calibration, width=80))  # compile
        cold = median(
            el.reconstruct(framed(one), calibration).seconds for one in frames[1:4]
        )
        steps = list(el.reconstruct_sequence(frames, calibration))
        within = median(step.seconds for step in steps[1:])
        warm = sum(step.warm for step in steps)
        print(
            f"{width} px: cold {cold:.2f} s, within a video {within:.2f} s, {warm} of {count} warm",
            flush=True,
        )
    frames, calibration = shots("simple", 320, 6)
    pictures = [framed(one) for one in frames]
    lam = (0.1, 0.3, 1.0, 3.0, 10.0)
    with tempfile.TemporaryDirectory() as folder:
        for jobs, backend in ((1, "loky"), (2, "loky"), (2, "threading")):
            how = {"n_jobs": jobs, "backend": backend}
            # Compile.
            el.sweep(
                pictures[:2],
                calibration,
                table=Path(folder) / f"{jobs}{backend}.csv",
                **how,
            )
            started = time.perf_counter()
            el.sweep(
                pictures,
                calibration,
                lam=lam,
                table=Path(folder) / f"{jobs}{backend}30.csv",
                **how,
            )
            print(
                f"sweep of 30, {jobs} {backend}: {time.perf_counter() - started:.2f} s",
                flush=True,
            )


if __name__ == "__main__":
    main()
