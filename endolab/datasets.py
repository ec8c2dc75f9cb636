"""Published frames with truth, and the endoscopes that endolab knows by name.

Every sample comes out the same way: a `Frame`, a `Calibration` of its size, and Euclidean
distances in mm, nan where the truth is unknown. Nothing is downloaded. `folders.open_folder`
opens any layout; that of UCL 2019 is in `ucl`, EndoMapper's calibrations are in `endomapper`.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from endolab.brdf import Lambertian
from endolab.cameras import Camera, KannalaBrandt, Pinhole, Scaramuzza
from endolab.endoscope import Calibration
from endolab.files import PathLike, read_image, read_stored
from endolab.operators import BoolArray, FloatArray
from endolab.photometry import Photometry
from endolab.preprocess import Frame

if TYPE_CHECKING:
    from endolab.traced_set import TracedSample

TRACED = ("matt", "diffuse-1", "diffuse-2", "diffuse-3", "wet-1", "wet-2", "foggy")
NEAREST = 2.0  # no endoscope has all it sees nearer, mm

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


# Layouts -------------------------------------------------------------------------------------


def stored_depth(path: Path, dtype: str, step: float) -> np.ndarray:
    """Read a depth map's numbers, and refuse what cannot be one in steps of `step` mm.

    Raises
    ------
    OSError, ValueError
        In one sentence, if it cannot be read, has another bit depth or several channels, is black, or
        shows nothing beyond 2 mm, as a map in another unit does.
    """
    stored = read_stored(path)
    if stored.ndim != 2 or stored.dtype != np.dtype(dtype):
        raise ValueError(
            f"{path}: expected one channel of {dtype}, found {stored.dtype} of shape {stored.shape}"
        )
    deepest = float(stored.max()) * step
    if deepest == 0:
        raise ValueError(f"{path}: expected depths, found 0 everywhere")
    if deepest < NEAREST:
        raise ValueError(
            f"{path}: expected depths in steps of {step:.4g} mm, found none beyond {deepest:.2g} mm; "
            "they may be in another unit"
        )
    return stored


def one_of(folder: Path, names: list[str]) -> Path:
    """Return the first of some files that is in a folder."""
    found = [folder / name for name in names if (folder / name).is_file()]
    if not found:
        raise FileNotFoundError(f"{folder}: expected a file {' or '.join(names)}")
    return found[0]


def true_distance(z: FloatArray, known: BoolArray, camera: Camera, path: Path) -> FloatArray:
    """Turn z into Euclidean distance, mm, nan where unknown; complain of another size than the camera's."""
    if z.shape != (camera.height, camera.width):
        raise ValueError(
            f"{path}: expected {camera.width}x{camera.height} px, found {z.shape[1]}x{z.shape[0]} px"
        )
    forward = np.where(camera.field.cos_alpha > 0, camera.field.cos_alpha, np.nan)
    return np.where(known, z, np.nan) / forward


def colour_picture(path: Path, shape: tuple[int, ...]) -> FloatArray:
    """Read the colour picture that belongs to a depth map of some shape: (H, W, 3), in [0, 1]."""
    image = read_image(path)
    if image.shape != (*shape, 3):
        raise ValueError(
            f"{path}: expected colours of {shape[1]}x{shape[0]} px as its depth map, "
            f"found the shape {image.shape}"
        )
    return image


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
    stored = stored_depth(Path(path), "uint16", 1 / 655.35)
    return stored / 655.35, (stored > 0) & (stored < 65535), stored > 0


def c3vd_normals(path: PathLike) -> FloatArray:
    """Read the normals of C3VD.

    Parameters
    ----------
    path : path
        `NNNN_normals.tiff` or `.png`, 16 bits a channel: x, y and z in red, green and blue, -1 to 1
        as 0 to 65535, in the camera frame (x right, y down, z forward), towards the camera; black
        is unknown. The data set's page speaks of 0 to 1 for z, its renderer writes -1 to 1.

    Returns
    -------
    (H, W, 3) float array
        Unit normals; nan where unknown.

    Raises
    ------
    OSError, ValueError
        In one sentence, if it cannot be read, has not 3 channels of 16 bits, is black, or does not
        hold vectors of length 1, as another scaling would not.
    """
    stored = read_stored(path)
    if stored.ndim != 3 or stored.shape[2] != 3 or stored.dtype != np.uint16:
        raise ValueError(
            f"{path}: expected three channels of uint16, found {stored.dtype} of shape {stored.shape}"
        )
    known = np.any(stored, axis=-1)
    if not np.any(known):
        raise ValueError(f"{path}: expected normals, found 0 everywhere")
    normals = stored[..., ::-1] / 32767.5 - 1  # OpenCV's order is B, G, R
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    usual = float(np.median(length[known]))
    if abs(usual - 1) > 0.01:
        raise ValueError(f"{path}: expected vectors of length 1, found a median of {usual:.3g}")
    return np.where(known[..., None], normals / np.where(length > 0, length, 1.0), np.nan)


def c3vd_poses(path: PathLike) -> FloatArray:
    """Read the poses of a sequence of C3VD.

    Parameters
    ----------
    path : path
        `pose.txt`: a line for each frame, 16 numbers between commas. They are the matrix for row
        vectors, (x, 1) M, so the translation comes last.

    Returns
    -------
    (n, 4, 4) float array
        Camera to world for column vectors, mm: the translation is in the last column. The data set's
        rotations are orthogonal to some 0.1 %, and are given as they are.

    Raises
    ------
    OSError, ValueError
        In one sentence that names the line, if one is not such a pose.
    """
    source = Path(path)
    if not source.is_file():
        raise FileNotFoundError(f"{source}: there is no such file")
    poses = []
    for number, line in enumerate(source.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        if not line.strip():
            continue
        try:
            values = np.array([float(part) for part in line.split(",")])
        except ValueError:
            values = np.empty(0)
        if values.size != 16 or not np.all(np.isfinite(values)):
            raise ValueError(f"{source}: line {number}: expected 16 numbers between commas")
        pose = values.reshape(4, 4).T
        turn = pose[:3, :3]
        if not np.allclose(pose[3], (0, 0, 0, 1)) or not np.allclose(turn @ turn.T, np.eye(3), atol=0.01):
            raise ValueError(f"{source}: line {number}: expected a rotation, with the translation last")
        poses.append(pose)
    if not poses:
        raise ValueError(f"{source}: expected poses, found none")
    return np.array(poses)


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
        The mask is the octagon that the endoscope shows; of 1350×1080 px, or of the data set's
        pictures shrunk in proportion.
    """
    place = Path(folder)
    colour = one_of(place, [f"{index:04d}_color.png"])
    depth = one_of(place, [f"{index:04d}_depth.png", f"{index:04d}_depth.tiff"])
    z, known, seen = c3vd_depth(depth)
    known_as = CALIBRATIONS["c3vd"]
    shrunk = calibration("c3vd", min(z.shape[1], known_as.camera.width))
    if z.shape == (shrunk.camera.height, shrunk.camera.width):
        known_as = shrunk
    distance = true_distance(z, known, known_as.camera, depth)
    return Sample(Frame(colour_picture(colour, z.shape), seen, colour.name), known_as, distance)


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
    stored = stored_depth(Path(path), "uint16", 200 / 65280)
    if stored.max() > 65280:
        raise ValueError(f"{path}: expected values up to 65280, which is 200 mm, found {stored.max()}")
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
    colour = one_of(place, [f"FrameBuffer_{index:04d}.png"])
    depth = one_of(place, [f"Depth_{index:04d}.png"])
    z, known = simcol3d_depth(depth)
    known_as = CALIBRATIONS["simcol3d"]
    distance = true_distance(z, known, known_as.camera, depth)
    image = colour_picture(colour, z.shape)
    image = np.minimum(image * 65535 / 65280, 1.0)  # bytes in the upper half of 16 bits
    return Sample(Frame(image, np.ones(image.shape[:2], bool), colour.name), known_as, distance)


def traced(name: str = "diffuse-1") -> TracedSample:
    """Load a path-traced frame that comes with endolab, with its truth and its layers of light.

    Parameters
    ----------
    name : {"matt", "diffuse-1", "diffuse-2", "diffuse-3", "wet-1", "wet-2", "foggy"}
        `matt` is a bare wall; `diffuse-1` to `diffuse-3` have mottles, vessels and one grey level of
        noise; `wet-1`, `wet-2` and `foggy` three lights, a wet film and three grey levels. The second
        and the last two are of a fisheye.

    Raises
    ------
    OSError, ValueError
        In one sentence, if there is none of that name or it cannot be read.
    """
    from endolab.traced_set import FOLDER, read  # which stands on this module

    if name not in TRACED:
        raise ValueError(f"unknown traced frame {name!r}; choose {', '.join(TRACED)}")
    return read(FOLDER / f"{name}.npz")


def true_z(path: PathLike) -> FloatArray:
    """Read true z, (H, W), mm, from a data set's depth map, told by its name; nan where unknown."""
    from endolab.ucl import ucl2019_depth  # which stands on this module

    name = Path(path).name.lower()
    if name.endswith(("_depth.png", "_depth.tiff")):
        z, known, _ = c3vd_depth(path)
    elif name.startswith("depth_") and name.endswith(".png"):
        z, known = simcol3d_depth(path)
    elif "_depth_" in name and name.endswith(".png"):
        z, known = ucl2019_depth(path)
    else:
        raise ValueError(
            f"{path}: expected truth.npz, C3VD's NNNN_depth.png (.tiff), SimCol3D's Depth_NNNN.png "
            "or UCL 2019's …_Depth_NNNN.png"
        )
    return np.where(known, z, np.nan)
