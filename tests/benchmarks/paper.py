"""The paper's tables: I on our scenes, and II on `diffuse-1`. Mean / median error of the distance, normals.

    python -m tests.benchmarks.paper

No test: it takes minutes.
"""

from itertools import product

from tests.benchmarks.frames import cases_of, table

SOLVERS = ("facing", "fast_marching", "gauss_newton")
LAM = {"first": 0.03, "second": 1.0}
HEADS = ("frame", "way", "mean / median %", "normals °", "ended")


def row_of(case, way, **options):
    """Solve a frame one way, and compare it with its truth."""
    result = case.solve(**options)
    e = case.errors_of(result)
    return [
        case.name,
        way,
        f"{e.mean_percent:.4g} / {e.median_percent:.4g}",
        f"{e.mean_degrees:.2g}",
        f"{result.iterations} {result.status.name}",
    ]


def scenes():
    """Table I."""
    for case, solver in product(cases_of("scenes"), SOLVERS):
        yield row_of(case, solver, solver=solver)


def variants():
    """Table II: the paper's solver with indirect light and without, and Gauss-Newton."""
    case = next(case for case in cases_of("traced") if case.name == "diffuse-1")
    case = case.resize(160)
    ways = (
        ("primal_dual", "green"),
        ("primal_dual", "separated"),
        ("gauss_newton", "separated"),
    )
    for xi, order, (solver, channel) in product(("1/z", "d", "1/d"), LAM, ways):
        yield row_of(
            case,
            f"{xi}, {order}, {solver}, {channel}",
            xi=xi,
            regulariser=order,
            solver=solver,
            channel=channel,
            lam=LAM[order],
            max_iterations=700,
        )


if __name__ == "__main__":
    table("Table I", HEADS, scenes())
    table("Table II", HEADS, variants())
