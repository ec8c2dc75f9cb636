"""Lights of an endoscope."""

import math
from dataclasses import dataclass

import numpy as np

from endolab.model.ranges import check_range, in_range
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import excerpt, real_array


@dataclass(frozen=True)
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

    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    exponent: float = 0.0
    weight: float = 1.0

    def __post_init__(self) -> None:
        position = real_array("position", self.position)
        direction = real_array("direction", self.direction)
        for name, three in (("position", position), ("direction", direction)):
            if three.shape != (3,):
                raise ValueError(
                    f"{name} must be three numbers, got {excerpt(getattr(self, name))}"
                )
        length = math.hypot(*direction)
        if not 1e-6 <= length <= 1e6:
            raise ValueError(f"direction must be 1e-06 to 1e+06 long, got {self.direction}")
        check_range("position", position)
        for name in ("exponent", "weight"):
            in_range(name, getattr(self, name))
        # Unit ones stay as they are.
        unit = direction if abs(length - 1) < 1e-12 else direction / length
        object.__setattr__(self, "position", tuple(position.tolist()))
        object.__setattr__(self, "direction", tuple(unit.tolist()))

    def illuminate(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Light that arrives at points (..., 3) in the camera frame, mm.

        Returns b cosᵐψ / distance², (...), 1/mm², 0 behind the light; and the distance to it, mm.
        """
        offset = points - np.asarray(self.position)
        distance = np.linalg.norm(offset, axis=-1)
        cos_psi = np.maximum(offset @ np.asarray(self.direction), 0.0) / distance
        front = np.where(cos_psi > 0, cos_psi, 1.0) ** self.exponent * (cos_psi > 0)
        return self.weight * front / distance**2, distance
