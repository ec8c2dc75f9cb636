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

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from endolab.calibration.least_squares import Model
from endolab.calibration.photometric.samples import Samples
from endolab.numerics.arrays import BoolArray, FloatArray

GREY_LEVELS = 255.0  # of a stored value of 1
# Stored values that the model may predict for a sample to count: noise of 3 grey levels cannot clip them.
LEVELS = (12 / 255, 240 / 255)
# Exponent that brings the BRDF's nodes closer together near θ = 0.
NODE_EXPONENT = 1.15
# Cosine of the steepest incidence of lamps' light, on average, at which a sample counts.
GRAZING = 0.05
LEAST_SUPPORT = 40  # samples between two nodes, or one of them is left out


def hats(nodes: FloatArray, theta: FloatArray) -> FloatArray:
    """Return the interpolation between nodes as a matrix, (n, nodes); constant beyond them."""
    return np.column_stack([np.interp(theta, nodes, unit) for unit in np.eye(len(nodes))])


def place_nodes(theta: FloatArray, count: int) -> FloatArray:
    """Choose at most `count` nodes of the BRDF for samples at incidence angles, rad; (nodes,), ascending.

    They are closer together near the least angle, where paper has its sheen; with too few samples
    between two of them, one is left out.
    """
    nodes = theta.min() + np.ptp(theta) * np.linspace(0, 1, count) ** NODE_EXPONENT
    while len(nodes) > 2:
        inside, _ = np.histogram(theta, nodes)
        thin = np.flatnonzero(inside < LEAST_SUPPORT)
        if not thin.size:
            break
        # Joining a thin interval with its neighbour removes the node between them.
        nodes = np.delete(nodes, min(thin[0] + 1, len(nodes) - 2))
    return nodes


def light_beside(
    samples: Samples, place: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Compare the light of a lamp at (x, y, 0), mm, with that of one at the lens, both of exponent 1.

    With n the normal, o = (x, y, 0) - X, r = |o| and d = |X|, a lamp's light is z (n·o) / r⁴, so that

        ω = (n·o) / (-n·X) · (d / r)⁴,      θ = arccos(n·h / |h|),  h = o/r - X/d

    Returns ω, (n,), and the half angle θ, rad, (n,), each with its derivatives by x and y, (n, 2).
    """
    points, normals = samples.points, samples.normals
    distance = samples.distance
    offset = np.append(place, 0.0) - points
    reach = np.linalg.norm(offset, axis=1)
    height = np.vecdot(normals, offset)
    behind = height < 1e-4 * reach
    height = np.where(behind, 1e-4 * reach, height)
    nearer = (distance / reach) ** 4 / np.maximum(-np.vecdot(normals, points), 1e-9)
    ratio = height * nearer
    by_place = nearer[:, None] * normals - 4 * (ratio / reach**2)[:, None] * offset
    by_place[behind] = 0

    to_lamp = offset / reach[:, None]
    half = to_lamp - points / distance[:, None]
    length = np.linalg.norm(half, axis=1)
    half /= length[:, None]
    cosine = np.clip(np.vecdot(normals, half), 0.0, 1.0)
    across = normals - cosine[:, None] * half
    across -= np.vecdot(across, to_lamp)[:, None] * to_lamp
    sine = np.maximum(np.sqrt(1 - cosine**2), 1e-9)
    turn = -across / (sine * reach * length)[:, None]
    return ratio, by_place[:, :2], np.arccos(cosine), turn[:, :2]


@dataclass(frozen=True, eq=False)
class LightModel(Model):
    """The photometric fit as `least_squares` asks for it.

    A group is what shares a gain: a frame, or all if it is locked. Its own unknowns are the logarithm of the
    gain and errors of the frame's poses, in standard deviations.
    """

    samples: Samples
    nodes: FloatArray  # of the BRDF, rad; a single one makes the surface Lambertian
    names: list[str]  # of the common unknowns, (p,)
    lamps: int = 0  # beside the lens; 0: one at the optical centre

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

    @cached_property
    def own_columns(self) -> FloatArray:
        """Derivatives of L by the own unknowns, (n, 1 + b)."""
        return np.column_stack([np.ones(len(self.samples)), self.samples.slack])

    def shine(self, vector: FloatArray, own: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return L, the logarithm of the light, (n,), and its derivatives by the vector, (n, p), γ apart."""
        columns = self.columns.copy()
        values = np.exp(vector[self.of_brdf])
        share = columns[:, self.of_brdf] * values
        slopes = np.zeros((len(columns), 2 * self.lamps))
        if self.lamps:
            bends = np.concatenate([[0], np.diff(values) / np.diff(self.nodes), [0]])
            share = np.zeros_like(share)
            for number, place in enumerate(vector[self.of_lamps].reshape(-1, 2)):
                ratio, by_place, theta, turn = light_beside(self.samples, place)
                hat = hats(self.nodes, theta)
                share += ratio[:, None] * hat * values / self.lamps
                bend = (ratio * bends[np.searchsorted(self.nodes, theta)])[:, None] * turn
                slope = (hat @ values)[:, None] * by_place + bend
                slopes[:, 2 * number : 2 * number + 2] = slope / self.lamps
        f = share.sum(axis=1, keepdims=True)
        columns[:, self.of_brdf] = share / f
        others = vector.copy()
        others[self.of_lamps.start : self.of_brdf.stop] = 0
        light = self.falloff + columns @ others + np.log(f[:, 0])
        columns[:, self.of_lamps] = slopes / f
        light += np.einsum("nb,nb->n", self.own_columns, own[self.group])
        return light, columns

    def usable(self, common: FloatArray, own: FloatArray) -> BoolArray:
        """Whether the level that a sample *should* have lies in the range of the sensor.

        Choosing by the measured level would keep what noise has moved into the range and drop
        what it has moved out: a bias of k and γ.
        """
        off, *_ = self.linearise(common, own)
        level = self.samples.level - off[:, 0] / GREY_LEVELS
        good = (level > LEVELS[0]) & (level < LEVELS[1])
        if self.lamps:
            cosines = []
            for place in common[self.of_lamps].reshape(-1, 2):
                offset = np.append(place, 0.0) - self.samples.points
                cosine = np.vecdot(self.samples.normals, offset)
                cosines.append(np.maximum(cosine / np.linalg.norm(offset, axis=1), 0))
            good &= np.mean(cosines, axis=0) > GRAZING
        return good

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
        by_own = slope * self.own_columns
        return off[:, None], by_vector[:, None], by_own[:, None]
