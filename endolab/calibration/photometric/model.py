"""The photometric model as a least-squares problem: grey levels against k, γ, gains and BRDF.

A sample of frame t on material m at the point x should have the grey level

    I = 255 · exp(L/γ),  L = k log cos α - 2 log d + log cos θ + log f(θ) + log a_m + log g_t

with the light at the optical centre. f is linear between its nodes, just as a `TabulatedBRDF` is, and its
unknowns are the logarithms there.

What is common to all frames is one vector: k, γ, log f at the nodes, log a of the materials. What is
known of each number beforehand decides whether it is free. The scale of f is that of the gains and
the light together, so one node, the one with the most light, is given: f is 1/π there.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from endolab.calibration.least_squares import Linearised
from endolab.calibration.photometric.samples import Samples
from endolab.numerics.arrays import BoolArray, FloatArray, IntArray

GREY_LEVELS = 255.0  # of a stored value of 1


# Where the fit of the light begins, what it is given, and what it may not leave.
# Predicted stored values that noise of 3 grey levels cannot clip.
LEVELS = (12 / 255, 240 / 255)
FIRST_GAMMA = 2.2  # where the fit of a γ that is not known begins
GAMMA_BOUNDS = (0.5, 5.0)
LEAST_SAMPLES = 10
# What can be known of a number at best, and the blackest black that is not the ink's.
LEAST_DEVIATION = 1e-9
LEAST_REFLECTANCE = 1e-6
# Exponent that brings the BRDF's nodes closer together near θ = 0.
NODE_EXPONENT = 1.15
LEAST_SUPPORT = 40  # samples between two nodes, or one of them is left out

Known = float | tuple[float, float] | None  # given, (mean, sd), or free


@dataclass(frozen=True)
class LightUnknowns:
    """What is fitted, and what is given with it."""

    k: float  # exponent of the joint fall-off
    gamma: float  # exponent of the response
    log_brdf: FloatArray  # (nodes,), of f_r in 1/sr; a single one for a Lambertian surface
    log_reflectance: FloatArray  # (materials,), relative to material 0, whose entry is 0
    # (groups, 1 + b): the logarithm of the gain of each frame, or a single one if the gain is locked;
    # errors of the poses, in standard deviations.
    own: FloatArray

    @property
    def vector(self) -> FloatArray:
        """All but `own`, (p,)."""
        first = [self.k, self.gamma]
        return np.concatenate([first, self.log_brdf, self.log_reflectance])


@dataclass(frozen=True)
class SampleGeometry:
    """What the model needs to know of where the samples lie, (n,) each."""

    valid: BoolArray  # lit, and in front of the camera
    log_cos_alpha: FloatArray  # 0 where not valid, like the others
    falloff: FloatArray  # -2 log d + log cos θ
    theta: FloatArray  # rad

    @classmethod
    def of(cls, samples: Samples) -> SampleGeometry:
        """Measure the samples as seen from the optical centre."""
        valid = (samples.cos_alpha > 0) & (samples.cos_theta > 0)
        cos_alpha = np.where(valid, np.minimum(samples.cos_alpha, 1.0), 1.0)
        cos_theta = np.where(valid, np.minimum(samples.cos_theta, 1.0), 1.0)
        falloff = np.where(valid, np.log(cos_theta) - 2 * np.log(samples.distance), 0.0)
        return cls(valid, np.log(cos_alpha), falloff, np.arccos(cos_theta))


def hats(nodes: FloatArray, theta: FloatArray) -> FloatArray:
    """Return the interpolation between nodes as a matrix, (n, nodes); constant beyond them."""
    return np.column_stack([np.interp(theta, nodes, unit) for unit in np.eye(len(nodes))])


def place_nodes(theta: FloatArray, count: int) -> FloatArray:
    """Choose at most `count` nodes of the BRDF for samples at incidence angles, rad; (nodes,), ascending.

    They are closer together near the least angle, where paper has its sheen; with too few samples
    between two of them, one is left out.
    """
    low = float(theta.min())
    high = float(theta.max())
    nodes = low + (high - low) * np.linspace(0, 1, count) ** NODE_EXPONENT
    while len(nodes) > 2:
        inside, _ = np.histogram(theta, nodes)
        thin = np.flatnonzero(inside < LEAST_SUPPORT)
        if not thin.size:
            break
        # Joining a thin interval with its neighbour removes the node between them.
        first = thin[0]
        nodes = np.delete(nodes, first if first == len(nodes) - 2 else first + 1)
    return nodes


@dataclass(frozen=True)
class LightModel:
    """The photometric fit as `least_squares` asks for it."""

    samples: Samples
    group: IntArray  # (n,), frame that a sample takes its gain from, counted from 0
    nodes: FloatArray  # of the BRDF, rad; a single one makes the surface Lambertian
    # Of each number of the vector, (p,): its value, (mean, sd), or None.
    known: tuple[Known, ...]
    # Stored values that the model may predict for a sample to count.
    levels: tuple[float, float]

    @property
    def names(self) -> list[str]:
        """Of the numbers of the vector, (p,)."""
        materials = range(len(self.known) - 2 - len(self.nodes))
        names = ["k", "gamma", *(f"brdf {node}" for node in range(len(self.nodes)))]
        return names + [f"reflectance {material}" for material in materials]

    @cached_property
    def free(self) -> BoolArray:
        """Which numbers of the vector are fitted, (p,)."""
        return np.array([not isinstance(known, float) for known in self.known])

    @property
    def reflectances(self) -> tuple[Known, ...]:
        """What is known of the logarithms of the materials' reflectances."""
        return self.known[2 + len(self.nodes) :]

    @property
    def loose_materials(self) -> list[int]:
        """Materials whose reflectance is fitted."""
        return np.flatnonzero(self.free[2 + len(self.nodes) :]).tolist()

    @property
    def known_vector(self) -> FloatArray:
        """The vector as far as it is known, (p,), 0 where it is not."""
        return np.array(
            [0.0 if known is None else np.ravel(known)[0] for known in self.known]
        )

    @property
    def given_log_reflectance(self) -> FloatArray:
        """Logarithm of the reflectance of each sample's material, as far as known, (n,); 0 where free."""
        return self.known_vector[2 + len(self.nodes) :][self.samples.material]

    @cached_property
    def geometry(self) -> SampleGeometry:
        """The samples as seen from the optical centre."""
        return SampleGeometry.of(self.samples)

    @cached_property
    def columns(self) -> FloatArray:
        """Derivatives of L by the vector, (n, p), γ apart, if f were interpolated in its logarithm."""
        geometry = self.geometry
        k = geometry.log_cos_alpha
        hat = hats(self.nodes, geometry.theta)
        material = self.samples.material[:, None] == np.arange(len(self.reflectances))
        return np.column_stack([k, np.zeros(len(k)), hat, material])

    @cached_property
    def own_columns(self) -> FloatArray:
        """Derivatives of L by the own unknowns, (n, 1 + b)."""
        return np.column_stack([np.ones(len(self.samples)), self.samples.slack])

    def unknowns(self, vector: FloatArray, own: FloatArray) -> LightUnknowns:
        """Name the parts of a vector, (p,)."""
        k, gamma = vector[:2].tolist()
        log_brdf, log_reflectance = np.split(vector[2:], [len(self.nodes)])
        return LightUnknowns(k, gamma, log_brdf, log_reflectance, own)

    def _shine(self, unknowns: LightUnknowns) -> tuple[FloatArray, FloatArray, FloatArray]:
        """∂L by the BRDF's logarithms, (n, nodes); L, the logarithm of the light, and grey level, (n,)."""
        geometry = self.geometry
        share = self.columns[:, 2 : 2 + len(self.nodes)] * np.exp(unknowns.log_brdf)
        f = share.sum(axis=1)
        shade = np.einsum("nb,nb->n", self.own_columns, unknowns.own[self.group])
        shade += unknowns.log_reflectance[self.samples.material]
        light = unknowns.k * geometry.log_cos_alpha + geometry.falloff + np.log(f) + shade
        # A wild step must not overflow.
        level = GREY_LEVELS * np.exp(np.minimum(light / unknowns.gamma, 50.0))
        return share / f[:, None], light, level * geometry.valid

    def predict(self, unknowns: LightUnknowns) -> FloatArray:
        """Grey level of each sample, (n,); 0 where no light can come from."""
        return self._shine(unknowns)[2]

    @cached_property
    def _priors(self) -> tuple[FloatArray, FloatArray]:
        """Mean of each free number, (q,), and the inverse of its deviation, 0 where nothing is known."""
        priors = [
            known if isinstance(known, tuple) else (0.0, np.inf) for known in self.known
        ]
        mean, deviation = np.array(priors)[self.free].T
        return mean, 1 / deviation

    def usable(self, unknowns: LightUnknowns) -> BoolArray:
        """Whether the level that a sample *should* have lies in the range of the sensor.

        Choosing by the measured level would keep what noise has moved into the range and drop
        what it has moved out: a bias of k and γ.
        """
        level = self.predict(unknowns) / GREY_LEVELS
        return (level > self.levels[0]) & (level < self.levels[1])

    def linearise(self, unknowns: LightUnknowns) -> Linearised:
        """Residuals and their derivatives."""
        by_brdf, light, level = self._shine(unknowns)
        slope = (level / unknowns.gamma)[:, None]  # ∂I/∂L
        columns = self.columns.copy()
        columns[:, 1] = -light / unknowns.gamma
        columns[:, 2 : 2 + len(self.nodes)] = by_brdf
        by_common = -slope * columns[:, self.free]
        by_own = -slope * self.own_columns
        residual = GREY_LEVELS * self.samples.level - level
        mean, certainty = self._priors
        prior = (unknowns.vector[self.free] - mean) * certainty
        # Nothing is known of the gain.
        stiff = np.append(0.0, np.ones(by_own.shape[1] - 1))
        return Linearised(
            residual[:, None],
            by_common[:, None],
            by_own[:, None],
            prior,
            np.diag(certainty),
            unknowns.own,
            stiff,
        )

    def take_step(
        self, unknowns: LightUnknowns, common: FloatArray, own: FloatArray
    ) -> LightUnknowns | None:
        """Return the unknowns after a step; None where γ would lose its meaning."""
        vector = unknowns.vector
        vector[self.free] += common
        if not 0.1 < vector[1] < 20:
            return None
        return self.unknowns(vector, unknowns.own + own)
