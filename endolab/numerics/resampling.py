"""Maps on another number of pixels."""

import cv2
import numpy as np

from endolab.numerics.arrays import FloatArray


def resample(maps: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Resample maps (h, w, ...) to (H, W, ...), linearly between the pixels' centres."""
    found = cv2.resize(maps, shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(found.reshape(*shape, *maps.shape[2:]), dtype=np.float64)
