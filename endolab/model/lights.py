"""Lights of an endoscope."""

import math
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field

from endolab.numerics.arrays import FloatArray
from endolab.numerics.checked_types import checked

Millimetres = Annotated[float, Field(ge=-1e3, le=1e3)]
Vector = tuple[float, float, float]


def _unit(direction: Vector) -> Vector:
    length = math.hypot(*direction)
    if not 1e-6 <= length <= 1e6:
        raise ValueError(f"must be 1e-06 to 1e+06 long, got {direction}")
    if abs(length - 1) < 1e-12:  # stays as it is
        return direction
    x, y, z = direction
    return x / length, y / length, z / length


@checked
class SpotLight:
    """A small light that fades with the cosine off its direction and the square of the distance.

    L(x) = b cosᵐψ / |x - x_l|² (paper, eqs. 1 and 2, with the exponent m and weight b = σo).

    Parameters
    ----------
    position : three floats
        x_l in the camera frame, mm. The default is the optical centre.
    direction : three floats
        Principal direction d_l, of any length; forward by default.
    exponent : float
        n, at least 0; 0 shines alike all over the half space in front.
    weight : float
        Its share of the light, positive.
    """

    position: tuple[Millimetres, Millimetres, Millimetres] = (0.0, 0.0, 0.0)
    direction: Annotated[Vector, AfterValidator(_unit)] = (0.0, 0.0, 1.0)
    exponent: Annotated[float, Field(ge=0, le=100)] = 0.0
    weight: Annotated[float, Field(ge=1e-12, le=1e12)] = 1.0

    def illuminate(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Light that arrives at points (..., 3) in the camera frame, mm.

        Returns b cosᵐψ / distance², (...), 1/mm², 0 behind the light; and the distance to it, mm.
        """
        offset = points - np.asarray(self.position)
        distance = np.linalg.norm(offset, axis=-1)
        cos_psi = np.maximum(offset @ np.asarray(self.direction), 0.0) / distance
        front = cos_psi**self.exponent * (cos_psi > 0)
        return self.weight * front / distance**2, distance
