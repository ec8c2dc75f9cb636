"""Folders of published frames: any known layout opens in one call, told by the names of its files."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from endolab.io.atomic import PathLike, one_sentence
from endolab.io.datasets.c3vd import list_c3vd, read_c3vd, read_c3vd_depth
from endolab.io.datasets.sample import Sample, files_by_number
from endolab.io.datasets.simcol3d import read_simcol3d, read_simcol3d_depth
from endolab.numerics.arrays import FloatArray


@dataclass(frozen=True)
class Folder:
    """The frames of a folder whose layout is known; a sequence of `Sample`, read when asked for.

    Names are paths from the folder, which may hold several sequences.
    """

    path: Path
    layout: str  # "c3vd" or "simcol3d"
    _places: dict[
        str, tuple[Path, int]
    ]  # of each frame: the folder of its sequence, and its number

    @property
    def names(self) -> tuple[str, ...]:
        """The frames' colour pictures, in order."""
        return tuple(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, which: int | str) -> Sample:
        """Load a frame by its position or by its name in `names`."""
        name = which if isinstance(which, str) else self.names[which]
        if name not in self._places:
            raise ValueError(f"{self.path}: there is no frame {name}")
        read = read_c3vd if self.layout == "c3vd" else read_simcol3d
        return read(*self._places[name])


def _find_frames(place: Path, prefix: str = "") -> dict[str, dict[str, tuple[Path, int]]]:
    """Find the frames that lie in a folder, by data set."""
    simcol3d = files_by_number(place, "", r"FrameBuffer_(\d{4})\.png")
    return {
        layout: {prefix + name: (place, number) for number, name in colours.items()}
        for layout, colours in (("c3vd", list_c3vd(place)), ("simcol3d", simcol3d))
    }


def open_dataset(path: PathLike) -> Folder:
    """Open a folder of published frames, or of such folders; the layout is told from the names of the files.

    Parameters
    ----------
    path : path
        C3VD (`N_color.png` with `N_depth.tiff`, in one folder or in `color/` and `depth/`), C3VDv2
        (`rgb/N.png` with `depth/N_depth.tiff`) or SimCol3D (`FrameBuffer_NNNN.png` with `Depth_NNNN.png`);
        or a folder that holds sequences of one of these.

    Returns
    -------
    Folder
        Has a length and is indexed: ``open_dataset(path)[0]`` is a `Sample`. The name of a frame of several
        sequences begins with its own: ``cecum_t1_a/0000_color.png``.

    Raises
    ------
    OSError, ValueError
        In one sentence, if there is no such folder, or no layout or more than one fits.
    """
    place = Path(path)
    with one_sentence(f"{place}: cannot be read"):
        if not place.is_dir():
            raise FileNotFoundError(f"{place}: there is no such folder")
        inside = sorted(entry for entry in place.iterdir() if entry.is_dir())
    found = _find_frames(place)
    for sequence in () if any(found.values()) else inside:
        for layout, frames in _find_frames(sequence, f"{sequence.name}/").items():
            found[layout] |= frames
    fitting = [layout for layout, frames in found.items() if frames]
    if len(fitting) != 1:
        known = "C3VD's N_color.png, C3VDv2's rgb/N.png or SimCol3D's FrameBuffer_NNNN.png"
        other = " and ".join(fitting) or "other files"
        raise ValueError(f"{place}: expected {known}, or folders of these, found {other}")
    return Folder(place, fitting[0], found[fitting[0]])


def depth_layout(path: PathLike) -> str | None:
    """Tell from its name alone of which data set a file is a depth map: "c3vd", "simcol3d", or None."""
    name = Path(path).name.lower()
    if name.endswith(("_depth.png", "_depth.tiff")):
        return "c3vd"
    return "simcol3d" if name.startswith("depth_") and name.endswith(".png") else None


def true_z(path: PathLike) -> FloatArray:
    """Read true z, (H, W), mm, from a data set's depth map, told by its name; nan where unknown."""
    layout = depth_layout(path)
    if layout is None:
        names = "C3VD's NNNN_depth.png (.tiff) or SimCol3D's Depth_NNNN.png"
        raise ValueError(f"{path}: expected {names}")
    z, known, _ = (read_c3vd_depth if layout == "c3vd" else read_simcol3d_depth)(path)
    return np.where(known, z, np.nan)
