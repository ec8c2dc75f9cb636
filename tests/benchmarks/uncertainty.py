"""How far the stated σ of a surface can be trusted: how often the truth lies within it.

    python -m tests.benchmarks.uncertainty [SET]...

Errors and σ are shares of the distance. *Whole* is the error at true scale with all
that is uncertain, `sigma`; *shape* the error once the median of d*/d is taken out, with `sigma_shape`: real
frames, of unknown scale, have that alone. No test: it takes minutes.
"""

import sys

import numpy as np

import endolab as el
from endolab.metrics.coverage import coverage_of
from tests.benchmarks.frames import cases_of, table

SETS = ("c3vd_shapes", "rendered", "traced", "c3vd", "simcol3d_nominal")
CELLS = (
    "{within_one:.1f} / {within_two:.1f}",
    "{spearman:.2f}",
    "{sigma_percent:.1f}",
    "{log_score:.2f} after {constant_log_score:.2f}",
)


def judge(case):
    """Reconstruct a frame, ask how far that can be trusted, and see: in shape, and as a whole."""
    result = case.solve()
    uncertainty = el.uncertainty_of(result, case.calibration)
    seen = result.mask & np.isfinite(case.distance) & case.scored
    own = (result.distance, uncertainty.sigma_shape, case.distance)
    factor = coverage_of(*own, seen, align="scale").scale
    scaled = (factor * result.distance, factor * uncertainty.sigma_shape)
    found = {"shape": coverage_of(*scaled, case.distance, seen)}
    if result.metric:
        found["whole"] = coverage_of(
            result.distance, uncertainty.sigma, case.distance, seen
        )
    return found


def rows_of(wanted):
    """Judge a set: means over frames, a row for each error."""
    scores = [judge(case) for case in cases_of(wanted)]
    for error in ("whole", "shape"):
        every = [vars(found[error]) for found in scores if error in found]
        if every:
            mean = {key: np.nanmean([one[key] for one in every]) for key in every[0]}
            cells = [cell.format(**mean) for cell in CELLS]
            yield [wanted, str(len(every)), error, *cells]


if __name__ == "__main__":
    rows = [row for wanted in sys.argv[1:] or SETS for row in rows_of(wanted)]
    table(
        "Uncertainty",
        (
            "frames",
            "number",
            "error",
            "within σ / 2σ %",
            "rank",
            "σ %",
            "log score, constant",
        ),
        rows,
    )
