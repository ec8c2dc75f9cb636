"""C3VD (Bobrow et al., 2023): frames of a colon phantom with its depth."""

from __future__ import annotations

from pathlib import Path

from endolab.datasets.known_endoscopes import CALIBRATIONS, load_calibration
from endolab.datasets.sample import Sample, colour_picture, one_of, stored_depth, true_distance
from endolab.io.atomic import PathLike
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.preprocessing.frame import Frame


def read_c3vd_depth(path: PathLike) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Read a depth map of C3VD.

    Parameters
    ----------
    path : path
        `NNNN_depth.png` or `.tiff`, 16 bits: z in mm is the value over 655.35; 0 is outside the
        octagon, 65535 is 100 mm or more.

    Returns
    -------
    z : (H, W) float array
        mm.
    known : (H, W) bool array
        Where z is known.
    seen : (H, W) bool array
        The octagon that the endoscope shows.
    """
    stored = stored_depth(Path(path), "uint16", 1 / 655.35)
    return stored / 655.35, (stored > 0) & (stored < 65535), stored > 0


def read_c3vd(folder: PathLike, index: int) -> Sample:
    """Load a frame of C3VD: `NNNN_color.png` and `NNNN_depth.png` or `.tiff` in one folder.

    Parameters
    ----------
    folder : path
    index : int
        NNNN.

    Returns
    -------
    Sample
        The mask is the octagon that the endoscope shows; of 1350×1080 px, or of the data set's
        pictures shrunk in proportion.
    """
    place = Path(folder)
    colour = one_of(place, [f"{index:04d}_color.png"])
    depth = one_of(place, [f"{index:04d}_depth.png", f"{index:04d}_depth.tiff"])
    z, known, seen = read_c3vd_depth(depth)
    known_as = CALIBRATIONS["c3vd"]
    shrunk = load_calibration("c3vd", min(z.shape[1], known_as.camera.width))
    if z.shape == (shrunk.camera.height, shrunk.camera.width):
        known_as = shrunk
    distance = true_distance(z, known, known_as.camera, depth)
    return Sample(Frame(colour_picture(colour, z.shape), seen, colour.name), known_as, distance)
