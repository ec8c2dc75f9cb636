"""Published frames with truth, and the endoscopes that endolab knows by name.

Every sample comes out the same way: a `Frame`, a `Calibration` of its size, and Euclidean
distances in mm, nan where the truth is unknown. Nothing is downloaded. `folders.open_dataset`
opens any layout; that of UCL 2019 is in `ucl`, EndoMapper's calibrations are in `endomapper`.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from endolab.io.descriptions import Calibration
from endolab.io.images import read_image, read_stored
from endolab.model.cameras import Camera
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.preprocessing.frame import Frame

NEAREST = 2.0  # no endoscope has all it sees nearer, mm


@dataclass(frozen=True)
class Sample:
    """A published frame.

    Attributes
    ----------
    frame : Frame
    calibration : Calibration
        Of the frame's size; its gain is unknown.
    distance : (H, W) float array
        True Euclidean distance, mm; nan where unknown.
    """

    frame: Frame
    calibration: Calibration
    distance: FloatArray


def data_folder() -> Path | None:
    """Folder of published frames: $ENDOLAB_DATA, else ../shared/data beside the checkout; or None."""
    named = os.environ.get("ENDOLAB_DATA")
    folder = Path(named) if named else Path(__file__).resolve().parents[2] / "shared" / "data"
    return folder if folder.is_dir() else None


# Layouts -------------------------------------------------------------------------------------
def stored_depth(path: Path, dtype: str, step: float) -> np.ndarray:
    """Read a depth map's numbers, and refuse what cannot be one in steps of `step` mm.

    Raises
    ------
    OSError, ValueError
        In one sentence, if it cannot be read, has another bit depth or several channels, is black, or
        shows nothing beyond 2 mm, as a map in another unit does.
    """
    stored = read_stored(path)
    if stored.ndim != 2 or stored.dtype != np.dtype(dtype):
        raise ValueError(
            f"{path}: expected one channel of {dtype}, found {stored.dtype} of shape {stored.shape}"
        )
    deepest = float(stored.max()) * step
    if deepest == 0:
        raise ValueError(f"{path}: expected depths, found 0 everywhere")
    if deepest < NEAREST:
        raise ValueError(
            f"{path}: expected depths in steps of {step:.4g} mm, found none beyond {deepest:.2g} mm; "
            "they may be in another unit"
        )
    return stored


def one_of(folder: Path, names: list[str]) -> Path:
    """Return the first of some files that is in a folder."""
    found = [folder / name for name in names if (folder / name).is_file()]
    if not found:
        raise FileNotFoundError(f"{folder}: expected a file {' or '.join(names)}")
    return found[0]


def true_distance(z: FloatArray, known: BoolArray, camera: Camera, path: Path) -> FloatArray:
    """Turn z into Euclidean distance, mm, nan where unknown; complain of another size than the camera's."""
    if z.shape != (camera.height, camera.width):
        raise ValueError(
            f"{path}: expected {camera.width}x{camera.height} px, found {z.shape[1]}x{z.shape[0]} px"
        )
    forward = np.where(camera.field.cos_alpha > 0, camera.field.cos_alpha, np.nan)
    return np.where(known, z, np.nan) / forward


def colour_picture(path: Path, shape: tuple[int, ...]) -> FloatArray:
    """Read the colour picture that belongs to a depth map of some shape: (H, W, 3), in [0, 1]."""
    image = read_image(path)
    if image.shape != (*shape, 3):
        raise ValueError(
            f"{path}: expected colours of {shape[1]}x{shape[0]} px as its depth map, "
            f"found the shape {image.shape}"
        )
    return image
