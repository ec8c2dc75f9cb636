"""How far the stated σ of a surface can be trusted: how often the truth lies within it, by kind of pixel.

    python -m tests.benchmarks.trust [open | sealed | shipped | real | FOLDER]...

`shipped` is the default. Errors and σ are shares of the distance. *Whole* is the error at true scale with all
that is uncertain, `sigma`; *shape* the error once the median of d*/d is taken out, with `sigma_shape`: real
frames, of unknown scale, have that alone. Near a contour are pixels within some px of a jump of the truth.
"In all" are means over frames, but for *pooled*: of as many pixels of each frame together, against one
constant for all of them, where else each frame has a best constant of its own. No test: it takes minutes;
sets and real frames as in `unseen` and `colon`.
"""

import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

import endolab as el
from endolab import datasets
from endolab.io.descriptions import Calibration
from endolab.metrics.coverage import Coverage, coverage_of
from endolab.metrics.depth_errors import occlusion_cuts
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.derivatives import REFERENCE_WIDTH
from endolab.preprocessing.frame import Frame
from endolab.uncertainty.shares import BORDER, DATA, PRIOR
from tests.benchmarks.colon import at_width, with_light
from tests.benchmarks.report import table
from tests.benchmarks.unseen import FOLDER
from tests.tools.random_frames import SETS, make, read

NEAR = 4.0  # px per 320 of the width, from a contour
POOLED = 4000  # pixels of each frame, drawn at random
FEW = 50  # pixels of a kind, below which a frame has none of it
WIDTH = 320  # px, of real frames
FIELD = 55.0  # degrees off the axis, beyond which C3VD's fisheye is not judged
WHOLE, SHAPE = "whole", "shape"


@dataclass(frozen=True)
class Case:
    """A frame with its truth."""

    name: str
    frame: Frame
    calibration: Calibration
    truth: FloatArray
    most: float = 90.0  # degrees off the axis
    metric: bool = True


@dataclass(frozen=True)
class Judged:
    """What was found of one frame."""

    name: str
    found: dict[tuple[str, str], Coverage]  # by whole or shape, and kind of pixel
    shares: dict[str, float]  # of the pixels that are of a kind, %
    pooled: dict[str, FloatArray]  # whole or shape: distance, σ and truth of some pixels, (3, n)
    seconds: tuple[float, float]  # CPU: to reconstruct, and to know how far


def cases_of(wanted: str) -> Iterator[Case]:
    """Frames of a set, or of a folder."""
    if wanted == "shipped":
        for name in datasets.TRACED:
            traced = datasets.load_traced(name)
            yield Case(name, traced.frame, traced.calibration, traced.distance)
        return
    if wanted == "real":
        folder = datasets.data_folder()
        for index in (1, 6):
            sample = datasets.read_c3vd(folder / "c3vd_trans_t1_a", index)
            frame, calibration, truth = at_width(sample, WIDTH)
            yield Case(f"c3vd {index}", frame, with_light(calibration, k=2.5, gamma=2.2), truth, FIELD, False)
        for index in (0, 3):
            frame, calibration, truth = at_width(datasets.read_simcol3d(folder / "simcol3d", index), WIDTH)
            yield Case(f"simcol {index}", frame, with_light(calibration), truth, metric=False)
        return
    here = FOLDER / wanted if wanted in SETS else Path(wanted)
    if wanted in SETS:
        make(SETS[wanted], here)
    paths = sorted(here.glob("*.npz"))
    if not paths:
        raise SystemExit(f"{here} holds no frames")
    for path in paths:
        drawn = read(path)
        yield Case(drawn.frame.name, drawn.frame, drawn.calibration, drawn.distance)


def near_contours(truth: FloatArray) -> BoolArray:
    """Pixels beside a jump of the truth."""
    right, below = occlusion_cuts(truth)
    jumps = right | below
    jumps[:, 1:] |= right[:, :-1]
    jumps[1:] |= below[:-1]
    away = scipy.ndimage.distance_transform_edt(~jumps) if jumps.any() else np.full(truth.shape, np.inf)
    return np.asarray(away <= NEAR * truth.shape[1] / REFERENCE_WIDTH)


def judge(case: Case) -> Judged:
    """Reconstruct a frame, ask how far that can be trusted, and see."""
    times = [time.process_time()]
    result = el.reconstruct(case.frame, case.calibration)
    times.append(time.process_time())
    trust = el.trust_of(result, case.calibration)
    times.append(time.process_time())
    cosine, truth = result.problem.field.cos_alpha, case.truth
    seen = np.nan_to_num(cosine, nan=-1.0) > np.cos(np.deg2rad(case.most))
    seen &= result.mask & np.isfinite(truth)
    close = near_contours(truth)
    kinds = {"all": seen, "near contours": seen & close, "elsewhere": seen & ~close}
    for kind, number in (("data", DATA), ("border", BORDER), ("prior", PRIOR)):
        kinds[kind] = seen & (trust.decided_by == number)
    factor = coverage_of(result.distance, trust.sigma_shape, truth, seen, scale="median").scale
    maps = {SHAPE: np.stack([factor * result.distance, factor * trust.sigma_shape, truth])}
    if case.metric:
        maps = {WHOLE: np.stack([result.distance, trust.sigma, truth]), **maps}
    found = {
        (error, kind): coverage_of(*stack, where)
        for error, stack in maps.items()
        for kind, where in kinds.items()
        if where.sum() >= FEW
    }
    shares = {kind: 100 * where.sum() / seen.sum() for kind, where in kinds.items()}
    drawn = np.random.default_rng(0).choice(np.flatnonzero(seen), POOLED)
    pooled = {error: stack.reshape(3, -1)[:, drawn] for error, stack in maps.items()}
    return Judged(case.name, found, shares, pooled, (times[1] - times[0], times[2] - times[1]))


def _cells(every: Sequence[Coverage]) -> list[str]:
    """Means over frames."""

    def mean(name: str) -> float:
        return float(np.nanmean([getattr(one, name) for one in every]))

    return [
        f"{mean('within_one'):5.1f} / {mean('within_two'):5.1f}",
        f"{mean('spearman'):5.2f}",
        f"{mean('sigma_percent'):5.1f}",
        f"{mean('log_score'):6.2f} after {mean('constant_log_score'):6.2f}",
        f"{mean('crps_percent'):5.2f} after {mean('constant_crps_percent'):5.2f}",
    ]


HEADS = ("within σ / 2σ %", "rank", "σ %", "log score, constant", "CRPS %, constant")


def report(title: str, cases: Iterator[Case]) -> None:
    """Judge frames and print the tables."""
    judged = []
    for case in cases:
        judged.append(judge(case))
        print(f"{case.name} {judged[-1].seconds[1]:.1f} s", file=sys.stderr, flush=True)
    which = [one for one in (WHOLE, SHAPE) if (one, "all") in judged[0].found]
    for error in which:
        rows = [
            [one.name, *_cells([one.found[error, "all"]]), f"{one.seconds[0]:.1f} + {one.seconds[1]:.1f}"]
            for one in judged
        ]
        table(f"{title}, {error} error, per frame", ["frame", *HEADS, "CPU s"], rows)
    rows = []
    for error in which:
        together = coverage_of(*np.concatenate([one.pooled[error] for one in judged], axis=1))
        rows.append([error, "all, pooled", "100.0", *_cells([together]), ""])
        for kind in judged[0].shares:
            of_kind = [one.found[error, kind] for one in judged if (error, kind) in one.found]
            if of_kind:
                share = np.mean([one.shares[kind] for one in judged])
                better = sum(one.beats_a_constant for one in of_kind)
                told = f"{better} of {len(of_kind)}"
                rows.append([error, kind, f"{share:5.1f}", *_cells(of_kind), told])
    table(f"{title}, in all", ["error", "pixels", "share %", *HEADS, "beats it on"], rows)


def main(arguments: Sequence[str]) -> None:
    """Judge sets or folders: ``python -m tests.benchmarks.trust shipped real``."""
    for wanted in arguments or ["shipped"]:
        report(f"Trust, {wanted}", cases_of(wanted))


if __name__ == "__main__":
    main(sys.argv[1:])
