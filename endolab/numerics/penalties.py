"""Robust penalties, in the convention with one half: near zero each is r squared over two."""

import numpy as np
from numpy.typing import ArrayLike

from endolab.numerics.arrays import FloatArray


def huber(r: ArrayLike, threshold: float) -> FloatArray:
    """Huber penalty: r²/2 up to the threshold t > 0, then t(|r| - t/2); in the unit of r squared.

    ``huber(r, epsilon) / epsilon`` is the Huber norm of DTAM (Newcombe, Lovegrove, Davison, "DTAM: dense
    tracking and mapping in real-time", ICCV 2011) that the paper writes ‖·‖_ε: total variation that is
    smooth within ε.
    """
    if not (np.isfinite(threshold) and threshold > 0):
        raise ValueError(f"threshold must be positive and finite, got {threshold}")
    size = np.abs(np.asarray(r, dtype=np.float64))
    small = np.minimum(size, threshold)
    return small * (size - 0.5 * small)
