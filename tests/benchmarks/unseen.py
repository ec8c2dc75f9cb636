"""How far frames that nobody tuned to are from their truth: random path-traced frames, open and sealed.

    python -m tests.benchmarks.unseen [open | sealed | FOLDER]...

`open` is the default. `sealed` frames are for the end: made, scored and not looked at, so that the gap
to the open ones tells how much was tuned to those. Sets that are not in build/unseen are made with Mitsuba;
a FOLDER of such frames is scored as it is. Where a frame's calibration has one albedo, it is green's, and red
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
from endolab.metrics.depth_errors import Errors, compare, occlusion_cuts
from endolab.model.photometry import CHANNELS
from endolab.reconstruction.assumptions import notes
from tests.benchmarks.report import table
from tests.tools.random_frames import SETS, RandomFrame, make, read

FOLDER = Path(__file__).resolve().parents[2] / "build" / "unseen"
WAYS: dict[str, dict[str, Any]] = {
    "facing": {"solver": "facing"},
    **{name: {"channel": name} for name in CHANNELS},
    "separated": {"channel": "separated"},
    "automatic": {"channel": "auto"},
}
BEST, TORN = "best colour", "separated, true contours"  # the best of three, as told by the truth
JUDGED = ("green", "separated", "automatic")
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
    return Score(compare(result.distance, sample.distance, cosine, **both), seconds, notes(result))


def ways_of(sample: RandomFrame) -> dict[str, Score]:
    """Score every way that there is, by name."""
    found = {}
    for name, options in WAYS.items():
        try:
            found[name] = score(sample, **options)
        except ValueError as error:
            if "unknown channel" not in str(error):
                raise
    found[BEST] = min((found[name] for name in CHANNELS), key=lambda one: one.errors.mean_percent)
    found[TORN] = score(sample, channel="separated", cuts=occlusion_cuts(sample.distance))
    return found


def _cells(scores: Sequence[Score]) -> list[str]:
    """Means over frames of the mean and median error in percent and mm, of normals and of seconds."""
    errors = [one.errors for one in scores]

    def mean(name: str) -> float:
        return float(np.mean([getattr(one, name) for one in errors]))

    return [
        f"{mean('mean_percent'):5.1f} / {mean('median_percent'):4.1f}",
        f"{max(one.mean_percent for one in errors):5.1f}",
        f"{mean('mean_mm'):5.2f} / {mean('median_mm'):5.2f}",
        f"{mean('mean_degrees'):5.1f}",
        f"{np.mean([one.seconds for one in scores]):5.1f}",
    ]


def report(title: str, frames: Iterable[Path]) -> dict[str, float]:
    """Print the tables of a set; returns the mean over frames of the mean error in percent of every way."""
    scored = []
    for path in frames:
        sample = read(path)
        scored.append((sample, ways_of(sample)))
        line = "  ".join(f"{name} {one.errors.mean_percent:.1f}" for name, one in scored[-1][1].items())
        print(f"{sample.frame.name:16}{line}", flush=True)
    ways = list(scored[0][1])
    heads = ["kind", "frames", "way", "mean / median %", "worst %", "mean / median mm", "normals °", "CPU s"]
    kinds = sorted({sample.kind for sample, _ in scored})
    rows = []
    for kind in [*kinds, "all"]:
        of_kind = [found for sample, found in scored if kind in (sample.kind, "all")]
        rows += [[kind, str(len(of_kind)), way, *_cells([found[way] for found in of_kind])] for way in ways]
    table(title, heads, rows)
    for way in JUDGED:
        _tell_worse(way, [(sample, found) for sample, found in scored if way in found])
    return {way: float(np.mean([found[way].errors.mean_percent for _, found in scored])) for way in ways}


def _tell_worse(way: str, scored: Sequence[tuple[RandomFrame, dict[str, Score]]]) -> None:
    """Print on which frames a way is worse than the best single colour, and what it said of them."""
    if not scored:
        return
    worse = [
        (sample, found)
        for sample, found in scored
        if found[way].errors.mean_percent > found[BEST].errors.mean_percent + WORSE
    ]
    print(
        f"\n{way}: worse than the best colour by more than {WORSE:g} point on {len(worse)} of {len(scored)}"
    )
    for sample, found in worse:
        told, least = found[way], found[BEST].errors.mean_percent
        said = " ".join(told.notes) or "it said nothing"
        print(f"  {sample.frame.name:16} {told.errors.mean_percent:5.1f} % after {least:.1f} %: {said}")


def main(arguments: Sequence[str]) -> None:
    """Score sets or folders: ``python -m tests.benchmarks.unseen open sealed``."""
    means = {}
    for wanted in arguments or ["open"]:
        folder = FOLDER / wanted if wanted in SETS else Path(wanted)
        if wanted in SETS:
            make(SETS[wanted], folder)
        frames = sorted(folder.glob("*.npz"))
        if not frames:
            raise SystemExit(f"{folder} holds no frames")
        means[wanted] = report(f"Unseen frames, {wanted}: at true scale", frames)
    if set(SETS) <= set(means):
        rows = [
            [way, f"{means['open'][way]:.1f}", f"{far:.1f}", f"{far - means['open'][way]:+.1f}"]
            for way, far in means["sealed"].items()
        ]
        table("The gap: mean over frames of the mean error, %", ["way", "open", "sealed", "gap"], rows)


if __name__ == "__main__":
    main(sys.argv[1:])
