"""Highlights: light that a wet film mirrors, found and filled in.

Mirrored light has the colour of the lamp, white, and lies in small patches on top of the tissue's
own colour. So a highlight is where two things are true at once, both told in linear light: the
pixel is whiter than the palest tissue around it, and brighter than its neighbourhood and than
what the slopes around it lead to. A near wall is bright but large, a fold's crest is narrow but
lies at the end of a slope or has the tissue's colour, and what lies between vessels is pale but
no paler than the tissue elsewhere.
"""

import cv2
import numpy as np
import scipy

from endolab.frames.frame import ROUNDING, power
from endolab.frames.surround import dilate, square
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.noise import noise_level
from endolab.numerics.stencils import links


def extend(image: FloatArray, mask: BoolArray) -> FloatArray:
    """Give every pixel outside the mask, which must not be empty, the value of the nearest one inside."""
    if mask.all():
        return image
    away = (~mask).astype(np.uint8)
    pixels = cv2.DIST_LABEL_PIXEL  # those inside are numbered from 1, row by row
    nearest = cv2.distanceTransformWithLabels(away, cv2.DIST_L2, 5, labelType=pixels)[1]
    return image[mask][nearest - 1]


def _palest_colour(light: np.ndarray, wide: float) -> FloatArray:
    """Colour of the palest quarter of the tissue around each pixel, over its red, (H, W, 3)."""
    from skimage.filters import rank

    high, across = light.shape[:2]
    step = max(1.0, wide / 80)
    size = max(1, round(across / step)), max(1, round(high / step))
    small = cv2.resize(light, size, interpolation=cv2.INTER_AREA)
    ratio = small / np.maximum(small[..., :1], 1e-4)
    levels = np.clip(200 * ratio + 0.5, 1, 255).astype(np.uint8)
    window = square(wide / step / 8)
    reach = len(window) // 2
    framed = cv2.copyMakeBorder(levels, reach, reach, reach, reach, cv2.BORDER_REPLICATE)
    planes = [rank.percentile(plane, window, p0=0.75) for plane in cv2.split(framed)]
    pale = cv2.merge(planes)[reach:-reach, reach:-reach] / 200
    return cv2.resize(pale, (across, high), interpolation=cv2.INTER_LINEAR)


def _white_part(
    light: FloatArray, colour: FloatArray, spread: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Split light into tissue's and white by least squares; the white part, and over its deviation.

    With u = colour/spread and v = 1/spread, v⊥ = v - u (u·v)/(u·u) is white that the tissue's colour is not;
    the white part is v⊥·l / v⊥·v⊥, of variance 1 / v⊥·v⊥.
    """
    own = colour / spread
    white = 1 / spread
    least = 1e-9 * np.vecdot(white, white)  # where the tissue itself is white
    white -= own * (np.vecdot(own, white) / np.vecdot(own, own))[..., None]
    squared = np.maximum(np.vecdot(white, white), least)
    part = np.vecdot(white, light / spread) / squared
    return part, part * np.sqrt(squared)


def _extrapolate(tissue: np.ndarray, step: int, steepest: float = 0.7) -> FloatArray:
    """Brightest value to which the tissue's slopes lead from eight sides.

    A change of log light over twice a highlight's width that is more than `steepest` is no slope.
    """
    log_tissue = np.log(np.maximum(tissue, 1e-4))
    brightest = log_tissue
    rows, columns = log_tissue.shape
    edge = 2 * step
    padded = np.pad(log_tissue, edge, mode="edge")
    for turn in np.arange(8) * np.pi / 4:
        direction = np.array([np.sin(turn), np.cos(turn)])
        near, far = np.rint(np.outer((step, edge), direction)).astype(int) + edge
        ahead = padded[near[0] :, near[1] :][:rows, :columns]
        beyond = padded[far[0] :, far[1] :][:rows, :columns]
        slope = np.clip(ahead - beyond, -steepest, steepest)
        brightest = np.maximum(brightest, ahead + slope)
    return np.exp(brightest)


def find_highlights(image: FloatArray, mask: BoolArray, gamma: float = 2.2) -> BoolArray:
    """Find mirrored light, by colour, local contrast and noise; with its skirts, and none outside the mask.

    The picture holds stored values in [0, 1] of R, G, B, white-balanced, so that the lamp is white. A grey
    one has contrast alone, and less is found in it. The mask is what the endoscope shows.

    Light is split into the palest tissue colour around and a white part; small highlights stand
    out from an opening of the light (Vincent's top-hat), from the values to which the slopes
    around lead, and from the noise. What is large, overexposed and smooth is a near wall, not a
    highlight: whoever solves the frame has to treat saturation by itself.
    """
    mirrored = np.zeros(mask.shape, dtype=bool)
    if not mask.any():
        return mirrored
    wide = float(np.ptp(np.nonzero(mask), axis=1).max() + 1)
    filled = extend(np.clip(np.nan_to_num(image), 0, 1), mask)
    light = power(filled, gamma)
    calm = cv2.medianBlur(light.astype(np.float32), 3)
    green = filled if image.ndim == 2 else filled[..., 1]
    noise = max(noise_level(green, mask), ROUNDING)
    # The derivative of I^γ, above the dark.
    spread = gamma * noise * np.maximum(light, 0.05**gamma) / np.maximum(filled, 0.05)
    white = certainty = np.full(mask.shape, np.inf)
    demand = 2.5  # without colour, which is half the evidence
    if image.ndim == 3:
        colour = _palest_colour(calm, wide)
        darkest = np.minimum.reduce(cv2.split(colour))
        if np.median(darkest[mask]) < 0.8:  # else tissue can't be told from lamps
            white, certainty = _white_part(light, colour, spread)
            demand = 1.0
        # Blue and green differ most between lamp and tissue; red may be saturated.
        light, calm = ((a[..., 1] + a[..., 2]) / 2 for a in (light, calm))
        spread = np.hypot(spread[..., 1], spread[..., 2]) / 2

    def evidence(base: np.ndarray, over: float, sigmas: float) -> BoolArray:
        excess = light - base
        stray = 0.02  # scatters into every pixel: in the dark, ratios say little
        much = np.minimum(excess, white) > demand * over * (base + stray)
        return mask & much & (np.minimum(excess / spread, certainty) > sigmas)

    # Half the width of most highlights and of the largest, as folds bulge at that scale;
    # mirrored light over the tissue's where one begins and where it ends.
    for reach, seed, skirt in ((wide / 100, 0.3, 0.12), (wide / 30, 1.5, 0.75)):
        opened = cv2.morphologyEx(calm, cv2.MORPH_OPEN, square(reach))
        opened = cv2.GaussianBlur(opened, (0, 0), max(0.25 * reach, 0.5))
        base = _extrapolate(opened, 2 * max(1, round(reach)))
        certain = evidence(base, seed, 4.0)
        skirts = [evidence(base, skirt, 2.0)]
        if seed < 1:  # a faint rim
            skirts += [dilate(certain, wide / 320) & evidence(opened, skirt, 2.0)]
        for faint in skirts:
            mirrored |= scipy.ndimage.binary_propagation(
                certain & faint, np.ones((3, 3)), faint
            )
    # Small holes are the highlights' own tops, where even white is clipped.
    closed = cv2.morphologyEx(mirrored.astype(np.uint8), cv2.MORPH_CLOSE, square(1))
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
    finite = np.where(np.isfinite(image), image, 0.0)
    log = np.log(np.maximum(extend(finite, known), 0.5 / 255)).reshape(holes.size, -1)
    axis, here = np.nonzero(links(mask).reshape(2, -1))
    there = here + np.array([1, holes.shape[1]])[axis]
    wanted = holes.ravel()
    pairs = np.stack([here, there])[:, wanted[here] | wanted[there]]
    graph = scipy.sparse.coo_array(
        (np.ones(pairs.shape[1]), tuple(pairs)), (holes.size, holes.size)
    )
    laplacian = scipy.sparse.csgraph.laplacian(graph, symmetrized=True).tocsr()[wanted]
    # A hint of the nearest value keeps a hole definite that the mask's rim cuts off on all sides.
    hint = 1e-9
    matrix = laplacian[:, wanted] + hint * scipy.sparse.eye_array(wanted.sum())
    around = laplacian[:, ~wanted] @ log[~wanted]
    # The matrix is symmetric: ordered for that, its factors stay thin.
    factors = scipy.sparse.linalg.splu(matrix.tocsc(), "MMD_AT_PLUS_A")
    filled = image.copy().reshape(holes.size, -1)
    solved = factors.solve(hint * log[wanted] - around)
    filled[wanted] = np.clip(np.exp(solved), 0.0, 1.0)
    return filled.reshape(image.shape)
