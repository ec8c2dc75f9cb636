"""How a surface reflects: BRDFs of the incidence angle θ and the half angle.

In the simplified model the light sits at the camera, and the two angles are one.
"""

from dataclasses import field
from typing import Annotated, Literal, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from endolab.numerics.arrays import FloatArray
from endolab.numerics.checked_types import checked

Albedo = Annotated[float, Field(ge=1e-9, le=1)]


class BRDF(Protocol):
    """What the photometric model asks of a surface."""

    def value(self, cos_incidence: ArrayLike, cos_half: ArrayLike) -> FloatArray:
        """f_r at the cosines of the angles normal-light and normal-half vector, 1/sr."""
        ...

    def slope(self, cosine: ArrayLike) -> FloatArray:
        """Derivative of ``value(c, c)`` by c: where the light is at the camera, both cosines are one."""
        ...


@checked
class Lambertian:
    """A matt surface, f_r = k_d/π.

    Parameters
    ----------
    albedo : float or three floats
        k_d in (0, 1]; three for the channels red, green, blue.
    """

    model: Literal["lambertian"] = field(default="lambertian", kw_only=True, repr=False)
    albedo: Albedo | tuple[Albedo, Albedo, Albedo] = 1.0

    def value(self, cos_incidence: ArrayLike, cos_half: ArrayLike) -> FloatArray:
        """See `BRDF.value`; needs one albedo, not three."""
        if isinstance(self.albedo, tuple):
            raise ValueError(
                "the surface has one albedo per channel: choose a channel first"
            )
        return np.full(np.shape(cos_incidence), self.albedo / np.pi)

    def slope(self, cosine: ArrayLike) -> FloatArray:
        """See `BRDF.slope`."""
        return np.zeros(np.shape(cosine))


@checked
class TabulatedBRDF:
    """A BRDF given at a few incidence angles, linear between them, constant beyond.

    Parameters
    ----------
    theta : (n,) increasing floats
        Nodes, rad (the paper calibrates 15).
    values : (n,) floats
        f_r there, positive, 1/sr.
    """

    model: Literal["tabulated"] = field(default="tabulated", kw_only=True, repr=False)
    theta: tuple[Annotated[float, Field(ge=0, le=np.pi / 2)], ...]
    values: tuple[Annotated[float, Field(ge=1e-9, le=1e9)], ...] = Field(alias="value")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if len(self.theta) != len(self.values) or len(self.theta) < 2:
            raise ValueError("theta and value must be lists of one length, 2 or more")
        if np.any(np.diff(self.theta) <= 0):
            raise ValueError(f"theta must increase, got {list(self.theta)}")
        return self

    def value(self, cos_incidence: ArrayLike, cos_half: ArrayLike) -> FloatArray:
        """See `BRDF.value`; beside the lens θ is the half angle, of which a sheen is."""
        theta = np.arccos(np.clip(cos_half, 0.0, 1.0))
        return np.interp(theta, self.theta, self.values)

    def slope(self, cosine: ArrayLike) -> FloatArray:
        """See `BRDF.slope`. At normal incidence, where the table has a cusp, 0."""
        theta = np.arccos(np.clip(cosine, 0.0, 1.0))
        nodes = np.asarray(self.theta)
        values = np.asarray(self.values)
        slopes = np.concatenate([[0.0], np.diff(values) / np.diff(nodes), [0.0]])
        slope = slopes[np.searchsorted(nodes, theta, side="right")]
        sin = np.sin(theta)
        return np.where(sin > 1e-8, -slope / np.maximum(sin, 1e-8), 0.0)


@checked
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

    model: Literal["glossy"] = field(default="glossy", kw_only=True, repr=False)
    albedo: Albedo = 1.0
    specular: Annotated[float, Field(ge=0, le=1e3)] = 0.02
    shininess: Annotated[float, Field(ge=0, le=1e6)] = 200.0

    def value(self, cos_incidence: ArrayLike, cos_half: ArrayLike) -> FloatArray:
        """See `BRDF.value`."""
        lobe = np.clip(cos_half, 0.0, None) ** self.shininess
        return (
            self.albedo / np.pi + self.specular * (self.shininess + 2) / (2 * np.pi) * lobe
        )

    def slope(self, cosine: ArrayLike) -> FloatArray:
        """See `BRDF.slope`."""
        lobe = np.clip(cosine, 0.0, None) ** max(self.shininess - 1, 0.0)
        return self.specular * (self.shininess + 2) / (2 * np.pi) * self.shininess * lobe
