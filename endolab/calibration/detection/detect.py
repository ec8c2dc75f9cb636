"""Find a target's features in a picture, and which of them they are.

    dots      find_blobs -> find_lattices -> match_code -> grow -> check_places
    circles   find_blobs -> find_lattices -> outline of the grid -> check_places
    ChArUco   OpenCV's markers -> check_places -> _complete: corners that the others foretell
    squares   OpenCV's two searches -> refine -> _order_corners -> check_places, _alternates

All work from neighbour to neighbour in the picture (`lattice`), so that no camera is needed. From the
three places before it the next one is predicted, and among its neighbours each must fit:

    o   o   o   o   o
    o  p₃  p₂  p₁  (?)     p = p₁ + (p₁ - p₂) |p₁ - p₂| / |p₂ - p₃|, mean over the eight directions
    o   o   o   o   o      |p - q(row, column)| ≤ min(3 usual + slack, most_miss), q: a quadratic of
                           the places within two steps, on the same panel
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from endolab.calibration.detection.blobs import SPOTS, shrink_picture, white_of
from endolab.calibration.detection.dots import (
    Found,
    detect_circles,
    detect_dots,
    no_features,
)
from endolab.calibration.detection.lattice import (
    check_places,
    cross,
    predict,
    steps,
    windows,
)
from endolab.calibration.targets import Charuco, Chessboard, CircleGrid, DotGrid, Target
from endolab.numerics.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class CornerRules:
    """How large a picture is searched, and which corners are kept; chosen by hand."""

    smallest: int = 16  # px, side of a picture
    # px, Full HD; larger pictures are made half as large as this before anything is sought.
    most_pixels: int = 2_100_000
    # px; OpenCV's second search for a chessboard takes too long in larger pictures.
    most_quick_pixels: int = 400_000
    # px of the shorter side; smaller pictures are enlarged before corners are sought in them ...
    fine_side: int = 600
    longest_side: int = 2000  # ... until the longer side is as long as this
    least_corners: int = 6  # of a ChArUco board
    # Half the side of what a corner is refined by, as a share of the way to the next one.
    window: float = 0.45
    # Of the roughness of refined corners, below which those that were found are better.
    spoilt: float = 0.8
    # Contrast of corners and squares that are sought, relative to those that are known.
    least_contrast: float = 0.4
    # Of the refining: what ends it, steps and px.
    stop: tuple[int, int, float] = (
        cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER,
        40,
        0.001,
    )


CORNERS = CornerRules()


@dataclass(frozen=True)
class Detection:
    """Features of a target that were found in a picture."""

    ids: IntArray  # (n,), rows of `target.points`, ascending; each at most once
    pixels: FloatArray  # (n, 2), px: the centroid of the disc's image, or the corner
    reason: str = ""  # in a few words, why nothing was found, where n is 0


def detect(image: NDArray[Any], target: Target) -> Detection:
    """Find a target's features in a picture, (H, W) or (H, W, 3): float in [0, 1], uint8 or uint16.

    Neither a camera nor a guess is needed. Dots and circles are ordered by local prediction and dots named
    by their code; corners are found by OpenCV. Features that do not lie where their neighbours place them
    are left out. A chessboard, and an asymmetric grid with an even number of rows, may look the same when
    turned by 180°; their first row then runs to the right in the picture. A picture of dots or of a ChArUco
    board in a mirror is refused.
    """
    if type(target) not in SEARCHES:
        raise ValueError(f"target must be of a known kind, got {type(target).__name__}")
    grey = _grey(image)
    if min(grey.shape) < CORNERS.smallest:
        return Detection(
            *no_features(f"the picture is too small, {CORNERS.smallest} px are needed")
        )
    picture = grey
    if grey.size > CORNERS.most_pixels:
        picture = _shrink_to(grey, CORNERS.most_pixels // 2)
    try:
        ids, pixels, reason = SEARCHES[type(target)](picture, target)
    except cv2.error as error:
        return Detection(
            *no_features(
                f"OpenCV fails on this picture ({' '.join(str(error.err or error).split())})"
            )
        )
    return Detection(ids, _rescale(pixels, picture, grey), reason)


def _grey(image: NDArray[Any]) -> NDArray[Any]:
    """Average the colours, to float32 in [0, 1]."""
    image = np.asarray(image)
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
        raise ValueError(f"image must be of shape (H, W) or (H, W, 3), got {image.shape}")
    most = {"u1": 255, "u2": 65535, "f4": 1, "f8": 1}.get(image.dtype.str[1:])
    if most is None:
        raise ValueError(
            f"image must be uint8, uint16 or float in [0, 1], got {image.dtype}"
        )
    grey = image.astype(np.float32)
    if grey.ndim == 3:
        grey = np.asarray(
            cv2.transform(grey, np.full((1, 3), 1 / 3, np.float32)), dtype=np.float32
        )
    grey *= np.float32(1 / most)
    if not np.all(np.isfinite(grey)) or grey.min() < -0.01 or grey.max() > 1.01:
        raise ValueError("image must hold finite values in [0, 1] where it is float")
    return grey


def _shrink_to(picture: NDArray[Any], most: int) -> NDArray[Any]:
    """Average the pixels of a picture, (H, W), so that about `most` are left at most."""
    share = np.sqrt(most / picture.size)
    if share >= 1:
        return picture
    height, width = (max(int(share * side), 1) for side in picture.shape)
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)


def _enlarge(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Enlarge a picture, (H, W), that is small or narrow."""
    enough = CORNERS.fine_side / min(picture.shape)
    most = CORNERS.longest_side / max(picture.shape)
    scale = round(min(enough, most))
    if scale <= 1:
        return picture
    size = (scale * picture.shape[1], scale * picture.shape[0])
    return np.asarray(
        cv2.resize(picture, size, interpolation=cv2.INTER_CUBIC), dtype=np.uint8
    )


def _rescale(pixels: FloatArray, from_: NDArray[Any], to: NDArray[Any]) -> FloatArray:
    """Where places (..., 2), px, of a picture are in another one of the same scene and another size."""
    return (pixels + 0.5) * np.divide(to.shape[::-1], from_.shape[::-1]) - 0.5


def _even_paper(grey: FloatArray) -> NDArray[np.uint8]:
    """Make the paper equally white everywhere, which OpenCV's detectors of chessboards need."""
    white = cv2.resize(white_of(shrink_picture(grey)), grey.shape[::-1])
    level = grey / np.maximum(white, SPOTS.least_white)
    return np.asarray(cv2.convertScaleAbs(level, alpha=220), dtype=np.uint8)


def _detect_charuco(grey: FloatArray, target: Charuco) -> Found:
    """Find the corners of a ChArUco board: those beside markers, then those that these foretell."""
    options = cv2.aruco.CharucoParameters()
    # Next to a corner; a corner that is wrong for it is left out below.
    options.minMarkers = 1
    picture = _enlarge(_even_paper(grey))
    # Small markers are read where they are sharpened; corners are measured where they are not.
    sharp = cv2.addWeighted(picture, 2.5, cv2.GaussianBlur(picture, (0, 0), 3), -1.5, 0)
    corners, ids, _, markers = cv2.aruco.CharucoDetector(target.board, options).detectBoard(
        sharp
    )
    count = 0 if markers is None else len(markers)
    grid = np.full((target.rows - 1, target.columns - 1, 2), np.nan)
    if ids is not None:
        grid.reshape(-1, 2)[ids.ravel()] = corners.reshape(-1, 2)
    panel = target.panel_of(target.points).reshape(grid.shape[:2])
    for step in range(4):  # what is left out hides others at first
        fits, _ = check_places(grid, panel, least=4 if step < 2 else 6)
        grid[~fits] = np.nan
        if step == 1:
            grid = _complete(grid, picture, (1 - target.marker / target.spacing) / 2)
    kept = np.flatnonzero(fits)
    if len(kept) < CORNERS.least_corners:
        read = f"{count} of the board's {len(target.board.getIds())} markers can be read"
        return no_features(
            f"{read}, {len(kept)} corners agree, {CORNERS.least_corners} are needed"
        )
    return kept, _rescale(grid.reshape(-1, 2)[kept], picture, grey), ""


def _complete(grid: FloatArray, picture: NDArray[np.uint8], border: float) -> FloatArray:
    """Refine the corners of a ChArUco board, and find others where their neighbours place them.

    `grid`, (h, w, 2), px, is nan where none is known; `border` is the white around a marker, in steps.
    """
    row, column = np.nonzero(np.isfinite(grid[..., 0]))
    guess, (along, down) = grid[row, column], (step[row, column] for step in steps(grid))
    grid = np.full_like(grid, np.nan)
    usual = -np.inf
    for _ in range(sum(grid.shape)):
        size = np.minimum(np.hypot(*along.T), np.hypot(*down.T))
        inside = np.all((guess > 3) & (guess < np.array(picture.shape[::-1]) - 4), axis=1)
        tried = np.flatnonzero(inside & np.isfinite(size))
        corner = guess.copy()
        for n in tried:
            half = max(round(border * size[n]), 2)
            place = guess[n].astype(np.float32)[None]
            corner[n] = cv2.cornerSubPix(
                picture, place, (half, half), (-1, -1), CORNERS.stop
            )[0]
        # Of the four squares around a corner, the upper left one is black where row and column are even.
        aside = [corner + border / 2 * (sign * along + down) for sign in (1, -1)]
        aside += [corner - border / 2 * (sign * along + down) for sign in (1, -1)]
        a, b, c, d = (
            scipy.ndimage.map_coordinates(picture, place.T[::-1], float, 1, mode="nearest")
            for place in aside
        )
        contrast = (b + d - a - c) * (-1.0) ** (row + column)
        if usual < 0:
            usual = float(np.median(contrast[tried])) if len(tried) else 0.0
        tried = tried[contrast[tried] > CORNERS.least_contrast * usual]
        tried = tried[np.hypot(*(corner - guess)[tried].T) < border * size[tried]]
        if not len(tried):
            break
        grid[row[tried], column[tried]] = corner[tried]
        row, column = np.nonzero(np.isnan(grid[..., 0]))
        if not len(row):
            break
        guess, along, down = predict(windows(grid, row, column))
    return grid


def _detect_chessboard(grey: FloatArray, target: Chessboard) -> Found:
    """Find the inner corners of a chessboard; all of them or none."""
    picture = _enlarge(_even_paper(grey))
    pattern = (target.columns - 1, target.rows - 1)
    # The two find about as many, but not the same; the first says no more quickly.
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    sharp, corners = cv2.findChessboardCornersSB(picture, pattern, flags=flags)
    is_there = sharp
    if not is_there:
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ADAPTIVE_THRESH
        small = _shrink_to(picture, CORNERS.most_quick_pixels)
        is_there, corners = cv2.findChessboardCorners(small, pattern, flags=flags)
    if not is_there:
        return no_features("no chessboard of this size, or not all of it is in view")
    if not sharp:
        corners = _rescale(np.asarray(corners, dtype=np.float64), small, picture).astype(
            np.float32
        )
    along, down = steps(corners.reshape(pattern[1], pattern[0], 2).astype(np.float64))
    shortest = min(np.hypot(step[..., 0], step[..., 1]).min() for step in (along, down))
    half = max(int(CORNERS.window * shortest), 2)
    refined = cv2.cornerSubPix(
        picture, corners.copy(), (half, half), (-1, -1), CORNERS.stop
    )
    grid, given = (
        corner.reshape(pattern[1], pattern[0], 2).astype(np.float64)
        for corner in (refined, corners)
    )
    # Refining is better on most pictures, and spoils corners where a camera has sharpened and enlarged them.
    if sharp and _roughness(given) < CORNERS.spoilt * _roughness(grid):
        grid = given
    grid = _order_corners(_rescale(grid, picture, grey), grey)
    fits, _ = check_places(grid, np.zeros(grid.shape[:2], int))
    if fits.mean() < 0.9:
        return no_features("the corners do not lie on a smooth sheet")
    if not _alternates(grid, grey):
        return no_features("the chessboard has other squares than the target says")
    ids = np.flatnonzero(fits)
    return ids, grid.reshape(-1, 2)[ids], ""


def _alternates(grid: FloatArray, grey: FloatArray) -> bool:
    """Whether the squares of a chessboard are black and white by turns, and none beyond its rim are."""
    (left, top), (right, bottom) = (
        pick(grid.reshape(-1, 2), axis=0).astype(int) for pick in (np.min, np.max)
    )
    if (
        abs(_darkness(grid, grey))
        < CORNERS.least_contrast * grey[top:bottom, left:right].std()
    ):
        return False
    for quarters in range(4):
        side = np.rot90(grid, quarters)
        # The first row of squares between corners, and that of the same colours beyond the board; second
        # differences, as light may fall off along both.
        rows = side[:2], 3 * side[:2] - 2 * side[1:3]
        inner, beyond = (np.diff(_squares(row, grey)[0], 2) for row in rows)
        if beyond @ inner > CORNERS.least_contrast * (inner @ inner) > 0:
            return False
    return True


def _roughness(grid: FloatArray) -> float:
    """How far corners lie from a smooth sheet, a cubic of row and column: root mean square, px."""
    row, column = (np.linspace(-1, 1, n) for n in grid.shape[:2])
    terms = np.polynomial.polynomial.polyvander2d(
        *np.meshgrid(row, column, indexing="ij"), [3, 3]
    )
    terms = terms.reshape(-1, 16)
    left = (
        grid.reshape(-1, 2)
        - terms @ np.linalg.lstsq(terms, grid.reshape(-1, 2), rcond=None)[0]
    )
    return float(np.sqrt(np.mean(left**2)))


def _order_corners(grid: FloatArray, grey: FloatArray) -> FloatArray:
    """Turn a grid of corners so that it is not mirrored and the first square is black."""
    if np.median(cross(*steps(grid))) < 0:
        grid = grid[:, ::-1]
    turned = grid[::-1, ::-1]
    dark = _darkness(grid, grey)
    dark_turned = _darkness(turned, grey)
    rows, columns = grid.shape[:2]
    if (rows + columns) % 2 and dark != dark_turned:  # the two ends differ in colour
        return grid if dark > dark_turned else turned
    return grid if np.median(np.diff(grid[..., 0], axis=1)) >= 0 else turned


def _darkness(grid: FloatArray, grey: FloatArray) -> float:
    """How much darker the squares are that ought to be black."""
    value = _squares(grid, grey)
    row, column = np.indices(value.shape)
    black = (row + column) % 2 == 0
    return float(value[~black].mean() - value[black].mean())


def _squares(grid: FloatArray, grey: FloatArray) -> FloatArray:
    """Grey values in the middle of the squares between corners; 0 beside the picture."""
    middle = (grid[1:, 1:] + grid[1:, :-1] + grid[:-1, 1:] + grid[:-1, :-1]) / 4
    return np.asarray(
        scipy.ndimage.map_coordinates(grey, [middle[..., 1], middle[..., 0]], order=1)
    )


SEARCHES: dict[type[Target], Callable[..., Found]] = {
    DotGrid: detect_dots,
    CircleGrid: detect_circles,
    Charuco: _detect_charuco,
    Chessboard: _detect_chessboard,
}
