"""Find a target's features in a picture, and which of them they are.

    dots      find_blobs -> find_lattices -> match_code -> grow -> check_places
    ChArUco   OpenCV's markers -> check_places -> _complete: corners that the others foretell
    squares   OpenCV's two searches -> refine -> _order_corners -> check_places

All work from neighbour to neighbour in the picture (`lattice`), so that no camera is needed. From the
three places before it the next one is predicted, and among its neighbours each must fit:

    o   o   o   o   o
    o  p₃  p₂  p₁  (?)     p = p₁ + (p₁ - p₂) |p₁ - p₂| / |p₂ - p₃|, mean over the eight directions
    o   o   o   o   o      |p - q(row, column)| ≤ min(3 usual + slack, most_miss), q: a quadratic of
                           the places within two steps, on the same panel
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
import scipy

from endolab.calibration.detection.blobs import (
    LEAST_WHITE,
    Numbers,
    shrink_picture,
    white_of,
)
from endolab.calibration.detection.dots import Found, detect_dots, no_features
from endolab.calibration.detection.lattice import (
    check_places,
    cross,
    predict,
    steps,
    windows,
)
from endolab.calibration.targets import Charuco, Chessboard, DotGrid, Target
from endolab.numerics.arrays import FloatArray, IntArray

# How large a picture is searched, and which corners are kept; chosen by hand.
SMALLEST = 16  # px, side of a picture
# px, Full HD; larger pictures are made half as large as this before anything is sought.
MOST_PIXELS = 2_100_000
# px; OpenCV's second search for a chessboard takes too long in larger pictures.
MOST_QUICK_PIXELS = 400_000
# px of the shorter side; smaller pictures are enlarged before corners are sought in them ...
FINE_SIDE = 600
LONGEST_SIDE = 2000  # ... until the longer side is as long as this
LEAST_CORNERS = 6  # of a ChArUco board
# Half the side of what a corner is refined by, as a share of the way to the next one.
WINDOW = 0.45
# Of the roughness of refined corners, below which those that were found are better.
SPOILT = 0.8
# Contrast of corners that are sought, relative to those that are known.
LEAST_CONTRAST = 0.4
# Of the refining: what ends it, steps and px.
STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 0.001)


@dataclass(frozen=True)
class Detection:
    """Features of a target that were found in a picture."""

    ids: IntArray  # (n,), rows of `target.points`, ascending; each at most once
    pixels: FloatArray  # (n, 2), px: the centroid of the disc's image, or the corner
    reason: str = ""  # in a few words, why nothing was found, where n is 0


def detect(image: Numbers, target: Target) -> Detection:
    """Find a target's features in a picture, (H, W) or (H, W, 3): float in [0, 1], uint8 or uint16.

    Neither a camera nor a guess is needed. Dots are ordered by local prediction and named
    by their code; corners are found by OpenCV. Features that do not lie where their neighbours place them
    are left out. A chessboard may look the same when turned by 180°; its first row then runs to
    the right in the picture. A picture of dots or of a ChArUco
    board in a mirror is refused.
    """
    grey = _grey(image)
    if min(grey.shape) < SMALLEST:
        reason = f"the picture is too small, {SMALLEST} px are needed"
        return Detection(*no_features(reason))
    picture = grey
    if grey.size > MOST_PIXELS:
        picture = _shrink_to(grey, MOST_PIXELS // 2)
    try:
        ids, pixels, reason = SEARCHES[type(target)](picture, target)
    except cv2.error as error:
        what = " ".join(str(error.err or error).split())
        return Detection(*no_features(f"OpenCV fails on this picture ({what})"))
    return Detection(ids, _rescale(pixels, picture, grey), reason)


def see_board(image: Numbers) -> tuple[int, int] | None:
    """Columns and rows of squares of the chessboard that a picture shows, of whatever size; None if none."""
    picture = _enlarge(_even_paper(_shrink_to(_grey(image), MOST_PIXELS // 2)))
    for pattern in ((9, 6), (7, 5), (5, 4), (3, 3)):
        rows, columns = np.add(_search_board(picture, pattern)[1].shape, 1).tolist()
        for size in sorted([(columns, rows), (rows, columns)], reverse=True):
            if min(size) >= 4 and len(detect(image, Chessboard(*size, 1.0)).ids):
                return size
    return None


def _grey(image: Numbers) -> Numbers:
    """Average the colours, to float32 in [0, 1]."""
    most = {"u1": 255, "u2": 65535, "f4": 1, "f8": 1}.get(image.dtype.str[1:])
    if most is None or image.ndim not in (2, 3) or image.shape[2:] not in ((), (3,)):
        raise ValueError(
            "image must be (H, W) or (H, W, 3), uint8, uint16 or float in [0, 1], "
            f"got {image.dtype} of shape {image.shape}"
        )
    grey: Numbers = image.astype(np.float32)
    if grey.ndim == 3:
        grey = cv2.transform(grey, np.full((1, 3), 1 / 3, np.float32))
    grey *= np.float32(1 / most)
    if not (np.isfinite(grey).all() and grey.min() >= -0.01 and grey.max() <= 1.01):
        raise ValueError("image must hold finite values in [0, 1] where it is float")
    return grey


def _shrink_to(picture: Numbers, most: int) -> Numbers:
    """Average the pixels of a picture, (H, W), so that about `most` are left at most."""
    share = min(np.sqrt(most / picture.size), 1)
    height, width = (max(int(share * side), 1) for side in picture.shape)
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)


def _enlarge(picture: Numbers) -> Numbers:
    """Enlarge a picture, (H, W), that is small or narrow."""
    enough = FINE_SIDE / min(picture.shape)
    most = LONGEST_SIDE / max(picture.shape)
    scale = max(round(min(enough, most)), 1)
    size = (scale * picture.shape[1], scale * picture.shape[0])
    return cv2.resize(picture, size, interpolation=cv2.INTER_CUBIC)


def _rescale(
    pixels: FloatArray,
    from_: Numbers,
    to: Numbers,
) -> FloatArray:
    """Where places (..., 2), px, of a picture are in another one of the same scene and another size."""
    return (pixels + 0.5) * np.divide(to.shape[::-1], from_.shape[::-1]) - 0.5


def _even_paper(grey: FloatArray) -> Numbers:
    """Make the paper equally white everywhere, which OpenCV's detectors of chessboards need."""
    white = cv2.resize(white_of(shrink_picture(grey)), grey.shape[::-1])
    level = grey / np.maximum(white, LEAST_WHITE)
    return cv2.convertScaleAbs(level, alpha=220)


def _detect_charuco(grey: FloatArray, target: Charuco) -> Found:
    """Find the corners of a ChArUco board: those beside markers, then those that these foretell."""
    options = cv2.aruco.CharucoParameters()
    # Next to a corner; a corner that is wrong for it is left out below.
    options.minMarkers = 1
    picture = _enlarge(_even_paper(grey))
    # Small markers are read where they are sharpened; corners are measured where they are not.
    sharp = cv2.addWeighted(
        picture,
        2.5,
        cv2.GaussianBlur(picture, (0, 0), 3),
        -1.5,
        0,
    )
    detector = cv2.aruco.CharucoDetector(target.board, options)
    corners, ids, _, markers = detector.detectBoard(sharp)
    count = 0 if markers is None else len(markers)
    grid = np.full((target.rows - 1, target.columns - 1, 2), np.nan)
    if ids is not None:
        grid.reshape(-1, 2)[ids.ravel()] = corners.reshape(-1, 2)
    panel = target.panel_of(target.points).reshape(grid.shape[:2])
    for step in range(4):  # what is left out hides others at first
        fits, _ = check_places(grid, panel, least=4 if step < 2 else 6)
        grid[~fits] = np.nan
        if step == 1:
            border = (1 - target.marker / target.spacing) / 2
            grid = _complete(grid, picture, border, target.first_black)
    kept = np.flatnonzero(fits)
    if len(kept) < LEAST_CORNERS:
        ids = np.ravel(target.board.getIds())
        read = f"{count} of the board's {len(ids)} markers can be read"
        if count and not np.isin(markers, ids).any():
            read = (
                f"markers from {markers.min()} on are read, first_id is {target.first_id}"
            )
        return no_features(f"{read}, {len(kept)} corners agree, {LEAST_CORNERS} are needed")
    return kept, _rescale(grid.reshape(-1, 2)[kept], picture, grey), ""


def _complete(
    grid: FloatArray,
    picture: Numbers,
    border: float,
    first_black: int,
) -> FloatArray:
    """Refine the corners of a ChArUco board, and find others where their neighbours place them.

    `grid`, (h, w, 2), px, is nan where none is known; `border` is the white around a marker, in steps;
    `first_black` as of a `Chessboard`.
    """
    row, column = np.nonzero(np.isfinite(grid[..., 0]))
    guess = grid[row, column]
    along, down = (step[row, column] for step in steps(grid))
    grid = np.full_like(grid, np.nan)
    usual = -np.inf
    for _ in range(sum(grid.shape)):
        size = np.minimum(*np.linalg.norm([along, down], axis=-1))
        inside = np.all((guess > 3) & (guess < np.array(picture.shape[::-1]) - 4), axis=1)
        tried = np.flatnonzero(inside & np.isfinite(size))
        corner = guess.copy()
        for n in tried:
            half = max(round(border * size[n]), 2)
            place = guess[n].astype(np.float32)[None]
            corner[n] = _refine(picture, place, half)
        # Of the four squares around a corner, the upper left one is black where row and column are even, or
        # where one of them is odd.
        contrast = np.zeros(len(corner))
        for i, j in product((-1, 1), repeat=2):
            place = corner + border / 2 * (i * along + j * down)
            contrast -= i * j * _read(picture, place, "nearest")
        contrast *= (-1.0) ** (row + column + first_black)
        if usual < 0:
            usual = float(np.median(contrast[tried])) if len(tried) else 0.0
        tried = tried[contrast[tried] > LEAST_CONTRAST * usual]
        moved = np.linalg.norm(corner - guess, axis=-1)
        tried = tried[moved[tried] < border * size[tried]]
        if not len(tried):
            break
        grid[row[tried], column[tried]] = corner[tried]
        row, column = np.nonzero(np.isnan(grid[..., 0]))
        if not len(row):
            break
        guess, along, down = predict(windows(grid, row, column))
    return grid


def _refine(picture: Numbers, corners: Numbers, half: int) -> Numbers:
    """Refine corners, (..., 2), px, by what lies within `half` px of each to every side."""
    start = corners.reshape(-1, 1, 2).astype(np.float32)
    found = cv2.cornerSubPix(picture, start, (half, half), (-1, -1), STOP)
    return found.reshape(corners.shape)


def _read(
    picture: Numbers,
    places: FloatArray,
    mode: str = "constant",
) -> FloatArray:
    """Interpolate a picture at places (..., 2), px; `mode` says what is beside it, as to SciPy."""
    at = np.moveaxis(places, -1, 0)[::-1]
    return scipy.ndimage.map_coordinates(
        picture,
        at,
        float,
        order=1,
        mode=mode,
    )


def _search_board(picture: Numbers, pattern: tuple[int, int]) -> tuple[Numbers, Numbers]:
    """Find a board of so many inner corners along rows and columns, or more: its corners, and their grid."""
    how = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_LARGER
    cv2.setRNGSeed(0)  # it draws numbers: so a picture has the same corners every time
    found, corners, grid = cv2.findChessboardCornersSBWithMeta(picture, pattern, how)
    return (corners, grid) if found else (np.zeros((0, 2)), np.zeros((0, 0)))


def _detect_chessboard(grey: FloatArray, target: Chessboard) -> Found:
    """Find the inner corners of a chessboard; all of them or none."""
    picture = _enlarge(_even_paper(grey))
    pattern = (target.columns - 1, target.rows - 1)
    # The two find about as many, but not the same; the first says no more quickly.
    corners, seen = _search_board(picture, pattern)
    if seen.size > len(target.points):
        rows, columns = np.add(seen.shape, 1)
        return no_features(f"a board of {columns}×{rows} squares is seen")
    if not seen.size:
        how = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ADAPTIVE_THRESH
        small = _shrink_to(picture, MOST_QUICK_PIXELS)
        is_there, corners = cv2.findChessboardCorners(small, pattern, flags=how)
        if not is_there:
            return no_features("no chessboard of this size, or not all of it is in view")
        corners = _rescale(corners.astype(np.float64), small, picture)
    given = corners.reshape(*pattern[::-1], 2).astype(np.float64)
    shortest = np.linalg.norm(steps(given), axis=-1).min()
    grid = _refine(picture, given, max(int(WINDOW * shortest), 2)).astype(np.float64)
    # Refining is better on most pictures, and spoils corners where a camera has sharpened and enlarged them.
    if seen.size and _roughness(given) < SPOILT * _roughness(grid):
        grid = given
    grid = _order_corners(_rescale(grid, picture, grey), grey)
    fits, _ = check_places(grid, np.zeros(grid.shape[:2], int))
    if fits.mean() < 0.9:
        return no_features("the corners do not lie on a smooth sheet")
    if _darkness(grid, grey) < 0:
        return no_features(
            "its upper left square is white; exchange columns and rows if the board is turned"
        )
    ids = np.flatnonzero(fits)
    return ids, grid.reshape(-1, 2)[ids], ""


def _roughness(grid: FloatArray) -> float:
    """How far corners lie from a smooth sheet, a cubic of row and column: root mean square, px."""
    sides = [np.linspace(-1, 1, count) for count in grid.shape[:2]]
    row, column = np.meshgrid(*sides, indexing="ij")
    terms = np.polynomial.polynomial.polyvander2d(row, column, [3, 3]).reshape(-1, 16)
    places = grid.reshape(-1, 2)
    smooth = terms @ np.linalg.lstsq(terms, places, rcond=None)[0]
    return float(np.sqrt(np.mean((places - smooth) ** 2)))


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
    return _read(grey, (grid[1:, 1:] + grid[1:, :-1] + grid[:-1, 1:] + grid[:-1, :-1]) / 4)


SEARCHES: dict[type[Target], Callable[..., Found]] = {
    DotGrid: detect_dots,
    Charuco: _detect_charuco,
    Chessboard: _detect_chessboard,
}
