"""How far the default is from the truth, and what was chosen by that truth: a table in Markdown.

    python -m tests.benchmarks.accuracy [SET]...

Published frames are left out one by one: the light of each is measured on the others of its sequence. A set
that is not here has no row; `sealed` frames are scored once, at the end, so that they are to be named. No
test: it takes minutes.
"""

import sys

import numpy as np

import endolab as el
from endolab.metrics.depth_errors import Errors
from tests.benchmarks.frames import cases_of
from tests.benchmarks.report import table

NOTHING = "nothing"
THRESHOLDS = "λ and thresholds"
SETS = {
    "c3vd_shapes": ("the C3VD phantom's shapes, path-traced", NOTHING),
    "sealed": ("random cavities, sealed until the end", NOTHING),
    "simcol3d_nominal": ("SimCol3D, a simulated colon, nominal light", NOTHING),
    "simcol3d": (
        "the same, light measured on the other frames",
        "light, on the others",
    ),
    "c3vd": (
        "C3VD, photographs, light measured on the other frame",
        "light, on the other; thresholds",
    ),
    "scenes": ("rendered by the model: plane, bowl, tube, colon", THRESHOLDS),
    "rendered": ("colons, a bag, polyps", THRESHOLDS),
    "traced": ("path-traced colons: bare, mottled, wet, foggy", THRESHOLDS),
    "open": ("random cavities", THRESHOLDS),
}
HEADS = (
    "frames",
    "chosen on them",
    "number",
    "mean %",
    "median %",
    "worst %",
    "normals °",
)


def score(wanted: str) -> list[Errors]:
    """Reconstruct all frames of a set with the defaults; say how far each is off."""
    scores = []
    for case in cases_of(wanted):
        errors = case.errors_of(el.reconstruct(case.frame, case.calibration))
        light = case.calibration.photometry
        print(
            f"{case.name:18} k {light.k:.2f} γ {light.gamma:.2f}  mean {errors.mean_percent:.2f} %, "
            f"median {errors.median_percent:.2f} %, normals {errors.mean_degrees:.1f}°",
            flush=True,
        )
        scores.append(errors)
    return scores


def row_of(wanted: str) -> list[str]:
    """Means over the frames of a set."""
    scores = score(wanted)
    means = [
        np.mean([getattr(errors, name) for errors in scores]) if scores else np.nan
        for name in ("mean_percent", "median_percent", "mean_degrees")
    ]
    worst = max((errors.mean_percent for errors in scores), default=np.nan)
    values = (*means[:2], worst, means[2])
    cells = [f"{value:.1f}" if np.isfinite(value) else "–" for value in values]
    return [*SETS[wanted], str(len(scores)), *cells]


if __name__ == "__main__":
    names = sys.argv[1:] or [name for name in SETS if name != "sealed"]
    table("Accuracy of the default", HEADS, [row_of(name) for name in names])
