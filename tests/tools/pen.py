"""The pen of the drawings: paper, arrows, angles, walls, lamps, and where a ray meets a wall.

A drawing is 100 units wide; at 700 px a unit is 7 px. Places are arrays (..., 2), y upwards.
"""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Ellipse, PathPatch
from matplotlib.path import Path

from endolab.plots.style import BLUE, ORANGE, PAPER

INCHES = 7.0
INK, FAINT = "black", "0.45"
TISSUE, RIM = "#F4DCD0", "#8A4B38"
STEEL, GLASS = "0.82", "#CBE3F5"
DASHED = (0, (4, 2))
HEAD = 2.2  # of an arrow, units


def paper(height):
    """Axes of a white page, 100 units wide and so many high; a unit is the same in x and y."""
    figure = Figure(figsize=(INCHES, INCHES * height / 100), facecolor=PAPER)
    ax = figure.add_axes((0, 0, 1, 1))
    ax.set(xlim=(0, 100), ylim=(0, height))
    ax.axis("off")
    return ax


# Geometry -------------------------------------------------------------------------------
def at(degrees):
    """Direction at an angle, counted from x towards y."""
    return np.array([np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))])


def towards(start, end):
    """Direction from one place to another."""
    step = np.subtract(end, start)
    return step / np.hypot(*step)


def moved(places, right, up):
    """Places, (..., 2), shifted on the page."""
    return np.asarray(places) + np.array([right, up])


def box(left, low, right, high):
    """Corners of an upright rectangle."""
    return np.array([(left, low), (right, low), (right, high), (left, high)])


def heading(direction):
    """Angle of a direction, degrees."""
    return np.rad2deg(np.arctan2(direction[1], direction[0]))


def hit(start, direction, wall):
    """Place where a ray first meets a wall, (n, 2) places in a row."""
    steps, offset = np.diff(wall, axis=0), wall[:-1] - start
    cross = direction[0] * steps[:, 1] - direction[1] * steps[:, 0]
    along = (offset[:, 0] * steps[:, 1] - offset[:, 1] * steps[:, 0]) / cross
    share = (offset[:, 0] * direction[1] - offset[:, 1] * direction[0]) / cross
    return start + along[(share >= 0) & (share < 1) & (along > 1e-9)].min() * direction


def normals(wall):
    """Unit normals of a wall at its places, (n, 2): to the left of who walks along it."""
    x, y = np.gradient(wall, axis=0).T
    return np.stack([-y, x], axis=-1) / np.hypot(x, y)[:, None]


def normal_at(place, wall):
    """Unit normal of a wall at the place of it that lies nearest."""
    return normals(wall)[np.argmin(np.hypot(*(wall - place).T))]


# Strokes --------------------------------------------------------------------------------
def stroke(ax, places, colour, **style):
    """Draw a line through places, (n, 2)."""
    kept = {"lw": 1.8, "solid_capstyle": "round", "solid_joinstyle": "round"}
    ax.plot(*np.transpose(places), color=colour, clip_on=False, **kept | style)


def arrow(ax, start, end, colour, share=1.0, **style):
    """Draw an arrow whose head ends at a share of its way; at 1 it ends there itself."""
    along = towards(start, end)
    across = 0.36 * HEAD * np.array([-along[1], along[0]])
    point = start + share * np.subtract(end, start)
    back = point - HEAD * along
    last = end if share < 1 else end - 0.7 * HEAD * along  # a head is sharper than a line
    stroke(ax, [start, last], colour, solid_capstyle="butt", **style)
    shapes(ax, [np.array([point, back + across, back - across])], facecolor=colour, zorder=3)


def angle(ax, apex, first, second, radius, text, colour, beyond=2.6, share=0.5):
    """Draw the arc between two directions, the short way round, and write its name beyond a share of it."""
    start = heading(first)
    turn = (heading(second) - start + 180) % 360 - 180
    rays = at(start + turn * np.linspace(0, 1, 25)).T
    stroke(ax, apex + radius * rays, colour, lw=1.6)
    write(ax, apex + (radius + beyond) * at(start + share * turn), text, colour)


def write(ax, place, text, colour=INK, **style):
    """Write centred on a place."""
    kept = {"ha": "center", "va": "center", "linespacing": 1.3, "zorder": 5}
    ax.text(*place, text, color=colour, **kept | style)


def shapes(ax, outlines, **style):
    """Fill closed outlines, (n, 2) each, as one path."""
    paths = [Path(np.concatenate([outline, outline[:1]]), closed=True) for outline in outlines]
    ax.add_patch(PathPatch(Path.make_compound_path(*paths), clip_on=False, **{"lw": 0} | style))


def dot(ax, place, colour, radius=0.8, **style):
    """Draw a disc."""
    ax.add_patch(Circle(place, radius, facecolor=colour, clip_on=False, **{"lw": 0, "zorder": 4} | style))


# Things ---------------------------------------------------------------------------------
def tissue(ax, wall, behind):
    """Draw a wall with the tissue between it and a line behind it, (m, 2) from end to end."""
    shapes(ax, [np.concatenate([wall, behind[::-1]])], facecolor=TISSUE, zorder=1)
    stroke(ax, wall, RIM, lw=2.2, zorder=2)


def tip(ax, place, half, length=7.0):
    """Draw the tip of an endoscope that looks to the right, with its lens at a place."""
    x, y = place
    ax.add_patch(Ellipse(place, 2.0, 4.8, facecolor=GLASS, edgecolor=BLUE, lw=1.4, zorder=3))
    shapes(ax, [box(x - length, y - half, x, y + half)], facecolor=STEEL, zorder=3)


def lamp(ax, place, radius=1.5, rays=()):
    """Draw a small light, with short beams in the directions that are named, degrees."""
    for degrees in rays:
        beam = place + radius * np.outer([1.45, 2.2], at(degrees))
        stroke(ax, beam, ORANGE, lw=1.6, zorder=4)
    dot(ax, place, ORANGE, radius, edgecolor=INK, lw=0.8)
