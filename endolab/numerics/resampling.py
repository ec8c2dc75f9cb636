"""Maps on another number of pixels."""

import numpy as np

from endolab.numerics.arrays import FloatArray


def resample(maps: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Resample maps (h, w, ...) to (H, W, ...), linearly between the pixels' centres.

    OpenCV does so with weights of single precision, which are not the same from the left and from the right.
    """
    for axis, size in enumerate(shape):
        length = maps.shape[axis]
        place = np.clip((np.arange(size) + 0.5) * length / size - 0.5, 0, length - 1)
        low = np.minimum(place.astype(int), max(length - 2, 0))
        share = (place - low).reshape(-1, *[1] * (maps.ndim - axis - 1))
        below = maps.take(low, axis)
        above = maps.take(np.minimum(low + 1, length - 1), axis)
        maps = (1 - share) * below + share * above
    return maps
