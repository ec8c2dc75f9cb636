"""Hamlyn's stereo videos of the abdomen, rectified and given depths by Recasens et al. (2021) [1]_.

Their depths are by stereo matching, not measured. They are said to be in mm, to 300 mm, whether along the
axis is not; z is what stereo gives, and is taken here. The page of the data was not at hand: layout and unit
are as [1]_ and its users' loaders have them.

.. [1] Recasens et al., "Endo-Depth-and-Motion: reconstruction and tracking in endoscopic videos using depth
   networks and photometric constraints", RA-L 2021; github.com/UZ-SLAMLab/Endo-Depth-and-Motion.
"""

from functools import partial
from pathlib import Path

from endolab.io.atomic import PathLike
from endolab.io.datasets.sample import (
    Sample,
    load_sample,
    read_intrinsics,
    read_stored_depth,
)
from endolab.numerics.arrays import BoolArray, FloatArray

COLOURS = ("image01", r"(\d+)\.jpg")  # of the left camera: their folder and names
FARTHEST = 300  # mm, at which depths are cut off


def read_hamlyn_depth(path: PathLike) -> tuple[FloatArray, BoolArray]:
    """Read a depth map of the rectified Hamlyn videos.

    Parameters
    ----------
    path : path
        16 bits: z in mm.

    Returns
    -------
    z : (H, W) float array
        mm, in steps of 1 mm.
    known : (H, W) bool array
        Where it is neither 0 nor 300 mm or more.
    """
    stored = read_stored_depth(path, "uint16", 1.0)
    return stored.astype(float), (stored > 0) & (stored < FARTHEST)


def read_hamlyn(folder: PathLike, index: int) -> Sample:
    """Load a frame of a rectified video of Hamlyn.

    Parameters
    ----------
    folder : path
        `rectifiedNN`, with `image01/N.jpg`, `depth01/N.png` and `intrinsics.txt`.
    index : int
        N, of ten digits.

    Returns
    -------
    Sample
        Of the left camera; the whole picture is in the mask; the light is nominal.
    """
    camera = partial(read_intrinsics, Path(folder) / "intrinsics.txt")
    name = f"{index:010d}"
    pair = (f"image01/{name}.jpg", f"depth01/{name}.png")
    return load_sample(folder, *pair, read_hamlyn_depth, camera)
