"""What recording costs in time and on disk, and leaves behind: `python -m tests.benchmarks.recording [RUNS]`.

Not a test: it asserts nothing and depends on the machine.
"""

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil

import endolab as el
from endolab import datasets
from endolab.recording.recorder import Recorder
from tests.benchmarks.report import table

RUNS = {
    "gauss_newton, cold": {"channel": "green"},
    "automatic": {},
    "primal_dual, 100 steps": {"solver": "primal_dual", "max_iterations": 100},
    "primal_dual, 100 steps, each shown": {"solver": "primal_dual", "max_iterations": 100, "every": 1},
}


class Timed:
    """An observer that tells how long the file took when the run had ended."""

    def __init__(self, observer: Recorder) -> None:
        self.observer, self.writing = observer, 0.0

    def __call__(self, iterate: el.Iterate) -> None:
        self.observer(iterate)

    def close(self) -> None:
        """Close the recording."""
        started = time.perf_counter()
        self.observer.close()
        self.writing = time.perf_counter() - started


def main(repeats: int) -> None:
    """Time each solver with and without a recording, in turn, on the colon at 320 x 240.

    The overhead within the run, the seconds from its end until the file is written, and both together.
    """
    calibration = datasets.load_calibration("paper", width=320)
    scene = el.render(el.SCENES["colon"], calibration.camera, calibration.photometry, noise=1, bits=8)
    frame, known = el.Frame(scene.image, scene.mask), el.Calibration(scene.camera, scene.photometry)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.rrd"
        for name, options in RUNS.items():
            taken = []
            for _ in range(repeats + 1):
                observer = Timed(el.record(path))
                clocks = [(time.perf_counter(), time.process_time())]
                for observers in ([], [observer]):
                    el.reconstruct(frame, known, observers=observers, **options)
                    clocks.append((time.perf_counter(), time.process_time()))
                (alone, alone_cpu), (both, both_cpu) = np.diff(clocks, axis=0)
                taken.append([alone, both - observer.writing, observer.writing, both, both_cpu - alone_cpu])
            alone, during, writing, both, computing = np.median(taken[1:], axis=0)  # the first compiles
            rows.append([name, *(f"{1000 * seconds:.0f}" for seconds in (alone, during))])
            rows[-1] += [f"{100 * (during / alone - 1):.0f} %", f"{1000 * writing:.0f}"]
            rows[-1] += [f"{100 * (both / alone - 1):.0f} %", f"{1000 * computing:.0f}"]
            rows[-1].append(f"{path.stat().st_size / 1e6:.1f}")
    titles = ["run", "alone, ms", "recorded, ms", "overhead", "then writing, ms", "overhead in all"]
    table("Recording a run, 320 x 240", [*titles, "processor, ms", "file, MB"], rows)


def many(count: int = 200) -> None:
    """Tell threads and memory of a process that makes one recording after another, of a small frame."""
    calibration = datasets.load_calibration("paper", width=32)
    scene = el.render(el.SCENES["colon"], calibration.camera, calibration.photometry)
    frame, process, rows = el.Frame(scene.image, scene.mask), psutil.Process(), []
    with tempfile.TemporaryDirectory() as folder:
        for done in range(1, count + 1):
            el.reconstruct(frame, calibration, observers=[el.record(Path(folder) / "run.rrd")])
            if done in (1, 10, 50, 100, count):
                megabytes = f"{process.memory_info().rss / 1e6:.0f}"
                rows.append([str(done), str(process.num_threads()), megabytes])
    table("One recording after another", ["recordings", "threads", "memory, MB"], rows)


if __name__ == "__main__":
    many()
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 7)
