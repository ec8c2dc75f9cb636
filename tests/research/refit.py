"""What the constants of light and contours would be if they were chosen now.

    python -m tests.research.refit [CONSTANT]...

Each is varied alone on every third frame of the open sets, of 240 px, on which light and contours are found.
Told are the value of least error, by all frames and by each half of them, and what the error becomes with the
value at which the constant does nothing, with its standard error. If that covers 0, the constant can go. The
phantom's shapes are scored, not fitted on. A minute or so for a constant; by default six are done.
"""

import sys
from unittest.mock import patch

import numpy as np

from endolab.reconstruction import constants
from tests.benchmarks.frames import cases_of, table

FITTED = ("rendered", "traced", "open")
SCORED = "c3vd_shapes"
WIDTH = 240  # px
EVERY = 3  # frames of a set, of which one is taken
# What is tried in place of each; the first does nothing.
TRIED = {
    "HIDDEN": (1.0, 0.5, 0.9),
    "NEARER": (1.0, 1.2),
    "WIDTH_PER_PIXEL": (1e-3, 0.25, 1.0),
    "MISFIT_LIMIT": (1.0, 1.05, 1.15),
    "LIMB_WIDTH": (0.0, 5.0, 12.0),
    "ACROSS": (0.0, 0.2),
    "BACK": (0.1, 1.0, 4.0),
    "FACTOR_PRIOR": ((0.9, 1e3), (0.9, 0.1), (0.9, 0.4), (1.0, 0.2)),
    "LAMP_PRIOR": ((1.0, 1e-3), (1.0, 0.2), (1.0, 0.5)),
    "TOGETHER": (0.0, 0.5, 0.95),
    "PIECES": (1e9, 10.0, 40.0),
    "LEAST_SPREAD": (1e-3, 0.15, 0.4),
    "OUTLIER": (1e3, 1.0, 2.5),
    "MOST_MISFIT": (1e9, 0.03, 0.07),
    "RATIO_DOUBT": (0.0, 0.08, 0.3),
    "UNCUT_ROUNDS": ((4, 2), (6, 3, 3)),
    "TRIAL_STEPS": (2, 4),
    "PRICE": (0.0, 0.05, 0.2),
    "CLEAN_PRICE": (0.1, 0.01, 0.04),
    "MIN_STEEPNESS": ((0.07,), (0.07, 0.05, 0.035, 0.025, 0.018)),
    "LINE_BLUR": (0.0, 1.0, 2.0),
    "SHALLOW": (0.0, 0.003, 0.008),
}


def errors_with(name, value, cases):
    """Mean errors of the frames with a value of a constant, %."""
    with patch.object(constants, name, value):
        return np.array([case.percent() for case in cases])


def row_of(name, cases, others):
    """What is chosen in place of a constant, and what it is worth."""
    values = [getattr(constants, name), *TRIED[name]]
    errors = np.array([errors_with(name, value, cases) for value in values])
    every, *halves = (
        str(values[np.argmin(errors[:, part].mean(axis=1))])
        for part in (np.s_[:], np.s_[::2], np.s_[1::2])
    )
    change = errors[1] - errors[0]
    now, neutral = (errors_with(name, value, others).mean() for value in values[:2])
    return [
        name,
        f"{values[0]}",
        every,
        ", ".join(halves),
        f"{errors[0].mean():.2f}",
        f"{values[1]}",
        f"{change.mean():+.2f} ± {change.std() / np.sqrt(len(cases)):.2f}",
        f"{neutral - now:+.2f}",
    ]


if __name__ == "__main__":
    cases = [
        case.resize(WIDTH)
        for wanted in FITTED
        for case in list(cases_of(wanted))[::EVERY]
    ]
    others = [case.resize(WIDTH) for case in cases_of(SCORED)]
    names = sys.argv[1:] or list(TRIED)[:6]
    rows = (row_of(name, cases, others) for name in names)
    table(
        f"Constants, by {len(cases)} frames of {', '.join(FITTED)}",
        (
            "constant",
            "now",
            "best",
            "of halves",
            "error %",
            "neutral",
            "with neutral",
            "phantom's shapes",
        ),
        rows,
    )
