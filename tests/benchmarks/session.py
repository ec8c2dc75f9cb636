"""A calibration from rendered pictures, end to end: `python -m tests.benchmarks.session [FRAMES [SEEDS]]`.

Not a test: it asserts nothing and depends on the machine; 300 frames take some minutes a video.
"""

import sys

import numpy as np

from endolab import datasets
from endolab.calibration.session import calibrate
from endolab.calibration.simulation.sheet_image import Sensor
from endolab.calibration.simulation.trajectory import Movement
from endolab.calibration.simulation.video import PAPER_SHEET, simulate_video
from endolab.calibration.targets import TARGETS
from endolab.model.photometry import Photometry
from tests.benchmarks.report import table

CAMERA = datasets.load_calibration("paper").camera
TRUTH = Photometry(2.5, 2.2, None, PAPER_SHEET)


def run(
    name: str, fold: float, count: int, seed: int, **options: object
) -> tuple[list[str], list[float]]:
    """Render, detect, calibrate; return a row of the table, and the pulls of k and γ."""
    seen = {"movement": Movement(fold), "sensor": Sensor(outliers=0.001)}
    video = simulate_video(TARGETS[name], CAMERA, TRUTH, count, seed=seed, **seen)
    stored = [
        (f"{number:04d}", frame.image.astype(np.float32))
        for number, frame in enumerate(video)
    ]
    size = CAMERA.width, CAMERA.height
    session = calibrate(stored, TARGETS[name], size=size, **options)
    light = session.light
    geometry = session.geometry
    assert light is not None, session.refused
    assert geometry is not None
    worst = max(
        abs(getattr(geometry.camera, x) - getattr(CAMERA, x))
        for x in ("fx", "fy", "cx", "cy")
    )
    row = [
        name,
        f"{len(session.poses)}/{count}",
        f"{geometry.rmse:.3f}",
        f"{worst:.3f}",
    ]
    pulls = []
    for parameter, off in (
        ("k", light.k - TRUTH.k),
        ("gamma", light.photometry.gamma - TRUTH.gamma),
    ):
        error = light.standard_errors[parameter]
        row.append(f"{off:+.4f} ± {error:.4f}")
        if error:
            pulls.append(abs(off) / error)
    return row, pulls


def main(count: int = 300, seeds: int = 1) -> None:
    """Print the table."""
    rows = []
    pulls: list[float] = []
    for seed in range(seeds):
        for name, fold, gamma in (
            ("vicalib_small", 0.0, 2.2),
            ("vicalib_folded", np.deg2rad(20), "free"),
        ):
            row, off = run(name, fold, count, seed, gamma=gamma)
            rows.append(row)
            pulls += off
    title = f"From {count} rendered pictures of 1440x1080, noise 3 grey levels"
    heads = ("target", "frames found", "RMSE px", "f, c px", "Δk", "Δγ")
    table(title, heads, rows)
    within = [f"{100 * np.mean(np.array(pulls) < limit):.0f} %" for limit in (1, 2)]
    print(f"k and γ within 1 and 2 standard errors: {' and '.join(within)}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
