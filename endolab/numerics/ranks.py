"""Numbers by their order: sorted places, medians of groups, and the nth lowest in a moving window."""

import numpy as np
from numpy.typing import NDArray

from endolab.numerics.arrays import FloatArray, IntArray
from endolab.numerics.compiled import kernel


def sorted_places(values: FloatArray) -> IntArray:
    """Places of values (n,) from the lowest up, those of equal ones in their order.

    NumPy's stable sort does the same, more slowly: equal ones are few, and put in their order afterwards.
    """
    places = np.argsort(values)
    found = values[places]
    as_before = np.concatenate([[False], found[1:] == found[:-1]])
    equal = as_before.copy()
    equal[:-1] |= as_before[1:]
    if equal.any():
        group = np.cumsum(~as_before)[equal]
        places[equal] = places[equal][np.lexsort((places[equal], group))]
    return places


def nth_lowest(values: FloatArray, nth: int) -> float:
    """The value that sorting would put at `nth`, from 0."""
    return float(np.partition(values, nth)[nth])


def median(values: FloatArray) -> float:
    """Median of values (n,), as NumPy's, which asks for both in the middle at once, more slowly."""
    middle = values.size // 2
    parted = np.partition(values, middle)
    if values.size % 2:
        return float(parted[middle])
    return float((parted[:middle].max() + parted[middle]) / 2)


@kernel
def _select(a: FloatArray, first: int, last: int, nth: int) -> float:
    """Put the value that sorting would at `nth` there, of `a` from `first` to before `last` (Hoare)."""
    low, high = first, last - 1
    while low < high:
        pivot, i, j = a[(low + high) // 2], low, high
        while i <= j:
            while a[i] < pivot:
                i += 1
            while a[j] > pivot:
                j -= 1
            if i <= j:
                a[i], a[j] = a[j], a[i]
                i, j = i + 1, j - 1
        if nth <= j:
            high = j
        elif nth >= i:
            low = i
        else:
            break
    return a[nth]


@kernel
def _medians(values: FloatArray, labels: NDArray, count: int) -> FloatArray:
    first, out = np.zeros(count + 2, np.int64), np.full(count, np.nan)
    for label in labels:
        if label >= 0:
            first[label + 2] += 1
    for label in range(2, count + 2):
        first[label] += first[label - 1]
    grouped = np.empty(first[count + 1])
    for i in range(len(labels)):
        if labels[i] >= 0:
            grouped[first[labels[i] + 1]] = values[i]
            first[labels[i] + 1] += 1
    for label in range(count):
        start, end = first[label], first[label + 1]
        if start < end:
            middle = (start + end - 1) // 2
            low = high = _select(grouped, start, end, middle)
            if (end - start) % 2 == 0:
                high = grouped[middle + 1]
                for i in range(middle + 2, end):
                    high = min(high, grouped[i])
            out[label] = (low + high) / 2
    return out


def medians(values: FloatArray, labels: NDArray, count: int) -> FloatArray:
    """Median of the values (n,) of each label from 0 to before `count`; a negative label is none."""
    return np.asarray(_medians(values, labels, count), dtype=np.float64)


@kernel
def _slide(order: IntArray, count: IntArray, width: int, nth: int, out: IntArray) -> None:
    """Nth lowest, from 0, of whole numbers in a square window, which is moved to and fro.

    How many of each number the window holds is counted, and kept as it moves (Huang, Yang, Tang, "A fast
    two-dimensional median filtering algorithm", 1979). `order` is larger than `out` by a window less one,
    `count` zero, with a place for each number.
    """
    rows, columns = out.shape
    at = below = 0
    for k in range(width):
        for column in range(width):
            count[order[k, column]] += 1
    for row in range(rows):
        for step in range(columns):
            back = row % 2
            column = columns - 1 - step if back else step
            if step or row:
                for k in range(width):
                    if step:
                        gone, new = (column + width, column) if back else (column - 1, column + width - 1)
                        one, other = order[row + k, gone], order[row + k, new]
                    else:
                        one, other = order[row - 1, column + k], order[row + width - 1, column + k]
                    count[one] -= 1
                    count[other] += 1
                    below += (other < at) - (one < at)
            while below > nth:
                at -= 1
                below -= count[at]
            while below + count[at] <= nth:
                below += count[at]
                at += 1
            out[row, column] = at


def window_percentile(a: FloatArray, percent: float, width: int) -> FloatArray:
    """Percentile of a map (H, W) in a square window of odd width around each pixel, rounded down.

    Beyond its border the map goes on as at its border.
    """
    values, order = np.unique(np.pad(a, width // 2, mode="edge"), return_inverse=True)
    found = np.empty(a.shape, np.int64)
    nth = min(int(width**2 * percent / 100), width**2 - 1)
    order = order.reshape(a.shape[0] + width - 1, a.shape[1] + width - 1)
    _slide(order, np.zeros(values.size, np.int64), width, nth, found)
    return np.asarray(values[found], dtype=np.float64)
