"""Whether left is right: the surfaces of turned frames against the frame's own; a table in Markdown.

    python -m tests.benchmarks.turned [WIDTH]

Of drawn and of traced frames, uncut and cut: by how much the distances differ at the 99th percentile, and the
mean error of each. What halves rows and columns shares an odd number of them out from the first on: there the
surfaces differ by what convergence leaves. No test: it takes a minute.
"""

import sys

import numpy as np

import endolab as el
from tests.benchmarks.frames import table
from tests.tools.problems import Shot
from tests.tools.turns import TURNS, solve_turned

HEADS = ("frame", "", "error %", *TURNS)


def frames_of(width):
    """Yield name, frame, calibration and true distance (H, W)."""
    for noise in (0.0, 1.0):
        shot = Shot("colon", el.load_calibration("simple", width), noise=noise, bits=8)
        yield (
            f"colon, noise {noise:g}",
            shot.frame,
            shot.calibration,
            shot.truth.distance,
        )
    for name in ("matt", "wet-1"):
        sample = el.load_traced(name)
        height = width * 3 // 4
        known = sample.calibration.resize(width, height)
        truth = sample.scene.distance(known.camera.field.rays)
        yield name, sample.frame.resize(width, height, 2.2), known, truth


def rows_of(width):
    """A row for each frame, uncut and cut."""
    for name, frame, known, truth in frames_of(width):
        for contours in (False, None):
            upright = el.reconstruct(frame, known, contours=contours)

            def error(result, true):
                return 100 * np.nanmean(np.abs(result.distance / true - 1))

            row = [f"{error(upright, truth):.2f}"]
            for turned, turn in TURNS.items():
                found = solve_turned(frame, known, turned, contours=contours)
                moved = np.abs(np.log(found.distance / turn(upright.distance)))
                off = 100 * np.nanpercentile(moved, 99)
                row.append(f"{off:.2g} %, {error(found, turn(truth)):.2f}")
            yield [name, "uncut" if contours is False else "cut", *row]


if __name__ == "__main__":
    width = int(sys.argv[1]) if len(sys.argv) > 1 else 240
    table(f"Turned frames, {width} columns", HEADS, rows_of(width))
