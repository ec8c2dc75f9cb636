"""A calibration from rendered pictures, end to end: `python -m tests.benchmarks.session [FRAMES]`.

Not a test: it asserts nothing and depends on the machine; 300 frames take some minutes a video.
"""

import sys

import numpy as np

from endolab import datasets
from endolab.calibration.session import calibrate
from endolab.calibration.simulation.video import PAPER_SHEET, simulate_video
from endolab.calibration.targets import TARGETS
from endolab.model.photometry import Photometry
from tests.benchmarks.frames import table

CAMERA = datasets.load_calibration("paper").camera
TRUTH = Photometry(2.5, 2.2, None, PAPER_SHEET)
HEADS = ("target", "frames found", "RMSE px", "f, c px", "Δk", "Δγ")


def row_of(name, fold, count, gamma):
    """Render, detect, calibrate; say how far camera and light are off."""
    target = TARGETS[name]
    video = simulate_video(target, CAMERA, TRUTH, count, fold=fold, outliers=0.001)
    stored = [
        (f"{number:04d}", frame.image.astype(np.float32))
        for number, frame in enumerate(video)
    ]
    size = CAMERA.width, CAMERA.height
    session = calibrate(stored, target, size=size, gamma=gamma)
    light = session.light
    found = session.geometry.camera
    off = [getattr(found, x) - getattr(CAMERA, x) for x in ("fx", "fy", "cx", "cy")]
    errors = light.standard_errors
    return [
        name,
        f"{len(session.poses)}/{count}",
        f"{session.geometry.rmse:.3f}",
        f"{np.abs(off).max():.3f}",
        f"{light.k - TRUTH.k:+.4f} ± {errors['k']:.4f}",
        f"{light.photometry.gamma - TRUTH.gamma:+.4f} ± {errors['gamma']:.4f}",
    ]


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 300
    flat = row_of("vicalib_small", 0.0, count, 2.2)
    folded = row_of("vicalib_folded", np.deg2rad(30), count, "free")
    table(f"From {count} rendered pictures, noise 3 grey levels", HEADS, [flat, folded])
