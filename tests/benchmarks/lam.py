"""Whether the λ that the explained contrast suggests is a good one: a table in Markdown.

    python -m tests.benchmarks.lam [WIDTH] [SET]...

Five λ are solved as the tuner does, with the light and the contours of the first, at 320 px at most; the rule
takes the largest that explains 99 %, or 1 if none does. Beside its error stand those of a solve anew there,
of λ = 1 and of the best of the five, which needs the truth. No test: it takes minutes.
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
HEADS = (
    "frames",
    "none explains 99 %",
    "suggested λ",
    "error %",
    "solved anew",
    "at λ = 1",
    "at the best",
    "best λ",
)


def solve(case: Case) -> tuple[dict[float, Answer], float | None, Answer]:
    """Answers to all λ, the λ that is suggested, and what a solve anew finds there."""
    tuner = Tuner(case.calibration, frame=case.frame)
    first = tuner.solve_cold(Knobs(scene=None, width=case.frame.width, channel="auto"))
    found = {1.0: first}

    def add(lam: float) -> None:
        if lam not in found:
            found[lam] = solve_warm(first, replace(first.settings, lam=lam))

    for lam in values_of_lam(1.0).values():
        add(lam)
    explained = [answer.explained_contrast for answer in found.values()]
    suggested = suggest_lam([*found], explained)
    anew = first
    if suggested is not None:
        add(suggested)
        anew = tuner.solve_cold(replace(first.settings, lam=suggested))
    tuner.close()
    return found, suggested, anew


def row_of(case: Case) -> list[float]:
    """Whether none is suggested, suggested λ, its errors, that of 1, the least of the five, and its λ."""
    found, advised, anew = solve(case)
    suggested = advised or 1.0  # as the guide advises
    errors = {lam: case.errors_of(found[lam].result).mean_percent for lam in found}
    tried = values_of_lam(1.0).values()
    best = min(tried, key=errors.__getitem__)
    line = " ".join(
        f"{lam:g}: {100 * found[lam].explained_contrast:.1f} % {errors[lam]:.2f}"
        for lam in sorted(tried)
    )
    error = case.errors_of(anew.result).mean_percent
    print(
        f"{case.name:16} {line}; {suggested:.2g}: {errors[suggested]:.2f}, "
        f"anew {error:.2f}",
        flush=True,
    )
    scores = (errors[suggested], error, errors[1.0], errors[best])
    return [advised is None, suggested, *scores, best]


def mean_of(name: str, width: int) -> list[str]:
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
