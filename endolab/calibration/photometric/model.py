"""The photometric model as a least-squares problem: grey levels against k, γ, gains and BRDF.

A sample of frame t on material m at the point x should have the grey level

    I = 255 · exp(L/γ),  L = k log cos α - 2 log d + log cos θ + log f(θ) + log a_m + log g_t

with the light at the optical centre. f is linear between its nodes, just as a `TabulatedBRDF` is, and its
unknowns are the logarithms there.

What is common to all frames is one vector: k, γ, log f at the nodes, log a of the materials. Each number
has a mean and a standard deviation before the fit: 0 if it is given, inf if nothing is known. The scale of f
is that of the gains and the light together, so one node, the one with the most light, is given: f is 1/π
there.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from endolab.calibration.least_squares import Linearised
from endolab.calibration.photometric.samples import Samples
from endolab.numerics.arrays import BoolArray, FloatArray, IntArray

GREY_LEVELS = 255.0  # of a stored value of 1
# Stored values that the model may predict for a sample to count: noise of 3 grey levels cannot clip them.
LEVELS = (12 / 255, 240 / 255)
# Exponent that brings the BRDF's nodes closer together near θ = 0.
NODE_EXPONENT = 1.15
LEAST_SUPPORT = 40  # samples between two nodes, or one of them is left out


# What is fitted, and what is given with it: the vector, (p,); and of each group, (groups, 1 + b), the log
# of its gain, and errors of the poses, in standard deviations. If the gain is locked, there is one group.
Unknowns = tuple[FloatArray, FloatArray]


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


@dataclass(frozen=True)
class LightModel:
    """The photometric fit as `least_squares` asks for it."""

    samples: Samples
    group: IntArray  # (n,), frame that a sample takes its gain from, counted from 0
    nodes: FloatArray  # of the BRDF, rad; a single one makes the surface Lambertian
    mean: FloatArray  # (p,), of each number of the vector before the fit
    sd: FloatArray  # (p,), its standard deviation

    @property
    def free(self) -> BoolArray:
        """Which numbers of the vector are fitted, (p,)."""
        return self.sd > 0

    @property
    def names(self) -> list[str]:
        """Of the numbers of the vector, (p,)."""
        brdf = [f"brdf {node}" for node in range(len(self.nodes))]
        materials = range(len(self.mean) - self.of_brdf.stop)
        return ["k", "gamma", *brdf, *(f"reflectance {m}" for m in materials)]

    @property
    def of_brdf(self) -> slice:
        """Where the BRDF is in the vector; the materials come after it."""
        return slice(2, 2 + len(self.nodes))

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
        return np.column_stack([k, np.zeros(len(k)), hat, self.materials])

    @cached_property
    def own_columns(self) -> FloatArray:
        """Derivatives of L by the own unknowns, (n, 1 + b)."""
        return np.column_stack([np.ones(len(self.samples)), self.samples.slack])

    def shine(self, unknowns: Unknowns) -> tuple[FloatArray, FloatArray]:
        """Return L, the logarithm of the light, (n,), and its derivatives by the vector, (n, p), γ apart."""
        vector, own = unknowns
        columns = self.columns.copy()
        share = columns[:, self.of_brdf] * np.exp(vector[self.of_brdf])
        f = share.sum(axis=1, keepdims=True)
        columns[:, self.of_brdf] = share / f
        others = np.delete(np.arange(len(self.mean)), self.of_brdf)
        light = self.falloff + columns[:, others] @ vector[others] + np.log(f[:, 0])
        light += np.einsum("nb,nb->n", self.own_columns, own[self.group])
        return light, columns

    def level(self, light: FloatArray, gamma: float) -> FloatArray:
        """Grey level of light whose logarithm is given, (n,); 0 where none can come from."""
        # A wild step must not overflow.
        return GREY_LEVELS * np.exp(np.minimum(light / gamma, 50.0)) * self.samples.lit

    def usable(self, unknowns: Unknowns) -> BoolArray:
        """Whether the level that a sample *should* have lies in the range of the sensor.

        Choosing by the measured level would keep what noise has moved into the range and drop
        what it has moved out: a bias of k and γ.
        """
        light, _ = self.shine(unknowns)
        level = self.level(light, unknowns[0][1]) / GREY_LEVELS
        return (level > LEVELS[0]) & (level < LEVELS[1])

    def linearise(self, unknowns: Unknowns) -> Linearised:
        """Residuals and their derivatives."""
        vector, own = unknowns
        gamma = vector[1]
        light, columns = self.shine(unknowns)
        columns[:, 1] = -light / gamma
        level = self.level(light, gamma)
        slope = (-level / gamma)[:, None]
        return Linearised(
            (GREY_LEVELS * self.samples.level - level)[:, None],
            (slope * columns[:, self.free])[:, None],
            (slope * self.own_columns)[:, None],
            (vector - self.mean)[self.free],
            self.sd[self.free] ** -2.0,
            own,
            # Nothing is known of the gain.
            np.append(0.0, np.ones(self.samples.slack.shape[1])),
        )

    def take_step(
        self, unknowns: Unknowns, common: FloatArray, own: FloatArray
    ) -> Unknowns | None:
        """Return the unknowns after a step; None where γ would lose its meaning."""
        vector = unknowns[0].copy()
        vector[self.free] += common
        if not 0.1 < vector[1] < 20:
            return None
        return vector, unknowns[1] + own
