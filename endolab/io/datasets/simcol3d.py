"""SimCol3D (Rau et al., 2023): rendered frames of a colon with its depth."""

from dataclasses import replace

import numpy as np

from endolab.io.atomic import PathLike
from endolab.io.datasets.known_endoscopes import CALIBRATIONS
from endolab.io.datasets.sample import Sample, load_sample, read_stored_depth
from endolab.numerics.arrays import BoolArray, FloatArray


def read_simcol3d_depth(path: PathLike) -> tuple[FloatArray, BoolArray, BoolArray]:
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
    seen : (H, W) bool array
        All of it.
    """
    stored = read_stored_depth(path, 200 / 65280)
    return stored / 256 / 255 * 200, stored > 0, np.ones(stored.shape, dtype=bool)


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
    colour = f"FrameBuffer_{index:04d}.png"
    depth = f"Depth_{index:04d}.png"
    sample = load_sample(
        folder, colour, depth, read_simcol3d_depth, CALIBRATIONS["simcol3d"]
    )
    # Bytes in the upper half of 16 bits.
    image = np.minimum(sample.frame.image * 65535 / 65280, 1.0)
    return replace(sample, frame=replace(sample.frame, image=image))
