"""The photometric model as a least-squares problem: grey levels against k, γ, gains and BRDF.

A sample of frame t on material m at the point x should have the grey level

    I = 255 · exp(L/γ),  L = k log cos ψ - 2 log r + log cos θ + log f(θ) + log a_m + log g_t

r is the distance to the light, θ the angle at the surface and ψ the angle off the light's
direction; with the light at the optical centre r = d and ψ = α. f is linear between its nodes, just
as a `TabulatedBRDF` is, and its unknowns are the logarithms there.

The scale of f is that of the gains and the light together, so one node, the one with the most
light, is not an unknown: f is 1/π there.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from endolab.calibration.least_squares import Linearised
from endolab.calibration.photometric.samples import Samples
from endolab.numerics.arrays import BoolArray, FloatArray, IntArray

GREY_LEVELS = 255.0  # of a stored value of 1


@dataclass(frozen=True)
class LightFitRules:
    """Where the fit of the light begins, what it is given, and what it may not leave."""

    # Predicted stored values that noise of 3 grey levels cannot clip.
    levels: tuple[float, float] = (12 / 255, 240 / 255)
    first_gamma: float = 2.2  # where the fit of a γ that is not known begins
    gamma_bounds: tuple[float, float] = (0.5, 5.0)
    least_samples: int = 10
    # Exponent that brings the BRDF's nodes closer together near θ = 0.
    node_exponent: float = 1.15
    least_support: int = 40  # samples between two nodes, or one of them is left out
    # Largest standard errors of a free light's place, mm, and of its tilt.
    largest_place_error: float = 2.0
    largest_tilt_error: float = 0.1


LIGHT_FIT = LightFitRules()

Known = float | tuple[float, float] | None  # given, (mean, sd), or free


@dataclass(frozen=True)
class LightUnknowns:
    """What is fitted."""

    k: float  # exponent of the joint fall-off
    gamma: float  # exponent of the response
    log_brdf: FloatArray  # (nodes,), of f_r in 1/sr; a single one for a Lambertian surface
    log_reflectance: FloatArray  # (materials,), relative to material 0, whose entry is 0
    log_gain: FloatArray  # (groups,), of each frame, or a single one if the gain is locked
    # (5,): position of the virtual light, mm, and tilt of its direction (a, b, 1) along x and y.
    light: FloatArray = field(default_factory=lambda: np.zeros(5))
    # (groups, b), errors of the poses, in standard deviations.
    slack: FloatArray | float = 0.0


@dataclass(frozen=True)
class SampleGeometry:
    """What the model needs to know of where the samples lie, (n,) each, for one place of the light."""

    valid: BoolArray  # lit, and in front of camera and light
    log_cos_psi: FloatArray  # 0 where not valid, like the others
    falloff: FloatArray  # -2 log r + log cos θ
    theta: FloatArray  # rad

    @classmethod
    def of(cls, samples: Samples, light: FloatArray) -> SampleGeometry:
        """Measure the samples as seen from a light; see `LightUnknowns.light`."""
        offset = samples.points - light[:3]
        reach = np.linalg.norm(offset, axis=1)
        direction = np.array([light[3], light[4], 1.0])
        cos_psi = offset @ direction / (reach * np.linalg.norm(direction))
        cos_theta = -np.einsum("ni,ni->n", offset, samples.normals) / reach
        valid = (cos_psi > 0) & (cos_theta > 0)
        cos_theta = np.where(valid, np.minimum(cos_theta, 1.0), 1.0)
        log_cos_psi = np.log(np.where(valid, np.minimum(cos_psi, 1.0), 1.0))
        falloff = np.where(valid, -2 * np.log(reach) + np.log(cos_theta), 0.0)
        return cls(valid, log_cos_psi, falloff, np.arccos(cos_theta))


def hats(nodes: FloatArray, theta: FloatArray) -> FloatArray:
    """Return the interpolation between nodes as a matrix, (n, nodes); constant beyond them."""
    if len(nodes) == 1:
        return np.ones((len(theta), 1))
    matrix = np.zeros((len(theta), len(nodes)))
    row = np.arange(len(theta))
    below = interval(nodes, theta)
    share = np.clip((theta - nodes[below]) / np.diff(nodes)[below], 0.0, 1.0)
    matrix[row, below] = 1 - share
    matrix[row, below + 1] = share
    return matrix


def interval(nodes: FloatArray, theta: FloatArray) -> IntArray:
    """Index of the node below, (n,); that of the nearest interval beyond them."""
    return np.clip(np.searchsorted(nodes, theta, side="right") - 1, 0, len(nodes) - 2)


def place_nodes(theta: FloatArray, count: int) -> FloatArray:
    """Choose at most `count` nodes of the BRDF for samples at incidence angles, rad; (nodes,), ascending.

    They are closer together near the least angle, where paper has its sheen; with too few samples
    between two of them, one is left out.
    """
    low = float(theta.min())
    high = float(theta.max())
    nodes = low + (high - low) * np.linspace(0, 1, count) ** LIGHT_FIT.node_exponent
    while len(nodes) > 2:
        inside = np.bincount(interval(nodes, theta), minlength=len(nodes) - 1)
        thin = np.flatnonzero(inside < LIGHT_FIT.least_support)
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
    pinned: int  # the node that is no unknown
    gamma: Known
    reflectance: tuple[Known, ...]  # of materials 1 and up
    free_light: bool
    # Stored values that the model may predict for a sample to count.
    levels: tuple[float, float]

    @property
    def names(self) -> list[str]:
        """Of the common unknowns, in their order."""
        names = ["k"] + ([] if isinstance(self.gamma, float) else ["gamma"])
        names += [f"brdf {node}" for node in range(len(self.nodes)) if node != self.pinned]
        names += [f"reflectance {material}" for material in self.loose_materials]
        if self.free_light:
            names += ["light x", "light y", "light z", "light tilt x", "light tilt y"]
        return names

    @cached_property
    def loose_materials(self) -> list[int]:
        """Materials whose reflectance is fitted."""
        return [
            i
            for i, known in enumerate(self.reflectance, start=1)
            if not isinstance(known, float)
        ]

    @property
    def given_log_reflectance(self) -> FloatArray:
        """Logarithms of the materials' reflectances, (materials,), as far as known; 0 where free."""
        known = (r[0] if isinstance(r, tuple) else r for r in self.reflectance)
        return np.log([1.0, *(1.0 if value is None else value for value in known)])

    def _look_from(self, light: FloatArray) -> tuple[SampleGeometry, FloatArray]:
        geometry = SampleGeometry.of(self.samples, light)
        return geometry, hats(self.nodes, geometry.theta)

    @cached_property
    def _centred_geometry(self) -> tuple[SampleGeometry, FloatArray]:
        return self._look_from(np.zeros(5))

    def geometry(self, unknowns: LightUnknowns) -> tuple[SampleGeometry, FloatArray]:
        """Return the samples as seen from the light, and how f is interpolated there, (n, nodes)."""
        return (
            self._look_from(unknowns.light) if self.free_light else self._centred_geometry
        )

    def _shine(
        self, unknowns: LightUnknowns, geometry: SampleGeometry, f: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """L, the logarithm of the linear light, and the grey level, (n,) each."""
        shade = (
            unknowns.log_reflectance[self.samples.material] + unknowns.log_gain[self.group]
        )
        shade += np.einsum(
            "nb,nb->n", self.samples.slack, self._slack(unknowns)[self.group]
        )
        logarithm = unknowns.k * geometry.log_cos_psi + geometry.falloff + np.log(f) + shade
        # A wild step must not overflow.
        return logarithm, GREY_LEVELS * np.exp(
            np.minimum(logarithm / unknowns.gamma, 50.0)
        ) * geometry.valid

    def _slack(self, unknowns: LightUnknowns) -> FloatArray:
        return np.broadcast_to(
            unknowns.slack, (int(self.group[-1]) + 1, self.samples.slack.shape[1])
        )

    def predict(self, unknowns: LightUnknowns) -> FloatArray:
        """Grey level of each sample, (n,); 0 where no light can come from."""
        geometry, hat = self.geometry(unknowns)
        return self._shine(unknowns, geometry, hat @ np.exp(unknowns.log_brdf))[1]

    @cached_property
    def _priors(self) -> list[tuple[int, int, float, float]]:
        """Column, material (0 stands for γ), mean and sd of what is roughly known, in its logarithm but γ."""
        priors = [(1, 0, *self.gamma)] if isinstance(self.gamma, tuple) else []
        for material, value in enumerate(self.reflectance, start=1):
            if isinstance(value, tuple):
                column = self.names.index(f"reflectance {material}")
                priors.append(
                    (column, material, float(np.log(value[0])), value[1] / value[0])
                )
        return priors

    def _prior(self, unknowns: LightUnknowns) -> FloatArray:
        logs = unknowns.log_reflectance
        gamma = unknowns.gamma
        return np.array(
            [((logs[m] if m else gamma) - mean) / sd for _, m, mean, sd in self._priors]
        )

    def residual(self, unknowns: LightUnknowns) -> tuple[FloatArray, FloatArray]:
        """Measured minus predicted grey levels, (n, 1), and what the priors say."""
        off = np.append(self._prior(unknowns), self._slack(unknowns))
        return (GREY_LEVELS * self.samples.level - self.predict(unknowns))[:, None], off

    def usable(self, unknowns: LightUnknowns) -> BoolArray:
        """Whether the level that a sample *should* have lies in the range of the sensor.

        Choosing by the measured level would keep what noise has moved into the range and drop
        what it has moved out: a bias of k and γ.
        """
        level = self.predict(unknowns) / GREY_LEVELS
        return (level > self.levels[0]) & (level < self.levels[1])

    def linearise(self, unknowns: LightUnknowns) -> Linearised:
        """Residuals and their derivatives."""
        geometry, hat = self.geometry(unknowns)
        values = np.exp(unknowns.log_brdf)
        f = hat @ values
        logarithm, level = self._shine(unknowns, geometry, f)
        slope = level / unknowns.gamma  # ∂I/∂L
        # Derivatives of L, in the order of `names`.
        columns = [geometry.log_cos_psi[:, None]]
        if not isinstance(self.gamma, float):
            columns.append(-logarithm[:, None] / unknowns.gamma)
        columns.append(np.delete(hat * values, self.pinned, axis=1) / f[:, None])
        columns.append(self.samples.material[:, None] == self.loose_materials)
        if self.free_light:
            columns.append(self._by_light(unknowns, geometry, f))
        by_common = -slope[:, None] * np.concatenate(columns, axis=1)
        by_prior = np.zeros((len(self._priors), by_common.shape[1]))
        for row, (column, _, _, sd) in enumerate(self._priors):
            by_prior[row, column] = 1 / sd
        residual = GREY_LEVELS * self.samples.level - level
        own = np.column_stack([np.ones(len(slope)), self.samples.slack])
        by_own = -(slope[:, None] * own)[:, None]
        # Nothing is known of the gain.
        slack = np.pad(self._slack(unknowns), ((0, 0), (1, 0)))
        stiff = np.append(0.0, np.ones(slack.shape[1] - 1))
        prior = self._prior(unknowns)
        return Linearised(
            residual[:, None], by_common[:, None], by_own, prior, by_prior, slack, stiff
        )

    def _by_light(
        self, unknowns: LightUnknowns, geometry: SampleGeometry, f: FloatArray
    ) -> FloatArray:
        """∂L by the light's position and tilt, (n, 5)."""
        offset = self.samples.points - unknowns.light[:3]
        square = np.sum(offset**2, axis=1)[:, None]
        direction = np.append(unknowns.light[3:], 1.0)
        along = np.where(geometry.valid, offset @ direction, np.inf)[:, None]
        towards = np.where(
            geometry.valid, np.einsum("ni,ni->n", offset, self.samples.normals), np.inf
        )
        # Gradients by the point: of log cos ψ, of log cos θ; of log r it is offset/square.
        psi = direction / along - offset / square
        incidence = self.samples.normals / towards[:, None] - offset / square
        rise = np.zeros(len(f))  # df/dθ
        if len(self.nodes) > 1:
            slopes = np.diff(np.exp(unknowns.log_brdf)) / np.diff(self.nodes)
            inside = (geometry.theta > self.nodes[0]) & (geometry.theta < self.nodes[-1])
            rise = slopes[interval(self.nodes, geometry.theta)] * inside
        # dθ = -cot θ d log cos θ
        cot = 1 / np.tan(np.maximum(geometry.theta, 1e-6))
        by_point = (
            unknowns.k * psi
            - 2 * offset / square
            + incidence * (1 - cot * rise / f)[:, None]
        )
        by_tilt = unknowns.k * (
            offset[:, :2] / along - direction[:2] / (direction @ direction)
        )
        return np.where(
            geometry.valid[:, None], np.concatenate([-by_point, by_tilt], axis=1), 0.0
        )

    def take_step(
        self, unknowns: LightUnknowns, common: FloatArray, own: FloatArray
    ) -> LightUnknowns | None:
        """Return the unknowns after a step; None where γ would lose its meaning."""
        column = 1 if isinstance(self.gamma, float) else 2
        gamma = unknowns.gamma + (common[1] if column == 2 else 0.0)
        if not 0.1 < gamma < 20:
            return None
        last = column + len(self.nodes) - 1
        log_brdf = unknowns.log_brdf.copy()
        log_reflectance = unknowns.log_reflectance.copy()
        log_brdf[np.arange(len(log_brdf)) != self.pinned] += common[column:last]
        log_reflectance[self.loose_materials] += common[
            last : last + len(self.loose_materials)
        ]
        return replace(
            unknowns,
            k=unknowns.k + float(common[0]),
            gamma=float(gamma),
            log_brdf=log_brdf,
            log_reflectance=log_reflectance,
            log_gain=unknowns.log_gain + own[:, 0],
            slack=unknowns.slack + own[:, 1:],
            light=unknowns.light + (common[-5:] if self.free_light else 0.0),
        )
