"""Sheets to print: a target as a PDF of true size."""

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, PathPatch, Rectangle
from matplotlib.path import Path as Outline

from endolab.calibration.session import describe_target
from endolab.calibration.targets import TARGETS, Target
from endolab.io.atomic import PathLike, stage_file

A4 = (297.0, 210.0)  # landscape, mm; a page is larger if the sheet needs it
EDGE = 8.0  # mm that a printer may leave white
CAPTION = 24.0  # mm below the sheet, for words and the ruler
RULER = 50  # mm
SIDES = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])  # once around a square


def paper_of(target: Target) -> str:
    """Name the smallest paper that a sheet is printed on."""
    long, short = A4
    taken = draw_sheet(target).get_size_inches() * 25.4 - 0.01
    for name in ("A4", "A3", "A2", "A1", "A0"):
        if taken[0] < long and taken[1] < short:
            return name
        long, short = long * np.sqrt(2), long
    return f"{taken[0]:.0f} x {taken[1]:.0f} mm"


def draw_sheet(target: Target) -> Figure:
    """Draw a sheet on its page, with its name in `TARGETS`, if it has one, and what it is.

    The figure is of the page's size: A4 landscape, or larger where the sheet is. Its only axes are in mm of
    the target's frame, y down.
    """
    left, top, width, height = target.sheet
    taken = np.array([width, height + CAPTION])
    page = np.maximum(taken + 2 * EDGE, A4)
    figure = Figure(figsize=tuple(page / 25.4))
    axes = figure.add_axes((0, 0, 1, 1))
    x, y = np.array([left, top]) + (taken - page) / 2  # of the page's corner
    axes.set(xlim=(x, x + page[0]), ylim=(y + page[1], y))
    axes.set_axis_off()
    rim: Any = {"fill": False, "edgecolor": "0.7", "linewidth": 0.5}
    axes.add_patch(Rectangle((left, top), width, height, **rim))
    discs = PatchCollection([Circle((x, y), radius) for x, y, radius, _ in target.discs])
    # SRGB, which pages are in; its straight part is darker than any ink.
    greys = (1.055 * target.discs[:, 3] ** (1 / 2.4) - 0.055).clip(0)
    discs.set(facecolor=[f"{grey:.4f}" for grey in greys], linewidth=0)
    axes.add_collection(discs)
    # All squares are one outline: then no renderer shows seams.
    corners = [target.squares[:, :2] + side * target.squares[:, 2:] for side in SIDES]
    outline = Outline.make_compound_path_from_polys(np.stack(corners, axis=1))
    axes.add_patch(PathPatch(outline, facecolor="black", linewidth=0))
    words: dict[str, Any] = {"fontsize": 8, "color": "0.2", "va": "center"}
    lines: dict[str, Any] = {"color": "0.4", "linewidth": 0.5}
    bottom = top + height
    if target.fold is not None:
        axes.plot([target.fold_x] * 2, [top, bottom], "|", ms=12, **lines)
        axes.text(target.fold_x, top - 5, "fold here, away from you", ha="center", **words)
    names = [name for name, known in TARGETS.items() if known == target]
    what = ": ".join([*names, describe_target(target)])
    axes.text(left, bottom + 5, f"{what}. Print at 100 %, not fitted to the page.", **words)
    check = f"Check: this line must be {RULER} mm long."
    axes.text(left, bottom + 10, check, **words)
    ruler = left + np.arange(0, RULER + 1, 10)
    axes.plot(ruler, np.full(len(ruler), bottom + 17), "|-", **lines)
    return figure


def write_sheet(target: Target, path: PathLike) -> None:
    """Write a sheet to print at true size, a .pdf, whole or not at all; the same bytes each time."""
    if Path(path).suffix.lower() != ".pdf":
        raise ValueError(f"{path}: a sheet is written as .pdf")
    with stage_file(path) as temporary, matplotlib.rc_context({"path.simplify": False}):
        draw_sheet(target).savefig(temporary, metadata={"CreationDate": None})
