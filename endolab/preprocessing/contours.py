"""Occluding contours, found in the picture: where a fold hides what lies behind it.

Over a contour the distance jumps, and with it log d₀ = -½ log I_c; a march that crosses it puts all
behind it too near. A jump is told from a slope and from texture by looking at two scales: the height
of a step does not depend on the blur, that of a slope grows with it, and that of a thin line (a
vessel, a highlight's rim) falls. The end of a blind tube is such a step too, although nothing is
hidden there: the picture alone does not tell.
"""

import cv2
import numpy as np
from scipy import ndimage

from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.derivatives import REFERENCE_WIDTH, forward_gradient, links

FINE, COARSE = 1.5, 3.0  # blurs, in 1/320 of the picture's width
STEP = 0.2  # of log d₀ over the strongest part of a contour; its weaker parts may have half
LINE, SLOPE = 0.65, 1.7  # coarse over fine height: a line's halves, a step's stays, a slope's doubles
SHORTEST = 12.0  # extent of a contour, in 1/320 of the width
BAND = 5.0  # half-width of what noise and blur make of a jump, in 1/320 of the width
UNEVEN = 0.025  # change of log d₀ per 1/320 of the width, within the band, that belongs to the jump


def find_contours(log_facing: FloatArray, mask: BoolArray) -> tuple[BoolArray, BoolArray]:
    """Find the occluding contours of a picture, given log d₀ (`Problem.log_facing`) where it is known.

    Returns the pixels on a contour, a line a pixel or two wide, and the steps (2, H, W) over which the
    surface is torn, as `Problem.cuts` takes them: those through a contour, and within the band that blur
    makes of it all that are steep. There d₀ lies between near and far, and would start a march at a wrong
    distance.
    """
    unit = mask.shape[1] / REFERENCE_WIDTH
    known = np.where(mask, log_facing, 0.0)
    (by_row, by_column), fine = _steps(known, mask, FINE * unit)
    coarse = _steps(known, mask, COARSE * unit)[1]
    is_step = (coarse > LINE * fine) & (coarse < SLOPE * fine)
    height = np.where(mask & is_step, np.minimum(fine, coarse), 0.0)
    size = np.hypot(by_row, by_column) + 1e-12
    up_row, up_column = by_row / size, by_column / size
    ridge = _is_ridge(fine, up_row, up_column)
    weak = cv2.morphologyEx(
        (ridge & (height > STEP / 2)).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)
    )
    count, labels, stats, _ = cv2.connectedComponentsWithStats(weak, connectivity=8)
    kept = np.zeros(count, dtype=bool)
    kept[np.unique(labels[ridge & (height > STEP)])] = True
    kept &= stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1) >= SHORTEST * unit
    kept[0] = False
    edges = kept[labels] & mask

    near = ndimage.distance_transform_edt(~edges) <= BAND * unit if edges.any() else edges
    linked = links(mask)
    cuts = linked & near & (np.abs(forward_gradient(known)) > UNEVEN / unit)
    # Through the contour itself: every step that leaves it uphill, even where it is not steep.
    for axis, up in ((1, up_column), (0, up_row)):
        here, there = edges & (up > 0.38), edges & (up < -0.38)
        cuts[1 - axis] |= linked[1 - axis] & (here | np.roll(there, -1, axis))
    return edges, cuts


def _steps(known: FloatArray, mask: BoolArray, blur: float) -> tuple[list[FloatArray], FloatArray]:
    """Gradient (rows, columns) of a map blurred within its mask, and the step that it would be part of."""
    share = cv2.GaussianBlur(mask.astype(np.float64), (0, 0), blur)
    smooth = cv2.GaussianBlur(known, (0, 0), blur) / np.maximum(share, 1e-6)
    gradient = [np.asarray(part) for part in np.gradient(smooth)]
    # A blurred step of height h has the slope h / (blur √2π).
    return gradient, np.hypot(*gradient) * blur * np.sqrt(2 * np.pi)


def _is_ridge(size: FloatArray, up_row: FloatArray, up_column: FloatArray) -> BoolArray:
    """Where a map is at least as large as a pixel ahead and a pixel back along a direction."""
    rows, columns = np.indices(size.shape, dtype=np.float32)
    ahead, back = (
        cv2.remap(
            size.astype(np.float32),
            (columns + sign * up_column).astype(np.float32),
            (rows + sign * up_row).astype(np.float32),
            cv2.INTER_LINEAR,
        )
        for sign in (1, -1)
    )
    return (size >= ahead - 1e-7) & (size >= back - 1e-7)
