"""Find a target's features in a picture, and which of them they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from endolab.calibration.dots import detect_dots
from endolab.calibration.targets import DotGrid, Target
from endolab.cameras import Camera
from endolab.operators import FloatArray, IntArray


@dataclass(frozen=True)
class Detection:
    """Features of a target that were found in a picture.

    Attributes
    ----------
    ids : (n,) int array
        Rows of `target.points`, ascending; each at most once.
    pixels : (n, 2) float array
        Where they are seen, px: the centroid of the disc's image, or the corner.
    reason : str
        In a few words, why nothing was found, where n is 0.
    """

    ids: IntArray
    pixels: FloatArray
    reason: str = ""


def detect(image: FloatArray, target: Target, camera: Camera | None = None) -> Detection:
    """Find a target's features in a picture (other kinds than dots: being written)."""
    image = np.asarray(image)
    if image.dtype != np.uint8 and image.dtype != np.uint16:
        grey = image.astype(np.float32)
    else:
        grey = image.astype(np.float32) / np.iinfo(image.dtype).max
    if grey.ndim == 3:
        grey = grey.mean(axis=2)
    if isinstance(target, DotGrid):
        return Detection(*detect_dots(grey, target))
    raise NotImplementedError
