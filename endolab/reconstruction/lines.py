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
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from endolab.numerics.arrays import BoolArray, FloatArray, IndexArray, IntArray
from endolab.numerics.compiled import kernel
from endolab.numerics.derivatives import links, px_per_reference
from endolab.numerics.side_by_side import side_by_side


@dataclass(frozen=True)
class LineSearch:
    """Which watersheds may be contours.

    Lengths are in 1/320 of the longer side, slopes in log d₀ per such a length.
    """

    blur: float = 1.5  # of log d₀
    shallow: float = 0.005  # basins of the slope less deep than this are one
    limb_width: float = 8.0  # a strip that is thinner than this may be a limb
    across: float = 0.1  # share of a line's slope that must lie across it, on the whole


LINE_SEARCH = LineSearch()


@kernel
def _root(parent: IntArray, label: int) -> int:
    """The basin that a basin has become a part of."""
    while parent[label] != label:
        label = parent[label]
    return label


@kernel
def _flood(
    order: IntArray, slope: FloatArray, steps: IntArray, shallow: float, region: IndexArray
) -> int:
    """Give each pixel the number of its basin, from 0; basins that meet before one is deep enough are one.

    `order` holds the pixels by their slope, `region` -1 everywhere; around them is a rim of pixels that
    are in no basin. Returns how many basins there are.
    """
    floor = np.zeros(order.size)
    parent = np.zeros(order.size, np.int64)
    count = 0
    taken = np.zeros(steps.size, np.bool_)
    for pixel in order:
        first = -1
        taken[:] = False
        # From the lowest flooded neighbour upwards, whichever way the picture is turned.
        for _ in steps:
            lowest = np.inf
            at = -1
            for k in range(steps.size):
                near = pixel + steps[k]
                if not taken[k] and region[near] >= 0 and slope[near] < lowest:
                    lowest = slope[near]
                    at = k
            if at < 0:
                break
            taken[at] = True
            other = _root(parent, region[pixel + steps[at]])
            if first < 0:
                first = other
                region[pixel] = first
            elif (
                other != first and slope[pixel] - max(floor[other], floor[first]) < shallow
            ):
                if floor[other] < floor[first]:
                    first, other = other, first
                parent[other] = first
        if first < 0:
            region[pixel] = parent[count] = count
            floor[count] = slope[pixel]
            count += 1
    number = np.empty(count, np.int64)
    basins = 0
    for label in range(count):
        if parent[label] == label:
            number[label] = basins
            basins += 1
    for pixel in order:
        region[pixel] = number[_root(parent, region[pixel])]
    return basins


def _order(values: FloatArray) -> IntArray:
    """Return which of finite values comes first; those within a 2³²nd of their range stay as they come.

    Numbers of 16 bits are sorted by counting, so that two passes take a fifth of the time of comparing.
    """
    least = values.min(initial=np.inf)
    span = float(values.max(initial=-np.inf) - least)
    scale = (2**32 - 1) / span if span > 0 else 0.0
    level = ((values - least) * scale).astype(np.uint32)
    order = np.argsort(level.astype(np.uint16), kind="stable")
    high = (level >> 16).astype(np.uint16)
    return order[np.argsort(high[order], kind="stable")]


def basins(slope: FloatArray, mask: BoolArray) -> tuple[Any, int]:
    """Number of the basin that each pixel of the mask is in, from 0; -1 outside. And how many there are."""
    rimmed = np.pad(np.where(mask, slope, np.inf), 1, constant_values=np.inf)
    flat = rimmed.ravel()
    steps = np.array([1, -1, rimmed.shape[1], -rimmed.shape[1]])
    inside = np.flatnonzero(np.isfinite(flat))
    region = np.full(flat.size, -1, np.int32)
    count = _flood(
        inside[_order(flat[inside])],
        flat,
        steps,
        LINE_SEARCH.shallow,
        region,
    )
    return region.reshape(rimmed.shape)[1:-1, 1:-1], count


def _medians(values: FloatArray, labels: Any, count: int) -> FloatArray:
    """Median of the values (n,) of each label from 0 to before `count`, of which none is without a value.

    `scipy.ndimage.median` takes ten times as long.
    """
    order = _order(values)
    by_value = labels[order].astype(np.min_scalar_type(count))
    order = order[np.argsort(by_value, kind="stable")]
    size = np.bincount(labels, minlength=count)
    first = np.cumsum(size) - size
    grouped = values[order]
    return (grouped[first + (size - 1) // 2] + grouped[first + size // 2]) / 2


def find_contours(log_d0: FloatArray, mask: BoolArray) -> FloatArray:
    """Find lines that may be occluding contours, given log d₀ (`Problem.log_d0`) where it is known.

    Returns how steep they are, (2, H, W): for each step from a pixel to its right and its lower
    neighbour that crosses a line, the median slope of log d₀ along the part of it between the same two
    regions, per 1/320 of the longer side; 0 for all other steps. ``steepness > 0.1`` are cuts as `Problem`
    has them.
    """
    unit = px_per_reference(mask.shape)
    blur = max(LINE_SEARCH.blur * unit, 0.3)
    steepness = np.zeros((2, *mask.shape))
    maps = (np.where(mask, log_d0, 0.0), mask.astype(np.float64))
    light, share = side_by_side(
        lambda a: cv2.GaussianBlur(a, (0, 0), blur), maps, mask.size
    )
    smooth = light / np.maximum(share, 1e-6)
    if min(mask.shape) == 1:
        return steepness
    slope = np.hypot(*np.gradient(smooth)) * unit
    # In single precision: what rounding makes of equals does not say which comes first.
    slope = slope.astype(np.float32).astype(np.float64)
    region, count = basins(slope, mask)
    # Of every step that crosses a line: the pixels on either side, as numbers.
    axis, row, column = np.nonzero(
        links(mask) & np.stack([_step(region, axis) != 0 for axis in (1, 0)])
    )
    if axis.size == 0:
        return steepness
    here = (row, column)
    there = (row + (axis == 1), column + (axis == 0))
    sides = np.stack([region[here], region[there]]).astype(np.int64)
    along = (slope[here] + slope[there]) / 2
    rise = (smooth[there] - smooth[here]) * unit
    across = np.where(sides[0] < sides[1], rise, -rise)
    low, high = np.sort(sides, axis=0)
    both, line = np.unique(low * count + high, return_inverse=True)
    both = np.stack(np.divmod(both, count))
    steep = _medians(along, line, both.shape[1])
    total_across, total_along = (np.bincount(line, parts) for parts in (across, along))
    steep[np.abs(total_across) < LINE_SEARCH.across * total_along] = 0.0
    thin = LINE_SEARCH.limb_width * unit
    steep[_joins_a_limb(both, region, count, log_d0, thin)] = 0.0
    steepness[axis, row, column] = steep[line]
    return steepness


def _step(region: IntArray, axis: int) -> IntArray:
    """Difference of each pixel and the next along an axis, (H, W); 0 at the end."""
    end = region.take([-1], axis)
    return np.diff(region, axis=axis, append=end)


def _depths(inside: BoolArray, region: IntArray, count: int) -> Any:
    """How far each region's pixels are at most from what is not inside, px, (count,)."""
    padded = np.pad(inside, 1).astype(np.uint8)
    depth = cv2.distanceTransform(padded, cv2.DIST_L2, 5)[1:-1, 1:-1]
    known = region >= 0
    deepest = np.zeros(count, depth.dtype)
    np.maximum.at(deepest, region[known], depth[known])
    return deepest


def _joins_a_limb(
    both: Any, region: Any, count: int, log_d0: FloatArray, thin: float
) -> BoolArray:
    """Which pairs of regions are a thin strip and the lightest of its neighbours, if that is lighter."""
    around = np.pad(region, 1, constant_values=-1)
    sides = (around[1:-1, 2:], around[1:-1, :-2], around[2:, 1:-1], around[:-2, 1:-1])
    inside = np.all([side == region for side in sides], axis=0)
    is_thin = 2 * _depths(inside, region, count) + 1 < thin
    known = region >= 0
    far = _medians(log_d0[known], region[known], count)
    lightest = far.copy()
    for end, far_end in (both, both[::-1]):
        np.minimum.at(lightest, end, far[far_end])
    is_limb = is_thin & (lightest < far)
    joins = [
        is_limb[end] & (far[far_end] == lightest[end])
        for end, far_end in (both, both[::-1])
    ]
    return joins[0] | joins[1]
