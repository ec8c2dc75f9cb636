"""How far the stated σ of a surface can be trusted: how often the truth lies within it, by who decided.

    python -m tests.benchmarks.uncertainty [open | sealed | shipped | real | FOLDER]...

`shipped` is the default. Errors and σ are shares of the distance. *Whole* is the error at true scale with all
that is uncertain, `sigma`; *shape* the error once the median of d*/d is taken out, with `sigma_shape`: real
frames, of unknown scale, have that alone. The last rows are means over frames, of the pixels that picture,
border or prior decided. No test: it takes minutes; sets and real frames as in `unseen` and `colon`.
"""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

import endolab as el
from endolab import datasets
from endolab.metrics.coverage import Coverage, coverage_of
from endolab.reconstruction.uncertainty.shares import BORDER, DATA, PRIOR
from tests.benchmarks.colon import at_width, with_light
from tests.benchmarks.report import table
from tests.benchmarks.unseen import FOLDER
from tests.tools.random_frames import SETS, make, read

FEW = 50  # pixels of a kind, below which a frame has none of it
FIELD = 55.0  # degrees off the axis, beyond which C3VD's fisheye is not judged
KINDS = {"data": DATA, "border": BORDER, "prior": PRIOR}
HEADS = ("within σ / 2σ %", "rank", "σ %", "log score, constant", "CRPS %, constant")


def cases_of(wanted: str) -> Iterator[tuple]:
    """Frames of a set, or of a folder: name, frame, calibration, truth, and degrees off the axis at most."""
    if wanted == "shipped":
        for name in datasets.TRACED:
            traced = datasets.load_traced(name)
            yield name, traced.frame, traced.calibration, traced.distance, 90.0
        return
    if wanted == "real":
        folder = datasets.data_folder()
        for index in (1, 6):
            sample = datasets.read_c3vd(folder / "c3vd_trans_t1_a", index)
            frame, calibration, truth = at_width(sample, 320)
            yield (
                f"c3vd {index}",
                frame,
                with_light(calibration, k=2.5, gamma=2.2),
                truth,
                FIELD,
            )
        for index in (0, 3):
            frame, calibration, truth = at_width(
                datasets.read_simcol3d(folder / "simcol3d", index), 320
            )
            yield f"simcol {index}", frame, with_light(calibration), truth, 90.0
        return
    here = FOLDER / wanted if wanted in SETS else Path(wanted)
    if wanted in SETS:
        make(SETS[wanted], here)
    for path in sorted(here.glob("*.npz")):
        drawn = read(path)
        yield drawn.frame.name, drawn.frame, drawn.calibration, drawn.distance, 90.0


def judge(frame, calibration, truth, most) -> dict[tuple[str, str], Coverage]:
    """Reconstruct a frame, ask how far that can be trusted, and see: by whole or shape, and kind of pixel."""
    result = el.reconstruct(frame, calibration)
    uncertainty = el.uncertainty_of(result, calibration)
    cosine = np.nan_to_num(result.problem.field.cos_alpha, nan=-1.0)
    seen = result.mask & np.isfinite(truth) & (cosine > np.cos(np.deg2rad(most)))
    factor = coverage_of(
        result.distance, uncertainty.sigma_shape, truth, seen, scale="median"
    ).scale
    maps = {"shape": (factor * result.distance, factor * uncertainty.sigma_shape, truth)}
    if result.metric:
        maps["whole"] = result.distance, uncertainty.sigma, truth
    kinds = {
        "all": seen,
        **{
            kind: seen & (uncertainty.dominant_source == number)
            for kind, number in KINDS.items()
        },
    }
    found = (
        (error, kind)
        for error in maps
        for kind, where in kinds.items()
        if where.sum() >= FEW
    )
    return {(error, kind): coverage_of(*maps[error], kinds[kind]) for error, kind in found}


def cells(every: Sequence[Coverage]) -> list[str]:
    """Means over frames."""
    found = {
        name: np.nanmean([getattr(one, name) for one in every]) for name in vars(every[0])
    }
    return [
        "{within_one:5.1f} / {within_two:5.1f}".format(**found),
        "{spearman:5.2f}".format(**found),
        "{sigma_percent:5.1f}".format(**found),
        "{log_score:6.2f} after {constant_log_score:6.2f}".format(**found),
        "{crps_percent:5.2f} after {constant_crps_percent:5.2f}".format(**found),
    ]


def main(arguments: Sequence[str]) -> None:
    """Judge sets or folders: ``python -m tests.benchmarks.uncertainty shipped real``."""
    for wanted in arguments or ["shipped"]:
        scores = {name: judge(*case) for name, *case in cases_of(wanted)}
        for error in ("whole", "shape"):
            rows = [
                [name, *cells([one[error, "all"]])]
                for name, one in scores.items()
                if (error, "all") in one
            ]
            for kind in ("all", *KINDS):
                every = [
                    one[error, kind] for one in scores.values() if (error, kind) in one
                ]
                rows += [[f"mean, {kind}", *cells(every)]] if every else []
            table(f"Uncertainty, {wanted}, {error} error", ["frame", *HEADS], rows)


if __name__ == "__main__":
    main(sys.argv[1:])
