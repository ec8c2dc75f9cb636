"""Types of arrays, and arrays that nobody may write into."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
SingleArray = NDArray[np.float32]
ComplexArray = NDArray[np.complex128]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
IndexArray = NDArray[np.int32]
ByteArray = NDArray[np.int8]  # marks of pixels: 0 or 1, or a kind of evidence
Span = tuple[int, int]  # the first, and the one after the last


def nan_if_undefined() -> np.errstate:
    """Let NumPy divide by 0, and compute with nan, without a warning."""
    return np.errstate(invalid="ignore", divide="ignore")


def freeze(array: np.ndarray) -> np.ndarray:
    """Make an array read-only: an observer that writes into it would change the result."""
    array.flags.writeable = False
    return array
