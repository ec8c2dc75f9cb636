"""Whether left is right: the surfaces of turned frames against the frame's own; a table in Markdown.

    python -m tests.benchmarks.turned

Of drawn and of traced frames, uncut and cut: by how much the distances differ at the 99th percentile, and the
mean error of each. What halves rows and columns shares an odd number of them out from the first on: there the
surfaces differ by what convergence leaves. No test: it takes a minute.
"""

from dataclasses import replace

import numpy as np

from tests.benchmarks.frames import table
from tests.tools.cases import drawn, traced
from tests.tools.problems import percent_off
from tests.tools.turns import TURNS, turned

WIDTH = 240  # px


def cases():
    """Yield the frames."""
    for noise in (0.0, 1.0):
        case = drawn("colon", "simple", WIDTH, noise=noise, bits=8)
        yield replace(case, name=f"colon, noise {noise:g}")
    for name in ("matt", "wet-1"):
        yield traced(name).resize(WIDTH)


def rows():
    """A row for each frame, uncut and cut."""
    for case in cases():
        for contours in (False, None):
            upright = case.solve(contours=contours)
            row = [f"{percent_off(upright, case):.2f}"]
            for name, turn in TURNS.items():
                there = turned(case, name)
                found = there.solve(contours=contours)
                moved = np.abs(np.log(found.distance / turn(upright.distance)))
                off = 100 * np.nanpercentile(moved, 99)
                row.append(f"{off:.2g} %, {percent_off(found, there):.2f}")
            yield [case.name, "uncut" if contours is False else "cut", *row]


if __name__ == "__main__":
    table(f"Turned frames, {WIDTH} columns", ("frame", "", "error %", *TURNS), rows())
