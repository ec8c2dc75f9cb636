"""Calibration targets: what is printed on the sheet, where, and which of it is a feature.

A target has a frame of its own: x right and y down on the sheet, z into it, the origin at the
feature in the upper left; all in mm. A sheet that is folded along one line has two flat panels,
each with a pose of its own, and keeps the coordinates that it had before.
"""

import re
from dataclasses import field, replace
from functools import cached_property
from typing import Annotated, ClassVar, Literal, Self

import cv2
import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from endolab.numerics.arrays import FloatArray, IntArray
from endolab.numerics.checked_types import OneOf, Whole, checked

Length = Annotated[float, Field(ge=1e-3, le=1e6)]  # mm
Count = Annotated[Whole, Field(ge=4, le=100)]


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
    columns: Count
    rows: Count
    spacing: Length  # between neighbours, or the side of a square, mm
    margin: Length = 10.0  # white paper around the features, mm

    fold: ClassVar[int | None] = None
    found_whole: ClassVar[bool] = False  # or not at all
    inner: ClassVar[int] = 0  # features are so many fewer than columns, and than rows

    @cached_property
    def points(self) -> FloatArray:
        """Features in the target's frame, (n, 3), mm; their row is their id."""
        places = _lattice(self.columns - self.inner, self.rows - self.inner)
        return np.insert(places * self.spacing, 2, 0, axis=1)

    @property
    def radii(self) -> FloatArray:
        """Radius of the disc that each feature is the centre of, (n,), mm; 0 for corners."""
        return np.zeros(len(self.points))

    @property
    def discs(self) -> FloatArray:
        """Printed discs, (n, 4): centre x, y and radius, mm, and reflectance; 0 for black ink."""
        return np.zeros((0, 4))

    @property
    def grey_discs(self) -> FloatArray:
        """Those of `discs` that are grey; reflectances are relative to the white of the paper."""
        return self.discs[self.discs[:, 3] > 0]

    @property
    def squares(self) -> FloatArray:
        """Printed black squares, (n, 3): left, top and side, mm."""
        return np.zeros((0, 3))

    def white_places(self) -> FloatArray:
        """Places where bare paper can be read, (n, 3): x, y, and the radius that is bare, mm."""
        raise NotImplementedError

    @property
    def fold_x(self) -> float:
        """Where the fold runs in the target's frame, mm; inf for a flat sheet."""
        return np.inf if self.fold is None else (self.fold - 0.5) * self.spacing

    def panel_of(self, xy: ArrayLike) -> IntArray:
        """Panel of places on the sheet, (..., 2 or 3), mm: 0, or 1 to the right of the fold."""
        return (np.asarray(xy)[..., 0] > self.fold_x).astype(int)

    @property
    def panels(self) -> int:
        """Number of flat panels."""
        return 1 if self.fold is None else 2

    @property
    def sheet(self) -> tuple[float, float, float, float]:
        """Left, top, width and height of the paper in the target's frame, mm."""
        beside = (self.radii.max() or self.spacing) + self.margin
        left, top = self.points[0, :2] - beside
        right, bottom = self.points[-1, :2] + beside
        return float(left), float(top), float(right - left), float(bottom - top)


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
    # The sheet is folded between this many columns on the left and the rest.
    fold: Whole | None = None  # type: ignore[misc]

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.fold is not None and not 2 <= self.fold <= self.columns - 2:
            raise ValueError(
                f"fold must leave two columns of dots on each side, got {self.fold} of {self.columns}"
            )
        if not self.small < self.large < self.spacing / 2:
            raise ValueError(
                f"the radii must be small < large < spacing / 2, got small {self.small}, "
                f"large {self.large}, spacing {self.spacing}"
            )
        return self

    @cached_property
    def code(self) -> IntArray:
        """1 where the dot is large, (rows, columns)."""
        random = np.random.RandomState(self.seed)
        words = random.randint(2**32, size=(self.rows, self.columns), dtype=np.uint32)
        return (words >> 31).astype(int)

    @cached_property
    def radii(self) -> FloatArray:  # noqa: D102
        return np.where(self.code.ravel() == 1, self.large, self.small)

    def _between(self, grey: bool) -> FloatArray:
        """Largest discs between four dots that are, or are not, for grey, (n, 3); none on the fold."""
        cells = _lattice(self.columns - 1, self.rows - 1)
        is_grey = (cells.sum(axis=1) % 2 == 0) & (self.greys is not None)
        cells = cells[(is_grey == grey) & (cells[:, 0] != (self.fold or 0) - 1)]
        radius = self.spacing / np.sqrt(2) - self.large
        return np.insert((cells + 0.5) * self.spacing, 2, radius, axis=1)

    @cached_property
    def discs(self) -> FloatArray:  # noqa: D102
        dots = np.column_stack([self.points[:, :2], self.radii])
        greys = self._between(grey=True) * [1, 1, 0.75]
        return np.concatenate(
            [np.insert(dots, 3, 0, axis=1), np.insert(greys, 3, self.greys or 0, axis=1)]
        )

    def white_places(self) -> FloatArray:  # noqa: D102
        return self._between(grey=False)


@checked
class Board(Target):
    """Black and white squares, `columns` × `rows`; the features are their inner corners."""

    inner: ClassVar[int] = 1

    @property
    def first_black(self) -> int:
        """Of the first row, which square is the first black one."""
        return 0

    def _squares_of(self, colour: int) -> FloatArray:
        """Left, top and side, mm, of the black squares, 0, or of the white ones, 1."""
        places = _lattice(self.columns, self.rows)
        chosen = places[(places.sum(axis=1) + self.first_black) % 2 == colour]
        return np.insert(chosen - 1, 2, 1, axis=1) * self.spacing

    @cached_property
    def squares(self) -> FloatArray:  # noqa: D102
        return self._squares_of(0)


@checked
class Chessboard(Board):
    """A chessboard of `columns` × `rows` squares."""

    kind: Literal["chessboard"] = field(default="chessboard", kw_only=True, repr=False)

    found_whole: ClassVar[bool] = True

    def white_places(self) -> FloatArray:  # noqa: D102
        return self._squares_of(1) + np.array([1, 1, -1]) * self.spacing / 2


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
        most = len(self._markers.bytesList)
        needed = self.first_id + self.columns * self.rows // 2
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
        board = cv2.aruco.CharucoBoard(size, self.spacing, self.marker, self._markers, ids)
        board.setLegacyPattern(self.legacy)
        return board

    @cached_property
    def squares(self) -> FloatArray:  # noqa: D102
        bits = self._markers.markerSize + 2  # with a black rim
        cell = self.marker / bits
        parts = [self._squares_of(0)]
        border = (self.spacing - self.marker) / 2
        for number, corner in enumerate(self._squares_of(1)[:, :2] + border):
            marker = self._markers.generateImageMarker(self.first_id + number, bits)
            black = np.argwhere(marker == 0)[:, ::-1]
            parts.append(np.insert(corner + cell * black, 2, cell, axis=1))
        return np.concatenate(parts)

    def white_places(self) -> FloatArray:
        """In the upper left of each white square, where the white around its marker is widest."""
        radius = (self.spacing - self.marker) / 2 * (2 - np.sqrt(2))
        return np.insert(self._squares_of(1)[:, :2] + radius, 2, radius, axis=1)


_SMALL = DotGrid(19, 10, 4.2238, 8.0, small=0.8471, large=1.2661)
TARGETS: dict[str, Target] = {
    "vicalib_big": DotGrid(19, 10, 5.2797, small=1.05885, large=1.58266),
    "vicalib_small": _SMALL,
    "vicalib_folded": replace(_SMALL, fold=9),
    "vicalib_grey": replace(_SMALL, greys=0.5),
    "charuco": Charuco(12, 8, 7.0, marker=5.2),
    "chessboard": Chessboard(12, 8, 7.0),
}
AnyTarget = Annotated[Target, OneOf(DotGrid, Chessboard, Charuco, key="kind")]
PRINTED = "chessboard:14x9:3mm, charuco:11x8:15mm:11mm:4X4_50"


def target_in_words(words: str) -> Target | None:
    """Read a board as it is bought, printed squares and mm, as in `PRINTED`; None for other words.

    ``chessboard:14x9:3mm``, ``charuco:11x8:15mm:11mm:4X4_50``; with ``:legacy`` as before OpenCV 4.6.
    """
    length = r"(\d*\.?\d+)(?:mm)?"
    markers = rf":{length}:(?:DICT_)?(\w+)(:legacy)?"
    board = rf"(chessboard|charuco):(\d+)x(\d+)(?::{length}(?:{markers})?)?"
    found = re.fullmatch(board, words)
    if not found:
        return None
    kind, columns, rows, side, marker, dictionary, old = found.groups()
    if side is None or (kind == "charuco") != (marker is not None):
        raise ValueError(f"{words} is no whole board: add :SIZEmm, as in {PRINTED}")
    size = int(columns), int(rows), float(side)
    if kind == "chessboard":
        return Chessboard(*size)
    return Charuco(
        *size,
        marker=float(marker),
        dictionary=f"DICT_{dictionary}",
        legacy=old is not None,
    )
