r"""Lines along which a picture's walls may be cut: where a fold hides what lies behind it.

Over an occluding contour the distance jumps, and with it log d₀ = -½ log I_c; a march that crosses it
puts all behind it too near. The slope of that, |∇ log d₀|, is a landscape whose ridges are such jumps:

    log d₀           .---------      slope          /\
                    /                              /  \
    _______________/                 ______.______/    \_______
     near wall   fold   far wall      basin    watershed   basin

Its watersheds are closed lines one step thin, without a gap for a march to leak through (Vincent and
Soille, "Watersheds in digital spaces", 1991). A line between two regions is as steep as the median of
the slope along it. Steep ones are contours, most likely; vessels and noise make lines, too, of less
slope. Basins are kept small, so that a line is steep all along or nowhere: a fold fades into the wall,
and a long line would be cut where there is none any more.

A wall that turns away is dark at its rim, before it ends. So a thin strip is the limb of its lightest
neighbour, and what is cut is the strip's other side. Beside a tube's dark end the watersheds of noise
run up the slope: nothing rises across them, so they are no contours either.

In living tissue a thin dark strip is most often what a fold leaves in the dark behind it: the steep line on
its near side is the contour. So no strip is taken for a limb there.
"""

from typing import Any

import cv2
import numpy as np
from scipy.ndimage import maximum, median

from endolab.numerics.arrays import BoolArray, FloatArray, IndexArray, IntArray
from endolab.numerics.compiled import kernel
from endolab.numerics.stencils import links, px_per_reference
from endolab.reconstruction import constants


def find_contours(
    log_d0: FloatArray, mask: BoolArray, in_tissue: bool = False
) -> FloatArray:
    """Find lines that may be occluding contours, given log d₀ (`Problem.log_d0`) where it is known.

    Returns how steep they are, (2, H, W): for each link from a pixel to its right and its lower
    neighbour that crosses a line, the median slope of log d₀ along the part of it between the same two
    regions, per 1/320 of the longer side; 0 for all other links. ``steepness > 0.1`` are cuts as `Problem`
    has them.
    """
    unit = px_per_reference(mask.shape)
    blur = max(constants.LINE_BLUR * unit, 0.3)
    steepness = np.zeros((2, *mask.shape))
    maps = np.where(mask, log_d0, 0.0), mask.astype(np.float64)
    light, known = (cv2.GaussianBlur(a, (0, 0), blur) for a in maps)
    smooth = light / np.maximum(known, 1e-6)
    if min(mask.shape) == 1:
        return steepness
    slope = np.hypot(*np.gradient(smooth)) * unit
    region, count = basins(slope, mask)

    # Of every link that crosses a line: the pixels on either side.
    next_region = [np.roll(region, -1, axis) for axis in (1, 0)]
    axis, row, column = np.nonzero(links(mask) & (region != np.stack(next_region)))
    if axis.size == 0:
        return steepness
    here = (row, column)
    there = (row + (axis == 1), column + (axis == 0))
    sides = np.stack([region[here], region[there]]).astype(np.int64)
    along = (slope[here] + slope[there]) / 2
    rise = (smooth[there] - smooth[here]) * unit

    # Links between the same two regions are one line.
    low, high = np.sort(sides, axis=0)
    pairs, line = np.unique(low * count + high, return_inverse=True)
    pairs = np.stack(np.divmod(pairs, count))
    steep = median(along, line, np.arange(pairs.shape[1]))
    across = np.bincount(line, np.where(sides[0] < sides[1], rise, -rise))
    least = 0.5 if in_tissue else constants.ACROSS
    steep[np.abs(across) < least * np.bincount(line, along)] = 0.0
    if not in_tissue:
        thin = constants.LIMB_WIDTH * unit
        steep[_joins_a_limb(pairs, region, count, log_d0, thin)] = 0.0
    steepness[axis, row, column] = steep[line]
    return steepness


def basins(slope: FloatArray, mask: BoolArray) -> tuple[Any, int]:
    """Number of the basin that each pixel of the mask is in, from 0; -1 outside. And how many there are."""
    rimmed = np.pad(np.where(mask, slope, np.inf), 1, constant_values=np.inf)
    flat = rimmed.ravel()
    around = np.array([1, -1, rimmed.shape[1], -rimmed.shape[1]])
    inside = np.flatnonzero(np.isfinite(flat))
    region = np.full(flat.size, -1, np.int32)
    order = inside[np.argsort(flat[inside])]
    count = _flood(order, flat, around, constants.SHALLOW, region)
    return region.reshape(rimmed.shape)[1:-1, 1:-1], count


@kernel
def _root(parent: IntArray, label: int) -> int:
    """The basin that a basin has become a part of."""
    while parent[label] != label:
        label = parent[label]
    return label


@kernel
def _flood(
    order: IntArray, slope: FloatArray, around: IntArray, shallow: float, region: IndexArray
) -> int:
    """Give each pixel the number of its basin, from 0; basins that meet before one is deep enough are one.

    `order` holds the pixels by their slope, `region` -1 everywhere; around them is a rim of pixels that
    are in no basin. Returns how many basins there are.
    """
    floor = np.zeros(order.size)
    parent = np.zeros(order.size, np.int64)
    count = 0
    for pixel in order:
        lowest = -1  # flooded neighbour
        for step in around:
            near = pixel + step
            if region[near] >= 0 and (lowest < 0 or slope[near] < slope[lowest]):
                lowest = near
        if lowest < 0:
            region[pixel] = parent[count] = count
            floor[count] = slope[pixel]
            count += 1
            continue
        region[pixel] = region[lowest]
        for step in around:
            near = pixel + step
            if region[near] < 0:
                continue
            deep = _root(parent, region[pixel])
            other = _root(parent, region[near])
            if floor[other] < floor[deep]:
                deep, other = other, deep
            if slope[pixel] - floor[other] < shallow:
                parent[other] = deep
    number = np.empty(count, np.int64)
    basins = 0
    for label in range(count):
        if parent[label] == label:
            number[label] = basins
            basins += 1
    for pixel in order:
        region[pixel] = number[_root(parent, region[pixel])]
    return basins


def _joins_a_limb(
    pairs: Any, region: Any, count: int, log_d0: FloatArray, thin: float
) -> BoolArray:
    """Which pairs of regions are a thin strip and the lightest of its neighbours, if that is lighter."""
    around = np.pad(region, 1, constant_values=-1)
    sides = (around[1:-1, 2:], around[1:-1, :-2], around[2:, 1:-1], around[:-2, 1:-1])
    inside = np.pad(np.all([side == region for side in sides], axis=0), 1)
    depth = cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
    known = region >= 0
    deepest = maximum(depth[known], region[known], np.arange(count))
    far = median(log_d0[known], region[known], np.arange(count))
    lightest = far.copy()
    there = pairs[::-1]
    np.minimum.at(lightest, pairs, far[there])
    is_limb = (2 * deepest + 1 < thin) & (lightest < far)
    return (is_limb[pairs] & (far[there] == lightest[pairs])).any(axis=0)
