"""C3VD (Bobrow et al., 2023) and C3VDv2 (Golhar et al., 2025): frames of colon phantoms with their depth."""

import re
from pathlib import Path

from endolab.datasets.known_endoscopes import CALIBRATIONS
from endolab.datasets.sample import Sample, load_sample, stored_depth
from endolab.io.atomic import PathLike
from endolab.numerics.arrays import BoolArray, FloatArray

# Of each folder that a sequence may have for its colours, "" if they lie beside the depths: where these are,
# what follows a colour's number, and the camera. EndoGSLAM moves C3VD's to color and depth, and keeps them as
# color_raw and depth_raw where it makes others of them, without distortion and of 8 bits.
_PLACES = {
    "": ("", "_color", "c3vd"),
    "color_raw": ("depth_raw", "_color", "c3vd"),
    "color": ("depth", "_color", "c3vd"),
    "rgb": ("depth", "", "c3vd_v2"),
}


def _numbered(folder: Path, pattern: str) -> dict[int, str]:
    """Find the files whose names are a number and what a pattern says, in the order of the numbers."""
    matches = (re.fullmatch(pattern, entry.name) for entry in folder.glob("*"))
    files = {int(match[1]): match[0] for match in matches if match}
    return dict(sorted(files.items()))


def list_c3vd(folder: PathLike) -> dict[int, str]:
    """Name the colour pictures of a sequence, as paths from its folder, by their numbers."""
    for place, (_, ending, _) in _PLACES.items():
        names = _numbered(Path(folder) / place, rf"(\d+){ending}\.png")
        if names:
            return {number: (Path(place) / name).as_posix() for number, name in names.items()}
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
    stored = stored_depth(path, "uint16", 1 / 655.35)
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
    usual = f"{index:04d}"
    colour = list_c3vd(folder).get(index, f"{usual}_color.png")
    place, _, known_as = _PLACES[Path(colour).parent.name]
    found = _numbered(Path(folder) / place, r"(\d+)_depth\.(?:png|tiff)").get(index)
    names = (f"{usual}_depth.png", f"{usual}_depth.tiff") if found is None else (found,)
    depths = tuple((Path(place) / name).as_posix() for name in names)
    return load_sample(folder, colour, depths, read_c3vd_depth, CALIBRATIONS[known_as], shrinkable=True)
