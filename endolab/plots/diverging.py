"""The colours of signed values, blue, white and red, in recordings and in the tuner."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from endolab.numerics.arrays import FloatArray

BLUE_WHITE_RED = np.array(
    [[0, 68, 136], [110, 170, 220], [255, 255, 255], [250, 150, 90], [153, 26, 0]], float
)


def blue_white_red(values: FloatArray) -> NDArray[np.uint8]:
    """Map -1…1 to blue, white, red: (...) to (..., 3); what lies beyond is as dark as the ends."""
    nodes = np.linspace(-1, 1, len(BLUE_WHITE_RED))
    channels = [np.interp(values, nodes, channel) for channel in BLUE_WHITE_RED.T]
    return np.round(np.stack(channels, axis=-1)).astype(np.uint8)
