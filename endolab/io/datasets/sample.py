"""A published frame with truth, and what the loaders of all data sets check.

Every sample comes out the same way: a `Frame`, a `Calibration` of its size, and Euclidean
distances in mm, nan where the truth is unknown. Nothing is downloaded. `folders.open_dataset`
opens any layout; EndoMapper's calibrations are in `endomapper`.
"""

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from endolab.frames.frame import Frame, check_size
from endolab.io.atomic import PathLike
from endolab.io.images import read_image, read_stored
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class Sample:
    """A published frame."""

    frame: Frame
    calibration: Calibration  # of the frame's size; its gain is unknown
    distance: FloatArray  # (H, W), true, Euclidean, mm; nan where unknown


def data_folder() -> Path | None:
    """Folder of published frames, which $ENDOLAB_DATA names; None if there is none."""
    named = os.environ.get("ENDOLAB_DATA")
    return Path(named) if named and os.path.isdir(named) else None


# Layouts -------------------------------------------------------------------------------------
def read_stored_depth(path: PathLike, step: float) -> np.ndarray:
    """Read a depth map's numbers, one channel of 16 bits in steps of `step` mm."""
    stored = read_stored(path)[0]
    if stored.ndim != 2 or stored.dtype != np.uint16:
        found = f"{stored.dtype} of shape {stored.shape}"
        raise ValueError(f"{path}: expected one channel of uint16, found {found}")
    if stored.max() * step < 2:  # mm; no endoscope has all it sees nearer
        raise ValueError(
            f"{path}: no depth beyond 2 mm in the data set's unit, by its name; --truth-unit says another"
        )
    return stored


def files_by_number(folder: PathLike, place: str, pattern: str) -> dict[int, str]:
    """Find the files at a place in a folder whose names are a pattern with one group, a number.

    Returns their paths from the folder, in the order of the numbers.
    """
    paths = Path(folder, place).glob("*")
    matches = (re.fullmatch(pattern, path.name) for path in paths)
    found = {int(m[1]): Path(place, m[0]).as_posix() for m in matches if m}
    return dict(sorted(found.items()))


def load_sample(
    folder: PathLike,
    colour_name: str,
    depth_name: str,
    read_depth: Callable[[PathLike], tuple[FloatArray, BoolArray, BoolArray]],
    calibration: Calibration,
) -> Sample:
    """Load a frame and its truth from two files of a folder.

    `read_depth` returns z, mm, where it is known, and what the endoscope shows. The calibration follows
    pictures that were shrunk in proportion.
    """
    colour = Path(folder) / colour_name
    depth = Path(folder) / depth_name
    image = read_image(colour)
    z, known, mask = read_depth(depth)
    rows, columns = z.shape
    camera = calibration.camera
    if columns < camera.width and rows == round(camera.height * columns / camera.width):
        calibration = calibration.resize(columns, rows)
        camera = calibration.camera
    check_size(str(depth), (columns, rows), camera)
    if image.shape != (rows, columns, 3):
        raise ValueError(
            f"{colour}: expected colours of {columns}x{rows} px as its depth map, "
            f"found the shape {image.shape}"
        )
    forward = np.where(camera.field.cos_alpha > 0, camera.field.cos_alpha, np.nan)
    distance = np.where(known, z, np.nan) / forward
    return Sample(Frame(image, mask, colour.name), calibration, distance)
