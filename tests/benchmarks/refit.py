"""What the constants of light and contours would be if they were chosen now.

    python -m tests.benchmarks.refit [CONSTANT]...

Each is varied alone on every third frame of the open sets, of 240 px, on which light and contours are found.
Told are the value of least error, by all frames and by each half of them, and what the error becomes with the
value at which the constant does nothing, with its standard error. If that covers 0, the constant can go. The
phantom's shapes are scored, not fitted on. A minute or so for a constant; by default six are done.
"""

import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
from endolab.reconstruction.contours.choice import CHOICE
from endolab.reconstruction.light.separation import SEPARATION_ROUNDS

import endolab as el
from endolab.numerics.arrays import FloatArray
from endolab.reconstruction.colours import FIT
from endolab.reconstruction.lines import LINE_SEARCH
from endolab.reconstruction.walls import WALL_MODEL
from tests.benchmarks.frames import Case, cases_of
from tests.benchmarks.report import table

FITTED = ("rendered", "traced", "open")
SCORED = "c3vd_shapes"
WIDTH = 240  # px
EVERY = 3  # frames of a set, of which one is taken


@dataclass(frozen=True)
class Sweep:
    """A constant, and what is tried in its place; the first does nothing."""

    owner: Any
    name: str
    values: tuple[Any, ...]

    @property
    def usual(self) -> Any:
        """The value that it has."""
        return getattr(self.owner, self.name)

    def errors(self, cases: list[Case], value: Any) -> FloatArray:
        """Mean errors of the frames with a value, %."""
        usual = self.usual
        object.__setattr__(self.owner, self.name, value)
        try:
            results = [el.reconstruct(case.frame, case.calibration) for case in cases]
        finally:
            object.__setattr__(self.owner, self.name, usual)
        pairs = zip(cases, results, strict=True)
        return np.array([case.errors_of(result).mean_percent for case, result in pairs])


ALL = (
    Sweep(WALL_MODEL, "hidden", (1.0, 0.5, 0.9)),
    Sweep(WALL_MODEL, "nearer", (1.0, 1.2)),
    Sweep(FIT, "width_per_pixel", (1e-3, 0.25, 1.0)),
    Sweep(CHOICE, "misfit_limit", (1.0, 1.03, 1.15)),
    Sweep(LINE_SEARCH, "limb_width", (0.0, 5.0, 12.0)),
    Sweep(LINE_SEARCH, "across", (0.0, 0.2)),
    Sweep(WALL_MODEL, "back", (0.1, 1.0, 4.0)),
    Sweep(FIT, "factor", ((0.9, 1e3), (0.9, 0.1), (0.9, 0.4), (1.0, 0.2))),
    Sweep(FIT, "lamp", ((1.0, 1e-3), (1.0, 0.2), (1.0, 0.5))),
    Sweep(FIT, "together", (0.0, 0.5, 0.95)),
    Sweep(FIT, "pieces", (1e9, 10.0, 40.0)),
    Sweep(FIT, "least_spread", (1e-3, 0.15, 0.4)),
    Sweep(FIT, "outlier", (1e3, 1.0, 2.5)),
    Sweep(FIT, "rounds", (1, 2)),
    Sweep(FIT, "most_misfit", (1e9, 0.07, 0.15)),
    Sweep(SEPARATION_ROUNDS, "ratio_doubt", (0.0, 0.08, 0.3)),
    Sweep(SEPARATION_ROUNDS, "uncut", ((4, 2), (6, 3, 3))),
    Sweep(SEPARATION_ROUNDS, "cut", (2, 4)),
    Sweep(CHOICE, "price", (0.0, 0.05, 0.2)),
    Sweep(CHOICE, "clean_price", (0.1, 0.01, 0.04)),
    Sweep(CHOICE, "min_steepness", ((0.07,), (0.07, 0.05, 0.035, 0.025, 0.018))),
    Sweep(LINE_SEARCH, "blur", (0.0, 1.0, 2.0)),
    Sweep(LINE_SEARCH, "shallow", (0.0, 0.003, 0.008)),
)
HEADS = (
    "constant",
    "now",
    "best",
    "of halves",
    "error %",
    "neutral",
    "with neutral",
    "phantom's shapes",
)


def row_of(sweep: Sweep, cases: list[Case], others: list[Case]) -> list[str]:
    """What is chosen in place of a constant, and what it is worth."""
    values = [sweep.usual, *sweep.values]
    errors = np.array([sweep.errors(cases, value) for value in values])
    best = [
        np.argmin(errors[:, part].mean(axis=1))
        for part in (np.s_[:], np.s_[::2], np.s_[1::2])
    ]
    change = errors[1] - errors[0]
    now, neutral = (sweep.errors(others, value).mean() for value in values[:2])
    chosen = [f"{values[index]}" for index in best]
    return [
        sweep.name,
        f"{sweep.usual}",
        chosen[0],
        ", ".join(chosen[1:]),
        f"{errors[0].mean():.2f}",
        f"{sweep.values[0]}",
        f"{change.mean():+.2f} ± {change.std() / np.sqrt(len(cases)):.2f}",
        f"{neutral - now:+.2f}",
    ]


def main(names: list[str]) -> None:
    """Print a row for each constant."""
    cases = [
        case.resize(WIDTH)
        for wanted in FITTED
        for case in list(cases_of(wanted))[::EVERY]
    ]
    others = [case.resize(WIDTH) for case in cases_of(SCORED)]
    wanted = [sweep for sweep in ALL if sweep.name in names] if names else ALL[:6]
    rows = []
    for sweep in wanted:
        rows.append(row_of(sweep, cases, others))
        print(*rows[-1], sep="  ", flush=True)
    table(f"Constants, by {len(cases)} frames of {', '.join(FITTED)}", HEADS, rows)


if __name__ == "__main__":
    main(sys.argv[1:])
