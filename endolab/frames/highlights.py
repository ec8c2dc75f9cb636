"""Highlights: light that a wet film mirrors, found and filled in.

Mirrored light has the colour of the lamp, white, and lies in small patches on top of the tissue's
own colour. So a highlight is where two things are true at once, both told in linear light: the
pixel is whiter than the palest tissue around it, and brighter than its neighbourhood and than
what the slopes around it lead to. A near wall is bright but large, a fold's crest is narrow but
lies at the end of a slope or has the tissue's colour, and what lies between vessels is pale but
no paler than the tissue elsewhere.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import scipy

from endolab.frames.frame import FRAME_LIMITS, power
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.noise import noise_level
from endolab.numerics.side_by_side import by_rows


@dataclass(frozen=True)
class HighlightSearch:
    """What a highlight looks like.

    Sizes are shares of the longer side of what is shown, amounts are mirrored light over the tissue's.
    """

    small: float = 1 / 100  # half the width of most highlights
    large: float = 1 / 30  # half the width of the largest
    # Half the neighbourhood whose palest quarter is the tissue's colour.
    around: float = 1 / 8
    # Pixels across what the endoscope shows, at which that colour is sought.
    coarse: int = 80
    colour_steps: int = 200  # of a colour over red, in one
    skirt_width: float = 1 / 320  # a highlight's faint rim
    seed: float = 0.3  # where a small highlight begins
    skirt: float = 0.12  # where it ends
    large_seed: float = 1.5  # the same of large ones, as folds bulge at that scale
    large_skirt: float = 0.75
    # Seeds must be brighter by this factor without colour, which is half the evidence.
    grey: float = 2.5
    sure: float = 4.0  # of seeds, standard deviations of the noise
    likely: float = 2.0  # of skirts, likewise
    # Change of log light over twice a highlight's width that still counts as a slope.
    steepest: float = 0.7
    # Green or blue over red, from which on tissue can't be told from lamps.
    colourless: float = 0.8
    # Linear light that scatters into every pixel: in the dark, ratios say little.
    stray: float = 0.02


HIGHLIGHT_SEARCH = HighlightSearch()


def _odd(size: float) -> int:
    """Return the width of a window that reaches as far as this to either side, at least 1 px."""
    return 2 * max(1, round(size)) + 1


def extend(image: FloatArray, mask: BoolArray) -> FloatArray:
    """Give every pixel outside the mask, which must not be empty, the value of the nearest one inside."""
    if mask.all():
        return image
    away = (~mask).astype(np.uint8)
    labels = cv2.distanceTransformWithLabels(
        away, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )[1]
    index = np.zeros(labels.max() + 1, np.intp)
    index[labels[mask]] = np.flatnonzero(mask)
    out = image.copy()
    out[~mask] = image.reshape(mask.size, *image.shape[2:])[index[labels[~mask]]]
    return out


def _palest_colour(light: FloatArray, wide: float) -> FloatArray:
    """Colour of the palest quarter of the tissue around each pixel, over its red, (H, W, 3)."""
    from skimage.filters import rank

    high, across = light.shape[:2]
    step = max(1.0, wide / HIGHLIGHT_SEARCH.coarse)
    size = (max(1, round(across / step)), max(1, round(high / step)))
    small = cv2.resize(light, size, interpolation=cv2.INTER_AREA)
    ratio = small / np.maximum(small[..., :1], 1e-4)
    width = _odd(HIGHLIGHT_SEARCH.around * wide / step)
    window = np.ones((width, width), np.uint8)
    reach = width // 2
    levels = np.clip(HIGHLIGHT_SEARCH.colour_steps * ratio + 0.5, 0, 255).astype(np.uint8)
    framed = cv2.copyMakeBorder(levels, reach, reach, reach, reach, cv2.BORDER_REPLICATE)
    pale = np.stack(
        [rank.percentile(plane, window, p0=0.75) for plane in cv2.split(framed)], axis=-1
    )
    pale = pale[reach:-reach, reach:-reach] / HIGHLIGHT_SEARCH.colour_steps
    return np.asarray(
        cv2.resize(pale, (across, high), interpolation=cv2.INTER_LINEAR), dtype=np.float64
    )


def _sum_colours(image: FloatArray) -> FloatArray:
    """Sum over the colours of a picture, (H, W, 3); NumPy's own takes several times as long for three."""
    return image[..., 0] + image[..., 1] + image[..., 2]


def _white_part(
    light: FloatArray, colour: FloatArray, spread: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Split light into tissue's and white by least squares; the white part and its standard deviation."""
    white, deviation = np.empty((2, *light.shape[:2]))

    def split(rows: slice) -> None:
        own = colour[rows]
        weight = 1 / spread[rows] ** 2
        weighted = weight * own
        aa = _sum_colours(weighted * own)
        ab = _sum_colours(weighted)
        bb = _sum_colours(weight)
        a = _sum_colours(weighted * light[rows])
        b = _sum_colours(weight * light[rows])
        aa += 1e-12 * bb  # a picture may be all black
        # 0 where the tissue itself is white.
        determinant = np.maximum(aa * bb - ab**2, 1e-9 * aa * bb)
        white[rows] = (aa * b - ab * a) / determinant
        deviation[rows] = np.sqrt(aa / determinant)

    by_rows(split, light.shape)
    return white, deviation


def _extrapolate(tissue: FloatArray, step: int) -> FloatArray:
    """Brightest value to which the tissue's slopes lead from eight sides."""
    log_tissue = np.log(np.maximum(tissue, 1e-4)).astype(np.float32)
    edge, (rows, columns) = 2 * step, log_tissue.shape
    padded = cv2.copyMakeBorder(log_tissue, edge, edge, edge, edge, cv2.BORDER_REPLICATE)

    def window_at(reach: int, turn: float) -> Any:
        down = edge + round(reach * np.sin(turn))
        across = edge + round(reach * np.cos(turn))
        return padded[down : down + rows, across : across + columns]

    steepest = HIGHLIGHT_SEARCH.steepest
    for turn in np.arange(8) * np.pi / 4:
        ahead = window_at(step, turn)
        slope = np.clip(ahead - window_at(edge, turn), -steepest, steepest)
        np.maximum(log_tissue, ahead + slope, out=log_tissue)
    return np.exp(log_tissue.astype(np.float64))


def dilate(region: BoolArray, reach: float) -> BoolArray:
    """Grow a region by a square, to every side by `reach` px, at least 1."""
    return cv2.dilate(region.astype(np.uint8), np.ones((_odd(reach),) * 2, np.uint8)) > 0


def _parts_with_seed(seed: BoolArray, skirt: BoolArray) -> BoolArray:
    """Return the connected parts of the skirt that hold a seed."""
    return scipy.ndimage.binary_propagation(seed & skirt, np.ones((3, 3)), skirt)


def find_highlights(image: FloatArray, mask: BoolArray, gamma: float = 2.2) -> BoolArray:
    """Find mirrored light, by colour, local contrast and noise; with its skirts, and none outside the mask.

    The picture holds stored values in [0, 1] of R, G, B, white-balanced, so that the lamp is white. A grey
    one has contrast alone, and less is found in it. The mask is what the endoscope shows.

    Light is split into the palest tissue colour around and a white part; small highlights stand
    out from an opening of the light (Vincent's top-hat), from the values to which the slopes
    around lead, and from the noise. What is large, overexposed and smooth is a near wall, not a
    highlight: whoever solves the frame has to treat saturation by itself.
    """
    if not mask.any():
        return np.zeros(mask.shape, dtype=bool)
    wide = float(np.ptp(np.nonzero(mask), axis=1).max() + 1)
    filled = extend(np.clip(np.nan_to_num(image), 0, 1), mask)
    light = power(filled, gamma)
    calm = cv2.medianBlur(light.astype(np.float32), 3)
    noise = max(
        noise_level(filled if filled.ndim == 2 else filled[..., 1], mask),
        FRAME_LIMITS.rounding,
    )
    spread = gamma * power(np.maximum(filled, 0.05), gamma - 1) * noise
    white = np.full(mask.shape, np.inf)
    doubt = np.ones(mask.shape)
    coloured = False
    if image.ndim == 3:
        colour = _palest_colour(calm.astype(np.float64), wide)
        darkest = np.minimum.reduce([colour[..., index] for index in range(3)])
        coloured = np.median(darkest[mask]) < HIGHLIGHT_SEARCH.colourless
        if coloured:
            white, doubt = _white_part(light, colour, spread)
        # Blue and green differ most between lamp and tissue; red may be saturated.
        light, calm = ((a[..., 1] + a[..., 2]) / 2 for a in (light, calm))
        spread = np.sqrt((spread[..., 1] ** 2 + spread[..., 2] ** 2) / 2 / 2)

    def evidence(base: FloatArray, over: float, sigmas: float) -> BoolArray:
        excess = light - base
        much = np.minimum(excess, white) > over * (base + HIGHLIGHT_SEARCH.stray)
        return mask & much & (np.minimum(excess / spread, white / doubt) > sigmas)

    mirrored = np.zeros(mask.shape, dtype=bool)
    demand = 1.0 if coloured else HIGHLIGHT_SEARCH.grey
    for reach, seed, skirt in (
        (HIGHLIGHT_SEARCH.small, HIGHLIGHT_SEARCH.seed, HIGHLIGHT_SEARCH.skirt),
        (HIGHLIGHT_SEARCH.large, HIGHLIGHT_SEARCH.large_seed, HIGHLIGHT_SEARCH.large_skirt),
    ):
        lowest = cv2.morphologyEx(
            calm, cv2.MORPH_OPEN, np.ones((_odd(reach * wide),) * 2, np.uint8)
        )
        lowest = cv2.GaussianBlur(lowest, (0, 0), max(0.25 * reach * wide, 0.5))
        opened = np.asarray(lowest, dtype=np.float64)
        base = _extrapolate(opened, 2 * max(1, round(reach * wide)))
        certain = evidence(base, demand * seed, HIGHLIGHT_SEARCH.sure)
        mirrored |= _parts_with_seed(
            certain, evidence(base, demand * skirt, HIGHLIGHT_SEARCH.likely)
        )
        if reach == HIGHLIGHT_SEARCH.small:
            around = dilate(certain, HIGHLIGHT_SEARCH.skirt_width * wide)
            mirrored |= _parts_with_seed(
                certain, around & evidence(opened, demand * skirt, HIGHLIGHT_SEARCH.likely)
            )
    # Small holes are the highlights' own tops, where even white is clipped.
    square = np.ones((3, 3), np.uint8)
    closed = cv2.morphologyEx(mirrored.astype(np.uint8), cv2.MORPH_CLOSE, square)
    return (closed > 0) & mask


def inpaint(image: FloatArray, holes: BoolArray, mask: BoolArray) -> FloatArray:
    """Fill holes in stored values smoothly from what surrounds them.

    Only pixels of the mask are used or filled: black around the endoscope's picture must
    not leak in. Within the holes the logarithm of light is harmonic: it has no peak or pit of its own, so
    nothing rings, and no response exponent is needed, as log I^γ = γ log I.
    """
    holes = holes & mask
    if not holes.any():
        return image.copy()
    known = mask & ~holes
    if not known.any():
        raise ValueError("the whole picture is a hole, there is nothing to fill it from")
    log = np.log(
        np.maximum(extend(np.where(np.isfinite(image), image, 0.0), known), 0.5 / 255)
    )
    number = np.arange(holes.size).reshape(holes.shape)
    shown = mask.ravel()
    wanted = holes.ravel()
    here = np.concatenate([number[:, :-1].ravel(), number[:-1].ravel()])
    there = np.concatenate([number[:, 1:].ravel(), number[1:].ravel()])
    pairs = shown[here] & shown[there] & (wanted[here] | wanted[there])
    here = here[pairs]
    there = there[pairs]
    step = np.arange(here.size)
    one = np.ones(here.size)
    size = (here.size, holes.size)
    differences = scipy.sparse.coo_array((one, (step, here)), size).tocsc()
    differences -= scipy.sparse.coo_array((one, (step, there)), size).tocsc()
    # A hint of the nearest value keeps a hole definite that the mask's rim cuts off on all sides.
    hint = 1e-9
    inner = differences[:, wanted]
    log = log.reshape(holes.size, -1)
    matrix = inner.T @ inner + hint * scipy.sparse.eye_array(inner.shape[1], format="csc")
    right = hint * log[wanted] - inner.T @ (
        differences @ np.where(wanted[:, None], 0.0, log)
    )
    # The matrix is symmetric: ordered for that, its factors stay thin.
    factors = scipy.sparse.linalg.splu(matrix.tocsc(), "MMD_AT_PLUS_A")
    filled = image.copy().reshape(holes.size, -1)
    filled[wanted] = np.clip(np.exp(factors.solve(right)), 0.0, 1.0)
    return filled.reshape(image.shape)
