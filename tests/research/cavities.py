"""Cavities of any make: bent, folded, closed, with polyps and rugae; for frames nobody tuned to.

A cavity is a tube about a line that bends along an arc and sways across it. In the tube's own coordinates
(u, v across, s along the line, all mm) the wall is where

    F = R - √(u² + v² + q²) - folds - polyps - rugae - bumps = 0,

q being what its rounded ends take. Every
term is smooth in space, so that F has a steepest slope; a ray goes ahead by F over that slope, which cannot
cross the wall.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from endolab.synthetic.rendering import waves
from tests.tools.meshes import grid_triangles

LEAST = 0.05  # mm, a step of a ray beside a wall
FAREST = 1000.0  # mm, beyond every wall
HALVES = 24  # of the last step
SPARE = 1.25  # for slopes between the places that are looked at
STEP = 1e-4  # mm, of the central differences that give normals
# mm, the size of bumps and the way from ruga to ruga
BUMPS = 12.0
RUGAE = 11.0
RUGA = 0.55  # half the width of a ruga, as a share of that way
LENGTHWAYS = 0.4  # rugae run along the bag: how much slower they change that way


@dataclass(frozen=True)
class Fold:
    """A fold across the tube: a ring (reach 0), or a crescent on one side of it."""

    s: float  # where it stands, mm along the tube
    height: float  # mm
    width: float  # half of it, mm
    side: float  # where the crescent is highest, rad about the tube
    reach: float  # how much higher it is there than a quarter turn away, as a logarithm
    lean: float  # how far that side leans forward, mm


@dataclass(frozen=True)
class Polyp:
    """A dome on the wall."""

    s: float  # mm along the tube
    side: float  # rad about it
    radius: float  # mm
    height: float  # mm, of the bump that is pushed in; the dome is flatter


@dataclass(frozen=True)
class Cavity:
    """A tube or bag that the camera is in; a scene, see `endolab.synthetic.scenes.Scene`."""

    radius: float = 22.0  # mm
    # Where the far end begins to round, mm along the tube from the camera.
    ahead: float = 120.0
    behind: float = 40.0  # the same, backwards
    # Over which the far and the near end close, mm.
    ends: tuple[float, float] = (20.0, 20.0)
    bend: float = 0.0  # curvature of the tube, 1/mm
    # Of the tube across the bend and its period, mm.
    sway: tuple[float, float] = (0.0, 200.0)
    place: tuple[float, float] = (0.0, 0.0)  # of the camera in the cross-section, mm
    # Roll, yaw and pitch of the camera, degrees.
    look: tuple[float, float, float] = (0.0, 0.0, 0.0)
    folds: tuple[Fold, ...] = ()
    polyps: tuple[Polyp, ...] = ()
    rugae: float = 0.0  # height, mm
    bumps: float = 0.0  # standard deviation, mm
    seed: int = 0  # of rugae and bumps

    # The shape -----------------------------------------------------------------------------
    def inside(self, x):
        """F at points (..., 3) of the camera frame, mm; positive in the cavity."""
        return self._in_tube(self.to_tube(x))

    def _in_tube(self, tube):
        """F at points (..., 3) of the tube's own coordinates."""
        u = tube[..., 0]
        v = tube[..., 1]
        s = tube[..., 2]
        beyond = (
            np.maximum(s - self.ahead, 0) / self.ends[0]
            + np.maximum(-self.behind - s, 0) / self.ends[1]
        )
        value = self.radius - np.sqrt(u * u + v * v + (self.radius * beyond) ** 2)
        for fold in self.folds:
            out = (u * np.cos(fold.side) + v * np.sin(fold.side)) / self.radius
            across = (s - fold.s - fold.lean * out) / fold.width
            value -= fold.height * np.exp(
                -across * across + fold.reach * (np.minimum(out, 1.5) - 1)
            )
        for polyp in self.polyps:
            centre = self.radius * np.array(
                [np.cos(polyp.side), np.sin(polyp.side), polyp.s / self.radius]
            )
            square = np.sum((tube - centre) ** 2, axis=-1) / polyp.radius**2
            value -= polyp.height * np.exp(-(np.minimum(square, 10.0) ** 2))
        if self.rugae:
            place = tube * [1.0, 1.0, LENGTHWAYS]
            wave = waves(place, RUGAE, np.random.default_rng([self.seed, 0]))[0]
            value -= self.rugae * np.exp(-((wave / RUGA) ** 2))
        if self.bumps:
            value -= (
                self.bumps
                * waves(tube, BUMPS, np.random.default_rng([self.seed, 1]))[0]
            )
        return value

    @cached_property
    def _turn(self):
        """From the camera's axes to those of the tube at the camera."""
        cr, cy, cp = np.cos(np.deg2rad(self.look))
        sr, sy, sp = np.sin(np.deg2rad(self.look))
        roll = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
        yaw = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        pitch = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
        return yaw @ pitch @ roll

    def to_tube(self, x):
        """Points (..., 3) of the camera frame in the tube's coordinates."""
        x = x @ self._turn.T + [*self.place, 0.0]
        u = x[..., 0]
        v = x[..., 1]
        s = x[..., 2]
        if self.bend:
            arm = 1 / self.bend - u
            u = 1 / self.bend - np.hypot(arm, s)
            s = np.arctan2(s, arm) / self.bend
        return np.stack([u, v - self._swayed(s), s], axis=-1)

    def from_tube(self, tube):
        """Points (..., 3) of the tube's coordinates in the camera frame."""
        u = tube[..., 0]
        s = tube[..., 2]
        v = tube[..., 1] + self._swayed(s)
        if self.bend:
            arm = 1 / self.bend - u
            angle = s * self.bend
            u = 1 / self.bend - arm * np.cos(angle)
            s = arm * np.sin(angle)
        return (np.stack([u, v, s], axis=-1) - [*self.place, 0.0]) @ self._turn

    def _swayed(self, s):
        return self.sway[0] * (1 - np.cos(2 * np.pi / self.sway[1] * s))

    # What a scene must tell ----------------------------------------------------------------
    def distance(self, rays):
        """See `Scene.distance`."""
        flat = rays.reshape(-1, 3)
        found = np.full(len(flat), np.nan)
        known = np.isfinite(flat).all(axis=-1)
        stretched = 1 / (1 - self.bend * self.radius)
        stretched += 2 * np.pi * abs(self.sway[0] / self.sway[1])
        steepest = stretched * self._steepest
        found[known] = _march(self.inside, np.zeros(3), flat[known], steepest)
        return found.reshape(rays.shape[:-1])

    def normals(self, points):
        """See `Scene.normals`; by central differences."""
        gradient = _gradient(self.inside, points)
        return gradient / np.linalg.norm(gradient, axis=-1, keepdims=True)

    def mesh(self, size=400):
        """Vertices and triangles, `size` steps along and around, by lines from the tube's middle."""
        start, out = self._lines(size, size)
        place = start + _march(self._in_tube, start, out, self._steepest)[:, None] * out
        return self.from_tube(place), grid_triangles(size, size)

    def _lines(self, along, around):
        """Points on the middle (n, 3) and directions out of it, from the near end to the far one."""
        arc = np.pi / 2 * self.radius
        place = np.linspace(-self.behind - arc, self.ahead + arc, along)
        middle = np.clip(place, -self.behind, self.ahead)
        angle = (place - middle) / self.radius
        lengths = np.where(angle > 0, self.ends[0], self.ends[1]) / self.radius
        side = np.linspace(0, 2 * np.pi, around)
        out = np.stack(
            [
                np.cos(angle)[:, None] * np.cos(side),
                np.cos(angle)[:, None] * np.sin(side),
                np.broadcast_to((lengths * np.sin(angle))[:, None], (along, around)),
            ],
            axis=-1,
        ).reshape(-1, 3)
        start = np.zeros_like(out)
        start[:, 2] = np.repeat(middle, around)
        return start, out / np.linalg.norm(out, axis=-1, keepdims=True)

    @cached_property
    def _steepest(self):
        """The steepest slope of F in the tube's coordinates, of a grid fine against folds; and some more."""
        start, out = self._lines(160, 48)
        reach = np.linspace(0, 1.1 * max(self.radius, *self.ends), 10)[1:, None, None]
        slopes = _gradient(self._in_tube, start + reach * out)
        return SPARE * float(np.linalg.norm(slopes, axis=-1).max())


def _gradient(value, x):
    """Slopes of a function of points (..., 3), by central differences."""
    steps = [value(x + step) - value(x - step) for step in STEP * np.eye(3)]
    return np.stack(steps, axis=-1) / (2 * STEP)


def _march(inside, start, rays, steepest):
    """How far it is along unit rays (n, 3) to the first place where `inside` is 0, mm; it starts above.

    A ray that passes a wall by goes ahead by at least `LEAST`, and overlooks what it meets on a shorter way.
    """
    start = np.broadcast_to(start, rays.shape)
    near = np.zeros(len(rays))
    far = np.zeros(len(rays))
    busy = np.arange(len(rays))
    while busy.size:
        room = inside(start[busy] + far[busy, None] * rays[busy])
        busy = busy[room > 0]
        near[busy] = far[busy]
        far[busy] += np.maximum(room[room > 0] / steepest, LEAST)
        if busy.size and far[busy].max() > FAREST:
            raise ValueError(
                f"{busy.size} of {len(rays)} rays come to no wall within {FAREST:.0f} mm"
            )
    for _ in range(HALVES):
        middle = (near + far) / 2
        is_before = inside(start + middle[:, None] * rays) > 0
        near = np.where(is_before, middle, near)
        far = np.where(is_before, far, middle)
    return far
