"""Drawings of how depth is found, and of the sheet; geometry computed, not eyeballed."""

from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from endolab.calibration.targets import TARGETS, Target
from endolab.model.cameras import KannalaBrandt
from endolab.numerics.arrays import FloatArray
from endolab.plots.style import BLUE, GREEN, ORANGE, SKY, VERMILION, house
from tests.tools import pen
from tests.tools.pen import FAINT, INK

FINAL, FRONT = "#BBDDF3", "#F5C56B"


# A fold, and how the march slides over it -----------------------------------------------
def folded_wall() -> FloatArray:
    """A wall with one fold, from left to right."""
    x = np.linspace(12, 99, 1741)
    y = 7 + 13 * np.exp(-0.5 * ((x - 47) / 5) ** 2) + 25 * (np.maximum(x - 60, 0) / 39) ** 2
    return np.stack([x, y], axis=-1)


def seen(eye: FloatArray, wall: FloatArray, angles: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance of a wall at angles, degrees, and the cosine of its incidence there."""
    distance = np.array([pen.hits(eye, pen.at(turn), wall)[0] for turn in angles])
    rays = np.array([pen.at(turn) for turn in angles])
    normals = np.array([pen.normal_at(eye + d * ray, wall) for d, ray in zip(distance, rays, strict=True)])
    return distance, -np.sum(normals * rays, axis=-1)


def marched(facing: FloatArray, step: float) -> FloatArray:
    """Solve y'² = 4 (y₀² − y²) along a row of pixels, each from its lower neighbour; `step` is in radians."""
    y = facing.copy()
    for walk in (range(1, len(y)), range(len(y) - 2, -1, -1)):
        for here in walk:
            lower = y[here - walk.step]
            inside = (1 + 4 * step**2) * 4 * (step * facing[here]) ** 2 - (2 * step * lower) ** 2
            if lower < facing[here]:
                y[here] = min(y[here], (lower + np.sqrt(inside)) / (1 + 4 * step**2))
    return y


@house()
def fold() -> Figure:
    """A fold that hides a piece of wall, and how the march slides over the gap."""
    ax = pen.paper(50)
    eye, wall = np.array([9.0, 37.0]), folded_wall()
    headings = np.rad2deg(np.arctan2(*(wall - eye).T[::-1]))
    crest = int(np.argmax(np.where(wall[:, 0] < 60, headings, -90)))
    graze = headings[crest]
    gap = pen.hits(eye, pen.at(graze + 1e-3), wall)[0]
    landing = int(np.argmin(np.hypot(*(wall - eye - gap * pen.at(graze + 1e-3)).T)))

    fine = np.linspace(-50, -4, 1841)
    distance, cosine = seen(eye, wall, fine)
    slid = np.sqrt(marched(distance**2 / cosine, np.deg2rad(fine[1] - fine[0])))
    slid = eye + slid[:, None] * np.array([pen.at(turn) for turn in fine])

    hidden = wall[crest : landing + 1]
    for part, name in ((wall[: crest + 1], "wall in front"), (hidden, ""), (wall[landing:], "wall behind")):
        pen.tissue(ax, part, [(part[0, 0], 2), (part[-1, 0], 2)], name)
    pen.stroke(ax, hidden, "white", lw=2.4, zorder=2)
    pen.stroke(ax, hidden, pen.RIM, "hidden", lw=2.0, ls=(0, (2, 2)), zorder=2)
    for number in range(-5, 5):
        ray = pen.at(graze + 3.2 * (number + 0.5))
        place = eye + pen.hits(eye, ray, wall)[0] * ray
        apart = number in (-1, 0)
        pen.stroke(ax, [eye, place], BLUE if apart else SKY, f"ray {number}", lw=2.2 if apart else 1.2)
        pen.dot(ax, place, BLUE if apart else SKY, 0.9 if apart else 0.7)
    pen.stroke(ax, slid[fine > graze - 1.0], VERMILION, "marched", lw=2.6, zorder=4)
    pen.tip(ax, eye, 5, 7)
    pen.write(ax, hidden[len(hidden) // 2] - (0, 3.4), "hidden", pen.RIM)
    pen.write(ax, pen.moved(eye, 27, 8.6), "two neighbouring pixels\nlook at two surfaces", BLUE)
    pen.write(ax, (73, 35.0), "the march joins neighbours:\nit slides over the gap", VERMILION)
    return pen.page(ax)


# The march as a front -------------------------------------------------------------------
COLUMNS, ROWS, DONE = 13, 11, 42


def tilted_plane(column: FloatArray, row: FloatArray) -> tuple[FloatArray, FloatArray]:
    """y = d² and y₀ = d²/cos θ of a tilted plane at a distance of 1, as a pinhole sees it."""
    rays = np.stack([(column - 6) / 8, (row - 5) / 8, np.ones_like(row)], axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    normal = np.array([-0.19, 0.07, 1.0])
    cosine = rays @ (normal / np.linalg.norm(normal))
    return cosine**-2.0, cosine**-3.0


def states(y: FloatArray, done: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which pixels are final after so many steps of the march, and which are its front."""
    final = y <= np.sort(y, axis=None)[done - 1]
    near = np.pad(final, 1)
    beside = near[2:, 1:-1] | near[:-2, 1:-1] | near[1:-1, 2:] | near[1:-1, :-2]
    return final, beside & ~final


@house()
def front() -> Figure:
    """The march as a front: what is final, what is next, and how a pixel takes its value."""
    ax = pen.paper(60)
    row, column = np.indices((ROWS, COLUMNS)).astype(float)
    y, _ = tilted_plane(column, row)
    final, beside = states(y, DONE)
    size, corner = 4.0, np.array([2.0, 6.0])

    def middle(row: int, column: int) -> FloatArray:
        return corner + size * np.array([column + 0.5, ROWS - row - 0.5])

    square = pen.box(-size / 2, -size / 2, size / 2, size / 2)
    for where, face in ((final, FINAL), (beside, FRONT), (~(final | beside), "white")):
        cells = [middle(*place) + square for place in np.argwhere(where)]
        pen.shapes(ax, cells, facecolor=face, edgecolor="0.65", lw=0.8)
    start = divmod(int(np.argmin(y)), COLUMNS)
    taking = [
        place
        for place in np.argwhere(beside)
        if final[place[0], place[1] - 1] and final[place[0] + 1, place[1]]
    ]
    here = taking[len(taking) // 2]
    for lower in ((here[0], here[1] - 1), (here[0] + 1, here[1])):
        way = middle(*here) - middle(*lower)
        pen.arrow(ax, middle(*lower), middle(*lower) + 0.85 * way, INK, "from a lower neighbour", lw=1.6)
    pen.dot(ax, middle(*start), INK, 0.9)
    lowest = divmod(int(np.argmin(np.where(beside, y, np.inf))), COLUMNS)
    pen.shapes(ax, [middle(*lowest) + square], facecolor=FRONT, edgecolor=VERMILION, lw=2.4, zorder=2)
    boxes = (2, FINAL, "final"), (14, FRONT, "front"), (27, FRONT, "next"), (39, "white", "untouched")
    for x, face, words in boxes:
        edge, width = (VERMILION, 2.4) if words == "next" else ("0.65", 0.8)
        pen.shapes(ax, [0.6 * square + (x + 1.2, 55.5)], facecolor=face, edgecolor=edge, lw=width)
        pen.write(ax, (x + 3.4, 55.3), words, ha="left")
    pen.write(ax, (78, 55.3), "the dot's row")
    _climb(ax, start[0], start[1], final[start[0]], beside[start[0]])
    return pen.page(ax)


def _climb(ax: Axes, row: int, first: int, final: NDArray[np.bool_], beside: NDArray[np.bool_]) -> None:
    """One row of the picture in profile: y climbs from where it meets y₀."""

    def spot(column: FloatArray, value: FloatArray) -> FloatArray:
        return np.stack([61 + 2.7 * column, 11 + 16 * (value - 1)], axis=-1)

    fine = np.linspace(0, COLUMNS - 1, 97)
    y, facing = tilted_plane(fine, np.full_like(fine, row))
    pen.stroke(ax, spot(fine, facing), INK, "y0", lw=1.6)
    pen.stroke(ax, spot(fine, y), BLUE, "y", lw=2.0)
    columns = np.arange(COLUMNS).astype(float)
    y, facing = tilted_plane(columns, np.full(COLUMNS, row, float))
    for place, done, near in zip(spot(columns, y), final, beside, strict=True):
        face = FINAL if done else FRONT if near else "white"
        pen.dot(ax, place, face, 1.0, edgecolor=BLUE, lw=1.2)
    pen.write(ax, spot(columns, facing)[-1] + (0, 2.5), "$y_0$")
    pen.write(ax, spot(columns, y)[-1] + (2.8, 0), "$y$", BLUE)
    pen.write(ax, spot(columns, y)[first] - (-2, 5.6), "faces the camera:\n$y = y_0$")


# The sheet ------------------------------------------------------------------------------
FISHEYE = (-0.13893, -0.0012396, 0.00091258, -0.000040716)  # the paper's k₁ to k₄
CAMERA = KannalaBrandt(1440, 1080, 717.21, 717.48, 735.37, 552.80, FISHEYE)


def pose() -> tuple[FloatArray, FloatArray]:
    """Rotation and shift (mm) from the sheet's frame to that of a tilted camera before its middle."""
    c, s = np.cos(np.deg2rad([28, -24, 6])), np.sin(np.deg2rad([28, -24, 6]))
    about_x = np.array([[1, 0, 0], [0, c[0], -s[0]], [0, s[0], c[0]]])
    about_y = np.array([[c[1], 0, s[1]], [0, 1, 0], [-s[1], 0, c[1]]])
    about_z = np.array([[c[2], -s[2], 0], [s[2], c[2], 0], [0, 0, 1]])
    turn = about_z @ about_y @ about_x
    return turn, np.array([0.0, 0.0, 52.0]) - turn @ TARGETS["vicalib_small"].points.mean(axis=0)


def rims(target: Target, count: int) -> FloatArray:
    """Places around each dot of a sheet, (n, count, 3), mm."""
    circle = np.array([(*pen.at(360 * turn / count), 0.0) for turn in range(count)])
    return np.asarray(target.points[:, None] + target.radii[:, None, None] * circle)


def from_above(places: FloatArray) -> FloatArray:
    """Places of the sheet's frame, (..., 3), mm, as who stands beside it sees them, in units of the page."""
    c, s, up = np.cos(0.3), np.sin(0.3), np.sin(0.6)
    x, y, z = np.moveaxis(np.asarray(places, float), -1, 0)
    return np.stack(
        [9 + 0.46 * (c * x + s * y), 23 + 0.46 * (up * (s * x - c * y) - np.cos(0.6) * z)], axis=-1
    )


def in_the_picture(places: FloatArray) -> FloatArray:
    """Places of the sheet's frame, (..., 3), mm, as the camera sees them, in units of the page."""
    turn, shift = pose()
    pixels = CAMERA.project(places @ turn.T + shift)
    return np.asarray(np.array([54.0, 44.0]) + pixels * (44 / 1440, -44 / 1440))


@house()
def sheet() -> Figure:
    """The calibration sheet, with its dots of two sizes, and what a tilted camera sees of it."""
    ax = pen.paper(57)
    target = TARGETS["vicalib_small"]
    turn, shift = pose()
    eye = -turn.T @ shift
    left, top, width, height = target.sheet
    corners = np.array([(left, top), (left + width, top), (left + width, top + height), (left, top + height)])
    side = np.linspace(0, 1, 16)[:-1, None]
    edge = np.concatenate([a + side * (b - a) for a, b in pairwise([*corners, corners[0]])])
    pen.shapes(ax, [pen.box(54, 11, 98, 44)], facecolor="0.9", edgecolor=FAINT, lw=1.0)
    for view, count in ((from_above, 7), (in_the_picture, 9)):
        pen.shapes(ax, [view(np.pad(edge, ((0, 0), (0, 1))))], facecolor="white", edgecolor=FAINT, lw=1.0)
        pen.shapes(ax, view(rims(target, count)), facecolor=INK)
        for axis, colour, name in ((0, VERMILION, "$x$"), (1, GREEN, "$y$")):
            far, beside = np.eye(3)[[axis, 1 - axis]] * target.spacing * [[4], [1]]
            pen.arrow(
                ax, view(np.zeros(3)), view(far), colour, f"{name} in {view.__name__}", lw=2.0, zorder=4
            )
            pen.write(ax, view(far - beside), name, colour)
    for number in (0, target.columns - 1, len(target.points) - target.columns, len(target.points) - 1):
        pen.stroke(
            ax, from_above(np.stack([eye, target.points[number]])), SKY, f"ray of dot {number}", lw=1.2
        )
    body = from_above(np.stack([eye, eye - 14 * turn[2]]))
    pen.stroke(ax, body, pen.STEEL, lw=18, solid_capstyle="butt")
    pen.dot(ax, body[0], pen.GLASS, 0.9, edgecolor=BLUE, lw=1.4)
    pen.write(ax, (27, 4.2), "printed: 19 × 10 dots, whose\ntwo sizes tell which is which")
    pen.write(ax, (76, 4.2), "what the camera sees")
    return pen.page(ax)


# Bump and dent --------------------------------------------------------------------------
HIGH = 14.0  # of the near lamp over the flat wall


def relief(height: float) -> FloatArray:
    """A wall with a bump of that height in its middle, or a dent; from left to right, about 0."""
    x = np.linspace(-14, 14, 141)
    return np.stack([x, height * np.exp(-0.5 * (x / 3.8) ** 2)], axis=-1)


def shading(wall: FloatArray, near: bool) -> FloatArray:
    """What a wall sends back to a lamp and camera above its middle, or far away: cos θ/d² times HIGH²."""
    if not near:
        return np.asarray(pen.normals(wall)[:, 1])
    ways = np.array([0.0, HIGH]) - wall
    distance = np.hypot(*ways.T)
    return np.asarray(np.sum(pen.normals(wall) * ways, axis=-1) / distance**3 * HIGH**2)


@house()
def bump_and_dent() -> Figure:
    """A bump and a dent under a lamp far away, where they look alike, and under one at the camera."""
    ax = pen.paper(74)
    walls = {"bump": (relief(4.0), 17.0, VERMILION), "dent": (relief(-4.0), 49.0, BLUE)}
    for near, base, words in (
        (False, 46.0, "lamp and camera far away"),
        (True, 10.0, "lamp and camera near"),
    ):
        brightest = max(shading(wall, near).max() for wall, _, _ in walls.values())
        floor = np.array([83.0, base - 6.6])
        pen.stroke(ax, [pen.moved(floor, -14, 0), pen.moved(floor, 14, 0)], FAINT, lw=0.8)
        pen.write(ax, (33, base + 18.5), words)
        for name, (wall, across, colour) in walls.items():
            middle = np.array([across, base])
            light = shading(wall, near) / brightest
            pen.tissue(
                ax, wall + middle, [pen.moved(middle, -14, -5), pen.moved(middle, 14, -5)], f"{name}, {words}"
            )
            _strip(ax, middle - (0, 7.6), light[2::5][:28])
            _beams(ax, middle, wall, near)
            dashes = "-" if name == "bump" else (0, (4, 2))
            curve = floor + np.stack([wall[:, 0], 18 * light], axis=-1)
            pen.stroke(ax, curve, colour, f"light of the {name}, {words}", lw=2.2, ls=dashes)
    for name, (_, across, colour) in walls.items():
        pen.write(ax, (across, 70.5), name, colour, weight="bold")
    pen.write(ax, (83, 70.5), "brightness", weight="bold")
    pen.write(ax, (83, 61), "alike")
    pen.write(ax, (90.5, 19), "bump", VERMILION)
    pen.write(ax, (83, 6.6), "dent", BLUE)
    return pen.page(ax)


def _strip(ax: Axes, middle: FloatArray, light: FloatArray) -> None:
    """What a picture shows of a wall, as grey cells beneath it."""
    for left, grey in zip(np.arange(-14.0, 14.0), light, strict=True):
        cell = middle + pen.box(left, -1.3, left + 1, 1.3)
        pen.shapes(ax, [cell], facecolor=f"{grey:.2f}")


def _beams(ax: Axes, middle: FloatArray, wall: FloatArray, near: bool) -> None:
    """Light on its way to a wall: from a point above, or parallel."""
    for x in range(-12, 13, 4):
        place = wall[np.argmin(np.abs(wall[:, 0] - x))]
        start = np.array([0.0, HIGH]) if near else np.array([place[0], HIGH])
        pen.arrow(ax, middle + start, middle + place, ORANGE, lw=1.2)
    if near:
        pen.lamp(ax, pen.moved(middle, 0, HIGH), radius=1.2)
