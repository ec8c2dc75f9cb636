"""Sheets to print: a target as a PDF or SVG of true size, and its description as JSON."""

import io
from dataclasses import dataclass
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


@dataclass(frozen=True)
class SheetPage:
    """The page of a target, mm."""

    size: tuple[float, float] = (297.0, 210.0)  # A4 landscape; larger if the sheet needs it
    edge: float = 8.0  # that a printer may leave white
    caption: float = 24.0  # below the sheet, for words and the ruler
    words: float = 120.0  # that the longest line of words needs
    ruler: float = 50.0


PAGE = SheetPage()


# Pages ----------------------------------------------------------------------------------
def _fill(axes: Axes, unit: Outline, frames: FloatArray, colour: str) -> None:
    """Fill copies of a shape at (x, y, width, height), as one outline: then no renderer shows seams."""
    corners = np.asarray(unit.vertices, dtype=np.float64)
    copies = [Outline(corners * frame[2:] + frame[:2], unit.codes) for frame in frames]
    if copies:
        axes.add_patch(
            PathPatch(Outline.make_compound_path(*copies), facecolor=colour, linewidth=0)
        )


def _grey(reflectance: float) -> str:
    """Colour that a printer turns into a reflectance: sRGB, which pages are in."""
    dark = reflectance <= 0.0031308
    stored = 12.92 * reflectance if dark else 1.055 * reflectance ** (1 / 2.4) - 0.055
    return str(round(stored, 4))


def _caption(target: Target) -> str:
    names = [name for name, known in TARGETS.items() if known == target]
    size = f"{target.kind} {target.spacing:g} mm apart"
    if isinstance(target, Board):
        size = f"squares of {target.spacing:g} mm"
    return f"{[*names, target.kind][0]}: {target.columns} × {target.rows} {size}"


def draw_sheet(target: Target) -> Figure:
    """Draw a sheet on its page, under its name in `TARGETS`, or its kind.

    The figure is of the page's size: A4 landscape if the sheet fits, else as large as needed. Its only
    axes are in mm of the target's frame, y down.
    """
    left, top, width, height = target.sheet
    page = np.array([max(width, PAGE.words), height + PAGE.caption]) + 2 * PAGE.edge
    if np.all(page <= PAGE.size):
        page = np.array(PAGE.size)
    figure = Figure(figsize=(page[0] / 25.4, page[1] / 25.4))
    axes = figure.add_axes((0, 0, 1, 1))
    x = left + (width - page[0]) / 2
    y = top - (page[1] - height - PAGE.caption) / 2
    axes.set(xlim=(x, x + page[0]), ylim=(y + page[1], y))
    axes.set_axis_off()

    rim: Any = {"fill": False, "edgecolor": "0.7", "linewidth": 0.5}
    axes.add_patch(Rectangle((left, top), width, height, **rim))
    ink = target.ink
    for reflectance in np.unique(ink.greys[:, 3]):
        same = ink.greys[ink.greys[:, 3] == reflectance]
        _fill(axes, Outline.unit_circle(), same[:, [0, 1, 2, 2]], _grey(reflectance))
    _fill(axes, Outline.unit_circle(), ink.discs[:, [0, 1, 2, 2]], "black")
    _fill(axes, Outline.unit_rectangle(), ink.rectangles, "black")

    words: dict[str, Any] = {"fontsize": 8, "color": "0.2", "va": "center"}
    bottom = top + height
    line = min(left, x + page[0] - PAGE.edge - PAGE.words)
    if target.fold_x is not None:
        mark = min(3.0, target.margin / 3)
        for start, end in ((top, top + mark), (bottom, bottom - mark)):
            axes.plot([target.fold_x] * 2, [start, end], color="0.4", linewidth=0.6)
        axes.text(target.fold_x, top - 3, "fold here, away from you", ha="center", **words)
    caption = f"{_caption(target)}. Print at 100 %, not fitted to the page."
    axes.text(line, bottom + 5, caption, **words)
    ruler = bottom + 17
    check = f"Check: this line must be {PAGE.ruler:g} mm long."
    axes.text(line, bottom + 10, check, **words)
    axes.plot([line, line + PAGE.ruler], [ruler, ruler], color="black", linewidth=0.5)
    words["fontsize"] = 6
    for tick in np.arange(0, PAGE.ruler + 1, 10):
        at = line + tick
        axes.plot([at, at], [ruler - 1.5, ruler], color="black", linewidth=0.5)
        axes.text(at, ruler + 2.5, f"{tick:g}", ha="center", **words)
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
