"""The house style of figures: colours, sizes, axes with units, colour bars.

Colours are safe for colour-blind readers (Okabe and Ito's), text is large enough to be read at
half the figure's size, and paper is white and opaque, so that a figure looks the same on a dark
page. Axes that a caller gives get white paper, too.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from types import SimpleNamespace
from typing import Any

import matplotlib.style
import numpy as np
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import LogLocator, MaxNLocator

from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.workbench.plots import scales
from endolab.workbench.plots.scales import COLOURS, MAPS

# Colours as Matplotlib reads them; `left_out` is of what is unknown in a map.
HOUSE = SimpleNamespace(left_out=(0.72, 0.72, 0.72), **COLOURS)
# Of curves that are neither start nor estimate.
HOUSE.curve_colours = (HOUSE.green, HOUSE.purple, HOUSE.orange, HOUSE.blue)
STYLE: Any = [
    "default",  # black on white, whatever the style around it
    {
        "font.size": 12,  # at 100 dots per inch 17 px, and 8 at half size
        "axes.titleweight": "bold",
        "axes.prop_cycle": cycler(
            color=[HOUSE.blue, HOUSE.vermilion, *HOUSE.curve_colours[:3], HOUSE.sky]
        ),
        "legend.frameon": False,
        "grid.alpha": 0.3,
        "grid.color": "0.5",
        "lines.linewidth": 1.8,
    },
]
# Draw in the house style: a context, and a decorator, ``@house()``.
house = partial(matplotlib.style.context, STYLE)
# Give the house style to all that pyplot draws from now on.
use = partial(matplotlib.style.use, STYLE)

# Round distances: ticks of their colour bars, and lines on their maps.
ROUND = LogLocator(subs=(1, 2, 3, 5, 7))
AxesOrNew = Axes | None  # none: those of a new figure


@contextmanager
def page(width: float, height: float, lines: int = 0) -> Iterator[Figure]:
    """Give a figure for many panels, in units of 100 px, none of pyplot's, with room for some lines above.

    Pages are shown smaller, so that all on them is drawn a twelfth larger.
    """
    size = (12 / 13 * width, 12 / 13 * height)
    room = (0.01, 0.01, 0.98, 0.98 - 0.3 * lines / height)  # nothing at the edge
    with house():
        yield Figure(size, dpi=100 * 13 / 12, layout=ConstrainedLayoutEngine(rect=room))


def decorate(ax: AxesOrNew, title: str, x: str, y: str, grid: bool = True) -> Axes:
    """Give axes, whoever made them, white paper, a title, a grid, and labels: quantity [unit].

    Without any it makes new ones.
    """
    if ax is None:
        from matplotlib import pyplot  # of which pages have no need

        ax = pyplot.subplots(layout="constrained")[1]
    ax.set(facecolor="white", title=title)
    ax.set_xlabel(x, size="medium")
    ax.set_ylabel(y, size="medium")
    ax.tick_params(which="both", labelsize="medium")
    if grid:
        ax.grid(True)
    return ax


def show_pixels(picture: FloatArray, ax: AxesOrNew, title: str, **look: Any) -> Axes:
    """Show a picture on axes in px; grey where it is not known."""
    ax = decorate(ax, title, "column u [px]", "row v [px]", grid=False)
    ax.set_facecolor(HOUSE.left_out)
    ax.imshow(picture, interpolation="nearest", **look)
    ax.locator_params(nbins=3)
    return ax


def show_values(
    name: str,
    values: FloatArray,
    ax: AxesOrNew,
    title: str = "",
    label: str = "",
    limits: tuple[float, float] | None = None,
    **look: Any,
) -> Axes:
    """Show one of `MAPS`, with a colour bar, which is pointed where values may exceed the limits."""
    scale = MAPS[name]
    low, high = limits or scales.limits(name, values)
    norm = (LogNorm if scale.kind == "log" else Normalize)(low, high)
    look |= {"cmap": scale.palette, "norm": norm}
    ax = show_pixels(values, ax, title or scale.title, **look)
    crop(ax, np.isfinite(values))
    ends = "max" if scale.kind == "from 0" else "both"
    label = label or f"{scale.title.lower()} [{scale.unit}]"
    colour_bar(ax, ax.images[-1], label, ends)
    return ax


def crop(ax: Axes, known: BoolArray) -> None:
    """Show the part of a map, (H, W), that is known; axes stay in px."""
    rows, columns = np.nonzero(known)
    if rows.size:
        left, right = columns.min() - 0.5, columns.max() + 0.5
        ax.axis((left, right, rows.max() + 0.5, rows.min() - 0.5))


def colour_bar(
    ax: Axes, shown: ScalarMappable, label: str, extend: str = "neither"
) -> Colorbar:
    """Put a colour bar beside a picture, as high as the picture; `extend` says which ends are exceeded."""
    # An inset is as high as the picture; a bar beside the axes is as high as their slot.
    place = ax.inset_axes((1.03, 0, 0.045, 1))
    ticks = ROUND if isinstance(shown.norm, LogNorm) else MaxNLocator(5)
    look: Any = {"label": label, "extend": extend, "ticks": ticks, "format": "%g"}
    bar = ax.figure.colorbar(shown, cax=place, **look)
    bar.minorticks_off()
    return bar


def legend_below(ax: Axes) -> None:
    """Put the legend below the axes and their label, where it hides nothing of a picture."""
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, 0), borderaxespad=3.6, ncols=3)
