"""Sheets to print: a target as a PDF or SVG of true size, and its description as JSON."""

import io
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch, Rectangle
from matplotlib.path import Path as Outline

from endolab.calibration.targets import TARGETS, Board, Target
from endolab.io.atomic import PathLike, write_atomically
from endolab.numerics.arrays import FloatArray

A4 = (297.0, 210.0)  # landscape, mm; a page is larger if the sheet needs it
EDGE = 8.0  # mm that a printer may leave white
CAPTION = 24.0  # mm below the sheet, for words and the ruler
WORDS = 120.0  # mm that the longest line of words needs
RULER = 50  # mm


def _fill(axes: Axes, unit: Outline, frames: FloatArray, colour: str) -> None:
    """Fill copies of a shape at (x, y, width, height), as one outline: then no renderer shows seams."""
    corners = np.asarray(unit.vertices)
    copies = [Outline(corners * frame[2:] + frame[:2], unit.codes) for frame in frames]
    if copies:
        outline = Outline.make_compound_path(*copies)
        axes.add_patch(PathPatch(outline, facecolor=colour, linewidth=0))


def draw_sheet(target: Target) -> Figure:
    """Draw a sheet on its page, under its name in `TARGETS`, or its kind.

    The figure is of the page's size: A4 landscape if the sheet fits, else as large as needed. Its only
    axes are in mm of the target's frame, y down.
    """
    left, top, width, height = target.sheet
    page = np.array([max(width, WORDS), height + CAPTION]) + 2 * EDGE
    if np.all(page <= A4):
        page = np.array(A4)
    figure = Figure(figsize=tuple(page / 25.4))
    axes = figure.add_axes((0, 0, 1, 1))
    x = left + (width - page[0]) / 2
    y = top - (page[1] - height - CAPTION) / 2
    axes.set(xlim=(x, x + page[0]), ylim=(y + page[1], y))
    axes.set_axis_off()
    rim: Any = {"fill": False, "edgecolor": "0.7", "linewidth": 0.5}
    axes.add_patch(Rectangle((left, top), width, height, **rim))
    discs = target.discs
    for reflectance in np.unique(discs[:, 3]):
        alike = discs[discs[:, 3] == reflectance]
        # SRGB, which pages are in; its straight part is darker than any ink.
        grey = max(1.055 * reflectance ** (1 / 2.4) - 0.055, 0)
        _fill(axes, Outline.unit_circle(), alike[:, [0, 1, 2, 2]], f"{grey:.4f}")
    _fill(axes, Outline.unit_rectangle(), target.squares[:, [0, 1, 2, 2]], "black")
    words: dict[str, Any] = {"fontsize": 8, "color": "0.2", "va": "center"}
    lines: dict[str, Any] = {"color": "0.4", "linewidth": 0.5}
    bottom = top + height
    if target.fold_x is not None:
        axes.plot([target.fold_x] * 2, [top, bottom], "|", ms=12, **lines)
        axes.text(target.fold_x, top - 5, "fold here, away from you", ha="center", **words)
    start = min(left, axes.get_xlim()[1] - EDGE - WORDS)
    names = [name for name, known in TARGETS.items() if known == target]
    step = f"{target.kind} {target.spacing:g} mm apart"
    if isinstance(target, Board):
        step = f"squares of {target.spacing:g} mm"
    what = f"{[*names, target.kind][0]}: {target.columns} × {target.rows} {step}"
    caption = f"{what}. Print at 100 %, not fitted to the page."
    axes.text(start, bottom + 5, caption, **words)
    check = f"Check: this line must be {RULER} mm long."
    axes.text(start, bottom + 10, check, **words)
    ruler = np.arange(0, RULER + 1, 10)
    axes.plot(start + ruler, np.full(len(ruler), bottom + 17), "|-", **lines)
    for tick in ruler:
        axes.text(start + tick, bottom + 20, f"{tick}", ha="center", **words)
    return figure


def write_sheet(target: Target, path: PathLike) -> None:
    """Write a sheet to print at true size, a .pdf or .svg, whole or not at all; the same bytes each time."""
    suffix = Path(path).suffix.lower()
    dates = {".pdf": "CreationDate", ".svg": "Date"}
    if suffix not in dates:
        raise ValueError(f"{path}: a sheet is written as .pdf or .svg")
    page = io.BytesIO()
    undated = {dates[suffix]: None}
    with matplotlib.rc_context({"svg.hashsalt": "endolab", "path.simplify": False}):
        draw_sheet(target).savefig(page, format=suffix[1:], metadata=undated)
    write_atomically(path, page.getvalue())
