"""The pen of the drawings: paper, arrows, angles, walls, lamps, and where a ray meets a wall.

A drawing is 100 units wide; at 700 px a unit is 7 px. Its parts are named (``gid``): tests measure them,
and the names stand in the SVG.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from numpy.typing import ArrayLike

from endolab.numerics.arrays import FloatArray
from endolab.plots.style import BLUE, ORANGE, PAPER

WIDTH = 100.0
INCHES = 7.0
INK, FAINT = "black", "0.45"
TISSUE, RIM = "#F4DCD0", "#8A4B38"
STEEL, GLASS = "0.82", "#CBE3F5"
HEAD = 2.2  # of an arrow, units


def paper(height: float) -> Axes:
    """Make a white page, 100 units wide and so many high, y upwards; a unit is the same in x and y."""
    figure = Figure(figsize=(INCHES, INCHES * height / WIDTH), facecolor=PAPER)
    ax = figure.add_axes((0, 0, 1, 1))
    ax.set(xlim=(0, WIDTH), ylim=(0, height))
    ax.axis("off")
    return ax


def page(ax: Axes) -> Figure:
    """Return the page that axes lie on."""
    figure = ax.figure
    assert isinstance(figure, Figure)
    return figure


# Geometry -------------------------------------------------------------------------------
def at(degrees: float) -> FloatArray:
    """Direction at an angle, counted from x towards y."""
    return np.array([np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))])


def towards(start: ArrayLike, end: ArrayLike) -> FloatArray:
    """Direction from one place to another."""
    step = np.subtract(end, start)
    return np.asarray(step / np.hypot(*step))


def moved(places: ArrayLike, right: float, up: float) -> FloatArray:
    """Places, (..., 2), shifted on the page."""
    return np.asarray(places, float) + np.array([right, up])


def box(left: float, low: float, right: float, high: float) -> FloatArray:
    """Corners of an upright rectangle."""
    return np.array([(left, low), (right, low), (right, high), (left, high)])


def heading(direction: FloatArray) -> float:
    """Angle of a direction, degrees."""
    return float(np.rad2deg(np.arctan2(direction[1], direction[0])))


def between(first: FloatArray, second: FloatArray) -> float:
    """Angle between two directions, degrees."""
    return abs((heading(first) - heading(second) + 180) % 360 - 180)


def hits(start: ArrayLike, direction: FloatArray, wall: FloatArray) -> FloatArray:
    """Distances at which a ray meets a wall, (n, 2) places in a row, nearest first."""
    steps = np.diff(wall, axis=0)
    offset = wall[:-1] - np.asarray(start)
    cross = direction[0] * steps[:, 1] - direction[1] * steps[:, 0]
    cross = np.where(cross == 0, np.nan, cross)
    along = (offset[:, 0] * steps[:, 1] - offset[:, 1] * steps[:, 0]) / cross
    share = (offset[:, 0] * direction[1] - offset[:, 1] * direction[0]) / cross
    return np.sort(along[(share >= 0) & (share < 1) & (along > 1e-9)])


def normals(wall: FloatArray) -> FloatArray:
    """Unit normals of a wall at its places, (n, 2): to the left of who walks along it."""
    x, y = np.gradient(wall, axis=0).T
    return np.asarray(np.stack([-y, x], axis=-1) / np.hypot(x, y)[:, None])


def normal_at(place: FloatArray, wall: FloatArray) -> FloatArray:
    """Unit normal of a wall at the place of it that lies nearest."""
    return np.asarray(normals(wall)[np.argmin(np.hypot(*(wall - place).T))])


# Strokes --------------------------------------------------------------------------------
def stroke(ax: Axes, places: Any, colour: str, name: str | None = None, **style: Any) -> None:
    """Draw a line through places, (n, 2)."""
    x, y = np.transpose(places)
    kept: Any = {"lw": 1.8, "solid_capstyle": "round", "solid_joinstyle": "round"} | style
    ax.plot(x, y, color=colour, gid=name, clip_on=False, **kept)


def arrow(
    ax: Axes,
    start: ArrayLike,
    end: ArrayLike,
    colour: str,
    name: str | None = None,
    share: float = 1.0,
    **style: Any,
) -> None:
    """Draw an arrow whose head ends at a share of its way; at 1 it ends there itself."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    along = towards(start, end)
    across = 0.36 * HEAD * np.array([-along[1], along[0]])
    point = start + share * (end - start)
    back = point - HEAD * along
    last = end if share < 1 else end - 0.7 * HEAD * along  # a head is sharper than a line
    stroke(ax, [start, last], colour, name, **({"solid_capstyle": "butt"} | style))
    shapes(ax, [np.array([point, back + across, back - across])], facecolor=colour, zorder=3)


def angle(
    ax: Axes,
    apex: ArrayLike,
    first: FloatArray,
    second: FloatArray,
    radius: float,
    text: str,
    colour: str,
    name: str | None = None,
    beyond: float = 2.6,
    share: float = 0.5,
) -> None:
    """Draw the arc between two directions, the short way round, and write its name beyond a share of it."""
    start = heading(first)
    turn = (heading(second) - start + 180) % 360 - 180
    rays = np.array([at(start + part * turn) for part in np.linspace(0, 1, 25)])
    stroke(ax, np.asarray(apex) + radius * rays, colour, name, lw=1.6)
    write(ax, np.asarray(apex) + (radius + beyond) * at(start + share * turn), text, colour)


def write(ax: Axes, place: ArrayLike, text: str, colour: str = INK, **style: Any) -> None:
    """Write centred on a place."""
    x, y = np.asarray(place, float)
    kept: Any = {"ha": "center", "va": "center", "linespacing": 1.3, "zorder": 5} | style
    ax.text(x, y, text, color=colour, **kept)


def shapes(ax: Axes, outlines: Iterable[FloatArray], **style: Any) -> None:
    """Fill closed outlines, (n, 2) each, as one path."""
    paths = [Path(np.concatenate([outline, outline[:1]]), closed=True) for outline in outlines]
    ax.add_patch(PathPatch(Path.make_compound_path(*paths), clip_on=False, **({"lw": 0} | style)))


def dot(ax: Axes, place: ArrayLike, colour: str, radius: float = 0.8, **style: Any) -> None:
    """Draw a disc."""
    disc = np.asarray(place, float) + radius * np.array(
        [at(angle) for angle in range(0, 360, 6 if radius > 2 else 20)]
    )
    shapes(ax, [disc], **({"facecolor": colour, "zorder": 4} | style))


# Things ---------------------------------------------------------------------------------
def tissue(ax: Axes, wall: FloatArray, behind: ArrayLike, name: str = "wall") -> None:
    """Draw a wall with the tissue between it and a line behind it, (m, 2) from end to end."""
    thinned = np.concatenate([wall[: -1 : max(1, len(wall) // 100)], wall[-1:]])  # for the file's size
    shapes(ax, [np.concatenate([thinned, np.asarray(behind, float)[::-1]])], facecolor=TISSUE, zorder=1)
    stroke(ax, wall, RIM, name, lw=2.2, zorder=2)


def tip(ax: Axes, place: ArrayLike, half: float, length: float = 7.0) -> None:
    """Draw the tip of an endoscope that looks to the right, with its lens at a place."""
    x, y = np.asarray(place, float)
    shapes(ax, [box(x - length, y - half, x, y + half)], facecolor=STEEL, zorder=2)
    lens = np.array([(1.0 * np.cos(a), 2.4 * np.sin(a)) for a in np.linspace(-np.pi / 2, np.pi / 2, 15)])
    shapes(ax, [moved(lens, x, y)], facecolor=GLASS, edgecolor=BLUE, lw=1.4, zorder=3)


def lamp(
    ax: Axes, place: ArrayLike, colour: str = ORANGE, radius: float = 1.5, rays: Sequence[float] = ()
) -> None:
    """Draw a small light, with short beams in the directions that are named, degrees."""
    for degrees in rays:
        beam = [np.asarray(place) + reach * radius * at(degrees) for reach in (1.45, 2.2)]
        stroke(ax, beam, ORANGE, lw=1.6, zorder=4)
    dot(ax, place, ORANGE, radius, edgecolor=INK, lw=0.8)
