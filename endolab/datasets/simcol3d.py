"""SimCol3D (Rau et al., 2023): rendered frames of a colon with its depth."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from endolab.datasets.known_endoscopes import CALIBRATIONS
from endolab.datasets.sample import Sample, colour_picture, one_of, stored_depth, true_distance
from endolab.io.atomic import PathLike
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.preprocessing.frame import Frame


def read_simcol3d_depth(path: PathLike) -> tuple[FloatArray, BoolArray]:
    """Read a depth map of SimCol3D.

    Parameters
    ----------
    path : path
        `Depth_NNNN.png`, 16 bits: z in cm is the value / 256 / 255 · 20.

    Returns
    -------
    z : (H, W) float array
        mm.
    known : (H, W) bool array
        Where it is above 0.
    """
    stored = stored_depth(Path(path), "uint16", 200 / 65280)
    if stored.max() > 65280:
        raise ValueError(f"{path}: expected values up to 65280, which is 200 mm, found {stored.max()}")
    return stored / 256 / 255 * 200, stored > 0


def read_simcol3d(folder: PathLike, index: int) -> Sample:
    """Load a frame of SimCol3D: `FrameBuffer_NNNN.png` and `Depth_NNNN.png` in one folder.

    Parameters
    ----------
    folder : path
    index : int
        NNNN.

    Returns
    -------
    Sample
        The whole picture is in the mask.
    """
    place = Path(folder)
    colour = one_of(place, [f"FrameBuffer_{index:04d}.png"])
    depth = one_of(place, [f"Depth_{index:04d}.png"])
    z, known = read_simcol3d_depth(depth)
    known_as = CALIBRATIONS["simcol3d"]
    distance = true_distance(z, known, known_as.camera, depth)
    image = colour_picture(colour, z.shape)
    image = np.minimum(image * 65535 / 65280, 1.0)  # bytes in the upper half of 16 bits
    return Sample(Frame(image, np.ones(image.shape[:2], bool), colour.name), known_as, distance)
