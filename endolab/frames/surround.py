"""What an endoscope shows, told from the flat surround that fills corners of the picture, or its border.

What differs from the corners' colours is the field, but for text and boxes, and but for walls that are as
dark as the surround. The field is the connected region about the middle, or else the largest, whatever stands
apart from it. So a few outlines are tried: the convex hull of that region, the disc through its edge, and
what two or three of the hull's four mirror images share, which completes a dark side from the other and drops
a box over the edge. Across each point of an outline runs a profile of the contrast to the surround; at a
field's edge it rises within RISE px and little after, while shading goes on rising:

    contrast           .----------
                      /
    surround ________/   |       |
               -RISE   0 RISE   2 RISE    px into the field

So of the contrast c(s), s px into the field, a point is at an edge if

    c(-RISE/5) is the surround's,  c(RISE/5) is more,  c(RISE/2) is 5 grey levels more, and
    c(RISE) - c(-RISE/5) > 1.2 (c(2 RISE) - c(RISE)).

The outline with most points at an edge counts. If too small a share of its points is, there is no surround.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import cv2
import numpy as np

from endolab.numerics.arrays import BoolArray, ComplexArray, FloatArray, SingleArray

SIDE = 480  # px of the longer side of what is looked at
RISE = 10  # px of that, within which an edge rises
SURE = 0.8  # share of an outline at an edge, from which on no other is sought
UNSURE = 0.52  # share from which on an outline may be the field's


class Field(NamedTuple):
    """What an endoscope may show, on what is looked at."""

    inside: BoolArray  # (h, w)
    edge: ComplexArray  # (n,), x + iy of the points of its outline that are at an edge, px
    profiles: SingleArray  # (n, 3 RISE + 1), the contrast across them
    share: float  # of the outline that is at an edge; the picture's border is no outline
    apart: float = 0.0  # the largest region that stands apart from it, of its size


def square(reach: float) -> np.ndarray:
    """A window that reaches as far as this to either side, at least 1 px."""
    return np.ones((2 * max(1, round(reach)) + 1,) * 2, np.uint8)


def dilate(region: BoolArray, reach: float) -> BoolArray:
    """Grow a region by a square, to every side by `reach` px, at least 1."""
    return cv2.dilate(region.astype(np.uint8), square(reach)) > 0


def field_of_view(image: FloatArray, least: float = 0.55) -> BoolArray:
    """Find what an endoscope shows: all but the flat surround that fills corners of the picture.

    `image` is (H, W) or (H, W, 3), in [0, 1]; colours tell more. The surround may be of any colour, with
    noise, and hold text and boxes. `least` is the share of the field's outline that must be at an edge.
    All True if there is no such field. Else narrower than what is shown by the width of its edge, two
    pixels at least.
    """
    high, wide = image.shape[:2]
    field = _find_field(image)
    if field is None or field.share < least:
        return np.ones((high, wide), dtype=bool)
    profile = np.median(field.profiles, axis=0)[RISE:]
    top = profile[RISE] - max(0.0, profile[-1] - profile[RISE])  # without shading
    width = (profile > 0.8 * top).argmax()
    inside = field.inside.astype(np.uint8)
    depth = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) - width
    shown = cv2.resize(depth, (wide, high)) * max(high, wide) / SIDE > 2
    box = np.ix_(shown.any(axis=1), shown.any(axis=0))
    if shown[box].all():  # bars, which may frame a surround of another colour
        shown[box] = field_of_view(image[box], SURE)
    return shown


def surround_doubts(image: FloatArray, mask: BoolArray) -> tuple[bool, bool]:
    """Whether a mask keeps what may be a surround, 2 % of the mask at least; whether there are two fields."""
    field = _find_field(image)
    if field is None or field.share < UNSURE:
        return False, False
    outside = (~field.inside).astype(np.uint8)
    kept = cv2.resize(outside, mask.shape[::-1], interpolation=cv2.INTER_NEAREST)[mask]
    is_unclear = bool(kept.sum() > 0.02 * kept.size)
    # What stands apart is another field from a fifth of this one's size on.
    return is_unclear, field.share > SURE and field.apart > 0.2


def _find_field(image: FloatArray) -> Field | None:
    """Return the outline that explains most of the edge, None if nothing has an edge."""
    longer = max(image.shape[:2])
    if longer < 60:  # each pixel has edges
        return None
    high, wide = (max(1, round(length * SIDE / longer)) for length in image.shape[:2])
    levels = cv2.convertScaleAbs(image, alpha=255)
    scaled = cv2.resize(levels, (wide, high), interpolation=cv2.INTER_AREA)
    # A median takes noise and keeps edges.
    picture = np.atleast_3d(cv2.medianBlur(scaled, 5)).astype(np.float32)
    fields = [*_find_outlines(_contrast(picture, _corners(picture, 0.03), 90))]
    if all(field.share < UNSURE for field in fields):
        # Half of each corner may be text, or all of it, and half of the border.
        border = np.concatenate([*picture[[0, -1]], *picture[:, [0, -1]].swapaxes(0, 1)])
        patches = _corners(picture, 0.1), np.stack([border, border])
        contrast = np.minimum(*(_contrast(picture, each, 50) for each in patches))
        fields += [field for field in _find_outlines(contrast) if field.share > SURE]
    return max(fields, key=lambda field: len(field.edge), default=None)


def _find_outlines(contrast: SingleArray) -> Iterator[Field]:
    """Find outlines that may be the field's, up to one that surely is, of a contrast (h, w)."""
    if contrast.all():  # no corner is flat
        return
    high, wide = contrast.shape
    usual = float(np.median(contrast[contrast > 0])) if contrast.any() else 0.0
    # Text and other narrow parts are no field.
    stub = square(0.075 * min(high, wide))
    for glow in (0.0, 0.1, 0.25):  # of the usual contrast, stray light around the field
        differs = (contrast > glow * usual).astype(np.uint8)
        cv2.drawContours(differs, _contours(differs), -1, 1, cv2.FILLED)
        body = cv2.morphologyEx(differs, cv2.MORPH_OPEN, stub)
        _, labels, facts, _ = cv2.connectedComponentsWithStats(body)
        sizes = facts[1:, cv2.CC_STAT_AREA]
        if sizes.max(initial=0) < 0.03 * body.size:  # of the smallest field
            continue
        chosen = labels[high // 2, wide // 2] or 1 + sizes.argmax()
        apart = max(np.delete(sizes, chosen - 1), default=0) / sizes[chosen - 1]
        # What stands apart may yet be of it, beside a dark part, if the edge is not sure.
        for region in (labels == chosen, labels > 0)[: 1 + (apart > 0)]:
            corners = cv2.convexHull(np.concatenate(_contours(region.astype(np.uint8))))
            hull = cv2.fillConvexPoly(np.zeros_like(body), corners, 1)
            images = hull + hull[::-1] + hull[:, ::-1] + hull[::-1, ::-1]
            first = _measure_outline(hull > 0, contrast, glow * usual)
            outlines = _disc(first.edge, hull.shape), images >= 2, images >= 3
            found = [first] + [
                _measure_outline(each, contrast, glow * usual)
                for each in outlines
                if len(_contours(each.astype(np.uint8))) == 1
            ]
            # A smaller field, or one beside the middle, must be sure.
            is_usual = region[high // 2, wide // 2] and region.mean() >= 0.1
            is_all = region.sum() == body.sum()
            for field in found:
                if len(field.edge) > 10 * RISE and (
                    (is_usual and is_all) or field.share > SURE
                ):
                    yield field._replace(apart=float(apart))
            if any(field.share > SURE for field in found):
                return


def _corners(picture: SingleArray, fraction: float) -> SingleArray:
    """Return the pixels (4, n, c) of squares in the corners, whose sides are a fraction of the picture's."""
    legs = max(4, round(fraction * min(picture.shape[:2])))
    ends = np.r_[:legs, -legs:0]
    corners = picture[np.ix_(ends, ends)].reshape(2, legs, 2, legs, -1)
    return corners.swapaxes(1, 2).reshape(4, legs**2, -1)


def _contrast(picture: SingleArray, patches: SingleArray, percentile: float) -> SingleArray:
    """Return the contrast (h, w) to the flat colours of two patches (m, n, c), or black.

    It is 0 within their noise, which a percentile of what is off the patch's colour tells.
    """
    colours = np.median(patches, axis=1)
    off = np.abs(patches - colours[:, None]).max(axis=-1)
    noise = 3 + 2 * np.percentile(off, percentile, axis=1).astype(np.float32)
    alike = np.abs(colours[:, None] - colours).max(axis=-1) <= noise[:, None]
    contrast = np.full(picture.shape[:2], 255, np.float32)
    for corner in np.flatnonzero(noise <= 23):
        first = alike[corner].argmax() == corner
        if first and (alike[corner].sum() > 1 or colours[corner].max() <= 8):
            apart = np.abs(picture - colours[corner]).max(axis=-1) - noise[corner]
            contrast = np.minimum(contrast, np.maximum(apart, 0))
    return contrast


def _disc(edge: ComplexArray, shape: tuple[int, ...]) -> BoolArray:
    """Return the disc through points, by least squares; the quarter that is off most does not count."""
    points = edge
    centre, radius = 0j, 0.0
    for _ in range(4 if len(edge) else 0):
        # |p|² = 2 c·p + r² - |c|².
        system = np.column_stack([2 * points.real, 2 * points.imag, np.ones(len(points))])
        x, y, rest = np.linalg.lstsq(system, np.abs(points) ** 2)[0]
        centre = x + 1j * y
        radius = np.sqrt(max(0.0, rest + np.abs(centre) ** 2))
        off = np.abs(np.abs(points - centre) - radius)
        points = points[off <= max(1.0, np.percentile(off, 75))]
    row, column = np.ogrid[: shape[0], : shape[1]]
    return np.asarray(np.abs(column + 1j * row - centre) <= radius)


def _contours(region: np.ndarray) -> Sequence[np.ndarray]:
    """Return the outer outlines of a region's parts, each (n, 1, 2), px."""
    return cv2.findContours(region, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]


def _measure_outline(outline: BoolArray, contrast: SingleArray, least: float) -> Field:
    """Return how much of an outline is at an edge."""
    contours = _contours(outline.astype(np.uint8)) or [np.zeros((1, 1, 2))]
    points = np.concatenate(contours)[:, 0] @ (1, 1j)
    along = np.roll(points, -4) - np.roll(points, 4)
    inwards = -1j * along / np.maximum(np.abs(along), 1)
    high, wide = outline.shape
    x, y = points.real, points.imag
    inner = (x > 1) & (y > 1) & (x < wide - 2) & (y < high - 2)
    px = np.arange(-RISE, 2 * RISE + 1)  # into the field
    at = (points[:, None] + px * inwards[:, None]).astype(np.complex64)
    profiles = np.asarray(cv2.remap(contrast, at.real, at.imag, cv2.INTER_LINEAR))
    before, after, soon, end, beyond = profiles[:, [8, 12, 15, 20, 30]].T
    edge = (
        inner
        & (before <= least + 1)
        & (after > least)
        & (soon > least + 5)
        & (end - before > 1.2 * (beyond - end))
    )
    share = edge.sum() / max(1, inner.sum())
    return Field(outline, points[edge], profiles[edge], float(share))
