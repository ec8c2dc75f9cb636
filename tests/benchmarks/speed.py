"""Seconds of the default and of one channel: `python -m tests.benchmarks.speed`.

Not a test: it asserts nothing and depends on the machine.
"""

import time
from dataclasses import replace
from statistics import median

from endolab import datasets
from tests.benchmarks.frames import cases_of, table
from tests.tools.cases import Case, drawn

REPEATS = 7


def frames():
    """The guide's frames, each on the pixels that it names, as far as they are here."""
    yield replace(drawn("colon", "paper", 320), name="the demo's colon")
    for name, own in (("traced", "matt"), ("rendered", "colon_pinhole")):
        yield from (case for case in cases_of(name) if case.name == own)
    folder = datasets.data_folder()
    if folder and (folder / "c3vd_trans_t1_a").is_dir():
        sample = datasets.open_dataset(folder / "c3vd_trans_t1_a")[0]
        yield Case("C3VD", sample.frame, sample.calibration, sample.distance)


def seconds_of(case, **options):
    """Median of the seconds that a frame takes, once all is compiled."""
    case.solve(**options)
    seconds = []
    for _ in range(REPEATS):
        started = time.perf_counter()
        case.solve(**options)
        seconds.append(time.perf_counter() - started)
    return f"{median(seconds):.2f}"


if __name__ == "__main__":
    heads = ("frame", "px", "the default", "one channel")
    rows = [
        [
            case.name,
            str(case.frame.width),
            seconds_of(case),
            seconds_of(case, channel="green"),
        ]
        for case in frames()
    ]
    table("Seconds, medians", heads, rows)
