"""Whether left is right: the surfaces of turned frames against the frame's own; a table in Markdown.

    python -m tests.benchmarks.turned

Of drawn and of traced frames, uncut and cut: by how much the distances differ at the 99th percentile, and the
mean error of each. What halves rows and columns shares an odd number of them out from the first on: there the
surfaces differ by what convergence leaves. No test: it takes a minute.
"""

import numpy as np

import endolab as el
from tests.benchmarks.frames import cases_of, drawn, table
from tests.tools.problems import percent_off
from tests.tools.turns import TURNS, solve_turned

WIDTH = 240  # px


def cases():
    """Yield the frames."""
    known = el.load_calibration("simple", WIDTH)
    for noise in (0.0, 1.0):
        yield drawn(f"colon, noise {noise:g}", "colon", known, noise=noise, bits=8)
    for case in cases_of("traced"):
        if case.name in ("matt", "wet-1"):
            yield case.resize(WIDTH)


def rows():
    """A row for each frame, uncut and cut."""
    for case in cases():
        for contours in (False, None):
            upright = case.solve(contours=contours)
            row = [f"{percent_off(upright, case):.2f}"]
            for name, turn in TURNS.items():
                how = {"contours": contours}
                found = solve_turned(case.frame, case.calibration, name, **how)
                moved = np.abs(np.log(found.distance / turn(upright.distance)))
                off = 100 * np.nanpercentile(moved, 99)
                error = percent_off(found, turn(case.distance))
                row.append(f"{off:.2g} %, {error:.2f}")
            yield [case.name, "uncut" if contours is False else "cut", *row]


if __name__ == "__main__":
    table(f"Turned frames, {WIDTH} columns", ("frame", "", "error %", *TURNS), rows())
