"""Folders of published frames: any known layout opens in one call, told by the names of its files."""

import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from endolab.io.atomic import PathLike, as_path, one_sentence
from endolab.io.datasets import endoslam, hamlyn, scared
from endolab.io.datasets.c3vd import list_c3vd, read_c3vd, read_c3vd_depth
from endolab.io.datasets.sample import Sample, data_folder, files_by_number
from endolab.io.datasets.simcol3d import read_simcol3d, read_simcol3d_depth
from endolab.io.datasets.ucl2019 import read_ucl2019, read_ucl2019_depth
from endolab.model.cameras import Camera
from endolab.numerics.arrays import FloatArray

# What reads a frame of a folder by its number.
NUMBERED = {
    "c3vd": read_c3vd,
    "hamlyn": hamlyn.read_hamlyn,
    "endoslam": endoslam.read_endoslam,
}
# What reads a depth map.
DEPTHS: dict[str, Callable[[PathLike], tuple[Any, ...]]] = {
    "c3vd": read_c3vd_depth,
    "simcol3d": read_simcol3d_depth,
    "ucl2019": read_ucl2019_depth,
    "scared": scared.read_scared_depth,
    "endoslam": endoslam.read_endoslam_depth,
}
# Of frames, by the names of their colour pictures, in order.
Readers = dict[str, Callable[[], Sample]]


@dataclass(frozen=True)
class Folder:
    """The frames of a folder whose layout is known; a sequence of `Sample`, read when asked for.

    Names are paths from the folder, which may hold several sequences.
    """

    path: Path
    layout: str  # "c3vd", "simcol3d", "ucl2019", "hamlyn", "endoslam" or "scared"
    _readers: Readers

    @property
    def names(self) -> tuple[str, ...]:
        """The frames' colour pictures, in order."""
        return tuple(self._readers)

    def __len__(self) -> int:
        return len(self._readers)

    def __getitem__(self, which: int | str) -> Sample:
        """Load a frame by its position or by its name in `names`."""
        name = which if isinstance(which, str) else self.names[which]
        if name not in self._readers:
            raise ValueError(f"{self.path}: there is no frame {name}")
        return self._readers[name]()


def _find_frames(place: Path, camera: Camera | None) -> dict[str, Readers]:
    """Find the frames that lie in a folder, by data set."""
    found: dict[str, Readers] = {"simcol3d": {}, "ucl2019": {}, "scared": {}}
    lists = {"c3vd": list_c3vd(place)}
    lists["hamlyn"] = files_by_number(place, *hamlyn.COLOURS)
    lists["endoslam"] = files_by_number(place, *endoslam.COLOURS)
    for layout, colours in lists.items():
        read = NUMBERED[layout]
        found[layout] = {name: partial(read, place, n) for n, name in colours.items()}
    if (place / scared.COLOUR).exists():
        found["scared"] = {scared.COLOUR: partial(scared.read_scared, place)}
    with one_sentence(f"{place}: cannot be read"):
        names = sorted(entry.name for entry in place.iterdir())
    for name in names:
        if match := re.fullmatch(r"FrameBuffer_(\d{4})\.png", name):
            found["simcol3d"][name] = partial(read_simcol3d, place, int(match[1]))
        elif match := re.fullmatch(r"(.+)_FrameBuffer_(\d{4})\.png", name):
            if camera is None:
                raise ValueError(
                    f"{place}: the camera of UCL 2019 is not published; give one"
                )
            found["ucl2019"][name] = partial(
                read_ucl2019, place, match[1], int(match[2]), camera
            )
    return found


def open_dataset(path: PathLike, camera: Camera | None = None) -> Folder:
    """Open a folder of published frames, or of such folders; the layout is told from the names of the files.

    Parameters
    ----------
    path : path
        C3VD (`N_color.png` with `N_depth.tiff`, in one folder or in `color/` and `depth/`), C3VDv2
        (`rgb/N.png` with `depth/N_depth.tiff`), SimCol3D (`FrameBuffer_NNNN.png` with `Depth_NNNN.png`),
        UCL 2019 (`…_FrameBuffer_NNNN.png` with `…_Depth_NNNN.png`), Hamlyn's rectified videos
        (`image01/N.jpg` with `depth01/N.png`), EndoSLAM's Unity camera (`Frames/` with `Pixelwise Depths/`)
        or SCARED (`Left_Image.png` with `left_depth_map.tiff`); or a folder that holds sequences of one of
        these.
    camera : Camera, optional
        Needed for UCL 2019, whose camera is not published, and refused for the others.

    Returns
    -------
    Folder
        Has a length and is indexed: ``open_dataset(path)[0]`` is a `Sample`. The name of a frame of several
        sequences begins with its own: ``cecum_t1_a/0000_color.png``.

    Raises
    ------
    OSError, ValueError
        In one sentence, if there is no such folder, no layout or more than one fits, or the camera
        is missing or too many.
    """
    place = as_path(path)
    with one_sentence(f"{place}: cannot be read"):
        if not place.is_dir():
            raise FileNotFoundError(f"{place}: there is no such folder")
        inside = sorted(entry for entry in place.iterdir() if entry.is_dir())
    found = _find_frames(place, camera)
    for sequence in () if any(found.values()) else inside:
        for layout, readers in _find_frames(sequence, camera).items():
            found[layout] |= {
                f"{sequence.name}/{name}": read for name, read in readers.items()
            }
    fitting = sorted(layout for layout, readers in found.items() if readers)
    if len(fitting) != 1:
        raise ValueError(
            f"{place}: expected C3VD's N_color.png, C3VDv2's rgb/N.png, SimCol3D's FrameBuffer_NNNN.png, "
            "UCL 2019's …_FrameBuffer_NNNN.png, Hamlyn's image01/N.jpg, EndoSLAM's Frames/image_NNNN.png or "
            "SCARED's Left_Image.png, or folders of these, found "
            f"{' and '.join(fitting) or 'other files'}"
        )
    layout = fitting[0]
    if layout != "ucl2019" and camera is not None:
        raise ValueError(f"{place}: the camera of {layout} is known; give none")
    return Folder(place, layout, found[layout])


def find_dataset(layout: str, prefer: str = "") -> Folder | None:
    """Find published frames on this machine: in `data_folder`, or in a folder that lies in it.

    Parameters
    ----------
    layout : {"c3vd", "simcol3d"}
        Of which data set.
    prefer : str
        What the folder's name should hold, if there are several.

    Returns
    -------
    Folder or None
        The first by name, whatever it is called; None if there is none, or no `data_folder`.
    """
    place = data_folder()
    if place is None:
        return None
    inside = [*sorted(entry for entry in place.iterdir() if entry.is_dir()), place]
    for folder in sorted(inside, key=lambda folder: prefer not in folder.name):
        with suppress(OSError, ValueError):  # other files, or other data
            dataset = open_dataset(folder)
            if dataset.layout == layout:
                return dataset
    return None


def depth_layout(path: PathLike) -> str | None:
    """Tell from its name alone of which data set a file is a depth map: a key of `DEPTHS`, or None."""
    name = Path(path).name.lower()
    if name == scared.DEPTH:
        return "scared"
    if name.endswith(("_depth.png", "_depth.tiff")):
        return "c3vd"
    if not name.endswith(".png"):
        return None
    for beginning, layout in {"depth_": "simcol3d", "aov_image_": "endoslam"}.items():
        if name.startswith(beginning):
            return layout
    return "ucl2019" if "_depth_" in name else None


def true_z(path: PathLike) -> FloatArray:
    """Read true z, (H, W), mm, from a data set's depth map, told by its name; nan where unknown."""
    layout = depth_layout(path)
    if layout is None:
        raise ValueError(
            f"{path}: expected C3VD's NNNN_depth.png (.tiff), SimCol3D's Depth_NNNN.png, UCL 2019's "
            "…_Depth_NNNN.png, SCARED's left_depth_map.tiff or EndoSLAM's aov_image_NNNN.png"
        )
    z, known, *_ = DEPTHS[layout](path)
    return np.where(known, z, np.nan)
