"""The paper's Table II on a path-traced colon: `python -m tests.benchmarks.colon`.

No test: it takes minutes.
"""

import time
from itertools import product
from typing import Any

import endolab as el
from tests.benchmarks.frames import Case, cases_of
from tests.benchmarks.report import table

HEADS = (
    "frame",
    "way",
    "mean / median %",
    "mean mm",
    "normals °",
    "iterations",
    "s",
    "cut",
)


def row_of(case: Case, way: str, **options: Any) -> list[str]:
    """Reconstruct a frame one way, and compare it with its truth."""
    started = time.perf_counter()
    result = el.reconstruct(case.frame, case.calibration, **options)
    seconds = time.perf_counter() - started
    found = case.errors_of(result)
    return [
        case.name,
        way,
        f"{found.mean_percent:.1f} / {found.median_percent:.1f}",
        f"{found.mean_mm:.2f}",
        f"{found.mean_degrees:.1f}",
        f"{result.iterations} {result.status.name}",
        f"{seconds:.1f}",
        "cut" if result.problem.cuts is not None else "",
    ]


def variants() -> None:
    """Table II: the paper's solver on diffuse-1, all six variants."""
    case = next(case for case in cases_of("traced") if case.name == "diffuse-1")
    paper = {"solver": "primal_dual", "lam": 0.1}
    rows = [
        row_of(
            case,
            f"{channel}, {xi}, {regulariser}",
            channel=channel,
            xi=xi,
            regulariser=regulariser,
            **paper,
        )
        for channel, regulariser, xi in product(
            ("green", "separated"), ("first", "second"), ("1/z", "d", "1/d")
        )
    ]
    table("Table II", HEADS, rows)


if __name__ == "__main__":
    variants()
