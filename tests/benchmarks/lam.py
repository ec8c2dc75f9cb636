"""Whether the λ that the explained contrast suggests is a good one: a table in Markdown.

    python -m tests.benchmarks.lam [SET]...

Five λ are solved as the tuner does, with the light and the contours of the first, at 320 px; the rule takes
the largest that explains 99 %, or 1 if none does. Beside its error stand those of λ = 1 and of the best of
the five, which needs the truth. No test: it takes minutes.
"""

import sys
from dataclasses import replace

import numpy as np

from endolab.reconstruction.contrast import suggest_lam
from endolab.workbench.tuning.engine import Answer, Tuner, solve_warm, values_of_lam
from endolab.workbench.tuning.source import Knobs
from tests.benchmarks.frames import Case, cases_of
from tests.benchmarks.report import table

SETS = ("rendered", "traced", "c3vd_shapes", "c3vd", "simcol3d_nominal")
HEADS = ("frames", "suggested λ", "error %", "at λ = 1", "at the best", "best λ")
WIDTH = 320


def solve(case: Case) -> tuple[dict[float, Answer], float]:
    """Answers to all λ, and the λ that is suggested."""
    tuner = Tuner(case.calibration, frame=case.frame)
    first = tuner.solve_cold(Knobs(scene=None, width=WIDTH, channel="auto"))
    tuner.close()
    found = {1.0: first}

    def add(lam: float) -> None:
        if lam not in found:
            found[lam] = solve_warm(first, replace(first.settings, lam=lam))

    for lam in values_of_lam(1.0).values():
        add(lam)
    explained = [answer.explained for answer in found.values()]
    suggested = suggest_lam([*found], explained) or 1.0  # as the guide advises
    add(suggested)
    return found, suggested


def row_of(case: Case) -> list[float]:
    """Suggested λ, its error, that of 1, the least of the five, and its λ."""
    found, suggested = solve(case)
    errors = {lam: case.errors_of(found[lam].result).mean_percent for lam in found}
    tried = values_of_lam(1.0).values()
    best = min(tried, key=errors.__getitem__)
    told = " ".join(
        f"{lam:g}: {100 * found[lam].explained:.1f} % {errors[lam]:.2f}"
        for lam in sorted(tried)
    )
    print(
        f"{case.name:16} {told}; {suggested:.2g}: {errors[suggested]:.2f}", flush=True
    )
    return [suggested, errors[suggested], errors[1.0], errors[best], best]


def mean_of(name: str) -> list[str]:
    """Means over the frames of a set, of λ geometric ones."""
    rows = [row_of(case.resize(WIDTH)) for case in cases_of(name)]
    if not rows:
        return [name, *"–––––"]
    suggested, error, usual, least, best = np.transpose(rows)
    middle = (np.exp(np.mean(np.log(lams))) for lams in (suggested, best))
    first, last = (f"{lam:.2g}" for lam in middle)
    return [
        name,
        first,
        *(f"{np.mean(values):.2f}" for values in (error, usual, least)),
        last,
    ]


if __name__ == "__main__":
    table("λ by the explained contrast", HEADS, map(mean_of, sys.argv[1:] or SETS))
