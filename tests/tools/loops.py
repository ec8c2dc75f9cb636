"""A compiled loop over rows, and the same in NumPy."""

import numpy as np

from endolab.numerics.threads import on_cores, rows_within


@on_cores(cost=300)
def blurred(rows, turns, a, out):
    """Three rows' mean, in place, again and again: what others wrote is read in the next turn."""
    first, last = rows_within(rows, 1, a.shape[0] - 1)
    for turn in range(turns[0], turns[1]):
        for i in range(first, last):
            for j in range(a.shape[1]):
                if turn % 2:
                    a[i, j] = np.sin(out[i, j]) + 0.1
                else:
                    out[i, j] = (a[i - 1, j] + a[i, j] + a[i + 1, j]) / 3.1


def plainly_blurred(a, rounds):
    for _ in range(rounds):
        a = np.concatenate(
            [a[:1], np.sin((a[:-2] + a[1:-1] + a[2:]) / 3.1) + 0.1, a[-1:]]
        )
    return a
