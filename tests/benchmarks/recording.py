"""What recording costs in time and on disk, and leaves behind: `python -m tests.benchmarks.recording [RUNS]`.

Not a test: it asserts nothing and depends on the machine.
"""

import sys
import tempfile
import time
from pathlib import Path
from statistics import median

import psutil

import endolab as el
from endolab import datasets
from tests.benchmarks.report import table

RUNS = {
    "gauss_newton, cold": {"channel": "green"},
    "automatic": {},
    "primal_dual, 100 steps": {"solver": "primal_dual", "max_iterations": 100},
    "primal_dual, 100 steps, each shown": {"solver": "primal_dual", "max_iterations": 100, "every": 1},
}


def main(repeats: int) -> None:
    """Time each solver with and without a recording, in turn, on the colon at 320 x 240."""
    calibration = datasets.load_calibration("paper", width=320)
    scene = el.render(el.SCENES["colon"], calibration.camera, calibration.photometry, noise=1, bits=8)
    frame, known = el.Frame(scene.image, scene.mask), el.Calibration(scene.camera, scene.photometry)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.rrd"
        for name, options in RUNS.items():
            plain, recorded = [], []
            for _ in range(repeats + 1):
                started = time.perf_counter()
                el.reconstruct(frame, known, **options)
                middle = time.perf_counter()
                el.reconstruct(frame, known, observers=[el.record(path)], **options)
                plain.append(middle - started)
                recorded.append(time.perf_counter() - middle)
            alone, both = median(plain[1:]), median(recorded[1:])  # the first compiles
            share = f"{100 * (both / alone - 1):.0f} %"
            rows.append([name, f"{1000 * alone:.0f}", f"{1000 * both:.0f}", share])
            rows[-1].append(f"{path.stat().st_size / 1e6:.1f}")
    table("Recording a run, 320 x 240", ["run", "alone, ms", "recorded, ms", "overhead", "file, MB"], rows)


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
