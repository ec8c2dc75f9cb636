"""How well k is told by frames of an endoscope whose light is not known, and what it is worth.

    python -m tests.research.light [open | sealed | traced | c3vd]...

A row for each frame: the true k, what the frame alone tells, and the mean error of the distance, scaled by
its median, with the true k, with the one that was found, and with 2.5. Albedos are not told. No test: it
takes minutes.
"""

import sys
from dataclasses import replace

import numpy as np

import endolab as el
from tests.benchmarks.frames import cases_of, table

USUAL = 2.5


def percent(case, k, gamma):
    """Mean error of the distance with this k, %."""
    lit = replace(case.calibration, photometry=el.Photometry(k, gamma, None))
    return replace(case, calibration=lit, align="scale").percent(channel="separated")


def rows_of(wanted):
    """A row for each frame of a set, and their mean."""
    off = []
    for case in cases_of(wanted):
        light = case.calibration.photometry.simplify()
        gamma = light.gamma
        found = el.estimate_light([case.frame], case.calibration.camera, gamma=gamma)
        ks = (light.k, found.photometry.k, USUAL)
        errors = [percent(case, k, gamma) for k in ks]
        off.append([found.k - light.k, *errors])
        estimate = f"{found.k:.2f} ± {found.standard_error:.2f}"
        cells = [f"{one:.1f}" for one in errors]
        yield [case.name, f"{light.k:.2f}", estimate, found.outcome, *cells]
    mean, *errors = np.mean(off, axis=0)
    spread = f"{mean:.2f} ± {np.std(off, axis=0)[0]:.2f} off"
    yield ["mean", "", spread, "", *(f"{one:.1f}" for one in errors)]


if __name__ == "__main__":
    for wanted in sys.argv[1:] or ["open"]:
        table(
            f"k of {wanted}, asked of the frames",
            (
                "frame",
                "k",
                "found",
                "",
                "% with k",
                "with what was found",
                f"with {USUAL:g}",
            ),
            rows_of(wanted),
        )
