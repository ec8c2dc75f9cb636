"""How a surface reflects: BRDFs of the incidence angle θ and the half angle.

In the simplified model the light sits at the camera, and the two angles are one.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from endolab.model.ranges import check_range
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import real_array


class BRDF(Protocol):
    """What the photometric model asks of a surface."""

    def value(self, cos_incidence: ArrayLike, cos_half: ArrayLike) -> FloatArray:
        """f_r at the cosines of the angles normal-light and normal-half vector, 1/sr."""
        ...

    def derivative(self, cos_incidence: ArrayLike, cos_half: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Derivatives of `value` by its two cosines."""
        ...


def _checked(name: str, value: ArrayLike, low: float) -> FloatArray:
    array = real_array(name, value)
    if not np.all(np.isfinite(array) & (array >= low)):
        raise ValueError(f"{name} must be finite and at least {low:g}, got {np.array2string(array)}")
    return array


@dataclass(frozen=True)
class Lambertian:
    """A matt surface, f_r = k_d/π.

    Parameters
    ----------
    albedo : float or three floats
        k_d in (0, 1]; three for the channels red, green, blue.
    """

    albedo: float | tuple[float, float, float] = 1.0

    def __post_init__(self) -> None:
        albedo = real_array("albedo", self.albedo)
        if albedo.shape not in ((), (3,)):
            raise ValueError(f"albedo must be one number or three (red, green, blue), got {self.albedo}")
        if not np.all((albedo > 0) & (albedo <= 1)):
            raise ValueError(f"albedo must lie in (0, 1], got {self.albedo}")
        check_range("albedo", albedo)
        object.__setattr__(self, "albedo", float(albedo) if albedo.ndim == 0 else tuple(albedo.tolist()))

    def value(self, cos_incidence: ArrayLike, cos_half: ArrayLike) -> FloatArray:
        """See `BRDF.value`; needs one albedo, not three."""
        if isinstance(self.albedo, tuple):
            raise ValueError("the surface has one albedo per channel: choose a channel first")
        return np.full(np.shape(cos_incidence), self.albedo / np.pi)

    def derivative(self, cos_incidence: ArrayLike, cos_half: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """See `BRDF.derivative`."""
        zero = np.zeros(np.shape(cos_incidence))
        return zero, zero


@dataclass(frozen=True)
class TabulatedBRDF:
    """A BRDF given at a few incidence angles, linear between them, constant beyond.

    Parameters
    ----------
    theta : (n,) increasing floats
        Nodes, rad (the paper calibrates 15).
    values : (n,) floats
        f_r there, positive, 1/sr.
    """

    theta: tuple[float, ...]
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        theta = _checked("theta", self.theta, 0.0)
        values = _checked("value", self.values, 0.0)
        if theta.ndim != 1 or theta.size < 2 or theta.shape != values.shape:
            raise ValueError(
                f"theta and value must be lists of one length, got {theta.size} and {values.size}"
            )
        if not (np.all(np.diff(theta) > 0) and theta[-1] <= np.pi / 2):
            raise ValueError("theta must increase and end at π/2 or before")
        if not np.all(values > 0):
            raise ValueError("every value of the BRDF must be positive")
        check_range("value", values)
        object.__setattr__(self, "theta", tuple(theta.tolist()))
        object.__setattr__(self, "values", tuple(values.tolist()))

    def value(self, cos_incidence: ArrayLike, cos_half: ArrayLike) -> FloatArray:
        """See `BRDF.value`; the half angle plays no part."""
        theta = np.arccos(np.clip(cos_incidence, 0.0, 1.0))
        return np.interp(theta, self.theta, self.values)

    def derivative(self, cos_incidence: ArrayLike, cos_half: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """See `BRDF.derivative`. At normal incidence, where the table has a cusp, 0."""
        theta = np.arccos(np.clip(cos_incidence, 0.0, 1.0))
        nodes, values = np.asarray(self.theta), np.asarray(self.values)
        slopes = np.concatenate([[0.0], np.diff(values) / np.diff(nodes), [0.0]])
        slope = slopes[np.searchsorted(nodes, theta, side="right")]
        sin = np.sin(theta)
        by_cosine = np.where(sin > 1e-8, -slope / np.where(sin > 1e-8, sin, 1.0), 0.0)
        return by_cosine, np.zeros(by_cosine.shape)


@dataclass(frozen=True)
class Glossy:
    """A matt surface under a wet film: Lambertian plus a Blinn-Phong lobe.

    f_r = k_d/π + k_s (s + 2)/(2π) cosˢ(half angle).

    Parameters
    ----------
    albedo : float
        k_d, in (0, 1].
    specular : float
        k_s, at least 0: the share of light that the film returns.
    shininess : float
        s, at least 0; 50 is a wide sheen, 500 a small glint.
    """

    albedo: float = 1.0
    specular: float = 0.02
    shininess: float = 200.0

    def __post_init__(self) -> None:
        if np.ndim(self.albedo) != 0:
            raise ValueError(f"albedo of a glossy surface must be one number, got {self.albedo}")
        Lambertian(self.albedo)
        for name in ("specular", "shininess"):
            _checked(name, getattr(self, name), 0.0)
            check_range(name, getattr(self, name))

    def value(self, cos_incidence: ArrayLike, cos_half: ArrayLike) -> FloatArray:
        """See `BRDF.value`."""
        lobe = np.clip(cos_half, 0.0, None) ** self.shininess
        return self.albedo / np.pi + self.specular * (self.shininess + 2) / (2 * np.pi) * lobe

    def derivative(self, cos_incidence: ArrayLike, cos_half: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """See `BRDF.derivative`."""
        lobe = np.clip(cos_half, 0.0, None) ** max(self.shininess - 1, 0.0)
        by_half = self.specular * (self.shininess + 2) / (2 * np.pi) * self.shininess * lobe
        return np.zeros(np.shape(cos_incidence)), by_half
