"""Published frames with truth, and the endoscopes that endolab knows by name.

Every sample comes out the same way: a `Frame`, a `Calibration` of its size, and Euclidean
distances in mm, nan where the truth is unknown. Nothing is downloaded.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from endolab.brdf import Lambertian
from endolab.cameras import KannalaBrandt, Pinhole, Scaramuzza
from endolab.endoscope import Calibration
from endolab.files import PathLike, read_image, read_stored
from endolab.operators import BoolArray, FloatArray
from endolab.photometry import Photometry
from endolab.preprocess import Frame

CALIBRATIONS: dict[str, Calibration] = {
    # The paper's endoscope (Section IV-A) over tissue of a colon's mean albedo.
    "paper": Calibration(
        KannalaBrandt(
            1440, 1080, 717.21, 717.48, 735.37, 552.80, (-0.13893, -1.2396e-3, 9.1258e-4, -4.0716e-5)
        ),
        Photometry(k=2.5, gamma=2.2, brdf=Lambertian((0.75, 0.38, 0.30))),
    ),
    # A camera without distortion and 90° wide, for the simple scenes.
    "simple": Calibration(
        Pinhole(320, 240, 160.0, 160.0, 159.5, 119.5),
        Photometry(k=2.5, gamma=2.2, brdf=Lambertian((0.75, 0.38, 0.30))),
    ),
    # C3VD (Bobrow et al., 2023): its omnidirectional camera; light as in the paper, not calibrated.
    "c3vd": Calibration(
        Scaramuzza(
            1350,
            1080,
            678.544839,
            542.975888,
            (769.243600037, 0.0, -0.000812770624150226, 6.25674244578925e-07, -1.1966218214428e-09),
            0.99998686,
            0.00288274,
            -0.00296316,
        ),
        Photometry(k=2.5, gamma=2.2),
    ),
    # SimCol3D (Rau et al., 2023). Published with the picture's corner as origin, c = 237.5.
    "simcol3d": Calibration(
        Pinhole(475, 475, 227.60416, 227.60416, 237.0, 237.0), Photometry(k=2.5, gamma=2.2)
    ),
}


@dataclass(frozen=True)
class Sample:
    """A published frame.

    Attributes
    ----------
    frame : Frame
    calibration : Calibration
        Of the frame's size; its gain is unknown.
    distance : (H, W) float array
        True Euclidean distance, mm; nan where unknown.
    """

    frame: Frame
    calibration: Calibration
    distance: FloatArray


def calibration(name: str, width: int | None = None) -> Calibration:
    """Return an endoscope that endolab knows by name.

    Parameters
    ----------
    name : {"paper", "simple", "c3vd", "simcol3d"}
        The paper's endoscope, a 90° pinhole, and those of two data sets.
    width : int, optional
        For pictures of this many columns and the same shape, px.

    Raises
    ------
    ValueError
        If there is none of that name.
    """
    if name not in CALIBRATIONS:
        raise ValueError(f"unknown calibration {name!r}; choose {', '.join(CALIBRATIONS)}")
    known = CALIBRATIONS[name]
    if width is None:
        return known
    return known.resize(width, round(known.camera.height * width / known.camera.width))


def data_folder() -> Path | None:
    """Folder of published frames: $ENDOLAB_DATA, else ../shared/data beside the checkout; or None."""
    named = os.environ.get("ENDOLAB_DATA")
    folder = Path(named) if named else Path(__file__).resolve().parents[2] / "shared" / "data"
    return folder if folder.is_dir() else None


def _stored_depth(path: Path, dtype: str) -> np.ndarray:
    stored = read_stored(path)
    if stored.ndim != 2 or stored.dtype != np.dtype(dtype):
        raise ValueError(
            f"{path}: expected one channel of {dtype}, found {stored.dtype} of shape {stored.shape}"
        )
    return stored


def _one_of(folder: Path, names: list[str]) -> Path:
    found = [folder / name for name in names if (folder / name).is_file()]
    if not found:
        raise FileNotFoundError(f"{folder}: expected a file {' or '.join(names)}")
    return found[0]


def _true_distance(z: FloatArray, known: BoolArray, calibration: Calibration, path: Path) -> FloatArray:
    camera = calibration.camera
    if z.shape != (camera.height, camera.width):
        raise ValueError(
            f"{path}: expected {camera.width}x{camera.height} px, found {z.shape[1]}x{z.shape[0]} px"
        )
    forward = np.where(camera.field.cos_alpha > 0, camera.field.cos_alpha, np.nan)
    return np.where(known, z, np.nan) / forward


def c3vd_depth(path: PathLike) -> tuple[FloatArray, BoolArray, BoolArray]:
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
    stored = _stored_depth(Path(path), "uint16")
    return stored / 655.35, (stored > 0) & (stored < 65535), stored > 0


def c3vd(folder: PathLike, index: int) -> Sample:
    """Load a frame of C3VD: `NNNN_color.png` and `NNNN_depth.png` or `.tiff` in one folder.

    Parameters
    ----------
    folder : path
    index : int
        NNNN.

    Returns
    -------
    Sample
        The mask is the octagon that the endoscope shows.
    """
    place = Path(folder)
    colour = _one_of(place, [f"{index:04d}_color.png"])
    depth = _one_of(place, [f"{index:04d}_depth.png", f"{index:04d}_depth.tiff"])
    z, known, seen = c3vd_depth(depth)
    known_as = CALIBRATIONS["c3vd"]
    distance = _true_distance(z, known, known_as, depth)
    return Sample(Frame(read_image(colour), seen, colour.name), known_as, distance)


def simcol3d_depth(path: PathLike) -> tuple[FloatArray, BoolArray]:
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
    stored = _stored_depth(Path(path), "uint16")
    return stored / 256 / 255 * 200, stored > 0


def simcol3d(folder: PathLike, index: int) -> Sample:
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
    colour = _one_of(place, [f"FrameBuffer_{index:04d}.png"])
    depth = _one_of(place, [f"Depth_{index:04d}.png"])
    z, known = simcol3d_depth(depth)
    known_as = CALIBRATIONS["simcol3d"]
    distance = _true_distance(z, known, known_as, depth)
    image = np.minimum(read_image(colour) * 65535 / 65280, 1.0)  # bytes in the upper half of 16 bits
    return Sample(Frame(image, np.ones(image.shape[:2], bool), colour.name), known_as, distance)


def true_z(path: PathLike) -> FloatArray:
    """Read true z, (H, W), mm, from a data set's depth map, told by its name; nan where unknown."""
    name = Path(path).name.lower()
    if name.endswith(("_depth.png", "_depth.tiff")):
        z, known, _ = c3vd_depth(path)
    elif name.startswith("depth_") and name.endswith(".png"):
        z, known = simcol3d_depth(path)
    else:
        raise ValueError(
            f"{path}: expected truth.npz, C3VD's NNNN_depth.png (.tiff) or SimCol3D's Depth_NNNN.png"
        )
    return np.where(known, z, np.nan)
