"""How far the stated σ of a surface can be trusted: how often the truth lies within it, by who decided.

    python -m tests.benchmarks.uncertainty [SET]...

Errors and σ are shares of the distance. *Whole* is the error at true scale with all
that is uncertain, `sigma`; *shape* the error once the median of d*/d is taken out, with `sigma_shape`: real
frames, of unknown scale, have that alone. Rows are means over frames, of all pixels and of those
that picture, border or prior decided. No test: it takes minutes.
"""

import sys
from collections.abc import Sequence

import numpy as np

import endolab as el
from endolab.metrics.coverage import Coverage, coverage_of
from endolab.reconstruction.uncertainty import BORDER, DATA, PRIOR
from tests.benchmarks.frames import Case, cases_of
from tests.benchmarks.report import table

FEW = 50  # pixels of a kind, below which a frame has none of it
KINDS = {"data": DATA, "border": BORDER, "prior": PRIOR}
SETS = ("c3vd_shapes", "rendered", "traced", "c3vd", "simcol3d_nominal")
HEADS = (
    "frames",
    "number",
    "error, pixels",
    "within σ / 2σ %",
    "rank",
    "σ %",
    "log score, constant",
    "",
)
CELLS = (
    "{within_one:.1f} / {within_two:.1f}",
    "{spearman:.2f}",
    "{sigma_percent:.1f}",
    "{log_score:.2f} after {constant_log_score:.2f}",
)


def judge(case: Case) -> dict[tuple[str, str], Coverage]:
    """Reconstruct a frame, ask how far that can be trusted, and see: by whole or shape, and kind of pixel."""
    result = el.reconstruct(case.frame, case.calibration)
    uncertainty = el.uncertainty_of(result, case.calibration)
    seen = result.mask & np.isfinite(case.distance) & case.scored
    kinds = {"all": seen}
    for kind, number in KINDS.items():
        kinds[kind] = seen & (uncertainty.dominant_source == number)
    own = (result.distance, uncertainty.sigma_shape, case.distance)
    factor = coverage_of(*own, seen, scale="median").scale
    maps = {"shape": (factor * result.distance, factor * own[1], case.distance)}
    if result.metric:
        maps["whole"] = (result.distance, uncertainty.sigma, case.distance)
    found = {}
    for error, given in maps.items():
        for kind, where in kinds.items():
            if where.sum() >= FEW:
                found[error, kind] = coverage_of(*given, where)
    return found


def cells(every: Sequence[Coverage]) -> list[str]:
    """Means over frames, and whether σ is right: 68 ± 10 and 95 ± 5 % of the pixels within σ and 2 σ."""
    names = vars(every[0])
    mean = {name: np.nanmean([getattr(one, name) for one in every]) for name in names}
    is_right = abs(mean["within_one"] - 68) <= 10 and abs(mean["within_two"] - 95) <= 5
    return [*(cell.format(**mean) for cell in CELLS), "" if is_right else "fails"]


def rows_of(wanted: str) -> list[list[str]]:
    """Judge a set: a row for the whole error and that of shape, and for each kind of pixel."""
    scores = [judge(case) for case in cases_of(wanted)]
    rows = []
    for error in ("whole", "shape"):
        for kind in ("all", *KINDS):
            every = [found[error, kind] for found in scores if (error, kind) in found]
            if every:
                rows.append(
                    [wanted, str(len(every)), f"{error}, {kind}", *cells(every)]
                )
    table(f"Uncertainty, {wanted}", HEADS, rows)
    return rows


if __name__ == "__main__":
    every = [row for wanted in sys.argv[1:] or SETS for row in rows_of(wanted)]
    table("Uncertainty", HEADS, [row for row in every if row[2].endswith("all")])
