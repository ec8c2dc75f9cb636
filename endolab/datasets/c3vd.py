"""C3VD (Bobrow et al., 2023): frames of a colon phantom with its depth."""

from endolab.datasets.known_endoscopes import CALIBRATIONS
from endolab.datasets.sample import Sample, load_sample, stored_depth
from endolab.io.atomic import PathLike
from endolab.numerics.arrays import BoolArray, FloatArray


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
    stored = stored_depth(path, "uint16", 1 / 655.35)
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
    depths = f"{index:04d}_depth.png", f"{index:04d}_depth.tiff"
    known_as = CALIBRATIONS["c3vd"]
    return load_sample(folder, f"{index:04d}_color.png", depths, read_c3vd_depth, known_as, shrinkable=True)
