"""Where a panel of the target stands in front of the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from endolab.numerics.arrays import FloatArray, nan_if_undefined


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid motion from the target's frame to the camera's: x_c = R x_t + t."""

    rotation: FloatArray  # R, (3, 3)
    translation: FloatArray  # t, (3,), mm: where the target's origin is

    @classmethod
    def of(cls, vector: FloatArray) -> Pose:
        """Make a pose of its `vector`."""
        turn = scipy.spatial.transform.Rotation.from_rotvec(vector[:3])
        return cls(turn.as_matrix(), vector[3:])

    @property
    def vector(self) -> FloatArray:
        """Rotation vector, rad, and translation, mm: (6,)."""
        turn = scipy.spatial.transform.Rotation.from_matrix(self.rotation)
        return np.concatenate([turn.as_rotvec(), self.translation])

    def transform(self, points: ArrayLike) -> FloatArray:
        """Points of the target in the camera frame, (..., 3), mm."""
        return np.asarray(points, dtype=np.float64) @ self.rotation.T + self.translation

    def meet(self, rays: FloatArray) -> FloatArray:
        """Where rays (..., 3) from the camera meet the front of the panel, mm; nan where they do not."""
        height = self.translation @ self.normal
        facing = rays @ self.normal
        with nan_if_undefined():
            far = np.where(np.maximum(facing, height) < 0, height / facing, np.nan)
        return rays * far[..., None]

    @property
    def normal(self) -> FloatArray:
        """Unit normal of the panel in the camera frame, out of the paper: towards who reads it, (3,)."""
        return -self.rotation[:, 2]

    @property
    def tilt(self) -> float:
        """Angle between the panel's normal and the camera's axis, rad."""
        return float(np.arccos(np.clip(self.rotation[2, 2], -1, 1)))
