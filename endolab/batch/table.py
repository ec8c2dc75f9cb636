"""A table of reconstructions, one a row, as CSV: what is not known is nan, and an empty cell."""

import csv
import io
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from endolab.depth.result import Result
from endolab.io.atomic import PathLike, read_bytes, write_atomically

COUNTS = ("iterations", "pixels")  # the columns of whole numbers
MOST = 2.0**53  # below it, a float tells every whole number

Row = dict[str, Any]


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


def read_rows(
    path: PathLike, columns: Sequence[str], what: str
) -> Iterator[tuple[int, dict[str, str] | None]]:
    """Give the rows of a table as text, each with its number in the table, the head's being 1.

    A row of fewer or more cells is None. ValueError or OSError in one sentence that names the file, if it
    is not a table of `what`.
    """
    try:
        text = read_bytes(path, "table").decode(errors="surrogateescape")  # a file's name may be any bytes
        head, *rows = csv.reader(io.StringIO(text, newline=""))
    except (ValueError, csv.Error) as error:
        raise ValueError(f"{path}: not a table of {what}") from error
    if head != [*columns]:
        raise ValueError(f"{path}: not a table of {what}; its columns must be {', '.join(columns)}")
    for number, row in enumerate(filter(None, rows), start=2):
        yield number, dict(zip(columns, row, strict=True)) if len(row) == len(columns) else None


def read_numbers(cells: Mapping[str, str], names: Iterable[str]) -> Row:
    """Read the cells of these columns; ValueError if one is no number, or a count is not whole."""
    values: Row = {name: float(cells[name].strip() or "nan") for name in names}
    for name in (name for name in COUNTS if not math.isnan(values.get(name, math.nan))):
        if not (0 <= values[name] < MOST and values[name].is_integer()):
            raise ValueError(f"{name} must be a whole number, found {cells[name]}")
        values[name] = int(values[name])
    return values


def write_rows(path: PathLike, columns: Sequence[str], rows: Iterable[Row]) -> None:
    """Write a table, whole or not at all."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({name: "" if row[name] != row[name] else row[name] for name in columns})
    write_atomically(path, text.getvalue().encode(errors="surrogateescape"))
