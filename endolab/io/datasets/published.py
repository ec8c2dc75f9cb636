"""Folders of published frames: any known layout opens in one call, told by the names of its files."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from endolab.frames.frame import Frame, check_size
from endolab.io.atomic import PathLike, one_sentence
from endolab.io.datasets.known_endoscopes import CALIBRATIONS
from endolab.io.datasets.sample import Sample
from endolab.io.images import read_image, read_stored
from endolab.numerics.arrays import BoolArray, FloatArray

Pair = tuple[Path, Path | None]  # a colour picture and its depth map


@dataclass(frozen=True)
class Layout:
    """How a data set names the files of a sequence, and what its depth maps hold, 16 bits in one channel."""

    name: str  # which is its endoscope's, too
    places: Mapping[str, str]  # folders where colours may be, and where depths are then
    colour: str  # pattern of the files' names, with one group, the frame's number
    depth: str
    per_mm: float  # numbers of a depth map in a mm of z; 0 is unknown
    far: int = 65536  # what is so far or farther is unknown
    has_rim: bool = False  # whether 0 lies beyond what the endoscope shows
    brightest: int = 65535  # of colours of 16 bits

    def find(self, sequences: Iterable[Path]) -> list[Pair]:
        """Find the frames of sequences, in order: colours and depths are paired by their numbers."""
        pairs: list[Pair] = []
        for sequence in sequences:
            for place, deep in self.places.items():
                colours = files_by_number(sequence / place, self.colour)
                depths = files_by_number(sequence / deep, self.depth)
                pairs += [(colours[number], depths.get(number)) for number in colours]
                if colours:
                    break
        return pairs

    def read_depth(self, path: PathLike) -> tuple[FloatArray, BoolArray]:
        """Read z, (H, W), mm, nan where unknown, and what the endoscope shows."""
        stored = read_stored(path)[0]
        if stored.ndim != 2 or stored.dtype != np.uint16:
            found = f"{stored.dtype} of shape {stored.shape}"
            raise ValueError(f"{path}: expected one channel of uint16, found {found}")
        if stored.max() < 2 * self.per_mm:  # no endoscope has all it sees nearer
            raise ValueError(
                f"{path}: no depth beyond 2 mm in the data set's unit, by its name; --truth-unit says another"
            )
        known = (stored > 0) & (stored < self.far)
        z = np.where(known, stored / self.per_mm, np.nan)
        return z, stored > 0 if self.has_rim else np.ones(stored.shape, bool)

    def read(self, colour: Path, depth: Path | None) -> Sample:
        """Read a frame and its truth; the calibration follows pictures that were shrunk in proportion."""
        image = read_image(colour)
        if depth is None:
            raise FileNotFoundError(f"{colour}: there is no depth map of its number")
        z, mask = self.read_depth(depth)
        rows, columns = z.shape
        calibration = CALIBRATIONS[self.name]
        camera = calibration.camera
        if columns < camera.width and rows == round(camera.height * columns / camera.width):
            calibration = calibration.resize(columns, rows)
            camera = calibration.camera
        check_size(str(depth), (columns, rows), camera)
        if image.shape != (rows, columns, 3):
            raise ValueError(
                f"{colour}: expected colours of {columns}x{rows} px as its depth map, "
                f"found the shape {image.shape}"
            )
        if self.brightest < 65535:
            image = np.minimum(image * 65535 / self.brightest, 1.0)
        forward = np.where(camera.field.cos_alpha > 0, camera.field.cos_alpha, np.nan)
        return Sample(Frame(image, mask, colour.name), calibration, z / forward)


LAYOUTS = (
    # Bobrow et al., 2023: frames of colon phantoms. EndoGSLAM moves them into two folders, and calls these
    # _raw where it makes others of them, without distortion and of 8 bits.
    Layout(
        "c3vd",
        {"": "", "color_raw": "depth_raw", "color": "depth"},
        r"(\d+)_color\.png",
        r"(\d+)_depth\.(?:png|tiff)",
        per_mm=655.35,
        far=65535,
        has_rim=True,
    ),
    # Golhar et al., 2025: more of them.
    Layout(
        "c3vd_v2",
        {"rgb": "depth"},
        r"(\d+)\.png",
        r"(\d+)_depth\.(?:png|tiff)",
        per_mm=655.35,
        far=65535,
        has_rim=True,
    ),
    # Rau et al., 2023: rendered frames of a colon. z in cm is the number / 256 / 255 · 20; colours are bytes
    # in the upper half of 16 bits.
    Layout(
        "simcol3d",
        {"": ""},
        r"FrameBuffer_(\d{4})\.png",
        r"Depth_(\d{4})\.png",
        per_mm=256 * 255 / 200,
        brightest=65280,
    ),
)


@dataclass(frozen=True)
class Folder:
    """The frames of a folder whose layout is known; a sequence of `Sample`, read when asked for.

    Names are paths from the folder, which may hold several sequences.
    """

    path: Path
    layout: Layout
    pairs: Mapping[str, Pair]  # of each frame, by its colour picture's name

    @property
    def names(self) -> tuple[str, ...]:
        """The frames' colour pictures, in order."""
        return tuple(self.pairs)

    def __len__(self) -> int:
        return len(self.pairs)

    def __getitem__(self, which: int | str) -> Sample:
        """Load a frame by its position or by its name in `names`."""
        name = which if isinstance(which, str) else self.names[which]
        if name not in self.pairs:
            raise ValueError(f"{self.path}: there is no frame {name}")
        return self.layout.read(*self.pairs[name])


def files_by_number(folder: Path, pattern: str) -> dict[int, Path]:
    """Find the files of a folder whose names are a pattern with one group, a number, in their order."""
    matches = ((re.fullmatch(pattern, path.name), path) for path in folder.glob("*"))
    return dict(sorted((int(found[1]), path) for found, path in matches if found))


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
        Has a length and is indexed: ``open_dataset(path)[0]`` is a `Sample`, whose mask is what the endoscope
        shows. The name of a frame of several sequences begins with its own: ``cecum_t1_a/0000_color.png``.

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
    for sequences in ([place], inside):
        found = [(layout, layout.find(sequences)) for layout in LAYOUTS]
        fitting = [(layout, pairs) for layout, pairs in found if pairs]
        if fitting:
            break
    if len(fitting) != 1:
        known = "C3VD's N_color.png, C3VDv2's rgb/N.png or SimCol3D's FrameBuffer_NNNN.png"
        other = " and ".join(layout.name for layout, _ in fitting) or "other files"
        raise ValueError(f"{place}: expected {known}, or folders of these, found {other}")
    ((layout, pairs),) = fitting
    named = {pair[0].relative_to(place).as_posix(): pair for pair in pairs}
    return Folder(place, layout, named)


def depth_layout(path: PathLike) -> Layout | None:
    """Tell from its name alone of which data set a file is a depth map, if of any."""
    name = Path(path).name
    return next((layout for layout in LAYOUTS if re.fullmatch(layout.depth, name)), None)


def true_z(path: PathLike) -> FloatArray:
    """Read true z, (H, W), mm, from a data set's depth map, told by its name; nan where unknown."""
    layout = depth_layout(path)
    if layout is None:
        names = "C3VD's NNNN_depth.png (.tiff) or SimCol3D's Depth_NNNN.png"
        raise ValueError(f"{path}: expected {names}")
    return layout.read_depth(path)[0]
