"""What an endoscope shows, told from what surrounds it in the picture: black, or any other flat colour."""

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from endolab.numerics.arrays import BoolArray, FloatArray

Bytes = NDArray[np.uint8]

SIDE = 480  # px of the longer side, of what is looked at
MARGIN = 2  # px that are left out along the edge at least, since lenses and codecs blur it
# Shares of the shorter side.
CORNER = 0.03  # legs of the triangle in a corner that tells the colour
REACH = 0.06  # within which an edge ends: what goes on rising is shading
STUB = 0.15  # half the width of what is no part of a field: boxes over its edge, glowing crescents
# Grey levels.
ROUNDING = 3  # from the surround's colour that tell nothing
BLACK = 8  # as good as black, codec noise included
UNEVEN = 10  # spread of a corner that is no surround
WHITE, GLARE = 250, 90  # a saturated wall becomes a bright one by and by, a white surround at once
# Other shares.
FLAT = 0.6  # of a surround that is within half its tolerance; of a shaded wall it is less
EDGE_END = 0.35  # of an edge's steepest rise, above that of shading
STEP, SURE = 0.5, 0.9  # of a rim that stands out, if there is an edge, and if it is nothing but one
GLOW = 0.2  # of the usual contrast, below which light may be stray
ROUND = 0.45  # of an outline that lies on one circle, if it is a disc
SQUARE = 0.97  # of its box that an outline fills, if it is a rectangle
SOLID = 0.85  # of its outline that a field fills; corners of a wall leave other shapes
FAINT = 0.35  # of the usual contrast, along a gap that is a dark wall and no part of the surround
GAP = 1e-3  # of a field, the least gap in it that is looked at
SMALL = 0.1  # of the picture, below which nothing is a field


class Surround(NamedTuple):
    """What has the colour of some corners and hangs together with the picture's border."""

    region: BoolArray
    contrast: Bytes  # of all pixels to its colour, grey levels
    tolerance: float  # grey levels
    clear: float  # contrast of what is surely something else


def field_of_view(image: FloatArray) -> BoolArray:
    """Find what an endoscope shows: all but the flat surround that fills corners of the picture.

    `image` is (H, W) or (H, W, 3), in [0, 1]; colours tell more. The surround may be of any colour, with
    noise, and hold text and boxes. All True if there is none that has an edge. Else narrower than what is
    shown by the width of its edge, two pixels at least; as wide as its outline where a wall is as dark as
    the surround.
    """
    high, wide = image.shape[:2]
    scale = max(1.0, max(high, wide) / SIDE)
    picture = _small(image, scale)
    depth = np.full(picture.shape[:2], float(SIDE), np.float32)  # px from the surround
    window = (slice(None), slice(None))
    while True:  # bars may frame a surround of another colour
        before = depth[window].shape
        for surround in _surrounds(picture[window], depth[window] > 0):
            depth[window] = np.minimum(depth[window], _depth_within(surround))
        left, top, across, down = cv2.boundingRect((depth > 0).astype(np.uint8))
        window = (slice(top, top + down), slice(left, left + across))
        if depth[window].shape == before or not across:
            break
    shown = cv2.resize(depth, (wide, high), interpolation=cv2.INTER_LINEAR) * scale > MARGIN
    return shown if shown.any() else np.ones((high, wide), dtype=bool)


def unclear_surround(image: FloatArray, mask: BoolArray) -> bool:
    """Whether a mask keeps corners of one flat colour, which may be a surround or a wall."""
    surrounds = _surrounds(_small(image, 1.0), mask)
    return any(surround.region[mask].mean() > GAP for surround in surrounds)


def _small(image: FloatArray, scale: float) -> Bytes:
    high, wide = image.shape[:2]
    size = max(1, round(wide / scale)), max(1, round(high / scale))
    picture = cv2.resize(cv2.convertScaleAbs(image, alpha=255), size, interpolation=cv2.INTER_AREA)
    # A median keeps edges where they are, and leaves little of noise.
    return np.asarray(cv2.medianBlur(picture, 5))


def _surrounds(picture: Bytes, shown: BoolArray) -> list[Surround]:
    """Return what may surround a field: a flat colour of two corners that are still shown, or black."""
    legs = max(4, round(CORNER * min(shown.shape)))
    triangle = np.add.outer(np.arange(legs), np.arange(legs)) < legs
    colours: list[tuple[NDArray[np.intp], float]] = []
    surrounds = []
    for rows, columns in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        if min(shown.shape) < 2 * legs or not shown[::rows, ::columns][0, 0]:
            continue
        values = picture[::rows, ::columns][:legs, :legs][triangle].reshape(triangle.sum(), -1).astype(int)
        colour = np.median(values, axis=0).astype(int)
        spread = float(np.percentile(np.abs(values - colour).max(axis=-1), 90))
        tolerance = ROUNDING + 2 * spread
        alike = [np.abs(colour - other).max() <= max(reach, tolerance) / 2 for other, reach in colours]
        colours.append((colour, tolerance))
        if spread <= UNEVEN and (sum(alike) == 1 or (not any(alike) and colour.max() <= BLACK)):
            surrounds.append(_surround(picture, colour, tolerance))
    return [surround for surround in surrounds if surround is not None]


def _surround(picture: Bytes, colour: NDArray[np.intp], tolerance: float) -> Surround | None:
    """Return the region of a colour, None if it is not flat; its colour and noise are told anew from it."""
    for last in (False, True):
        contrast = np.zeros(picture.shape[:2], np.uint8)
        for plane, level in zip(cv2.split(picture), colour, strict=True):
            contrast = np.maximum(contrast, cv2.absdiff(plane, np.full_like(plane, level)))
        region = _reached(contrast <= tolerance)
        if not region.any() or region.all():
            return None
        if not last and colour.max() > BLACK and (contrast[region] <= tolerance / 2).mean() < FLAT:
            return None
        values = picture[region][::5]
        colour = np.median(values.reshape(len(values), -1), axis=0).astype(int)
        tolerance = ROUNDING + 1.5 * float(np.percentile(contrast[region], 80))
    clear = GLARE if colour.min() >= WHITE else ROUNDING if colour.max() <= BLACK else BLACK
    return Surround(region, contrast, tolerance, tolerance + clear)


def _reached(like: BoolArray) -> BoolArray:
    """Return which pixels of a region hang together with what is beyond the picture's border."""
    region = np.pad(like.astype(np.uint8), 1, constant_values=1)
    cv2.floodFill(region, None, (0, 0), 2)
    return region[1:-1, 1:-1] == 2


def _depth_within(surround: Surround) -> FloatArray:
    """Return how deep pixels lie in a surround's field, px; 0 as far as its edge is soft, inf if none is."""
    usual = GLOW * float(np.median(surround.contrast[~surround.region]))
    glow = max(surround.tolerance, BLACK, usual)
    # A glow around the field may be as bright as a dark wall in it; where the rim is a step, it is none.
    for least, share in ((surround.tolerance, SURE), (glow, STEP)):
        outline = _outline(~_reached(surround.contrast <= least))
        field = _with_dark_walls(~surround.region & outline, outline, surround.contrast)
        if field.any() and field.sum() >= SOLID * outline.sum():
            depth = cv2.distanceTransform(_largest(field).astype(np.uint8), cv2.DIST_L2, 5).astype(np.float64)
            width = _edge_width(depth, surround.contrast)
            rim = surround.contrast[(depth > width + 1) & (depth <= width + 3)]
            if (rim > max(least, surround.clear)).sum() >= max(1, share * rim.size):
                return np.maximum(depth - width, 0)
    return np.full(surround.region.shape, np.inf)


def _largest(region: BoolArray) -> BoolArray:
    _, labels, stats, _ = cv2.connectedComponentsWithStats(region.astype(np.uint8), connectivity=4)
    stats[0, cv2.CC_STAT_AREA] = 0
    return region & (labels == stats[:, cv2.CC_STAT_AREA].argmax())


def _outline(region: BoolArray) -> BoolArray:
    """Return the convex hull of a region without its stubs, or the disc or rectangle that it is part of."""
    radius = STUB * min(region.shape)
    outline = np.zeros(region.shape, np.uint8)
    core = cv2.distanceTransform(np.pad(region.astype(np.uint8), 1), cv2.DIST_L2, 5)[1:-1, 1:-1] > radius
    if not core.any():
        return outline > 0
    core = region & (cv2.distanceTransform((~_largest(core)).astype(np.uint8), cv2.DIST_L2, 5) <= radius)
    if core.sum() < SMALL * core.size:
        return outline > 0
    parts = cv2.findContours(core.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    hull = cv2.convexHull(np.concatenate(parts))
    cv2.fillConvexPoly(outline, hull, 1)
    left, top, wide, high = cv2.boundingRect(hull)
    if outline.sum() > SQUARE * wide * high:
        outline[top : top + high, left : left + wide] = 1
        return outline > 0

    def inner(points: Any) -> FloatArray:  # (n, 1, 2) to (m, 2); the picture's border is no edge
        points = points[:, 0]
        return points[((points > 0) & (points < np.array(region.shape[::-1]) - 1)).all(axis=-1)].astype(float)

    corners = inner(hull)
    contour = inner(cv2.findContours(outline, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0][0])
    for _ in range(4):  # |p|² = 2 c·p + r² - |c|², by least squares; a dark wall's corners lie off
        if len(corners) < 4:
            return outline > 0
        system = np.column_stack([2 * corners, np.ones(len(corners))])
        *centre, rest = np.linalg.lstsq(system, (corners**2).sum(axis=-1))[0]
        radius = float(np.sqrt(max(rest + np.dot(centre, centre), 0.0)))
        off = np.abs(np.linalg.norm(corners - centre, axis=-1) - radius)
        corners = corners[off <= max(1.5, np.percentile(off, 75))]
    off = np.abs(np.linalg.norm(contour - centre, axis=-1) - radius)
    if (off < 1.5 + 0.005 * radius).mean() >= ROUND:
        cv2.circle(outline, (round(centre[0]), round(centre[1])), round(radius), 1, cv2.FILLED)
    return outline > 0


def _with_dark_walls(field: BoolArray, outline: BoolArray, contrast: Bytes) -> BoolArray:
    """Fill the gaps of a field towards which it darkens by and by; the surround's own edge is a step."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats((outline & ~field).astype(np.uint8))
    around = np.ones((11, 11), np.uint8)
    rim = field & (cv2.dilate((~outline).astype(np.uint8), around) > 0)
    for label in range(1, count):
        if rim.any() and stats[label, cv2.CC_STAT_AREA] >= GAP * field.sum():
            gap = labels == label
            beside = field & (cv2.dilate(gap.astype(np.uint8), around) > 0)
            if np.median(contrast[beside]) < FAINT * np.median(contrast[rim]):
                field = field | gap
    return field


def _edge_width(depth: FloatArray, contrast: Bytes) -> float:
    """Return over how many pixels a field's contrast to its surround rises; inf if it has no edge."""
    reach = max(10, round(REACH * min(depth.shape)))
    band = depth < reach
    steps = depth[band].astype(int)
    mean = np.bincount(steps, contrast[band]) / np.maximum(np.bincount(steps), 1)
    rise = np.diff(mean)
    if len(rise) < reach - 1:
        return np.inf
    shading = max(0.0, float(np.mean(rise[reach // 2 :])))
    steepest = int(rise[: reach // 2].argmax())
    over = np.flatnonzero(rise[steepest:] < shading + EDGE_END * (rise[steepest] - shading))
    return max(0.0, float(steepest + over[0] - 1)) if over.size else np.inf
