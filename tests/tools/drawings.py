"""Drawings of the light and its ways: one function a figure, geometry computed, not eyeballed."""

from itertools import pairwise

import numpy as np

from endolab.model.lights import SpotLight
from endolab.model.photometry import Photometry
from endolab.plots.style import BLUE, GREEN, SKY, VERMILION
from tests.tools import pen
from tests.tools.pen import DASHED, FAINT, INK


# One pixel ------------------------------------------------------------------------------
def pixel():
    """The geometry of one pixel: its ray, the wall's normal, and a lamp beside the camera."""
    ax = pen.paper(60)
    eye, light, shines, axis = np.array([13.0, 17.0]), np.array([13.0, 42.0]), pen.at(-17), pen.at(0)
    ray, centre, around = pen.at(20), np.array([36.0, 4.0]), pen.at(np.linspace(-2, 89, 92)).T
    wall, behind = centre + 53 * around, centre + 56 * around
    place, foot = pen.hit(eye, ray, wall), pen.hit(eye, axis, wall)
    normal = pen.towards(place, centre)

    pen.tissue(ax, wall, behind)
    pen.stroke(ax, [eye, foot], FAINT, lw=1.2, ls=(0, (6, 4)))
    pen.stroke(ax, [place, light], VERMILION)
    pen.arrow(ax, light, light + 21 * shines, VERMILION, lw=1.4)
    pen.stroke(ax, [eye, place], BLUE, lw=2.4)
    pen.arrow(ax, place, place + 24 * normal, GREEN, lw=2.4)
    for row in range(-4, 5):  # a picture in front of the lens, edge on; the ray goes through one pixel
        low = 1.6 * (row - 0.5)
        face = SKY if row == round(9 * ray[1] / ray[0] / 1.6) else "white"
        cell = eye + pen.box(8.3, low, 9.7, low + 1.6)
        pen.shapes(ax, [cell], facecolor=face, edgecolor=FAINT, lw=0.8, zorder=3)
    pen.dot(ax, place, INK)
    pen.tip(ax, eye, 5.5, 9)
    pen.lamp(ax, light, rays=[pen.heading(shines) + turn for turn in (-75, -50, 50, 75)])

    pen.angle(ax, eye, axis, ray, 24, r"$\alpha$", BLUE)
    pen.angle(ax, place, -ray, normal, 10, r"$\theta$", BLUE)
    pen.angle(ax, place, light - place, normal, 19, r"$\theta_l$", VERMILION, share=0.22)
    pen.angle(ax, light, shines, place - light, 14, r"$\psi_l$", VERMILION, beyond=3)
    for where, text, colour in (
        (place + 26.2 * normal, "$n$", GREEN),
        ((eye + place) / 2 + (1.4, -2.0), "$d$", BLUE),
        ((light + place) / 2 + (0, 3.0), "$|x - x_l|$", VERMILION),
        (pen.moved(place, 4.6, 1.6), "$x$", INK),
        (foot - (9, 2.4), "optical axis", FAINT),
        (wall[3] - (3.6, 0), "wall", pen.RIM),
        (pen.moved(eye, 9, 8.7), "pixels", FAINT),
        (eye - (4.5, 8.2), "camera", INK),
        (pen.moved(light, -1.5, 5), "lamp $l$", INK),
    ):
        pen.write(ax, where, text, colour)
    return ax.figure


# Three lights against one ---------------------------------------------------------------
AROUND = 4 * pen.at(np.array([90, 210, 330])).T  # mm
LIGHTS = Photometry(k=1.0, gain=1.0, lights=tuple(SpotLight((*place, 0.0), exponent=1.5) for place in AROUND))


def light_on(height, distance):
    """Light that reaches the camera from a facing wall, of three lamps and of one, over the latter's most."""
    points = np.stack([0 * height, height, np.full_like(height, distance)], axis=-1)
    facing = np.array([0.0, 0.0, -1.0])
    three, one = (m.intensity(points, facing) ** m.gamma for m in (LIGHTS, LIGHTS.simplified()))
    return three / one.max(), one / one.max()


def lights():
    """Three lights beside the lens against one virtual light in it, on a near and on a far wall."""
    ax = pen.paper(60)
    lit = np.linspace(-18, 18, 121)  # mm along the wall; a unit is a millimetre
    for lens, distance, height in (([8.0, 23.0], 10.0, 7.0), ([42.0, 23.0], 40.0, 9.0)):
        wall = lens + np.stack([np.full_like(lit, distance), lit], axis=-1)
        place = pen.moved(lens, distance, height)
        pen.tissue(ax, wall[[0, -1]], pen.moved(wall[[0, -1]], 2, 0))
        pen.tip(ax, lens, 6.2, 5)
        for _, up in AROUND[:2]:  # from the side, two of the three are one behind the other
            pen.stroke(ax, [pen.moved(lens, 0, up), place], VERMILION, lw=1.6)
            pen.lamp(ax, pen.moved(lens, 0, up), radius=1.0)
        pen.stroke(ax, [lens, place], BLUE, ls=DASHED, lw=2.0)
        pen.dot(ax, place, INK)
        three, one = light_on(lit, distance)
        base = pen.moved(wall, 3.5, 0)
        pen.stroke(ax, base[[0, -1]], FAINT, lw=0.8)
        for share, colour, dashes in ((three, VERMILION, "-"), (one, BLUE, DASHED)):
            pen.stroke(ax, base + np.outer(share, [10, 0]), colour, ls=dashes, lw=2.0)
        off = 100 * np.sqrt(np.mean((one / three - 1) ** 2))
        pen.write(ax, (wall[0, 0], 2.2), f"wall at {distance:g} mm: {off:.0f} % apart")
        pen.write(ax, pen.moved(base[-1], 1, 2.2), "light on it", FAINT, ha="left")
    middle = np.array([9.0, 52.4])  # the tip from the front
    pen.dot(ax, middle, pen.STEEL, 6.4, zorder=2)
    pen.dot(ax, middle, pen.GLASS, 2.2, edgecolor=BLUE, lw=1.4)
    for place in AROUND:
        pen.lamp(ax, middle + place, radius=1.1)
    pen.write(ax, (18, 55.2), "three lamps, 4 mm beside the lens", VERMILION, ha="left")
    pen.write(ax, (18, 50.0), "one virtual light at the optical centre", BLUE, ha="left")
    return ax.figure


# Light that bounces ---------------------------------------------------------------------
def lumen():
    """The wall of a lumen with two folds and an end, from the side; its normals point inside."""
    x, turn = np.linspace(14, 80, 133), np.linspace(-90, 90, 91)[1:-1]
    low = 8 + 9 * np.exp(-0.5 * ((x - 50) / 5) ** 2)
    high = 48 - 10 * np.exp(-0.5 * ((x - 66) / 4) ** 2)
    end = (80, 28) + pen.at(turn).T * (15, 20)
    return np.concatenate([np.stack([x, low], axis=-1), end, np.stack([x, high], axis=-1)[::-1]])


def mirror(wall, lamp, eye):
    """The place of a wall that mirrors a lamp into an eye: its normal halves the angle between them."""
    half = sum((one - wall) / np.linalg.norm(one - wall, axis=-1, keepdims=True) for one in (lamp, eye))
    return wall[np.argmax(np.sum(pen.normals(wall) * half, axis=-1) / np.hypot(*half.T))]


def bounces():
    """Straight, bounced and mirrored light, on their way from the lamp to the camera."""
    ax = pen.paper(66)
    eye, light, wall = np.array([12.0, 24.0]), np.array([12.0, 30.0]), lumen()
    pen.tissue(ax, wall, [(14, 3), (98, 3), (98, 53), (14, 53)])
    nearest = [np.argmin(np.hypot(*(wall - near).T)) for near in ([30, 8], [47, 48], [61, 44])]
    first, second, straight = wall[nearest]
    for colour, ways in (
        (GREEN, [light, mirror(wall, light, eye), eye]),
        (BLUE, [light, straight, eye]),
        (VERMILION, [light, first, second, eye]),
    ):
        for start, end in pairwise(ways):
            pen.arrow(ax, start, end, colour, share=0.55, lw=2.0)
    for place, colour in ((first, VERMILION), (second, VERMILION), (straight, BLUE)):
        for turn in (-60, -30, 0, 30, 60):  # a matt wall sends in proportion to the cosine
            beam = pen.at(pen.heading(pen.normal_at(place, wall)) + turn)
            pen.stroke(ax, [place, place + 4.5 * np.cos(np.deg2rad(turn)) * beam], colour, lw=1.0)
    pen.tip(ax, eye, 9.5, 8)
    pen.lamp(ax, light, radius=1.2)
    pen.write(ax, (50, 5.2), "a matt wall scatters, a wet one mirrors as well", pen.RIM)
    pen.write(ax, (16, 60), "straight\nlamp, wall, camera", BLUE)
    pen.write(ax, (50, 60), "bounced\nlamp, wall, wall, camera", VERMILION)
    pen.write(ax, (82.5, 60), "mirrored\nwhere the wall faces us", GREEN)
    return ax.figure
