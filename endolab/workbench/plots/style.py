"""The house style of figures: colours, sizes, axes with units, colour bars, scale bars.

Colours are safe for colour-blind readers (Okabe and Ito's), text is large enough to be read at
half the figure's size, and paper is white and opaque, so that a figure looks the same on a dark
page. Where a caller's axes lie on a dark figure, what is drawn inside them still lies on white
paper, and what is written outside them keeps the caller's ink.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar  # type: ignore[import-untyped]

from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.workbench.plots.scales import OKABE_ITO, Colour, isoline_levels, round_length


def hex_colour(colour: Colour) -> str:
    """Say a colour, R, G, B of 255, as Matplotlib reads it."""
    return "#{:02X}{:02X}{:02X}".format(*colour)


@dataclass(frozen=True)
class Look:
    """What figures look like: colours as Matplotlib reads them, sizes of text in points."""

    left_out: tuple[float, float, float] = (0.72, 0.72, 0.72)  # what is unknown in a map
    backdrop: tuple[float, float, float] = (0.09, 0.10, 0.12)  # of a surface in space
    paper: str = "white"
    vermilion: str = hex_colour(OKABE_ITO.vermilion)
    sky: str = hex_colour(OKABE_ITO.sky)
    blue: str = hex_colour(OKABE_ITO.blue)
    green: str = hex_colour(OKABE_ITO.green)
    purple: str = hex_colour(OKABE_ITO.purple)
    orange: str = hex_colour(OKABE_ITO.orange)
    text_size: float = 12.0  # at 100 dots per inch 17 px, and 8 at half size
    page_text_size: float = 13.0  # of pages of many panels, which are shown smaller
    between_ticks: float = 0.09  # of a colour bar, between two numbers
    margin: float = 0.01  # of a picture's longer side, around what is known
    most_shown: float = 0.8  # of a picture: if more is known, all of it is shown

    @property
    def curve_colours(self) -> tuple[str, ...]:
        """Of curves that are neither start nor estimate."""
        return self.green, self.purple, self.orange, self.blue


HOUSE = Look()
STYLE: Any = {
    **dict.fromkeys(("figure.facecolor", "axes.facecolor"), HOUSE.paper),
    **dict.fromkeys(
        ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"),
        "black",
    ),
    **dict.fromkeys(
        ("axes.labelsize", "xtick.labelsize", "ytick.labelsize", "legend.fontsize"),
        "medium",
    ),
    **dict.fromkeys(("xtick.labelcolor", "ytick.labelcolor"), "inherit"),
    "axes.titlesize": "large",
    "axes.titleweight": "bold",
    "axes.prop_cycle": cycler(
        color=(
            HOUSE.blue,
            HOUSE.vermilion,
            HOUSE.green,
            HOUSE.purple,
            HOUSE.orange,
            HOUSE.sky,
        )
    ),
    "legend.frameon": False,
    "savefig.facecolor": "auto",
    "savefig.transparent": False,
    "grid.alpha": 0.3,
    "grid.color": "0.5",
    "lines.linewidth": 1.8,
}
_SIZE: ContextVar[float | None] = ContextVar("size", default=None)


@contextmanager
def house(size: float = HOUSE.text_size) -> Iterator[None]:
    """Draw in the house style, with text of that many points; also a decorator, ``@house()``.

    Within a page that has chosen its own size, that one stays.
    """
    if _SIZE.get() is not None:
        yield
        return
    token = _SIZE.set(size)
    try:
        with matplotlib.rc_context(STYLE | {"font.size": size}):
            yield
    finally:
        _SIZE.reset(token)


@contextmanager
def page(width: float, height: float) -> Iterator[Figure]:
    """Give a figure for many panels, in units of 100 px, that is none of pyplot's."""
    with house(HOUSE.page_text_size):
        yield Figure(figsize=(width, height), dpi=100, layout="constrained")


def use(size: float = HOUSE.text_size) -> None:
    """Give the house style to all that pyplot draws from now on."""
    matplotlib.rcParams.update(STYLE | {"font.size": size})


def new_axes(ax: Axes | None) -> Axes:
    """Return the axes, or those of a new figure."""
    if ax is None:
        from matplotlib import pyplot  # of which pages have no need

        ax = pyplot.subplots(layout="constrained")[1]
    return ax


def decorate(ax: Axes | None, title: str, x: str, y: str, grid: bool = True) -> Axes:
    """Give axes, whoever made them, white paper, a title, a grid, and labels: quantity [unit].

    Without any it makes new ones.
    """
    ax = new_axes(ax)
    ax.set_facecolor(HOUSE.paper)
    ax.set_title(title)
    ax.set_xlabel(x, size=matplotlib.rcParams["axes.labelsize"])
    ax.set_ylabel(y, size=matplotlib.rcParams["axes.labelsize"])
    ax.tick_params(which="both", labelsize=matplotlib.rcParams["xtick.labelsize"])
    if grid:
        ax.grid(True, alpha=STYLE["grid.alpha"], color=STYLE["grid.color"])
    return ax


def pixel_axes(ax: Axes | None, title: str) -> Axes:
    """Axes of a picture, in px; grey where it is not known."""
    ax = decorate(ax, title, "column u [px]", "row v [px]", grid=False)
    ax.set_facecolor(HOUSE.left_out)
    return ax


def show_values(
    values: FloatArray,
    ax: Axes | None,
    title: str,
    label: str,
    limits: tuple[float, float],
    ends: str | None = None,
    scale: type[Normalize] = Normalize,
    **look: Any,
) -> Axes:
    """Show a map with a colour bar, whose `ends` are pointed where values exceed the limits."""
    ax = pixel_axes(ax, title)
    low, high = limits
    shown = ax.imshow(values, norm=scale(low, high), interpolation="nearest", **look)
    crop(ax, np.isfinite(values))
    if ends is None:
        below = bool(np.any(values < low))
        above = bool(np.any(values > high))
        ends = (("neither", "max"), ("min", "both"))[below][above]
    colour_bar(ax, shown, label, ends)
    ax.locator_params(nbins=3)
    return ax


def crop(ax: Axes, known: BoolArray) -> None:
    """Show the part of a map, (H, W), that is known, if it is much smaller; axes stay in px."""
    margin = HOUSE.margin * max(known.shape)
    ends = []
    for axis, size in enumerate(known.shape[::-1]):
        inside = np.flatnonzero(known.any(axis=axis))
        if not inside.size:
            return
        low = max(inside[0] - margin, 0) - 0.5
        ends.append((low, min(inside[-1] + margin, size - 1) + 0.5))
    if np.prod(np.ptp(ends, axis=1)) < HOUSE.most_shown * known.size:
        ax.set(xlim=ends[0], ylim=ends[1][::-1])


def colour_bar(
    ax: Axes, shown: ScalarMappable, label: str, extend: str = "neither"
) -> Colorbar:
    """Put a colour bar beside a picture, as high as the picture; `extend` says which ends are exceeded."""
    # An inset is as high as the picture; a bar beside the axes is as high as their slot.
    bar = ax.figure.colorbar(
        shown, cax=ax.inset_axes((1.03, 0, 0.045, 1)), label=label, extend=extend
    )
    if isinstance(shown.norm, LogNorm):
        _tick_isolines(bar, *shown.get_clim())
    else:
        bar.ax.locator_params(nbins=5)
    # The bar lies outside the axes, on the figure's colour.
    ink = ax.yaxis.label.get_color()
    bar.ax.yaxis.label.set_color(ink)
    bar.ax.tick_params(colors=ink)
    bar.outline.set_edgecolor(ink)
    return bar


def _tick_isolines(bar: Colorbar, low: float, high: float) -> None:
    """Tick a logarithmic colour bar where maps have isolines; numbers only where there is room."""
    levels = isoline_levels(low, high)
    labels = []
    below = -1.0
    for level, place in zip(levels, np.log(levels / low) / np.log(high / low), strict=True):
        has_room = place - below > HOUSE.between_ticks
        labels.append(f"{level:g}" if has_room else "")
        below = place if has_room else below
    bar.set_ticks(levels.tolist(), labels=labels)
    bar.minorticks_off()


def legend_below(ax: Axes, **what: Any) -> None:
    """Put the legend below the axes and their label, where it hides nothing of a picture."""
    place: Any = {"loc": "upper center", "bbox_to_anchor": (0.5, 0), "borderaxespad": 3.6}
    ax.legend(ncols=3, **place, **what)


def scale_bar(ax: Axes, width: float, unit: str) -> None:
    """Draw a bar of a round length, about a quarter of the width, in the lower left corner."""
    length = round_length(width / 4)
    bar = AnchoredSizeBar(
        ax.transData,
        length,
        f"{length:g} {unit}",
        "lower left",
        frameon=False,
        color="white",
        pad=0.8,
        sep=4,
    )
    ax.add_artist(bar)
