"""Drawings of the light and its ways: one function a figure, geometry computed, not eyeballed."""

from itertools import pairwise

import numpy as np
from matplotlib.figure import Figure

from endolab.model.lights import SpotLight
from endolab.model.photometry import Photometry
from endolab.numerics.arrays import FloatArray
from endolab.plots.style import BLUE, GREEN, SKY, VERMILION, house
from tests.tools import pen
from tests.tools.pen import INK


# One pixel ------------------------------------------------------------------------------
@house()
def pixel() -> Figure:
    """The geometry of one pixel: its ray, the wall's normal, and a lamp beside the camera."""
    ax = pen.paper(60)
    eye, light, shines = np.array([13.0, 17.0]), np.array([13.0, 42.0]), pen.at(-17)
    ray, centre, around = pen.at(20), np.array([36.0, 4.0]), np.linspace(-2, 89, 183)
    wall, behind = (centre + radius * np.array([pen.at(turn) for turn in around]) for radius in (53, 56))
    place = eye + pen.hits(eye, ray, wall)[0] * ray
    normal = pen.towards(place, centre)
    back, to_light = pen.towards(place, eye), pen.towards(place, light)
    foot = eye + pen.hits(eye, pen.at(0), wall)[0] * pen.at(0)

    pen.tissue(ax, wall, behind)
    pen.stroke(ax, [eye, foot], pen.FAINT, "axis", lw=1.2, ls=(0, (6, 4)))
    pen.stroke(ax, [place, light], VERMILION, "way of the light")
    pen.arrow(ax, light, light + 21 * shines, VERMILION, "where the lamp points", lw=1.4)
    pen.stroke(ax, [eye, place], BLUE, "ray", lw=2.4)
    pen.arrow(ax, place, place + 24 * normal, GREEN, "normal", lw=2.4)
    _pixels(ax, eye, ray)
    pen.dot(ax, place, INK)
    pen.tip(ax, eye, 5.5, 9)
    pen.lamp(ax, light, rays=[pen.heading(shines) + turn for turn in (-75, -50, 50, 75)])

    pen.angle(ax, eye, pen.at(0), ray, 24, r"$\alpha$", BLUE, "alpha")
    pen.angle(ax, place, back, normal, 10, r"$\theta$", BLUE, "theta")
    pen.angle(ax, place, to_light, normal, 19, r"$\theta_l$", VERMILION, "theta of the lamp", share=0.22)
    pen.angle(ax, light, shines, -to_light, 14, r"$\psi_l$", VERMILION, "psi", beyond=3)
    pen.write(ax, place + 26.2 * normal, "$n$", GREEN)
    pen.write(ax, eye + 0.5 * (place - eye) + (1.4, -2.0), "$d$", BLUE)
    pen.write(ax, (light + place) / 2 + (0, 3.0), "$|x - x_l|$", VERMILION)
    pen.write(ax, pen.moved(place, 4.6, 1.6), "$x$")
    pen.write(ax, (foot[0] - 9, foot[1] - 2.4), "optical axis", pen.FAINT)
    pen.write(ax, wall[6] - (3.6, 0), "wall", pen.RIM)
    pen.write(ax, eye - (4.5, 8.2), "camera")
    pen.write(ax, pen.moved(light, -1.5, 5), "lamp $l$")
    return pen.page(ax)


def _pixels(ax: pen.Axes, eye: FloatArray, ray: FloatArray) -> None:
    """A picture in front of the lens, edge on: its pixels, and the one that the ray goes through."""
    near, size = eye[0] + 9, 1.6
    rows = np.arange(-4, 5)
    hit = int(np.floor(9 * ray[1] / ray[0] / size + 0.5))
    for row in rows:
        low = eye[1] + (row - 0.5) * size
        cell = pen.box(near - 0.7, low, near + 0.7, low + size)
        pen.shapes(
            ax, [cell], facecolor=SKY if row == hit else "white", edgecolor=pen.FAINT, lw=0.8, zorder=3
        )
    pen.write(ax, (near, eye[1] + 5.2 * size + 0.4), "pixels", pen.FAINT)


# Three lights against one ---------------------------------------------------------------
AROUND = [(4 * np.cos(angle), 4 * np.sin(angle), 0.0) for angle in np.deg2rad([90, 210, 330])]  # mm
LIGHTS = Photometry(k=1.0, gain=1.0, lights=tuple(SpotLight(place, exponent=1.5) for place in AROUND))
NEAR, FAR = 10.0, 40.0  # walls, mm from the lens


def light_on(height: FloatArray, distance: float) -> tuple[FloatArray, FloatArray]:
    """Light that reaches the camera from a facing wall, of three lamps and of one, over the latter's most."""
    points = np.stack([0 * height, height, np.full_like(height, distance)], axis=-1)
    facing = np.array([0.0, 0.0, -1.0])
    three, one = (m.intensity(points, facing) ** m.gamma for m in (LIGHTS, LIGHTS.simplified()))
    return three / one.max(), one / one.max()


@house()
def lights() -> Figure:
    """Three lights beside the lens against one virtual light in it, on a near and on a far wall."""
    ax = pen.paper(60)
    lit = np.linspace(-18, 18, 121)  # mm along the wall; a unit is a millimetre
    for lens, distance, height in ((np.array([8.0, 23.0]), NEAR, 7.0), (np.array([42.0, 23.0]), FAR, 9.0)):
        words = f"at {distance:g} mm"
        wall = lens + np.stack([np.full_like(lit, distance), lit], axis=-1)
        place = pen.moved(lens, distance, height)
        pen.tissue(ax, wall[[0, -1]], pen.moved(wall[[0, -1]], 2, 0), f"wall {words}")
        pen.tip(ax, lens, 6.2, 5)
        for up in (AROUND[0][1], AROUND[1][1]):  # from the side, two of the three are one behind the other
            pen.stroke(ax, [pen.moved(lens, 0, up), place], VERMILION, f"from {up:.0f} mm, {words}", lw=1.6)
            pen.lamp(ax, pen.moved(lens, 0, up), radius=1.0)
        pen.stroke(ax, [lens, place], BLUE, f"from the lens, {words}", ls=(0, (4, 2)), lw=2.0)
        pen.dot(ax, place, INK)
        three, one = light_on(lit, distance)
        base = pen.moved(wall, 3.5, 0)
        pen.stroke(ax, base[[0, -1]], pen.FAINT, lw=0.8)
        for share, colour, dashes in ((three, VERMILION, "-"), (one, BLUE, (0, (4, 2)))):
            curve = base + np.stack([10 * share, 0 * share], axis=-1)
            pen.stroke(ax, curve, colour, f"light {words}, {colour}", ls=dashes, lw=2.0)
        off = 100 * np.sqrt(np.mean((one / three - 1) ** 2))
        pen.write(ax, (wall[0, 0], 2.2), f"wall {words}: {off:.0f} % apart")
        pen.write(ax, (base[0, 0] + 1, 43.2), "light on it", pen.FAINT, ha="left")
    _three_in_front(ax)
    return pen.page(ax)


def _three_in_front(ax: pen.Axes) -> None:
    """The tip from the front, and which colour is which."""
    middle = np.array([9.0, 52.4])
    pen.dot(ax, middle, pen.STEEL, 6.4, zorder=2)
    pen.dot(ax, middle, pen.GLASS, 2.2, edgecolor=BLUE, lw=1.4)
    for x, y, _ in AROUND:
        pen.lamp(ax, middle + np.array([x, y]), radius=1.1)
    pen.write(ax, (18, 55.2), "three lamps, 4 mm beside the lens", VERMILION, ha="left")
    pen.write(ax, (18, 50.0), "one virtual light at the optical centre", BLUE, ha="left")


# Light that bounces ---------------------------------------------------------------------
def lumen() -> FloatArray:
    """The wall of a lumen with two folds and an end, from the side; its normals point inside."""
    x, turn = np.linspace(14, 80, 265), np.deg2rad(np.linspace(-90, 90, 181))[1:-1]
    low = 8 + 9 * np.exp(-0.5 * ((x - 50) / 5) ** 2)
    high = 48 - 10 * np.exp(-0.5 * ((x - 66) / 4) ** 2)
    end = np.stack([80 + 15 * np.cos(turn), 28 + 20 * np.sin(turn)], axis=-1)
    return np.concatenate([np.stack([x, low], axis=-1), end, np.stack([x, high], axis=-1)[::-1]])


def mirror(wall: FloatArray, lamp: FloatArray, eye: FloatArray) -> FloatArray:
    """The place of a wall that mirrors a lamp into an eye: its normal halves the angle between them."""
    to_lamp, to_eye = lamp - wall, eye - wall
    half = to_lamp / np.hypot(*to_lamp.T)[:, None] + to_eye / np.hypot(*to_eye.T)[:, None]
    normals = pen.normals(wall)
    off = normals[:, 0] * half[:, 1] - normals[:, 1] * half[:, 0]
    facing = np.sum(normals * half, axis=-1)[:-1] > 0
    crossing = np.flatnonzero((off[:-1] * off[1:] <= 0) & facing)[0]
    share = off[crossing] / (off[crossing] - off[crossing + 1])
    return np.asarray((1 - share) * wall[crossing] + share * wall[crossing + 1])


@house()
def bounces() -> Figure:
    """Straight, bounced and mirrored light, on their way from the lamp to the camera."""
    ax = pen.paper(66)
    eye, light, wall = np.array([12.0, 24.0]), np.array([12.0, 30.0]), lumen()
    pen.tissue(ax, wall, [(14, 3), (98, 3), (98, 53), (14, 53)])
    first, second, straight = (
        wall[np.argmin(np.hypot(*(wall - near).T))] for near in [(30, 8), (47, 48), (61, 44)]
    )
    shiny = mirror(wall, light, eye)
    for colour, name, ways in (
        (GREEN, "mirrored", [light, shiny, eye]),
        (BLUE, "straight", [light, straight, eye]),
        (VERMILION, "bounced", [light, first, second, eye]),
    ):
        for step, (start, end) in enumerate(pairwise(ways), 1):
            pen.arrow(ax, start, end, colour, f"{name} {step}", share=0.55, lw=2.0)
    for place, colour in ((first, VERMILION), (second, VERMILION), (straight, BLUE)):
        _scatter(ax, place, pen.normal_at(place, wall), colour)
    pen.tip(ax, eye, 9.5, 8)
    pen.lamp(ax, light, radius=1.2)
    pen.write(ax, (50, 5.2), "a matt wall scatters, a wet one mirrors as well", pen.RIM)
    for x, words, colour in (
        (16, "straight\nlamp, wall, camera", BLUE),
        (50, "bounced\nlamp, wall, wall, camera", VERMILION),
        (82.5, "mirrored\nwhere the wall faces us", GREEN),
    ):
        pen.write(ax, (x, 60), words, colour)
    return pen.page(ax)


def _scatter(ax: pen.Axes, place: FloatArray, normal: FloatArray, colour: str) -> None:
    """Short beams in proportion to the cosine: what a matt wall sends where."""
    for turn in (-60, -30, 0, 30, 60):
        beam = pen.at(pen.heading(normal) + turn)
        pen.stroke(ax, [place, place + 4.5 * np.cos(np.deg2rad(turn)) * beam], colour, lw=1.0)
