"""How far the default is from the truth, what was chosen by that truth, and how far one channel alone is.

    python -m tests.benchmarks.accuracy [SET]...

Published frames are left out one by one: the light of each is measured on the others of its sequence. A set
that is not here has no row; `sealed` frames are scored once, at the end, so that they are to be named. No
test: it takes minutes.
"""

import sys

import numpy as np

from tests.benchmarks.frames import cases_of, table

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
        "C3VD, photographs, light and lamp measured on the other frame",
        "light, on the other; how far off the axis it is measured; thresholds",
    ),
    "scenes": ("rendered by the model: plane, bowl, tube, colon", THRESHOLDS),
    "rendered": ("colons, a bag, polyps", THRESHOLDS),
    "traced": ("path-traced colons: bare, mottled, wet, foggy", THRESHOLDS),
    "open": ("random cavities", THRESHOLDS),
}
WAYS = {"the default": {}, "green": {"channel": "green"}}


def rows_of(wanted):
    """Means over the frames of a set, a row for each way."""
    scores = {way: [] for way in WAYS}
    for case in cases_of(wanted):
        for way, options in WAYS.items():
            e = case.errors_of(case.solve(**options))
            scores[way].append(
                (e.mean_percent, e.median_percent, e.mean_percent, e.mean_degrees)
            )
            print(f"{case.name} {way} {e.mean_percent:.2f} %", flush=True)
    for way, found in scores.items():
        if found:
            means = np.mean(found, axis=0)
            means[2] = np.max(found, axis=0)[2]
            cells = [f"{v:.1f}" if np.isfinite(v) else "–" for v in means]
            yield way, [*SETS[wanted], str(len(found)), *cells]


if __name__ == "__main__":
    names = sys.argv[1:] or [name for name in SETS if name != "sealed"]
    rows = [row for name in names for row in rows_of(name)]
    for way in WAYS:
        table(
            f"Accuracy: {way}",
            (
                "frames",
                "chosen on them",
                "number",
                "mean %",
                "median %",
                "worst %",
                "normals °",
            ),
            [row for own, row in rows if own == way],
        )
