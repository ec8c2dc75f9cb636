"""Find a target's features in a picture, and which of them they are.

    dots      find_blobs -> find_lattices -> match_code -> grow -> check_places
    ChArUco   OpenCV's markers and corners -> check_places
    squares   OpenCV's two searches -> turned so that the first square is black -> check_places

All work from neighbour to neighbour in the picture (`lattice`), so that no camera is needed. The places
within two steps foretell the next one, and each must lie where its neighbours put it:

    o   o   o   o   o
    o   o   o   o  (?)     q(row, column): a quadratic fitted to the places around
    o   o   o   o   o      |p - q| < 8 % of a step, of neighbours on the same panel
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from endolab.calibration import constants
from endolab.calibration.detection.blobs import (
    LEAST_WHITE,
    Numbers,
    shrink_picture,
    white_of,
)
from endolab.calibration.detection.dots import detect_dots
from endolab.calibration.detection.lattice import check_places, cross
from endolab.calibration.refusals import NotIdentifiableError, Refusal
from endolab.calibration.targets import Charuco, Chessboard, DotGrid, Target
from endolab.numerics.arrays import FloatArray, IntArray
from endolab.numerics.checks import excerpt

# px, Full HD; larger pictures are made half as large as this before anything is sought.
MOST_PIXELS = 2_100_000


@dataclass(frozen=True, eq=False)
class Detection:
    """Features of a target that were found in a picture."""

    ids: IntArray  # (n,), rows of `target.points`, ascending; each at most once
    pixels: FloatArray  # (n, 2), px: the centroid of the disc's image, or the corner
    reason: str = ""  # in a few words, why nothing was found, where n is 0


def no_features(reason: str) -> Detection:
    """Give no features, and the reason."""
    return Detection(np.zeros(0, int), np.zeros((0, 2)), reason)


def detect(image: Numbers, target: Target) -> Detection:
    """Find a target's features in a picture, (H, W) or (H, W, 3), of values in [0, 1].

    Neither a camera nor a guess is needed. Dots are ordered by local prediction and named
    by their code; corners are found by OpenCV. Features that do not lie where their neighbours place them
    are left out. A chessboard may look the same when turned by 180°; its first row then runs to
    the right in the picture. A picture of dots or of a ChArUco
    board in a mirror is refused.
    """
    grey = _grey(image)
    picture = grey if grey.size <= MOST_PIXELS else _shrink_to(grey, MOST_PIXELS // 2)
    try:
        ids, pixels = SEARCHES[type(target)](picture, target)
    except (NotIdentifiableError, cv2.error) as why:
        return no_features(" ".join(str(why).split()))
    return Detection(ids, _rescale(pixels, picture, grey))


def see_board(image: Numbers) -> tuple[int, int] | None:
    """Columns and rows of squares of the chessboard that a picture shows, of whatever size; None if none."""
    grey = _grey(image)
    picture = _enlarge(_even_paper(_shrink_to(grey, MOST_PIXELS // 2)))
    for pattern in ((9, 6), (7, 5), (5, 4), (3, 3)):
        seen = _rescale(_search_board(picture, pattern), picture, grey)
        for rows in sorted(set(seen.shape[:2])) if seen.size else ():
            upright = _turn(seen, grey, rows)
            near, middle = (_contrast(upright, grey, share) for share in (0.2, 0.5))
            # Boards have .8 to 1.15, dots 1.6 or more.
            if middle > 0 and 0.3 < near / middle < 1.3:
                return upright.shape[1] + 1, rows + 1
    return None


def _grey(image: Numbers) -> Numbers:
    """Average the colours, to float32."""
    grey: Numbers = image.astype(np.float32)
    if grey.ndim == 3:
        grey = cv2.transform(grey, np.full((1, grey.shape[2]), 1 / grey.shape[2]))
    if grey.ndim != 2 or not (grey.min() >= -0.01 and grey.max() <= 1.01):
        raise ValueError(
            f"image must be (H, W) or (H, W, 3) of values in [0, 1], got {excerpt(image)}"
        )
    return grey


def _shrink_to(picture: Numbers, most: int) -> Numbers:
    """Average the pixels of a picture, (H, W), so that about `most` are left at most."""
    share = min(np.sqrt(most / picture.size), 1)
    height, width = (max(int(share * side), 1) for side in picture.shape)
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)


def _enlarge(picture: Numbers) -> Numbers:
    """Enlarge a picture, (H, W), whose shorter side is below 600 px, the longer one up to 2000."""
    scale = max(round(min(600 / min(picture.shape), 2000 / max(picture.shape))), 1)
    return cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)


def _rescale(pixels: Numbers, from_: Numbers, to: Numbers) -> FloatArray:
    """Where places (..., 2), px, of a picture are in another one of the same scene and another size."""
    return (pixels + 0.5) * np.divide(to.shape[::-1], from_.shape[::-1]) - 0.5


def _even_paper(grey: FloatArray) -> Numbers:
    """Make the paper equally white everywhere, which OpenCV's detectors of chessboards need."""
    white = cv2.resize(white_of(shrink_picture(grey)), grey.shape[::-1])
    level = grey / np.maximum(white, LEAST_WHITE)
    return cv2.convertScaleAbs(level, alpha=220)


def _refine(picture: Numbers, corners: Numbers, half: int) -> Numbers:
    """Refine corners, (n, 1, 2), px, by what lies within `half` px of each to every side."""
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 0.001)
    return cv2.cornerSubPix(picture, corners.copy(), (half, half), (-1, -1), stop)


def _charuco_corners(grey: FloatArray, target: Charuco) -> tuple[IntArray, FloatArray, str]:
    """Find the corners of a ChArUco board beside which a marker is read, and say which markers are."""
    options = cv2.aruco.CharucoParameters()
    # Next to a corner; a corner that is wrong for it is left out below.
    options.minMarkers = 1
    picture = _enlarge(_even_paper(grey))
    # Small markers are read where they are sharpened; corners are measured where they are not.
    blurred = cv2.GaussianBlur(picture, (0, 0), 3)
    sharp = cv2.addWeighted(picture, 2.5, blurred, -1.5, 0)
    detector = cv2.aruco.CharucoDetector(target.board, options)
    corners, ids, _, markers = detector.detectBoard(sharp)
    grid = np.full((target.rows - 1, target.columns - 1, 2), np.nan)
    if ids is not None:
        corners = _refine(picture, corners, 3)
        grid.reshape(-1, 2)[ids.ravel()] = corners.reshape(-1, 2)
    for _ in range(3):  # what is left out hides others at first
        fits, _ = check_places(grid, np.zeros(grid.shape[:2], int), least=4)
        grid[~fits] = np.nan
    kept = np.flatnonzero(fits)
    read = "no marker is read"
    if markers is not None:
        read = f"{len(markers)} markers are read, {markers.min()} to {markers.max()}"
    return kept, _rescale(grid.reshape(-1, 2)[kept], picture, grey), read


def _detect_charuco(grey: FloatArray, target: Charuco) -> tuple[IntArray, FloatArray]:
    """Find the corners of a ChArUco board; one in a mirror is told from none."""
    kept, corners, read = _charuco_corners(grey, target)
    if len(kept) >= constants.LEAST_CORNERS:
        return kept, corners
    mirrored, *_ = _charuco_corners(np.fliplr(grey), target)
    Refusal.MIRRORED.if_(len(mirrored) >= constants.LEAST_CORNERS)
    own = np.ravel(target.board.getIds())
    facts = {"read": read, "first": own.min(), "last": own.max(), "count": len(kept)}
    raise Refusal.FEW_CORNERS.error(**facts)


def _search_board(picture: Numbers, pattern: tuple[int, int]) -> Numbers:
    """Find a board of so many inner corners along rows and columns, or more: (h, w, 2), px; empty if none."""
    how = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_LARGER
    cv2.setRNGSeed(0)  # it draws numbers: so a picture has the same corners every time
    found, corners, grid = cv2.findChessboardCornersSBWithMeta(picture, pattern, how)
    return corners.reshape(*grid.shape, 2) if found else np.zeros((0, 0, 2))


def _detect_chessboard(grey: FloatArray, target: Chessboard) -> tuple[IntArray, FloatArray]:
    """Find the inner corners of a chessboard; all of them or none."""
    picture = _enlarge(_even_paper(grey))
    pattern = (target.columns - 1, target.rows - 1)
    # The two find about as many, but not the same. The second takes too long in large pictures.
    seen = _search_board(picture, pattern)
    if not seen.size:
        how = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ADAPTIVE_THRESH
        small = _shrink_to(picture, 400_000)
        is_there, corners = cv2.findChessboardCorners(small, pattern, flags=how)
        Refusal.NO_BOARD.if_(not is_there)
        seen = _rescale(corners.reshape(*pattern[::-1], 2), small, picture)
    rows, columns = np.add(seen.shape[:2], 1)
    is_larger = rows * columns > target.rows * target.columns
    Refusal.OTHER_BOARD.if_(is_larger, columns=columns, rows=rows)
    sides = (np.linalg.norm(np.diff(seen, axis=axis), axis=-1) for axis in (0, 1))
    half = max(int(0.45 * min(side.min() for side in sides)), 2)
    given = seen.reshape(-1, 1, 2).astype(np.float32)
    refined = _refine(picture, given, half).reshape(seen.shape)
    # Better on most pictures, and worse where a camera has sharpened and enlarged them.
    rough, smooth = (np.abs(np.diff(one, 4, axis=1)).sum() for one in (refined, seen))
    best = seen if smooth < 0.8 * rough else refined
    grid = _turn(_rescale(best, picture, grey), grey, target.rows - 1)
    Refusal.WHITE_FIRST.if_(_contrast(grid, grey, 0.5) <= 0)
    fits, _ = check_places(grid, np.zeros(grid.shape[:2], int))
    Refusal.ROUGH_CORNERS.if_(fits.mean() < 0.9)
    ids = np.flatnonzero(fits)
    return ids, grid.reshape(-1, 2)[ids]


def _contrast(grid: FloatArray, grey: FloatArray, share: float) -> float:
    """How much brighter white squares are than black ones, at a share of the way from corner to corner."""
    along = np.diff(grid, axis=1)[:-1]
    down = np.diff(grid, axis=0)[:, :-1]
    place = grid[:-1, :-1] + share * (along + down)
    known = np.isfinite(place[..., 0])
    column, row = place[known].astype(int).T
    level = grey[row, column]
    is_black = np.indices(known.shape).sum(axis=0)[known] % 2 == 0
    return float(level[~is_black].mean() - level[is_black].mean())


def _turn(grid: FloatArray, grey: FloatArray, rows: int) -> FloatArray:
    """Turn a grid of corners to so many rows: not mirrored, first square black, rows to the right."""

    def looks_right(turned: FloatArray) -> tuple[bool, bool, bool]:
        along = np.diff(turned, axis=1)[:-1]
        down = np.diff(turned, axis=0)[:, :-1]
        return (
            bool(np.median(cross(along, down)) > 0),
            _contrast(turned, grey, 0.5) > 0,
            bool(np.median(along[..., 0]) >= 0),
        )

    ways = [way for way in (grid, grid.swapaxes(0, 1)) if len(way) == rows]
    turns = (way[::i, ::j] for way in ways for i in (1, -1) for j in (1, -1))
    return max(turns, key=looks_right)


SEARCHES: dict[type[Target], Callable[..., tuple[IntArray, FloatArray]]] = {
    DotGrid: detect_dots,
    Charuco: _detect_charuco,
    Chessboard: _detect_chessboard,
}
