"""A table of reconstructions, one a row, as CSV: what is not known is nan, and an empty cell."""

import csv
import io
import math
from collections.abc import Collection, Iterable, Sequence
from typing import Any

import numpy as np

from endolab.depth.result import Result
from endolab.io.atomic import PathLike, read_bytes, write_atomically
from endolab.reconstruction.sequence import Step

Row = dict[str, Any]
WORDS = ("frame", "status", "unit", "error")
ENERGIES = ("energy", "data", "regulariser_energy")
NUMBERS = ("iterations", *ENERGIES, "seconds", "gain", "median_distance", "pixels")
STEP = ("index", "frame", "status", "warm", "torn", "unit", *NUMBERS, "error")  # columns of a video's table


def measured(result: Result) -> Row:
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
    """What a row tells of a frame of a video or of a camera; see `STEP`."""
    row: Row = dict.fromkeys(STEP, math.nan) | {"index": index, "frame": step.name, "status": "", "unit": ""}
    row |= {"warm": int(step.warm), "seconds": step.seconds, "error": " ".join(step.error.split())}
    if step.result is not None:
        problem, known = step.result.problem, step.result.distance[step.result.mask]
        row |= measured(step.result) | {"unit": problem.unit, "gain": problem.photometry.gain}
        row |= {"torn": int(problem.cuts is not None), "pixels": known.size}
        row["median_distance"] = float(np.median(known))
    return row


def read_rows(path: PathLike, columns: Sequence[str], words: Collection[str]) -> list[Row]:
    """Read a table that `write_rows` wrote: of the columns `words` as text, of all others as numbers.

    ValueError or OSError in one sentence that names the file, if it is another table.
    """
    try:
        text = read_bytes(path, "table").decode(errors="surrogateescape")  # a file's name may be any bytes
        head, *lines = csv.reader(io.StringIO(text, newline=""))
    except (ValueError, csv.Error) as error:
        raise ValueError(f"{path}: not a table of endolab's") from error
    if head != [*columns]:
        raise ValueError(f"{path}: not a table of endolab's; its columns must be {', '.join(columns)}")
    rows = []
    for number, cells in enumerate(filter(None, lines), start=2):
        try:
            row = dict(zip(columns, cells, strict=True))
            rows.append(row | {name: _number(row[name]) for name in columns if name not in words})
        except ValueError as error:
            raise ValueError(f"{path}, line {number}: not a row of such a table") from error
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
        writer.writerow({name: "" if row[name] != row[name] else row[name] for name in columns})
    write_atomically(path, text.getvalue().encode(errors="surrogateescape"))
