"""How far a real colon is from what is found: path-traced frames, C3VD and SimCol3D, beside their truth.

    python -m tests.benchmarks.colon [traced | c3vd | simcol3d | variants]...

No test: it takes minutes, and real frames are looked for in $ENDOLAB_DATA or ../shared/data.
"""

import sys
import time
from dataclasses import replace
from itertools import product
from typing import Any

import endolab as el
from endolab.metrics.depth_errors import depth_cuts
from tests.benchmarks.frames import Case, cases_of
from tests.benchmarks.report import table

WAYS: dict[str, dict[str, Any]] = {
    "facing": {"solver": "facing"},
    "marched": {"solver": "fast_marching"},
    "green": {"channel": "green"},
    "automatic": {},
    "separated": {"channel": "separated"},
    "separated, marched": {"channel": "separated", "solver": "fast_marching"},
}
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


def report(wanted: str) -> None:
    """All ways on each frame of a set; then without albedos, and with the true contours."""
    for case in cases_of(wanted):
        rows = [row_of(case, way, **options) for way, options in WAYS.items()]
        light = case.calibration.photometry
        grey = case.with_light(replace(light, brdf=el.Lambertian(0.38)))
        rows.append(row_of(grey, "albedos unknown", channel="separated"))
        cuts = depth_cuts(case.distance)
        rows.append(row_of(case, "true contours", channel="separated", cuts=cuts))
        table(wanted, HEADS, rows)


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
    for wanted in sys.argv[1:] or ("traced", "c3vd", "simcol3d", "variants"):
        if wanted == "variants":
            variants()
        else:
            report(wanted)
