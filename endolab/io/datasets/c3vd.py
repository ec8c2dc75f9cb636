"""C3VD (Bobrow et al., 2023) and C3VDv2 (Golhar et al., 2025): frames of colon phantoms with their depth."""

from pathlib import Path

from endolab.io.atomic import PathLike
from endolab.io.datasets.known_endoscopes import CALIBRATIONS
from endolab.io.datasets.sample import (
    Sample,
    files_by_number,
    load_sample,
    read_stored_depth,
)
from endolab.numerics.arrays import BoolArray, FloatArray

# Where a sequence may have its colours, and then its depths. EndoGSLAM moves C3VD's into two folders, and
# calls these _raw where it makes others of them, without distortion and of 8 bits.
_PLACES = {"": "", "color_raw": "depth_raw", "color": "depth", "rgb": "depth"}
_SECOND = "rgb"  # C3VDv2's


def list_c3vd(folder: PathLike) -> dict[int, str]:
    """Name the colour pictures of a sequence, as paths from its folder, by their numbers."""
    for place in _PLACES:
        ending = r"\.png" if place == _SECOND else r"_color\.png"
        names = files_by_number(folder, place, rf"(\d+){ending}")
        if names:
            return names
    return {}


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
    stored = read_stored_depth(path, 1 / 655.35)
    return stored / 655.35, (stored > 0) & (stored < 65535), stored > 0


def read_c3vd(folder: PathLike, index: int) -> Sample:
    """Load a frame of a sequence of C3VD or C3VDv2; colour and depth are paired by their numbers.

    Parameters
    ----------
    folder : path
        With `N_color.png` and `N_depth.png` or `.tiff`; or with `color/` and `depth/` for these, as EndoGSLAM
        has them; or with C3VDv2's `rgb/N.png` and `depth/N_depth.tiff`.
    index : int
        N, which may have zeros before it.

    Returns
    -------
    Sample
        The mask is the octagon that the endoscope shows; of 1350×1080 px, or of the data set's
        pictures shrunk in proportion.
    """
    colour = list_c3vd(folder).get(index, f"{index:04d}_color.png")
    place = Path(colour).parent.name
    depths = files_by_number(folder, _PLACES[place], r"(\d+)_depth\.(?:png|tiff)")
    depth = depths.get(index, f"{_PLACES[place] or '.'}/{index:04d}_depth.tiff")
    known_as = CALIBRATIONS["c3vd_v2" if place == _SECOND else "c3vd"]
    return load_sample(folder, colour, depth, read_c3vd_depth, known_as)
