"""Calibration targets: what is printed on the sheet, where, and which of it is a feature.

A target has a frame of its own: x right and y down on the sheet, z into it, the origin at the
feature in the upper left; all in mm. A sheet that is folded along one line has two flat panels,
each with a pose of its own, and keeps the coordinates that it had before.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, Self

import cv2
import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from endolab.numerics.arrays import FloatArray, IntArray
from endolab.numerics.checked_types import OneOf, Whole, checked, from_content

Length = Annotated[float, Field(ge=1e-3, le=1e6)]  # mm


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
    return dark


# Targets --------------------------------------------------------------------------------
def _lattice(columns: int, rows: int) -> FloatArray:
    """Column and row of each place of a lattice, (n, 2), row by row."""
    row, column = np.indices((rows, columns), dtype=np.float64)
    return np.column_stack([column.ravel(), row.ravel()])


@checked
class Target:
    """A flat printed target; use one of its kinds."""

    endolab_target: Literal[1] = field(default=1, kw_only=True, repr=False)  # of the file
    kind: str = field(kw_only=True, repr=False)
    # Of dots, or of squares (chessboard, ChArUco).
    columns: Annotated[Whole, Field(ge=2, le=100)]
    rows: Annotated[Whole, Field(ge=2, le=100)]
    spacing: Length  # between neighbours, or the side of a square, mm
    margin: Length = 10.0  # white paper around the features, mm
    # The sheet is folded between this many columns on the left and the rest.
    fold: Annotated[Whole, Field(ge=0)] | None = None

    found_whole: ClassVar[bool] = False  # or not at all

    @model_validator(mode="after")
    def _check_fold(self) -> Self:
        if self.fold is not None and self.found_whole:
            raise ValueError("fold is of dots and ChArUco, other targets are flat")
        if self.fold_x is not None:
            right = np.unique(self.points[:, 0]) > self.fold_x
            if min(np.sum(~right), np.sum(right)) < 2:
                raise ValueError(
                    f"fold must leave two columns of features on each side, got {self.fold} "
                    f"of {self.columns} columns"
                )
        return self

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


@checked
class DotGrid(Target):
    """A square grid of dots of two sizes that spell a code: Vicalib's sheets (github.com/arpg/vicalib)."""

    kind: Literal["dots"] = field(default="dots", kw_only=True, repr=False)
    small: Length = field(kw_only=True)  # radius, mm
    large: Length = field(kw_only=True)  # radius, mm
    # Of the code: top bits of the words of a Mersenne Twister (MT19937). Vicalib's own is 71.
    seed: Annotated[Whole, Field(ge=0, le=2**32 - 1)] = 71
    # Reflectance of grey discs printed in every second cell; they tell γ.
    greys: Annotated[float, Field(ge=0.001, le=0.999)] | None = None

    @model_validator(mode="after")
    def _check_radii(self) -> Self:
        if not self.small < self.large < self.spacing / 2:
            raise ValueError(
                f"the radii must be small < large < spacing / 2, got small {self.small}, "
                f"large {self.large}, spacing {self.spacing}"
            )
        return self

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
            return Ink(discs)
        radius = 0.75 * (self.spacing / np.sqrt(2) - self.large)
        cells = _lattice(self.columns - 1, self.rows - 1)
        centres = (cells[cells.sum(axis=1) % 2 == 0] + 0.5) * self.spacing
        if self.fold_x is not None:
            centres = centres[np.abs(centres[:, 0] - self.fold_x) > radius]
        looks = np.tile([radius, self.greys], (len(centres), 1))
        return Ink(discs, greys=np.column_stack([centres, looks]))


@checked
class Board(Target):
    """Black and white squares, `columns` × `rows`; the features are their inner corners."""

    columns: Annotated[Whole, Field(ge=4, le=100)]
    rows: Annotated[Whole, Field(ge=4, le=100)]

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
        return Ink(rectangles=rectangles)


@checked
class Chessboard(Board):
    """A chessboard of `columns` × `rows` squares."""

    kind: Literal["chessboard"] = field(default="chessboard", kw_only=True, repr=False)

    found_whole: ClassVar[bool] = True


@checked
class Charuco(Board):
    """A chessboard with ArUco markers in its white squares."""

    kind: Literal["charuco"] = field(default="charuco", kw_only=True, repr=False)
    marker: Length = field(kw_only=True)  # side, mm
    dictionary: str = "DICT_5X5_250"  # its name in OpenCV
    first_id: Annotated[Whole, Field(ge=0)] = 0  # of the markers, numbered from it
    # The pattern before OpenCV 4.6: with an even number of rows, the upper left square is white.
    legacy: bool = False

    @model_validator(mode="after")
    def _check_markers(self) -> Self:
        if self.marker > 0.99 * self.spacing:
            raise ValueError(
                f"marker must be smaller than a square of {self.spacing:g}, got {self.marker:g}"
            )
        if not (
            self.dictionary.startswith("DICT_") and hasattr(cv2.aruco, self.dictionary)
        ):
            raise ValueError(
                f"dictionary must be one of OpenCV's (DICT_…), got {self.dictionary!r}"
            )
        needed = self.first_id + self.columns * self.rows // 2
        most = len(self._markers.bytesList)
        if needed > most:
            raise ValueError(
                f"dictionary {self.dictionary} has {most} markers, the board needs {needed} "
                f"with first_id {self.first_id}"
            )
        return self

    @property
    def _markers(self) -> cv2.aruco.Dictionary:
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))

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
            self._markers,
            ids,
        )
        board.setLegacyPattern(self.legacy)
        return board

    @cached_property
    def ink(self) -> Ink:  # noqa: D102
        board = self.board
        bits = self._markers.markerSize + 2  # with a black rim
        cell = self.marker / bits
        boxes = [super().ink.rectangles]
        for name, corners in zip(
            np.ravel(board.getIds()), board.getObjPoints(), strict=True
        ):
            picture = self._markers.generateImageMarker(int(name), bits)
            corner = np.asarray(corners)[:, :2].min(axis=0) - self.spacing
            places = corner + np.argwhere(picture == 0)[:, ::-1] * cell
            boxes.append(np.column_stack([places, np.full(places.shape, cell)]))
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
}

AnyTarget = Annotated[Target, OneOf(DotGrid, Chessboard, Charuco, key="kind")]


def target_from_dict(content: Any, name: str) -> Target:
    """Check the description of a target; errors name the file (or `name`) and the key."""
    if isinstance(content, dict):
        if content.get("kind") in ("circles", "aprilgrid") or content.get("inverted"):
            raise ValueError(
                f"{name}: circle grids, AprilGrids and targets that are white on black are no "
                "longer found; film a chessboard, charuco or one of the vicalib sheets"
            )
        # A description of 0.2.0 says that it is not inverted; null is a default.
        content = {
            key: value
            for key, value in content.items()
            if key != "inverted" and value is not None
        }
    target: Target = from_content(AnyTarget, content, name)
    return target
