"""The photometric model as a least-squares problem: grey levels against k, γ, gains and BRDF.

A sample of frame t on material m at the point x should have the grey level

    I = 255 · exp(L/γ),  L = k log cos α - 2 log d + log cos θ + log f(θ) + log a_m + log g_t

with the light at the optical centre. f is linear between its nodes, just as a `TabulatedBRDF` is, and its
unknowns are the logarithms there.

Of lamps beside the lens, at (x, y, 0), of exponent 1 and equal weight, f is the mean of ω_l f(θ_l): ω_l is a
lamp's light over that of one at the lens, θ_l the half angle, and k stays the joint exponent.

What is common to all frames is one vector: k, γ, x and y of the lamps, log f at the nodes, log a of the
materials. Each number has a mean and a standard deviation before the fit: 0 if it is given, inf if nothing is
known. The scale of f is that of the gains and the light together, so one node, the one with the most light,
is given: f is 1/π there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from endolab.calibration import constants
from endolab.calibration.least_squares import Model
from endolab.calibration.photometric.samples import Samples
from endolab.numerics.arrays import BoolArray, FloatArray

GREY_LEVELS = 255.0  # of a stored value of 1


def hats(nodes: FloatArray, theta: FloatArray) -> FloatArray:
    """Return the interpolation between nodes as a matrix, (n, nodes); constant beyond them."""
    number = np.arange(len(nodes))
    return np.maximum(1 - np.abs(np.interp(theta, nodes, number)[:, None] - number), 0.0)


def place_nodes(theta: FloatArray, count: int, least: int = 40) -> FloatArray:
    """Choose at most `count` nodes of the BRDF for samples at incidence angles, rad; (nodes,), ascending.

    With fewer than `least` samples between two of them, one is left out.
    """
    nodes = np.linspace(theta.min(), theta.max(), count)
    while len(nodes) > 2:
        inside, _ = np.histogram(theta, nodes)
        thin = np.flatnonzero(inside < least)
        if not thin.size:
            break
        # Joining a thin interval with its neighbour removes the node between them.
        nodes = np.delete(nodes, min(thin[0] + 1, len(nodes) - 2))
    return nodes


def light_beside(samples: Samples, place: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compare the light of a lamp at (x, y, 0), mm, with that of one at the lens, both of exponent 1.

    With n the normal, o = (x, y, 0) - X, r = |o| and d = |X|, a lamp's light is z (n·o) / r⁴, so that

        ω = (n·o) / (-n·X) · (d / r)⁴,      cos θ = n·h / |h|,  h = o/r - X/d

    Returns ω and the half angle θ, rad, (n,) each.
    """
    points, normals = samples.points, samples.normals
    distance = samples.distance
    offset = np.append(place, 0.0) - points
    reach = np.linalg.norm(offset, axis=1)
    height = np.maximum(np.vecdot(normals, offset), 1e-4 * reach)
    ratio = height / np.maximum(-np.vecdot(normals, points), 1e-9) * (distance / reach) ** 4
    half = offset / reach[:, None] - points / distance[:, None]
    cosine = np.vecdot(normals, half) / np.linalg.norm(half, axis=1)
    return ratio, np.arccos(np.clip(cosine, 0.0, 1.0))


@dataclass(frozen=True, eq=False)
class LightModel(Model):
    """The photometric fit as `least_squares` asks for it.

    A group is what shares a gain: a frame, or all if it is locked. Its own unknown is the logarithm of
    the gain.
    """

    samples: Samples
    nodes: FloatArray  # of the BRDF, rad; a single one makes the surface Lambertian
    names: list[str]  # of the common unknowns, (p,)
    lamps: int = 0  # beside the lens; 0: one at the optical centre

    def with_lamps(self, lamps: int) -> LightModel:
        """Add the places of so many lamps to the unknowns of a model whose lamp is at the lens."""
        names = [f"lamp {number} {axis}" for number in range(1, lamps + 1) for axis in "xy"]
        return replace(
            self,
            mean=np.insert(self.mean, 2, np.zeros(2 * lamps)),
            sd=np.insert(self.sd, 2, np.full(2 * lamps, np.inf)),
            names=[*self.names[:2], *names, *self.names[2:]],
            lamps=lamps,
        )

    @property
    def of_lamps(self) -> slice:
        """Where x and y of the lamps are in the vector."""
        return slice(2, 2 + 2 * self.lamps)

    @property
    def of_brdf(self) -> slice:
        """Where the BRDF is in the vector; the materials come after it."""
        return slice(self.of_lamps.stop, self.of_lamps.stop + len(self.nodes))

    @cached_property
    def log_cos_alpha(self) -> FloatArray:
        """By how much the light of each sample grows with k, (n,)."""
        return np.log(np.clip(self.samples.cos_alpha, 1e-9, 1.0))

    @cached_property
    def falloff(self) -> FloatArray:
        """-2 log d + log cos θ of each sample, (n,): the light of a lamp at the lens."""
        cosine = np.clip(self.samples.cos_theta, 1e-9, 1.0)
        return np.log(cosine) - 2 * np.log(self.samples.distance)

    @cached_property
    def materials(self) -> BoolArray:
        """Which samples are of which material, (n, materials)."""
        count = len(self.mean) - self.of_brdf.stop
        return self.samples.material[:, None] == np.arange(count)

    @cached_property
    def columns(self) -> FloatArray:
        """Derivatives of L by the vector, (n, p), γ apart, if f were interpolated in its logarithm."""
        k = self.log_cos_alpha
        hat = hats(self.nodes, self.samples.theta)
        untouched = np.zeros((len(k), self.of_lamps.stop - 1))
        return np.column_stack([k, untouched, hat, self.materials])

    def shine(self, vector: FloatArray, own: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return L, the logarithm of the light, (n,), and its derivatives by the vector, (n, p), γ apart."""
        columns = self.columns.copy()
        values = np.exp(vector[self.of_brdf])
        if self.lamps:
            columns[:, self.of_brdf] = 0
            places = vector[self.of_lamps].reshape(-1, 2)
            for place in places:
                ratio, theta = light_beside(self.samples, place)
                columns[:, self.of_brdf] += (ratio / self.lamps)[:, None] * hats(
                    self.nodes, theta
                )
            step = 1e-3  # mm
            for index, (place, move) in enumerate(product(places, step * np.eye(2))):
                before, after = (
                    ratio * np.interp(theta, self.nodes, values)
                    for ratio, theta in (
                        light_beside(self.samples, moved)
                        for moved in (place - move, place + move)
                    )
                )
                columns[:, 2 + index] = (after - before) / (2 * step * self.lamps)
        share = columns[:, self.of_brdf] * values
        f = share.sum(axis=1, keepdims=True)
        columns[:, self.of_brdf] = share / f
        columns[:, self.of_lamps] /= f
        others = vector.copy()
        others[self.of_lamps.start : self.of_brdf.stop] = 0
        light = self.falloff + columns @ others + np.log(f[:, 0])
        return light + own[self.group, 0], columns

    def usable(self, common: FloatArray, own: FloatArray) -> BoolArray:
        """Whether the level that a sample *should* have lies in the range of the sensor.

        Choosing by the measured level would keep what noise has moved into the range and drop
        what it has moved out: a bias of k and γ.
        """
        off, *_ = self.linearise(common, own)
        level = self.samples.level - off[:, 0] / GREY_LEVELS
        return (level > constants.LEVELS[0]) & (level < constants.LEVELS[1])

    def linearise(  # noqa: D102
        self, common: FloatArray, own: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        gamma = common[1]
        light, columns = self.shine(common, own)
        columns[:, 1] = -light / gamma
        # A wild step must not overflow.
        level = GREY_LEVELS * np.exp(np.minimum(light / gamma, 50.0)) * self.samples.lit
        slope = (-level / gamma)[:, None]
        off = GREY_LEVELS * self.samples.level - level
        if not 0.1 < gamma < 20:  # it would lose its meaning
            off = off * np.nan
        by_vector = slope * columns
        return off[:, None], by_vector[:, None], slope[:, None]
