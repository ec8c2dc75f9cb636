"""Where a panel of the target stands in front of the camera."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
import scipy
from numpy.typing import ArrayLike

from endolab.numerics.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid motion from the target's frame to the camera's: x_c = R x_t + t."""

    rotation: FloatArray  # R, (3, 3)
    translation: FloatArray  # t, (3,), mm: where the target's origin is
    # Of `vector`, (6, 6).
    covariance: FloatArray = field(default_factory=lambda: np.zeros((6, 6)), compare=False)

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

    @property
    def normal(self) -> FloatArray:
        """Unit normal of the panel in the camera frame, out of the paper: towards who reads it, (3,)."""
        return -self.rotation[:, 2]

    def plane_errors(self) -> FloatArray:
        """Return what the plane m, m · x = 1 for all its points x, may be off: (3, 3), 1/mm.

        Columns are independent errors, of one standard deviation each.
        """
        normal = self.normal
        height = self.normal @ self.translation
        turned = -cv2.Rodrigues(self.vector[:3])[1][:, 2::3].T  # δn by the rotation vector
        rise = np.append(self.translation @ turned, normal)  # δ(n · t)
        slopes = (
            np.hstack([turned, np.zeros((3, 3))]) / height
            - np.outer(normal, rise) / height**2
        )
        values, vectors = np.linalg.eigh(slopes @ self.covariance @ slopes.T)
        return vectors * np.sqrt(np.maximum(values, 0.0))

    @property
    def tilt(self) -> float:
        """Angle between the panel's normal and the camera's axis, rad."""
        return float(np.arccos(np.clip(self.rotation[2, 2], -1, 1)))
