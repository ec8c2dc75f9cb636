"""A compiled loop over bands of rows, and the same in NumPy."""

import numpy as np
from numba import prange

from endolab.numerics.threads import band_rows, bands, on_cores


@on_cores
def blurred(a, out, rounds):
    """Three rows' mean, in place, again and again: what other bands wrote is read in the next loop."""
    rows = a.shape[0] - 2
    for _ in range(rounds):
        for band in prange(bands(rows)):
            begin, end = band_rows(band, 1, rows + 1)
            for i in range(begin, end):
                for j in range(a.shape[1]):
                    out[i, j] = (a[i - 1, j] + a[i, j] + a[i + 1, j]) / 3.1
        for band in prange(bands(rows)):
            begin, end = band_rows(band, 1, rows + 1)
            for i in range(begin, end):
                for j in range(a.shape[1]):
                    a[i, j] = np.sin(out[i, j]) + 0.1
    return rounds


def plainly_blurred(a, rounds):
    for _ in range(rounds):
        a = np.concatenate([a[:1], np.sin((a[:-2] + a[1:-1] + a[2:]) / 3.1) + 0.1, a[-1:]])
    return a
