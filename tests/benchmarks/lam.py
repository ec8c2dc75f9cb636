"""Whether the λ that the explained contrast suggests is a good one: a table in Markdown.

    python -m tests.benchmarks.lam [WIDTH] [SET]...

Five λ are solved as the tuner does, with the light and the contours of the first, at 320 px at most; the rule
takes the largest that explains 99 %, or 1 if none does. Beside its error stand those of a solve anew there,
of λ = 1 and of the best of the five, which needs the truth. No test: it takes minutes.
"""

import sys

import numpy as np

from endolab.metrics.contrast import explained_contrast, suggest_lam
from tests.benchmarks.frames import cases_of, table

LAMS = (0.1, 0.32, 1.0, 3.2, 10.0)
SETS = ("rendered", "traced", "c3vd_shapes", "c3vd", "simcol3d_nominal")
HEADS = ("frames", "none explains 99 %", "suggested λ", "error %")
HEADS += ("solved anew", "at λ = 1", "at the best", "best λ")


def row_of(case):
    """Whether none is suggested, suggested λ, its errors, that of 1, the least of the five, and its λ."""
    first = case.solve()
    results = [first if lam == 1 else case.solve(lam=lam, start=first) for lam in LAMS]
    advised, _ = suggest_lam(LAMS, [explained_contrast(result) for result in results])
    suggested = advised or 1.0  # as the guide advises
    errors = [case.errors_of(result).mean_percent for result in results]
    best = int(np.argmin(errors))
    there = case.percent(lam=suggested, start=first)
    anew = case.percent(lam=suggested)
    scores = (there, anew, errors[LAMS.index(1.0)], errors[best])
    print(case.name, f"{suggested:.2g}", *(f"{e:.2f}" for e in errors), flush=True)
    return [advised is None, suggested, *scores, LAMS[best]]


def mean_of(name, width):
    """Means over the frames of a set, of λ geometric ones."""
    rows = [row_of(case.resize(width)) for case in cases_of(name)]
    if not rows:
        return [name, *"–––––––"]
    none, suggested, *errors, best = np.transpose(rows)
    first, last = (f"{np.exp(np.mean(np.log(lams))):.2g}" for lams in (suggested, best))
    means = (f"{np.mean(values):.2f}" for values in errors)
    return [name, f"{none.sum():.0f} of {len(rows)}", first, *means, last]


if __name__ == "__main__":
    names = sys.argv[1:]
    width = int(names.pop(0)) if "".join(names[:1]).isdigit() else 320
    rows = [mean_of(name, width) for name in names or SETS]
    table("λ by the explained contrast", HEADS, rows)
