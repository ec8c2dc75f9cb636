"""Calibration targets: what is printed on the sheet, where, and which of it is a feature.

A target has a frame of its own: x right and y down on the sheet, z into it, the origin at the
feature in the upper left; all in mm. A sheet that is folded along one line has two flat panels,
each with a pose of its own, and keeps the coordinates that it had before.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import ClassVar

import cv2
import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from endolab.model.ranges import check_range
from endolab.numerics.arrays import FloatArray, IntArray
from endolab.numerics.checks import check_int, number


# Ink ------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Ink:
    """What is printed: black discs, black rectangles, grey discs; mm."""

    # Centre x, y and radius.
    discs: FloatArray = field(default_factory=lambda: rows_of([], 3))
    # Left, top, width, height.
    rectangles: FloatArray = field(default_factory=lambda: rows_of([], 4))
    # Centre x, y, radius, and reflectance relative to the white of the paper.
    greys: FloatArray = field(default_factory=lambda: rows_of([], 4))
    # The shapes are bare and the paper around them is black.
    inverted: bool = False


def rows_of(values: ArrayLike, columns: int) -> FloatArray:
    """Make a table of so many columns of a list that may be empty."""
    return np.asarray(values, dtype=np.float64).reshape(-1, columns)


def darkness(
    ink: Ink,
    corner: ArrayLike,
    shape: Sequence[int],
    step: float,
    black: float = 0.0,
) -> NDArray[np.float32]:
    """Average what is printed over the cells of a raster: 1 - reflectance, (rows, columns); 0 where bare.

    `corner` is x, y of the raster's upper left, mm, `step` the side of a cell, mm, `black` the ink's
    reflectance. Exact for rectangles; the rim of a disc is taken as straight within a cell.
    """
    dark = np.zeros(shape, np.float32)
    left, top = np.asarray(corner, dtype=np.float64)

    def span(
        start: float,
        length: float,
        count: int,
    ) -> IntArray:
        """Cells that an interval touches."""
        first = np.floor(start / step - 0.5)
        last = np.ceil((start + length) / step + 0.5)
        return np.arange(*np.clip([first, last], 0, count), dtype=int)

    def cover(
        start: float,
        length: float,
        cells: IntArray,
    ) -> FloatArray:
        """Shares of cells that an interval covers."""
        edges = np.append(cells, cells[-1:] + 1)
        return np.diff(np.clip(edges, start / step, (start + length) / step))

    rows, columns = shape
    discs = np.pad(ink.discs, ((0, 0), (0, 1)), constant_values=black)
    for x, y, radius, reflectance in [*discs, *ink.greys]:
        row = span(y - top - radius, 2 * radius, rows)
        column = span(x - left - radius, 2 * radius, columns)
        down = (row + 0.5) * step - (y - top)
        across = (column + 0.5) * step - (x - left)
        inside = (radius - np.hypot(down[:, None], across)) / step + 0.5
        dark[np.ix_(row, column)] += np.clip(inside, 0, 1) * (1 - reflectance)
    for x, y, width, height in ink.rectangles:
        row = span(y - top, height, rows)
        column = span(x - left, width, columns)
        covers = np.outer(cover(y - top, height, row), cover(x - left, width, column))
        dark[np.ix_(row, column)] += covers * (1 - black)
    # Rounded, for shares of a cell that is bare do not add up to 1 exactly.
    return np.round(1 - black - dark, 5) if ink.inverted else dark


# Targets --------------------------------------------------------------------------------
def _lattice(columns: int, rows: int) -> FloatArray:
    """Column and row of each place of a lattice, (n, 2), row by row."""
    row, column = np.indices((rows, columns), dtype=np.float64)
    return np.column_stack([column.ravel(), row.ravel()])


@dataclass(frozen=True)
class Target:
    """A flat printed target; use one of its kinds."""

    columns: int  # of features (dots, circles) or of squares (chessboard, ChArUco)
    rows: int
    spacing: float  # between neighbours, or the side of a square, mm
    margin: float = 10.0  # white paper around the features, mm
    # The sheet is folded between this many columns on the left and the rest.
    fold: int | None = None
    # White on black paper, where others are black on white.
    inverted: bool = False

    kind: ClassVar[str]
    least: ClassVar[int] = 2  # columns and rows
    found_whole: ClassVar[bool] = False  # or not at all
    switches: ClassVar[tuple[str, ...]] = ("inverted",)  # fields that `variants` turn

    def __post_init__(self) -> None:
        for name in ("columns", "rows"):
            number(name, check_int(name, getattr(self, name), self.least), most=100)
        for name in ("spacing", "margin"):
            check_range(name, getattr(self, name), "length")
        for part in fields(self):
            value = getattr(self, part.name)
            if part.type is bool and not isinstance(value, bool):
                raise ValueError(f"{part.name} must be true or false, got {value!r}")
        if self.fold is None:
            return
        if self.found_whole:
            raise ValueError("fold is of dots and ChArUco, other targets are flat")
        check_int("fold", self.fold)
        right = self.panel_of(self.points[: self.columns])
        if min(np.sum(right == 0), np.sum(right)) < 2:
            raise ValueError(
                f"fold must leave two columns of features on each side, got {self.fold} "
                f"of {self.columns} columns"
            )

    @property
    def variants(self) -> list["Target"]:
        """What the sheet may be instead, if it is not found as it is described."""
        variants: list[Target] = []
        for name in self.switches:
            with suppress(ValueError):  # no such sheet can be so
                variants.append(replace(self, **{name: not getattr(self, name)}))
        return variants

    @property
    def points(self) -> FloatArray:
        """Features in the target's frame, (n, 3), mm; their row is their id."""
        raise NotImplementedError

    @property
    def radii(self) -> FloatArray:
        """Radius of the disc that each feature is the centre of, (n,), mm; 0 for corners."""
        return np.zeros(len(self.points))

    @property
    def ink(self) -> Ink:
        """What is printed."""
        raise NotImplementedError

    @property
    def fold_x(self) -> float | None:
        """Where the fold runs in the target's frame, mm; None for a flat sheet."""
        return None if self.fold is None else (self.fold - 0.5) * self.spacing

    def panel_of(self, xy: ArrayLike) -> IntArray:
        """Panel of places on the sheet, (..., 2 or 3), mm: 0, or 1 to the right of the fold."""
        x = np.asarray(xy, dtype=np.float64)[..., 0]
        return (x > (np.inf if self.fold_x is None else self.fold_x)).astype(int)

    @property
    def panels(self) -> int:
        """Number of flat panels."""
        return 1 if self.fold is None else 2

    @property
    def sheet(self) -> tuple[float, float, float, float]:
        """Left, top, width and height of the paper in the target's frame, mm."""
        ink = self.ink
        discs = np.concatenate([ink.discs, ink.greys[:, :3]])
        corner = np.concatenate([discs[:, :2] - discs[:, 2:], ink.rectangles[:, :2]])
        opposite = np.concatenate(
            [discs[:, :2] + discs[:, 2:], ink.rectangles[:, :2] + ink.rectangles[:, 2:]]
        )
        left, top = corner.min(axis=0) - self.margin
        right, bottom = opposite.max(axis=0) + self.margin
        return float(left), float(top), float(right - left), float(bottom - top)

    def white_places(self) -> FloatArray:
        """Places between the features where the paper is bare, for sampling its brightness, (n, 3), mm.

        x, y and the radius of bare paper there (at least 0.04 of a spacing), the barest first; the
        discs of that radius touch no ink, grey or fold, and the places lie half a spacing apart at least.
        """
        step = self.spacing / 64  # side of a cell of the raster that is searched
        low = self.points[:, :2].min(axis=0)
        high = self.points[:, :2].max(axis=0)
        columns, rows = np.floor((high - low) / step + 0.5).astype(int) + 1
        bare = darkness(self.ink, low - step / 2, (rows, columns), step) == 0
        x = low[0] + step * np.arange(columns)
        y = low[1] + step * np.arange(rows)
        if self.fold_x is not None:
            bare &= np.abs(x - self.fold_x) > step
        # Beside the raster may be ink; a cell may be bare to its rim only.
        distance = scipy.ndimage.distance_transform_edt(np.pad(bare, 1))[1:-1, 1:-1]
        radius = (distance - 1) * step
        ridge = radius >= scipy.ndimage.maximum_filter(radius, 3)
        ridge &= radius >= 0.04 * self.spacing
        row, column = np.nonzero(ridge)
        left = np.column_stack([x[column], y[row], radius[ridge]])
        hull = scipy.spatial.Delaunay(self.points[:, :2])
        left = left[hull.find_simplex(left[:, :2]) >= 0]
        left = left[np.argsort(-left[:, 2], kind="stable")]
        places = []
        while len(left):
            places.append(left[0])
            left = left[np.hypot(*(left[:, :2] - left[0, :2]).T) >= self.spacing / 2]
        return rows_of(places, 3)


@dataclass(frozen=True)
class DotGrid(Target):
    """A square grid of dots of two sizes that spell a code: Vicalib's sheets (github.com/arpg/vicalib)."""

    small: float = 0.0  # radius, mm
    large: float = 0.0  # radius, mm
    # Of the code: top bits of the words of a Mersenne Twister (MT19937). Vicalib's own is 71.
    seed: int = 71
    # Reflectance of grey discs printed in every second cell; they tell γ.
    greys: float | None = None

    kind: ClassVar[str] = "dots"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_range("small", self.small, "length")
        if not self.small < self.large < self.spacing / 2:
            raise ValueError(
                f"the radii must be small < large < spacing / 2, got small {self.small}, "
                f"large {self.large}, spacing {self.spacing}"
            )
        number("seed", check_int("seed", self.seed), most=2**32 - 1)
        if self.greys is not None:
            number(
                "greys",
                self.greys,
                0.001,
                0.999,
            )
            if self.inverted:
                raise ValueError("inverted is of targets without greys")

    @cached_property
    def code(self) -> IntArray:
        """1 where the dot is large, (rows, columns)."""
        shape = self.rows, self.columns
        words = np.random.RandomState(self.seed).randint(
            0,
            2**32,
            shape,
            np.uint32,
        )
        return (words >> 31).astype(int)

    @cached_property
    def points(self) -> FloatArray:  # noqa: D102
        return np.pad(_lattice(self.columns, self.rows), ((0, 0), (0, 1))) * self.spacing

    @cached_property
    def radii(self) -> FloatArray:  # noqa: D102
        return np.where(self.code.ravel() == 1, self.large, self.small)

    @cached_property
    def ink(self) -> Ink:  # noqa: D102
        discs = np.column_stack([self.points[:, :2], self.radii])
        if self.greys is None:
            return Ink(discs, inverted=self.inverted)
        radius = 0.75 * (self.spacing / np.sqrt(2) - self.large)
        cells = _lattice(self.columns - 1, self.rows - 1)
        centres = (cells[cells.sum(axis=1) % 2 == 0] + 0.5) * self.spacing
        if self.fold_x is not None:
            centres = centres[np.abs(centres[:, 0] - self.fold_x) > radius]
        looks = np.tile([radius, self.greys], (len(centres), 1))
        return Ink(discs, greys=np.column_stack([centres, looks]))


@dataclass(frozen=True)
class CircleGrid(Target):
    """A grid of equal circles, as OpenCV's: asymmetric, every second row is shifted, or symmetric.

    `columns` counts the circles of a row, `spacing` is the distance between rows; the circles of
    a row lie twice as far apart, in a symmetric grid as far.
    """

    radius: float = 0.0  # mm
    symmetric: bool = False

    kind: ClassVar[str] = "circles"
    found_whole: ClassVar[bool] = True
    switches: ClassVar[tuple[str, ...]] = ("symmetric", "inverted")

    def __post_init__(self) -> None:
        super().__post_init__()
        number(
            "radius",
            self.radius,
            0.001,
            (0.49 if self.symmetric else 0.7) * self.spacing,
        )

    @cached_property
    def points(self) -> FloatArray:  # noqa: D102
        column, row = _lattice(self.columns, self.rows).T
        if self.symmetric:
            return np.stack([column, row, 0 * row], axis=-1) * self.spacing
        return np.stack([2 * column + row % 2, row, 0 * row], axis=-1) * self.spacing

    @property
    def radii(self) -> FloatArray:  # noqa: D102
        return np.full(len(self.points), self.radius)

    @cached_property
    def ink(self) -> Ink:  # noqa: D102
        discs = np.column_stack([self.points[:, :2], self.radii])
        return Ink(discs, inverted=self.inverted)


@dataclass(frozen=True)
class Chessboard(Target):
    """A chessboard of `columns` × `rows` squares; its features are the inner corners."""

    kind: ClassVar[str] = "chessboard"
    least: ClassVar[int] = 4
    found_whole: ClassVar[bool] = True

    @property
    def first_black(self) -> int:
        """Of the first row, which square is the first black one."""
        return 0

    @property
    def fold_x(self) -> float | None:  # noqa: D102
        return None if self.fold is None else (self.fold - 1) * self.spacing

    @cached_property
    def points(self) -> FloatArray:  # noqa: D102
        corners = _lattice(self.columns - 1, self.rows - 1)
        return np.pad(corners, ((0, 0), (0, 1))) * self.spacing

    @cached_property
    def ink(self) -> Ink:  # noqa: D102
        squares = _lattice(self.columns, self.rows)
        black = squares[squares.sum(axis=1) % 2 == self.first_black]
        rectangles = np.column_stack([black - 1, np.ones(black.shape)]) * self.spacing
        return Ink(rectangles=rectangles, inverted=self.inverted)


@dataclass(frozen=True)
class Charuco(Chessboard):
    """A chessboard with ArUco markers in its white squares."""

    marker: float = 0.0  # side, mm
    dictionary: str = "DICT_5X5_250"  # its name in OpenCV
    first_id: int = 0  # of the markers, which are numbered from it
    # The pattern before OpenCV 4.6: with an even number of rows, the upper left square is white.
    legacy: bool = False

    kind: ClassVar[str] = "charuco"
    found_whole: ClassVar[bool] = False
    switches: ClassVar[tuple[str, ...]] = ("legacy", "inverted")

    def __post_init__(self) -> None:
        super().__post_init__()
        number(
            "marker",
            self.marker,
            0.001,
            0.99 * self.spacing,
        )
        check_dictionary(self.dictionary, self.first_id, self.columns * self.rows // 2)

    @property
    def first_black(self) -> int:  # noqa: D102
        return int(self.legacy and self.rows % 2 == 0)

    @property
    def board(self) -> cv2.aruco.CharucoBoard:
        """OpenCV's description of it; corner ids are those of `points`."""
        size = self.columns, self.rows
        ids = self.first_id + np.arange(self.columns * self.rows // 2)
        board = cv2.aruco.CharucoBoard(
            size,
            self.spacing,
            self.marker,
            dictionary_of(self.dictionary),
            ids,
        )
        board.setLegacyPattern(self.legacy)
        return board

    @cached_property
    def ink(self) -> Ink:  # noqa: D102
        board = self.board
        corners = [np.asarray(c)[:, :2].min(axis=0) for c in board.getObjPoints()]
        markers = draw_markers(
            board.getDictionary(),
            np.ravel(board.getIds()),
            np.array(corners) - self.spacing,
            self.marker,
        )
        rectangles = np.concatenate([super().ink.rectangles, markers])
        return Ink(rectangles=rectangles, inverted=self.inverted)


def check_dictionary(name: str, first_id: int, markers: int) -> None:
    """Refuse a name that is none of OpenCV's dictionaries, or one of too few markers."""
    if not (name.startswith("DICT_") and hasattr(cv2.aruco, name)):
        raise ValueError(f"dictionary must be one of OpenCV's (DICT_…), got {name!r}")
    needed = check_int("first_id", first_id) + markers
    most = len(dictionary_of(name).bytesList)
    if needed > most:
        raise ValueError(
            f"dictionary {name} has {most} markers, the board needs {needed} with first_id {first_id}"
        )


def dictionary_of(name: str) -> cv2.aruco.Dictionary:
    """Return OpenCV's markers of a name."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def draw_markers(
    dictionary: cv2.aruco.Dictionary,
    ids: IntArray,
    corners: FloatArray,
    side: float,
    border: int = 1,
) -> FloatArray:
    """Give the black cells of markers as rectangles, (n, 4), mm; `border`: cells of their black rim."""
    bits = dictionary.markerSize + 2 * border
    cell = side / bits
    boxes = []
    for name, corner in zip(ids, corners, strict=True):
        picture = dictionary.generateImageMarker(int(name), bits, borderBits=border)
        places = corner + np.argwhere(picture == 0)[:, ::-1] * cell
        boxes.append(np.column_stack([places, np.full(places.shape, cell)]))
    return np.concatenate(boxes)


@dataclass(frozen=True)
class AprilGrid(Target):
    """A grid of AprilTags, as Kalibr's: `columns` × `rows` tags, `spacing` apart; features are their corners.

    The tags are numbered from the lower left, row by row (github.com/ethz-asl/kalibr). Kalibr's `tagSize`
    is `marker`, and its `tagSpacing` the white between tags over that, so `spacing` is (1 + tagSpacing)
    times tagSize. White on black is not read: tags run into the squares there, and corners are 3 px off.
    """

    marker: float = 0.0  # side of a tag, mm
    dictionary: str = "DICT_APRILTAG_36h11"  # its name in OpenCV
    first_id: int = 0
    border: int = 2  # cells of a tag's black rim: Kalibr's 2, or 1
    # Black squares between the tags, whose corners meet theirs.
    squares: bool = True

    kind: ClassVar[str] = "aprilgrid"
    found_whole: ClassVar[bool] = True  # or in part, but it cannot be folded

    def __post_init__(self) -> None:
        super().__post_init__()
        number(
            "marker",
            self.marker,
            0.001,
            0.99 * self.spacing,
        )
        number("border", check_int("border", self.border, 1), most=2)
        check_dictionary(self.dictionary, self.first_id, self.columns * self.rows)
        if self.inverted:
            raise ValueError("inverted is not of AprilGrids")

    @property
    def tag_corners(self) -> IntArray:
        """Rows of `points` of a tag's corners, (tags, 4), by its number; clockwise from the upper left."""
        ids = np.arange(len(self.points)).reshape(self.rows, 2, self.columns, 2)
        by_tag = ids[::-1].transpose(0, 2, 1, 3).reshape(-1, 4)
        return by_tag[:, [0, 1, 3, 2]]

    @cached_property
    def points(self) -> FloatArray:  # noqa: D102
        column, row = _lattice(2 * self.columns, 2 * self.rows).T
        places = np.stack([column, row, 0 * row], axis=-1)
        return places // 2 * self.spacing + places % 2 * self.marker

    @cached_property
    def ink(self) -> Ink:  # noqa: D102
        corners = self.points[self.tag_corners[:, 0], :2]
        boxes = [
            draw_markers(
                dictionary_of(self.dictionary),
                self.first_id + np.arange(len(corners)),
                corners,
                self.marker,
                self.border,
            )
        ]
        gap = self.spacing - self.marker
        if self.squares:
            places = _lattice(self.columns + 1, self.rows + 1) * self.spacing - gap
            boxes.append(np.column_stack([places, np.full(places.shape, gap)]))
        return Ink(rectangles=np.concatenate(boxes))


_VICALIB_SMALL = {
    "columns": 19,
    "rows": 10,
    "spacing": 4.2238,
    "small": 0.8471,
    "large": 1.2661,
    "margin": 8.0,
}

TARGETS: dict[str, Target] = {
    "vicalib_big": DotGrid(19, 10, 5.2797, small=1.05885, large=1.58266),
    "vicalib_small": DotGrid(**_VICALIB_SMALL),  # type: ignore[arg-type]
    "vicalib_folded": DotGrid(**_VICALIB_SMALL, fold=9),  # type: ignore[arg-type]
    "vicalib_grey": DotGrid(**_VICALIB_SMALL, greys=0.5),  # type: ignore[arg-type]
    "charuco": Charuco(12, 8, 7.0, marker=5.2),
    "chessboard": Chessboard(12, 8, 7.0),
    "circles": CircleGrid(4, 11, 7.0, radius=2.5),
}
