"""How far frames that nobody tuned to are from their truth: random path-traced frames, open and sealed.

    python -m tests.benchmarks.unseen [open | sealed | smooth]...

`open` is the default. `sealed` frames are for the end: made, scored and not looked at, so that the gap
to the open ones tells how much was tuned to those. Sets that are not in build/unseen are made with
Mitsuba. Where a frame's calibration has one albedo, it is green's, and red
and blue alone are then of another scale. No test: it takes minutes.
"""

import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import endolab as el
from endolab.metrics.depth_errors import Errors, compare, depth_cuts
from endolab.model.photometry import CHANNELS
from endolab.reconstruction.sentences import notes
from tests.benchmarks.report import table
from tests.tools.random_frames import SETS, RandomFrame, make, read

FOLDER = Path(__file__).resolve().parents[2] / "build" / "unseen"
WAYS: dict[str, dict[str, Any]] = {
    "facing": {"solver": "facing"},
    **{name: {"channel": name} for name in CHANNELS},
    "separated": {"channel": "separated"},
    "automatic": {"channel": "auto"},
}
# the best of three, as told by the truth
BEST = "best colour"
TORN = "separated, true contours"
WORSE = 1.0  # points of the mean in percent, by which a way may be worse than the best single colour


@dataclass(frozen=True)
class Score:
    """What one way made of one frame."""

    errors: Errors
    seconds: float
    notes: tuple[str, ...]


def score(sample: RandomFrame, **options: Any) -> Score:
    """Reconstruct a frame one way and compare it with its truth, at true scale."""
    started = time.process_time()
    result = el.reconstruct(sample.frame, sample.calibration, **options)
    seconds = time.process_time() - started
    cosine = sample.calibration.camera.field.cos_alpha
    both = {"normals": result.normals, "true_normals": sample.normals}
    return Score(
        compare(result.distance, sample.distance, cosine, **both), seconds, notes(result)
    )


def ways_of(sample: RandomFrame) -> dict[str, Score]:
    """Score every way that there is, by name."""
    found = {name: score(sample, **options) for name, options in WAYS.items()}
    found[BEST] = min(
        (found[name] for name in CHANNELS), key=lambda one: one.errors.mean_percent
    )
    found[TORN] = score(sample, channel="separated", cuts=depth_cuts(sample.distance))
    return found


def _cells(scores: Sequence[Score]) -> list[str]:
    """Means over frames of the mean and median error in percent and mm, of normals and of seconds."""
    errors = [one.errors for one in scores]
    names = ("mean_percent", "median_percent", "mean_mm", "median_mm", "mean_degrees")
    percent, middle, mm, middle_mm, degrees = (
        np.mean([getattr(e, name) for e in errors]) for name in names
    )
    worst = max(e.mean_percent for e in errors)
    seconds = np.mean([one.seconds for one in scores])
    shares = [
        f"{percent:5.1f} / {middle:4.1f}",
        f"{worst:5.1f}",
        f"{mm:5.2f} / {middle_mm:5.2f}",
    ]
    return [*shares, f"{degrees:5.1f}", f"{seconds:5.1f}"]


def report(title: str, frames: Iterable[Path]) -> None:
    """Print the table of a set, and where the default is worse than the best single colour."""
    scored = []
    for path in frames:
        sample = read(path)
        scored.append((sample, ways_of(sample)))
        line = "  ".join(
            f"{name} {one.errors.mean_percent:.1f}" for name, one in scored[-1][1].items()
        )
        print(f"{sample.frame.name:16}{line}", flush=True)
    heads = [
        "kind",
        "frames",
        "way",
        "mean / median %",
        "worst %",
        "mean / median mm",
        "normals °",
        "CPU s",
    ]
    rows = []
    for kind in [*sorted({sample.kind for sample, _ in scored}), "all"]:
        of_kind = [found for sample, found in scored if kind in (sample.kind, "all")]
        count = str(len(of_kind))
        ways = list(of_kind[0])
        rows += [
            [kind, count, way, *_cells([found[way] for found in of_kind])] for way in ways
        ]
    table(title, heads, rows)
    for sample, found in scored:
        default = found["automatic"]
        least = found[BEST].errors.mean_percent
        if default.errors.mean_percent > least + WORSE:
            notes = " ".join(default.notes) or "it said nothing"
            print(
                f"{sample.frame.name}: {default.errors.mean_percent:.1f} % after {least:.1f} %: {notes}"
            )


if __name__ == "__main__":
    for wanted in sys.argv[1:] or ["open"]:
        make(SETS[wanted], FOLDER / wanted)
        report(
            f"Unseen frames, {wanted}: at true scale",
            sorted((FOLDER / wanted).glob("*.npz")),
        )
