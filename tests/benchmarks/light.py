"""How well k is told by frames of an endoscope whose light is not known, and what it is worth.

    python -m tests.benchmarks.light [open | sealed | traced | c3vd]...

A row for each frame: the true k, what the frame alone tells, and the mean error of the distance, scaled by
its median, with the true k, with the one that was found, and with 2.5. Albedos are not told. No test: it
takes minutes.
"""

import sys
from dataclasses import replace

import numpy as np

import endolab as el
from endolab.reconstruction.estimate_light import EXPONENT_SEARCH
from tests.benchmarks.frames import Case, cases_of
from tests.benchmarks.report import table

USUAL = EXPONENT_SEARCH.usual
HEADS = (
    "frame",
    "k",
    "found",
    "",
    "% with k",
    "with what was found",
    f"with {USUAL:g}",
)


def error(case: Case, k: float, gamma: float) -> float:
    """Mean error of the distance with this k, %."""
    known = replace(case.with_light(el.Photometry(k, gamma, None)), scale="median")
    result = el.reconstruct(known.frame, known.calibration, channel="separated")
    return known.errors_of(result).mean_percent


def main(wanted: str) -> None:
    """Print the table of a set."""
    rows = []
    off = []
    for case in cases_of(wanted):
        light = case.calibration.photometry.simplify()
        found = el.estimate_light(
            [case.frame], case.calibration.camera, gamma=light.gamma
        )
        ks = (light.k, found.photometry.k, USUAL)
        errors = [error(case, k, light.gamma) for k in ks]
        off.append([found.k - light.k, *errors])
        estimate = f"{found.k:.2f} ± {found.standard_error:.2f}"
        cells = [case.name, f"{light.k:.2f}", estimate, found.outcome]
        rows.append([*cells, *(f"{percent:.1f}" for percent in errors)])
    mean = np.mean(off, axis=0)
    spread = np.std(off, axis=0)[0]
    percents = [f"{percent:.1f}" for percent in mean[1:]]
    rows.append(["mean", "", f"{mean[0]:.2f} ± {spread:.2f} off", "", *percents])
    table(f"k of {wanted}, asked of the frames", HEADS, rows)


if __name__ == "__main__":
    for wanted in sys.argv[1:] or ["open"]:
        main(wanted)
