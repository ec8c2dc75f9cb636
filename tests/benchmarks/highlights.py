"""Precision and recall of highlights against a renderer's own mirrored light, as a table.

Not a test: it asserts nothing. `python -m tests.benchmarks.highlights` looks at the path-traced frames.
"""

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

import endolab as el
from endolab import datasets
from endolab.frames.highlights import dilate, find_highlights, inpaint
from tests.benchmarks.report import table

LIMITS = (0.1, 0.2, 0.5)  # mirrored light over the tissue's, in green


def scores(
    image: np.ndarray, mask: np.ndarray, ratio: np.ndarray, gamma: float
) -> list[str]:
    """Share found, precision and recall at each limit, and seconds."""
    start = time.perf_counter()
    found = find_highlights(image, mask, gamma)
    seconds = time.perf_counter() - start
    row = [f"{100 * found[mask].mean():.2f} %"]
    for limit in LIMITS:
        true = mask & (ratio > limit)
        hit = (found & true).sum()
        row.append(
            f"{hit / found.sum():.2f} / {hit / true.sum():.2f}"
            if found.any() and true.any()
            else "–"
        )
    return [*row, f"{seconds:.2f} s"]


def filled_error(sample: Any) -> str:
    """Mean error of what is filled in, of the tissue's own green, stored values."""
    gamma = sample.calibration.photometry.gamma
    mask = sample.frame.mask
    holes = (
        dilate(
            find_highlights(sample.frame.image, mask, gamma), 2 / 320 * mask.shape[1]
        )
        & mask
    )
    if not holes.any():
        return "–"
    truth = np.clip(sample.direct + sample.indirect, 0, 1)[..., 1] ** (1 / gamma)
    green = (
        picture[..., 1]
        for picture in (inpaint(sample.frame.image, holes, mask), sample.frame.image)
    )
    after, before = (255 * np.abs(values - truth)[holes].mean() for values in green)
    return f"{before:.1f} -> {after:.1f}"


def report(samples: Mapping[str, Any]) -> None:
    """Print the table of path-traced frames, by name."""
    rows = []
    for name, sample in samples.items():
        frame = sample.frame
        gamma = sample.calibration.photometry.gamma
        tissue = np.maximum((sample.direct + sample.indirect)[..., 1], 1e-9)
        ratio = np.where(frame.mask, sample.mirrored / tissue, 0.0)
        for kind, image in (
            ("colour", frame.image),
            ("green alone", frame.image[..., 1]),
        ):
            line = scores(image, frame.mask, ratio, gamma)
            rows.append(
                [name, kind, *line, filled_error(sample) if kind == "colour" else ""]
            )
    heads = [f"precision / recall, > {100 * limit:.0f} %" for limit in LIMITS]
    table(
        "Highlights",
        ["frame", "picture", "found", *heads, "time", "grey levels off in holes"],
        rows,
    )


if __name__ == "__main__":
    report({name: el.load_traced(name) for name in datasets.TRACED if name != "matt"})
