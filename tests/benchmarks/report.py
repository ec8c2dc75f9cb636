"""What the tables share: how they are printed, and times."""

import sys
import time
from collections.abc import Callable, Iterable
from statistics import median


def table(title: str, heads: Iterable[str], rows: Iterable[Iterable[str]]) -> None:
    """Print a table in Markdown, aligned."""
    lines = [list(heads), *(list(row) for row in rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    lines.insert(1, ["-" * width for width in widths])
    print(f"\n{title}\n")
    for line in lines:
        cells = (cell.ljust(width) for cell, width in zip(line, widths, strict=True))
        print(f"| {' | '.join(cells)} |")
    sys.stdout.flush()


def seconds_of(call: Callable[[], object], repeats: int = 9) -> float:
    """Median of the seconds that a call takes, once it is compiled."""
    call()
    seconds = []
    for _ in range(repeats):
        started = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - started)
    return median(seconds)
