"""Drawings of how depth is found, and of the sheet; geometry computed, not eyeballed."""

import numpy as np
from scipy.spatial.transform import Rotation

import endolab as el
from endolab.plots.style import BLUE, GREEN, ORANGE, SKY, VERMILION
from tests.tools import pen
from tests.tools.pen import DASHED, FAINT, INK

FINAL, FRONT = "#BBDDF3", "#F5C56B"


# A fold, and how the march slides over it -----------------------------------------------
def marched(facing, step):
    """Solve y'² = 4 (y₀² - y²) along a row of pixels, each from its lower neighbour; `step` is in radians."""
    y = facing.copy()
    for walk in (range(1, len(y)), range(len(y) - 2, -1, -1)):
        for here in walk:
            lower = y[here - walk.step]
            inside = (1 + 4 * step**2) * 4 * (step * facing[here]) ** 2 - (2 * step * lower) ** 2
            if lower < facing[here]:
                y[here] = min(y[here], (lower + np.sqrt(inside)) / (1 + 4 * step**2))
    return y


def fold():
    """A fold that hides a piece of wall, and how the march slides over the gap."""
    ax = pen.paper(50)
    eye, x = np.array([9.0, 37.0]), np.linspace(12, 99, 871)
    y = 7 + 13 * np.exp(-0.5 * ((x - 47) / 5) ** 2) + 25 * (np.maximum(x - 60, 0) / 39) ** 2
    wall = np.stack([x, y], axis=-1)
    headings = pen.heading((wall - eye).T)
    crest = np.argmax(np.where(x < 60, headings, -90))
    graze = headings[crest]
    landing = np.argmin(np.hypot(*(wall - pen.hit(eye, pen.at(graze + 1e-3), wall)).T))

    angles = np.linspace(-50, -4, 921)
    rays = pen.at(angles).T
    met = np.array([pen.hit(eye, ray, wall) for ray in rays])
    cosine = -np.sum(rays * [pen.normal_at(place, wall) for place in met], axis=-1)
    facing = np.sum((met - eye) ** 2, axis=-1) / cosine
    slid = eye + np.sqrt(marched(facing, np.deg2rad(angles[1] - angles[0])))[:, None] * rays

    hidden = wall[crest : landing + 1]
    pen.tissue(ax, wall, [(12, 2), (99, 2)])
    pen.stroke(ax, hidden, "white", lw=2.4, zorder=2)
    pen.stroke(ax, hidden, pen.RIM, lw=2.0, ls=(0, (2, 2)), zorder=2)
    for number in range(-5, 5):
        place = pen.hit(eye, pen.at(graze + 3.2 * (number + 0.5)), wall)
        colour, width, radius = (BLUE, 2.2, 0.9) if number in (-1, 0) else (SKY, 1.2, 0.7)
        pen.stroke(ax, [eye, place], colour, lw=width)
        pen.dot(ax, place, colour, radius)
    pen.stroke(ax, slid[angles > graze - 1], VERMILION, lw=2.6, zorder=4)
    pen.tip(ax, eye, 5)
    pen.write(ax, hidden[len(hidden) // 2] - (0, 3.4), "hidden", pen.RIM)
    pen.write(ax, pen.moved(eye, 27, 8.6), "two neighbouring pixels\nlook at two surfaces", BLUE)
    pen.write(ax, (73, 35.0), "the march joins neighbours:\nit slides over the gap", VERMILION)
    return ax.figure


# The march as a front -------------------------------------------------------------------
COLUMNS, ROWS, DONE = 13, 11, 42


def tilted_plane(column, row):
    """y = d² and y₀ = d²/cos θ of a tilted plane at a distance of 1, as a pinhole sees it."""
    rays = np.stack([(column - 6) / 8, (row - 5) / 8, np.ones_like(row)], axis=-1)
    normal = np.array([-0.19, 0.07, 1.0])
    cosine = rays @ normal / np.linalg.norm(normal) / np.linalg.norm(rays, axis=-1)
    return cosine**-2.0, cosine**-3.0


def front():
    """The march as a front: what is final, what is next, and how a pixel takes its value."""
    ax = pen.paper(60)
    y, _ = tilted_plane(*np.indices((ROWS, COLUMNS)).astype(float)[::-1])
    final = y <= np.sort(y, axis=None)[DONE - 1]
    around = np.pad(final, 1)
    beside = around[2:, 1:-1] | around[:-2, 1:-1] | around[1:-1, 2:] | around[1:-1, :-2]
    faces = np.where(final, FINAL, np.where(beside, FRONT, "white"))
    square = pen.box(-2, -2, 2, 2)

    def middle(row, column):
        return np.array([4 + 4 * column, 48 - 4 * row])

    for place in np.ndindex(ROWS, COLUMNS):
        pen.shapes(ax, [middle(*place) + square], facecolor=faces[place], edgecolor="0.65", lw=0.8)
    front = beside & ~final
    taking = np.argwhere(front[:-1, 1:] & final[:-1, :-1] & final[1:, 1:])
    row, left = taking[len(taking) // 2]  # a pixel takes its value from the left and from below
    here = middle(row, left + 1)
    for lower in (middle(row, left), middle(row + 1, left + 1)):
        pen.arrow(ax, lower, 0.15 * lower + 0.85 * here, INK, lw=1.6)
    start, lowest = (np.unravel_index(np.argmin(one), y.shape) for one in (y, np.where(front, y, np.inf)))
    pen.dot(ax, middle(*start), INK, 0.9)
    following = {"facecolor": FRONT, "edgecolor": VERMILION, "lw": 2.4, "zorder": 2}
    pen.shapes(ax, [middle(*lowest) + square], **following)
    for x, face, words in (
        (2, FINAL, "final"),
        (14, FRONT, "front"),
        (27, FRONT, "next"),
        (39, "white", "untouched"),
    ):
        style = following if words == "next" else {"facecolor": face, "edgecolor": "0.65", "lw": 0.8}
        pen.shapes(ax, [pen.moved(0.6 * square, x + 1.2, 55.5)], **style)
        pen.write(ax, (x + 3.4, 55.3), words, ha="left")
    pen.write(ax, (78, 55.3), "the dot's row")
    climb(ax, start, faces[start[0]])
    return ax.figure


def climb(ax, start, faces):
    """Draw one row of the picture in profile: y climbs from where it meets y₀."""

    def spots(columns):
        values = tilted_plane(columns, np.full_like(columns, start[0]))
        return [np.stack([61 + 2.7 * columns, 11 + 16 * (one - 1)], axis=-1) for one in values]

    y, facing = spots(np.linspace(0, COLUMNS - 1, 97))
    pen.stroke(ax, facing, INK, lw=1.6)
    pen.stroke(ax, y, BLUE, lw=2.0)
    pen.write(ax, pen.moved(facing[-1], 0, 2.5), "$y_0$")
    pen.write(ax, pen.moved(y[-1], 2.8, 0), "$y$", BLUE)
    y, _ = spots(np.arange(COLUMNS, dtype=float))
    for place, face in zip(y, faces, strict=True):
        pen.dot(ax, place, face, 1.0, edgecolor=BLUE, lw=1.2)
    pen.write(ax, pen.moved(y[start[1]], 2, -5.6), "faces the camera:\n$y = y_0$")


# The sheet ------------------------------------------------------------------------------
SHEET = el.TARGETS["vicalib_small"]
TURN = Rotation.from_euler("xyz", [28, -24, 6], degrees=True).as_matrix()  # to the camera's frame
SHIFT = np.array([0.0, 0.0, 52.0]) - TURN @ SHEET.points.mean(axis=0)  # mm
ACROSS, UP = np.array([np.cos(0.3), np.sin(0.3), 0]), np.array([np.sin(0.3), -np.cos(0.3), 0])


def from_above(places):
    """Places of the sheet's frame, (..., 3), mm, as who stands beside it sees them, in units of the page."""
    up = np.sin(0.6) * UP - (0, 0, np.cos(0.6))
    return (9, 23) + 0.46 * places @ np.stack([ACROSS, up], axis=-1)


def in_the_picture(places):
    """Places of the sheet's frame, (..., 3), mm, as the camera sees them, in units of the page."""
    pixels = el.load_calibration("paper").camera.project(places @ TURN.T + SHIFT)
    return (54, 44) + pixels * (44 / 1440, -44 / 1440)


def sheet():
    """The calibration sheet, with its dots of two sizes, and what a tilted camera sees of it."""
    ax = pen.paper(57)
    eye = -TURN.T @ SHIFT
    left, top, width, height = SHEET.sheet
    corners = pen.box(left, top, left + width, top + height)
    edge = np.linspace(corners, np.roll(corners, -1, axis=0), 15, endpoint=False, axis=1).reshape(-1, 2)
    pen.shapes(ax, [pen.box(54, 11, 98, 44)], facecolor="0.9", edgecolor=FAINT, lw=1.0)
    for view, count in ((from_above, 7), (in_the_picture, 9)):
        circle = np.pad(pen.at(np.arange(count) * 360 / count).T, ((0, 0), (0, 1)))
        dots = SHEET.points[:, None] + SHEET.radii[:, None, None] * circle
        pen.shapes(ax, [view(np.pad(edge, ((0, 0), (0, 1))))], facecolor="white", edgecolor=FAINT, lw=1.0)
        pen.shapes(ax, view(dots), facecolor=INK)
        for axis, colour, name in ((0, VERMILION, "$x$"), (1, GREEN, "$y$")):
            far, beside = np.eye(3)[[axis, 1 - axis]] * SHEET.spacing * [[4], [1]]
            pen.arrow(ax, view(np.zeros(3)), view(far), colour, lw=2.0, zorder=4)
            pen.write(ax, view(far - beside), name, colour)
    for number in (0, SHEET.columns - 1, -SHEET.columns, -1):
        pen.stroke(ax, from_above(np.stack([eye, SHEET.points[number]])), SKY, lw=1.2)
    body = from_above(np.stack([eye, eye - 14 * TURN[2]]))
    pen.stroke(ax, body, pen.STEEL, lw=18, solid_capstyle="butt")
    pen.dot(ax, body[0], pen.GLASS, 0.9, edgecolor=BLUE, lw=1.4)
    pen.write(ax, (27, 4.2), "printed: 19 × 10 dots, whose\ntwo sizes tell which is which")
    pen.write(ax, (76, 4.2), "what the camera sees")
    return ax.figure


# Bump and dent --------------------------------------------------------------------------
HIGH = np.array([0.0, 14.0])  # the near lamp over the flat wall
# Height, place, colour and dashes of each.
RELIEFS = {"bump": (4.0, 17.0, VERMILION, "-"), "dent": (-4.0, 49.0, BLUE, DASHED)}


def shading(wall, near):
    """What a wall sends back to a lamp and camera above its middle, or far away: cos θ/d²."""
    ways = HIGH - wall if near else np.array([[0.0, 1.0]])
    return np.sum(pen.normals(wall) * ways, axis=-1) / np.hypot(*ways.T) ** 3


def bump_and_dent():
    """A bump and a dent under a lamp far away, where they look alike, and under one at the camera."""
    ax = pen.paper(74)
    x = np.linspace(-14, 14, 141)
    walls = {
        name: np.stack([x, one[0] * np.exp(-0.5 * (x / 3.8) ** 2)], axis=-1) for name, one in RELIEFS.items()
    }
    for near, base, words in (
        (False, 46.0, "lamp and camera far away"),
        (True, 10.0, "lamp and camera near"),
    ):
        brightest = max(shading(wall, near).max() for wall in walls.values())
        floor = np.array([83.0, base - 6.6])
        pen.stroke(ax, floor + np.array([(-14, 0), (14, 0)]), FAINT, lw=0.8)
        pen.write(ax, (33, base + 18.5), words)
        for name, (_, across, colour, dashes) in RELIEFS.items():
            wall, middle = walls[name], np.array([across, base])
            light = shading(wall, near) / brightest
            pen.tissue(ax, wall + middle, middle + np.array([(-14, -5), (14, -5)]))
            for left, grey in zip(range(-14, 14), light[2::5], strict=False):  # the wall in a picture
                cell = middle + pen.box(left, -8.9, left + 1, -6.3)
                pen.shapes(ax, [cell], facecolor=f"{grey:.2f}")
            for place in wall[10:-9:20]:
                start = HIGH if near else pen.moved(HIGH, place[0], 0)
                pen.arrow(ax, middle + start, middle + place, ORANGE, lw=1.2)
            if near:
                pen.lamp(ax, middle + HIGH, radius=1.2)
            curve = floor + np.stack([x, 18 * light], axis=-1)
            pen.stroke(ax, curve, colour, lw=2.2, ls=dashes)
            pen.write(ax, (across, 70.5), name, colour, weight="bold")
    pen.write(ax, (83, 70.5), "brightness", weight="bold")
    pen.write(ax, (83, 61), "alike")
    pen.write(ax, (90.5, 19), "bump", VERMILION)
    pen.write(ax, (83, 6.6), "dent", BLUE)
    return ax.figure
