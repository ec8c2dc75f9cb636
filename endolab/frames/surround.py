"""What an endoscope shows, told from the flat surround that fills corners of the picture.

What differs from the corners' colours is the field, but for text and boxes, and but for walls that are as
dark as the surround. So several outlines are tried: the convex hull of what differs, the box and the disc
around it, and what one, two or three of its four mirror images share, which completes a dark side from the
other and drops a box over the edge. Across each point of an outline runs a profile of the contrast to the
surround; at a field's edge it rises within RISE px and little after, while shading goes on rising:

    contrast           .----------
                      /
    surround ________/   |       |
               -RISE   0 RISE   2 RISE    px into the field

So of the contrast c(s), s px into the field, a point is at an edge if

    c(-RISE/5) is the surround's,  c(RISE/5) is more,  c(RISE/2) is more by `step`, and
    c(RISE) - c(-RISE/5) > shading · (c(2 RISE) - c(RISE)).

The outline with most points at an edge counts. If too small a share of its points is, there is no surround.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from endolab.numerics.arrays import BoolArray, FloatArray, SingleArray


@dataclass(frozen=True)
class SurroundSearch:
    """What a surround and the edge of a field look like.

    Grey levels are of 255; px are of what is looked at, `side` px along its longer side.
    """

    side: int = 480  # px of the longer side, of what is looked at
    # Px of the longer side of a picture; in smaller ones each pixel has edges.
    smallest: int = 60
    # px of the picture that are left out along an edge at least, since lenses and codecs
    # blur it.
    margin: int = 2
    # Of the shorter side, the legs of the triangle in a corner that tells a colour.
    corner: float = 0.03
    # Of the shorter side, the width of what is no part of a field, such as text.
    stub: float = 0.15
    small: float = 0.1  # of the picture, below which nothing is a field
    rounding: float = 3.0  # grey levels from the surround's colour that tell nothing
    black: int = 8  # grey levels; a single corner as dark as this may be of a surround
    uneven: int = 10  # grey levels of spread in a corner that is no surround
    # Of the usual contrast, what may be stray light around the field.
    glow: tuple[float, float, float] = (0.0, 0.1, 0.25)
    step: int = 5  # grey levels that an edge rises in RISE / 2
    # An edge rises more than so many times what shading adds from there on.
    shading: float = 1.2
    # Of a mask that lies in what may be a surround, from which on it is worth a word.
    named: float = 0.02
    # Share of an outline that is at an edge, if it is a field's.
    possible: float = 0.52
    likely: float = 0.55
    sure: float = 0.8


SURROUND = SurroundSearch()


RISE = 10  # px of what is looked at, within which an edge rises


class Field(NamedTuple):
    """What an endoscope may show."""

    inside: BoolArray  # (h, w)
    edge: SingleArray  # (n, 2), the points of its outline that are at an edge, px
    share: float  # of the outline that is at an edge; the picture's border is no outline
    width: float  # of the edge within the outline, px


def field_of_view(image: FloatArray, least: float = SURROUND.likely) -> BoolArray:
    """Find what an endoscope shows: all but the flat surround that fills corners of the picture.

    `image` is (H, W) or (H, W, 3), in [0, 1]; colours tell more. The surround may be of any colour, with
    noise, and hold text and boxes. `least` is the share of the field's outline that must be at an edge.
    All True if there is no such field. Else narrower than what is shown by the width of its edge, two
    pixels at least.
    """
    high, wide = image.shape[:2]
    scale = max(high, wide) / SURROUND.side
    field = _find_field(image)
    if field is None or field.share < least:
        return np.ones((high, wide), dtype=bool)
    inside = cv2.distanceTransform(
        field.inside.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE
    )
    depth = cv2.resize(inside - field.width, (wide, high), interpolation=cv2.INTER_LINEAR)
    shown = depth * scale > SURROUND.margin
    box = np.ix_(shown.any(axis=1), shown.any(axis=0))
    if shown[box].all():  # bars, which may frame a surround of another colour
        shown[box] = field_of_view(image[box], SURROUND.sure)
    return shown


def unclear_surround(image: FloatArray, mask: BoolArray) -> bool:
    """Whether a mask keeps what may be a surround."""
    field = _find_field(image)
    if field is None or field.share < SURROUND.possible:
        return False
    inside = (
        cv2.resize(
            field.inside.astype(np.uint8), mask.shape[::-1], interpolation=cv2.INTER_NEAREST
        )
        > 0
    )
    return bool((mask & ~inside).sum() > SURROUND.named * mask.sum())


def _scale_down(image: FloatArray) -> SingleArray:
    """Return a picture (h, w, channels) of `side` px, grey levels; a median takes noise and keeps edges."""
    high, wide = image.shape[:2]
    size = [
        max(1, round(length * SURROUND.side / max(high, wide))) for length in (wide, high)
    ]
    scaled = cv2.resize(
        cv2.convertScaleAbs(image, alpha=255), size, interpolation=cv2.INTER_AREA
    )
    return np.atleast_3d(cv2.medianBlur(scaled, 5)).astype(np.float32)


def _find_field(image: FloatArray) -> Field | None:
    """Return the largest of the outlines that explain most of the edge, None if nothing has an edge."""
    if max(image.shape[:2]) < SURROUND.smallest:
        return None
    contrast = _contrast(_scale_down(image))
    differs = contrast[contrast > 0]
    fields: list[Field] = []
    for glow in SURROUND.glow:
        least = glow * float(np.median(differs)) if differs.size else 0.0
        fields += _try_outlines(contrast, least)
        if any(field.share > SURROUND.sure for field in fields):
            break
    most = max((len(field.edge) for field in fields), default=0)
    best = [field for field in fields if len(field.edge) > max(0.97 * most, 10 * RISE)]
    return max(best, key=lambda field: int(field.inside.sum()), default=None)


def _contrast(picture: SingleArray) -> SingleArray:
    """Return the contrast (h, w) to the flat colours of two corners, or black; 0 within their noise."""
    shorter = min(picture.shape[:2])
    legs = max(4, round(SURROUND.corner * shorter))
    contrast = np.full(picture.shape[:2], 255, np.float32)
    if shorter < 2 * legs:
        return contrast
    triangle = np.add.outer(np.arange(legs), np.arange(legs)) < legs
    corners = [
        picture[::down, ::across][:legs, :legs][triangle]
        for down in (1, -1)
        for across in (1, -1)
    ]
    colours = np.median(corners, axis=1)
    spread = np.percentile(np.abs(corners - colours[:, None]).max(axis=-1), 90, axis=1)
    noise = SURROUND.rounding + 2 * spread
    even = spread <= SURROUND.uneven
    apart = np.abs(colours[:, None] - colours).max(axis=-1)
    alike = even & (apart <= np.maximum(noise[:, None], noise))
    for corner in np.flatnonzero(even):
        first = alike[corner].argmax() == corner
        if first and (alike[corner].sum() > 1 or colours[corner].max() <= SURROUND.black):
            planes = np.abs(
                np.moveaxis(picture, -1, 0)
                - colours[corner, :, None, None].astype(np.float32)
            )
            contrast = np.minimum(
                contrast, np.maximum(planes.max(axis=0) - np.float32(noise[corner]), 0)
            )
    return contrast


def _try_outlines(contrast: SingleArray, least: float) -> Iterator[Field]:
    """Yield what may be the field in a surround that has no more contrast than `least`."""
    hull = _hull(contrast > least)
    if (
        hull.sum() < SURROUND.small * hull.size
        or hull.all()
        or not hull[hull.shape[0] // 2, hull.shape[1] // 2]
    ):
        return
    first = _measure_outline(hull, contrast, least)
    yield first
    outlines = [_disc(first.edge, hull.shape)]
    box = np.ix_(hull.any(axis=1), hull.any(axis=0))
    for window, shares in ((box, (0, 2, 3)), ((slice(None), slice(None)), (1, 2, 3))):
        part = hull[window].astype(int)
        images = part + part[::-1] + part[:, ::-1] + part[::-1, ::-1]
        for share in shares:
            outline = np.zeros_like(hull)
            outline[window] = images >= share
            outlines.append(outline)
    yield from (
        _measure_outline(outline, contrast, least)
        for outline in outlines
        if not outline.all()
    )


def _hull(differs: BoolArray) -> BoolArray:
    """Return the convex hull of a region that is surrounded, without text and other narrow parts."""
    region = np.pad((~differs).astype(np.uint8), 1, constant_values=1)
    cv2.floodFill(region, None, (0, 0), 2)
    square = np.ones((2 * round(SURROUND.stub / 2 * min(differs.shape)) + 1,) * 2, np.uint8)
    body = cv2.morphologyEx((region != 2).astype(np.uint8), cv2.MORPH_OPEN, square)[
        1:-1, 1:-1
    ]
    contours = cv2.findContours(body, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    if contours:
        corners = cv2.convexHull(np.concatenate(contours)).astype(np.float64)
        # No edge is halfway between pixels, so that.
        corners += 1e-3 * (corners - corners.mean(axis=0))
        # Mirror images agree.
        cv2.fillConvexPoly(body, np.round(256 * corners).astype(np.int32), 1, shift=8)
    return body > 0


def _disc(edge: SingleArray, shape: tuple[int, ...]) -> BoolArray:
    """Return the disc through points, by least squares; the quarter that is off most does not count."""
    points = edge.astype(np.float64)
    radius = 0.0
    centre = [0.0, 0.0]
    for _ in range(4):
        if len(points) >= 2 * RISE:
            # |p|² = 2 c·p + r² - |c|².
            system = np.column_stack([2 * points, np.ones(len(points))])
            *centre, rest = np.linalg.lstsq(system, (points**2).sum(axis=-1))[0]
            radius = np.sqrt(max(rest + np.dot(centre, centre), 0.0))
            off = np.abs(np.linalg.norm(points - centre, axis=-1) - radius)
            points = points[off <= max(1.0, np.percentile(off, 75))]
    row, column = np.ogrid[: shape[0], : shape[1]]
    return np.asarray(np.hypot(row - centre[1], column - centre[0]) <= radius + 0.3)


def _measure_outline(outline: BoolArray, contrast: SingleArray, least: float) -> Field:
    """Return how much of an outline is at an edge."""
    contours = cv2.findContours(
        outline.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )[0]
    points = np.concatenate([*contours, np.zeros((0, 1, 2))])[:, 0].astype(np.float32)
    along = np.roll(points, -4, axis=0) - np.roll(points, 4, axis=0)
    inwards = (
        along[:, ::-1]
        * (1, -1)
        / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1)
    )
    inner = ((points > 1) & (points < np.array(outline.shape[::-1]) - 2)).all(axis=-1)
    if not inner.any():
        return Field(outline, points[:0], 0.0, 0.0)
    at = (
        points[inner, None] + inwards[inner, None] * np.arange(-RISE, 2 * RISE + 1)[:, None]
    )
    x, y = np.moveaxis(at.astype(np.float32), -1, 0)
    profiles = np.asarray(cv2.remap(contrast, x, y, cv2.INTER_LINEAR))
    before, after, soon, end, beyond = profiles[
        :, RISE * np.array([8, 12, 15, 20, 30]) // 10
    ].T
    starts = (before <= least + 1) & (after > least)
    edge = (
        starts
        & (soon > least + SURROUND.step)
        & (end - before > SURROUND.shading * (beyond - end))
    )
    if not edge.any():
        return Field(outline, points[:0], 0.0, 0.0)
    profile = np.median(profiles[edge], axis=0)[RISE:]
    top = profile[RISE] - max(0.0, profile[2 * RISE] - profile[RISE])  # without shading
    # The edge's half height lies just before.
    half = int((profile > (profile[0] + top) / 2).argmax())
    slope = np.append(np.diff(profile), 0)
    steepest = int(slope.argmax())
    flat = steepest + int((slope[steepest:] < slope[steepest] / 2).argmax())
    return Field(
        outline, points[inner][edge], float(edge.mean()), max(0, min(2 * half - 1, flat))
    )
