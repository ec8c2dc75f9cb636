"""A table of reconstructions, one a row, as CSV: what is not known is nan, and an empty cell."""

import csv
import io
import math
from collections.abc import Iterable, Sequence
from typing import Any

from endolab.io.atomic import PathLike, write_atomically
from endolab.solvers.result import Result

Row = dict[str, Any]
MEASURED = ("iterations", "energy", "data", "regulariser_energy", "seconds")


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
