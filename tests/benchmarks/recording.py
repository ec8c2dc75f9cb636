"""What recording costs in time and on disk: `python -m tests.benchmarks.recording [REPEATS]`.

Not a test: it asserts nothing and depends on the machine.
"""

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import endolab as el
from endolab import datasets
from tests.benchmarks.report import table

RUNS = {
    "gauss_newton, green": {"channel": "green"},
    "automatic": {},
    "primal_dual, 100 steps, each shown": {
        "solver": "primal_dual",
        "max_iterations": 100,
        "every": 1,
    },
}


def main(repeats: int) -> None:
    """Time each solver with and without a recording, in turn, on the colon at 320 x 240."""
    calibration = datasets.load_calibration("paper", width=320)
    scene = el.render(
        el.SCENES["colon"], calibration.camera, calibration.photometry, noise=1, bits=8
    )
    frame = el.Frame(scene.image, scene.mask)
    known = el.Calibration(scene.camera, scene.photometry)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.rrd"
        for name, options in RUNS.items():
            taken = []
            for _ in range(repeats + 1):
                clocks = [time.perf_counter()]
                for observers in ([], [el.record(path)]):
                    el.reconstruct(frame, known, observers=observers, **options)
                    clocks.append(time.perf_counter())
                taken.append(np.diff(clocks))
            alone, recorded = np.median(taken[1:], axis=0)  # the first compiles
            seconds = [
                f"{1000 * alone:.0f}",
                f"{1000 * recorded:.0f}",
                f"{recorded / alone:.2f}",
            ]
            rows.append([name, *seconds, f"{path.stat().st_size / 1e6:.1f}"])
    table(
        "Recording a run, 320 x 240",
        ["run", "alone, ms", "recorded, ms", "ratio", "file, MB"],
        rows,
    )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
