"""Maps and cuts on another number of pixels."""

from typing import Any

import cv2
import numpy as np

from endolab.numerics.arrays import BoolArray, FloatArray


def resample(maps: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Resample maps (h, w, ...) to (H, W, ...), linearly between the pixels' centres."""
    found = cv2.resize(maps, shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(found.reshape(*shape, *maps.shape[2:]), dtype=np.float64)


def nearest_pixels(old: tuple[int, ...], new: tuple[int, ...]) -> tuple[Any, ...]:
    """Return the pixels of one grid in which the centres of another's lie, as an index of maps."""
    return np.ix_(
        *(
            (size / count * (np.arange(count) + 0.5)).astype(int)
            for size, count in zip(old, new, strict=True)
        )
    )


def resample_cuts(cuts: BoolArray, shape: tuple[int, ...]) -> BoolArray:
    """Return cuts (2, h, w), (`stencils`), on more pixels or fewer, (H, W).

    A step between two of these is cut if one on the way between the nearest pixels is.
    """
    nearest = nearest_pixels(cuts.shape[1:], shape)
    resampled = []
    for cut, axis in zip(cuts, (1, 0), strict=True):
        # On the way from the border to each pixel.
        passed = (np.cumsum(cut, axis) - cut)[nearest]
        ahead = np.diff(passed, axis=axis, append=passed.take([-1], axis))
        resampled.append(ahead > 0)
    return np.stack(resampled)
