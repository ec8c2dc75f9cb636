"""A table of reconstructions, one a row, as CSV: what is not known is nan, and an empty cell."""

import csv
import io
import math
from collections.abc import Collection, Iterable, Sequence
from typing import Any

import numpy as np

from endolab.io.atomic import PathLike, name_damage, read_bytes, write_atomically
from endolab.reconstruction.light_and_contours import min_steepness_of
from endolab.reconstruction.sequence import Step
from endolab.solvers.result import Result

Row = dict[str, Any]
MEASURED = ("iterations", "energy", "data", "regulariser_energy", "seconds")
# The columns of a video's table, and those of them that hold text.
FRAME_COLUMNS = (
    *("index", "frame", "status", "warm", "min_steepness", "unit"),
    *MEASURED,
    *("gain", "median_distance", "pixels", "error"),
)
TEXT_COLUMNS = ("frame", "status", "unit", "error")


def measure_result(result: Result) -> Row:
    """What a row tells of a result: how it ended, its iterations and energies."""
    terms = result.iterate.terms
    return {
        "status": result.status.name,
        "iterations": result.iterations,
        "energy": result.energy,
        "data": terms.get("data", math.nan),
        "regulariser_energy": terms.get("regulariser", math.nan),
    }


def step_row(step: Step, index: int) -> Row:
    """What a row tells of a frame of a video or of a camera; see `FRAME_COLUMNS`."""
    row: Row = dict.fromkeys(FRAME_COLUMNS, math.nan) | {
        "index": index,
        "frame": step.name,
        "status": "",
        "unit": "",
        "warm": int(step.warm),
        "seconds": step.seconds,
        "error": " ".join(step.error.split()),
    }
    result = step.result
    if result is not None:
        known = result.distance[result.mask]
        row |= measure_result(result) | {
            "unit": result.problem.unit,
            "gain": result.problem.photometry.gain,
            "min_steepness": min_steepness_of(result) or 0,
            "pixels": known.size,
            "median_distance": float(np.median(known)),
        }
    return row


def read_rows(path: PathLike, columns: Sequence[str], words: Collection[str]) -> list[Row]:
    """Read a table that `write_rows` wrote: of the columns `words` as text, of all others as numbers.

    ValueError or OSError in one sentence that names the file, if it is another table.
    """
    # a file's name may be any bytes.
    content = read_bytes(path, "table").decode(errors="surrogateescape")
    with name_damage(path, f"a table of endolab's, whose columns are {', '.join(columns)}"):
        head, *lines = filter(None, csv.reader(io.StringIO(content, newline="")))
        if head != [*columns]:
            raise ValueError("other columns")
        rows: list[Row] = [dict(zip(columns, line, strict=True)) for line in lines]
        for row in rows:
            for name in set(columns).difference(words):
                row[name] = _number(row[name])
        return rows


def _number(cell: str) -> float:
    try:
        return int(cell)
    except ValueError:
        return float(cell or "nan")


def write_rows(path: PathLike, columns: Sequence[str], rows: Iterable[Row]) -> None:
    """Write a table, whole or not at all."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow(
            {name: "" if row[name] != row[name] else row[name] for name in columns}
        )
    write_atomically(path, text.getvalue().encode(errors="surrogateescape"))
