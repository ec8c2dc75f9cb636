"""Find dark round spots on lit paper, and where their middles are."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from endolab.numerics.arrays import nan_if_undefined

LEAST_WHITE = 0.03  # stored value; what is darker than this is no lit paper
Numbers = NDArray[Any]  # OpenCV works in float32 and uint8, too


@dataclass(frozen=True, eq=False)
class Blobs:
    """Dark spots of a picture."""

    centres: Numbers  # (n, 2), centroid of the darkness, px
    ink: Numbers  # (n,), area of full darkness that the spot amounts to, px²


def shrink_picture(image: Numbers) -> Numbers:
    """Average the pixels of a picture, (H, W), to one of about 360 columns."""
    height, width = image.shape
    shrink = max(1, round(width / 360))
    size = (width // shrink, max(height // shrink, 1))
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def white_of(small: Numbers) -> Numbers:
    """Brightness of the bare paper at each place of a picture, made up where there is ink."""
    side = 2 * round(0.055 * small.shape[1]) + 1
    # Closing keeps what is bright and fills what is dark and narrower than the window.
    white = cv2.morphologyEx(small, cv2.MORPH_CLOSE, np.ones((side, side), np.uint8))
    return cv2.GaussianBlur(white, (0, 0), side / 6)


def find_blobs(image: Numbers) -> Blobs:
    """Find dark round spots on lit paper, in (H, W) float32 of [0, 1]."""
    height, width = image.shape
    small = shrink_picture(image)
    # Small glints would pass for white: nothing may be much brighter than the median around it.
    window = small.shape[1] // 40 * 2 + 1
    median = cv2.medianBlur(cv2.convertScaleAbs(small, alpha=255), window)
    white = white_of(np.minimum(small, np.maximum(median, 5) * np.float32(1.25 / 255)))
    gain = cv2.resize(1 / np.maximum(white, LEAST_WHITE), (width, height))
    level = cv2.multiply(image, gain)
    dark = (level < 0.7).astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(
        dark, connectivity=4, ltype=cv2.CV_32S
    )
    left, top, wide, high, area = stats.T
    whole = (left > 0) & (top > 0) & (left + wide < width) & (top + high < height)
    good = whole & (area >= 9)
    good[0] = False
    number = np.where(good, np.cumsum(good), 0).astype(np.uint16)
    # Closing is swayed by noise: only its mean level nearby makes the bare paper 1.
    bare = ((level > 0.85) & (level < 1.1)).astype(np.float32)
    side = width // 60 * 2 + 1
    light, weight = (cv2.blur(a, (side, side)) for a in (level * bare, bare))
    level = level / ((light + 0.01) / (weight + 0.01))
    return _measure(level, number[labels])


def _measure(level: Numbers, labels: Numbers) -> Blobs:
    """Centroids and ink of labelled spots (1, 2, …)."""
    count = int(labels.max()) + 1
    wide = cv2.dilate(labels, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7)))
    place = np.flatnonzero(wide)
    number = wide.ravel()[place].astype(int)
    inner = labels.ravel()[place] == number
    y, x = np.divmod(place, labels.shape[1])
    dark = 1 - level.ravel()[place].astype(float)

    def total(values: Numbers) -> Numbers:
        return np.bincount(number, values, count)[1:]

    with nan_if_undefined():
        depth = total(inner * dark) / total(inner)
        # Where the darkness is flat, inside and outside, noise and uneven light must not count.
        cover = np.clip((dark / depth[number - 1] - 0.1) / 0.8, 0, 1)
        moments = np.column_stack([total(cover * x), total(cover * y)])
        centres = moments / total(cover)[:, None]
    ink = total(dark)
    # Grey spots are less dark than black ones.
    usual = np.quantile(np.nan_to_num([0.0, *depth]), 0.8)
    good = (ink > 0) & (depth > 0.6 * usual)
    return Blobs(centres[good], ink[good])
