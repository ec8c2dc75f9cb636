"""What of a surface goes to the page that turns it: points on a thinned grid, its picture, its box."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from endolab.numerics.arrays import BoolArray, FloatArray, IndexArray
from endolab.numerics.checks import told
from endolab.plots.scales import lifted
from endolab.tuning.pictures import grey_or_colour

COLUMNS, ROWS = 320, 240  # of points at most: what a panel can show
TEXTURE = 640  # columns of the picture at most, px
OUTLYING = 1.0  # %, of the points lie beyond each face of the box: spikes must not make the rest small
KEPT = 1.25  # the box stays if the new one is larger or smaller, or its middle is off, by less than this
KINDS = {
    "distance": "real numbers",
    "rays": "real numbers",
    "picture": "bytes or real numbers",
    "cuts": "bool",
}


@dataclass(frozen=True)
class Shown:
    """What `SurfaceView.show` was given; a ValueError says in one sentence what does not fit."""

    distance: FloatArray
    rays: FloatArray
    picture: np.ndarray
    cuts: BoolArray | None
    unit: str
    lift: bool

    def __post_init__(self) -> None:
        for name, kinds in (("distance", "f"), ("rays", "f"), ("picture", "fB"), ("cuts", "b")):
            array = getattr(self, name)
            if array is None and name == "cuts":
                continue
            if not (
                isinstance(array, np.ndarray)
                and (array.dtype.kind in kinds or array.dtype.char in kinds)
                and array.size
            ):
                raise ValueError(f"{name} must be an array of {KINDS[name]}, got {told(array)}")
        if self.distance.ndim != 2:
            raise ValueError(f"distance must have two axes, found the shape {self.distance.shape}")
        shape, size = self.distance.shape, self.picture.shape
        for name, needed in (("rays", (*shape, 3)), ("cuts", (2, *shape))):
            array = getattr(self, name)
            if array is not None and array.shape != needed:
                raise ValueError(f"{name} must have shape {needed}, as the distance has, found {array.shape}")
        if len(size) not in (2, 3) or size[2:] not in ((), (3,)):
            raise ValueError(f"picture must have shape (h, w, 3) or (h, w), found {size}")
        # Frames are shrunk to whole pixels.
        if abs(size[0] * shape[1] - size[1] * shape[0]) > max(*shape, *size[:2]):
            raise ValueError(
                f"a picture of {size[1]}x{size[0]} px has not the proportions of {shape[1]}x{shape[0]} px"
            )

    @property
    def texture(self) -> NDArray[np.uint8]:
        """The picture as it is seen, (h, w, 3)."""
        picture = self.picture
        less = TEXTURE / picture.shape[1]
        if less < 1:
            picture = cv2.resize(picture, None, fx=less, fy=less, interpolation=cv2.INTER_AREA)
        if picture.dtype == np.uint8:
            picture = picture / 255
        return grey_or_colour(lifted(picture) if self.lift else picture)

    @property
    def known(self) -> BoolArray:
        """Pixels that have a distance, (H, W)."""
        return np.isfinite(self.distance) & (self.distance > 0)


def thinned(shape: tuple[int, ...]) -> tuple[IndexArray, IndexArray]:
    """Rows and columns of a picture of that shape that have a point: evenly, the outermost ones too."""
    less = max(1.0, shape[0] / ROWS, shape[1] / COLUMNS)
    first, second = (np.linspace(0, n - 1, max(1, int(n / less))).round().astype(np.int32) for n in shape)
    return first, second


def thinned_links(joined: BoolArray, rows: IndexArray, columns: IndexArray) -> BoolArray:
    """Steps between the points that are left, (2, h, w): those on whose way no step is missing."""
    out = np.zeros((2, len(rows), len(columns)), dtype=bool)
    missing = np.cumsum(~joined[0, rows], axis=1)  # up to and with the step from each column to the next
    before = np.where(columns > 0, missing[:, columns - 1], 0)
    out[0, :, :-1] = before[:, 1:] == before[:, :-1]
    missing = np.cumsum(~joined[1][:, columns], axis=0)
    before = np.where(rows[:, None] > 0, missing[rows - 1], 0)
    out[1, :-1] = before[1:] == before[:-1]
    return out


def grid_of(rays: FloatArray, rows: IndexArray, columns: IndexArray) -> bytes:
    """Of each point its ray, and its place in the picture, to the right and down, in [0, 1]."""
    grid = np.empty((len(rows), len(columns), 5), np.float32)
    grid[..., :3] = rays[np.ix_(rows, columns)]
    grid[..., 3] = (columns + 0.5) / rays.shape[1]
    grid[..., 4] = ((rows + 0.5) / rays.shape[0])[:, None]
    return np.where(np.isfinite(grid), grid, 0).astype(np.float32).tobytes()


def box_of(points: FloatArray) -> list[float]:
    """Least and greatest x, y, z of points (n, 3), but for a few that lie far out."""
    return [float(value) for value in np.percentile(points, [OUTLYING, 100 - OUTLYING], axis=0).ravel()]


def keeps(box: list[float], other: list[float]) -> bool:
    """Whether another surface can be seen in the box of the one before."""
    if not box:
        return False
    corners = np.reshape([box, other], (2, 2, 3))  # box, end, axis
    size, other_size = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=-1)
    off = np.linalg.norm(corners[1].mean(axis=0) - corners[0].mean(axis=0))
    return bool(other_size / KEPT <= size <= KEPT * other_size and off <= (KEPT - 1) * size)
