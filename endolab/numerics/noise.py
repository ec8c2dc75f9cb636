"""The noise of a picture."""

import cv2
import numpy as np

from endolab.numerics.arrays import BoolArray, FloatArray


def noise_level(image: FloatArray, mask: BoolArray) -> float:
    """Estimate the standard deviation of a picture's noise, in stored values.

    The difference of two Laplacians, to which surfaces and shading give almost nothing (Immerkær, "Fast
    noise variance estimation", 1996). The mean is over the lower four fifths of its sizes, so that edges
    do not count; 0.5586 is that mean for a normal distribution. 0 if no pixel has all its neighbours in
    the mask.
    """
    kernel = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]]) / 6
    inside = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0) > 0
    if not inside.any():
        return 0.0
    size = np.abs(cv2.filter2D(np.where(mask, image, 0.0), -1, kernel)[inside])
    nth = int(0.8 * (size.size - 1))  # of stored bytes many are equal, but for rounding
    return float(np.partition(size, nth)[: nth + 1].mean() / 0.5586)


def mean_weight(blur: float) -> float:
    """What is left of the standard deviation of white noise: that of a Gaussian's weights, or all of it."""
    return 1 / max(2 * np.sqrt(np.pi) * blur, 1.0)
