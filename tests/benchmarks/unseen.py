"""How far frames are from their truth, way by way: random path-traced ones, open and sealed, or another set.

    python -m tests.benchmarks.unseen [SET]...

`open` is the default. `sealed` frames are for the end: made, scored and not looked at, so that the gap
to the open ones tells how much was tuned to those. Sets that are not in build/unseen are made with
Mitsuba. Where a frame's calibration has one albedo, it is green's, and red
and blue alone are then of another scale. No test: it takes minutes.
"""

import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

import endolab as el
from endolab.metrics.depth_errors import Errors, depth_cuts
from endolab.model.photometry import CHANNELS
from endolab.reconstruction.report import notes
from tests.benchmarks.frames import Case, cases_of
from tests.benchmarks.report import table

WAYS: dict[str, dict[str, Any]] = {
    "facing": {"solver": "facing"},
    **{name: {"channel": name} for name in CHANNELS},
    "separated": {"channel": "separated"},
    "automatic": {},
}
BEST = "best colour"  # of three, as told by the truth
TRUE_CONTOURS = "separated, true contours"
WORSE = 1.0  # points of the mean in percent, by which a way may be worse than the best single colour
HEADS = ("kind", "frames", "way", "mean / median %", "worst %", "mean / median mm", "°")


def score(case: Case) -> dict[str, Errors]:
    """The errors of every way, by name; say where the default is worse than the best single colour."""
    cuts = depth_cuts(case.distance)
    ways = WAYS | {TRUE_CONTOURS: {"channel": "separated", "cuts": cuts}}
    found = {}
    sentences = ""
    for name, options in ways.items():
        result = el.reconstruct(case.frame, case.calibration, **options)
        found[name] = case.errors_of(result)
        if name == "automatic":
            sentences = " ".join(notes(result))
    found[BEST] = min((found[name] for name in CHANNELS), key=lambda e: e.mean_percent)
    percents = [f"{name} {errors.mean_percent:.1f}" for name, errors in found.items()]
    print(f"{case.name:16}", *percents, sep="  ", flush=True)
    if found["automatic"].mean_percent > found[BEST].mean_percent + WORSE:
        print(f"  worse than the best colour: {sentences}", flush=True)
    return found


def cells(scores: Sequence[Errors]) -> list[str]:
    """Means over frames."""
    names = ("mean_percent", "median_percent", "mean_mm", "median_mm", "mean_degrees")
    mean = {name: np.mean([getattr(e, name) for e in scores]) for name in names}
    worst = max(e.mean_percent for e in scores)
    return [
        "{mean_percent:.1f} / {median_percent:.1f}".format(**mean),
        f"{worst:.1f}",
        "{mean_mm:.2f} / {median_mm:.2f}".format(**mean),
        "{mean_degrees:.1f}".format(**mean),
    ]


def report(wanted: str) -> None:
    """Print the table of a set, by the kind of cavity."""
    scored = [(case.kind, score(case)) for case in cases_of(wanted)]
    rows = []
    for kind in [*sorted({kind for kind, _ in scored}), "all"]:
        of_kind = [found for own, found in scored if kind in (own, "all")]
        for way in of_kind[0]:
            errors = cells([found[way] for found in of_kind])
            rows.append([kind, str(len(of_kind)), way, *errors])
    table(f"Ways, {wanted}", HEADS, rows)


if __name__ == "__main__":
    for wanted in sys.argv[1:] or ["open"]:
        report(wanted)
