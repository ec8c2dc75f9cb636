"""SCARED (Allan et al., 2021): porcine abdomens, with depth by structured light in each keyframe.

The data set's own page is behind a licence; its layout is as its users' loaders have it. The later frames of
a keyframe, a video whose truth is the keyframe's moved along, are not read.
"""

from functools import partial
from pathlib import Path

import cv2
import numpy as np

from endolab.io.atomic import PathLike, name_damage, read_bytes
from endolab.io.datasets.sample import Sample, load_sample
from endolab.io.images import read_floats
from endolab.io.quiet import quiet
from endolab.model.cameras import BrownConrady, Camera
from endolab.numerics.arrays import BoolArray, FloatArray

COLOUR = "Left_Image.png"
DEPTH = "left_depth_map.tiff"
CAMERAS = "endoscope_calibration.yaml"


def read_scared_depth(path: PathLike) -> tuple[FloatArray, BoolArray]:
    """Read a depth map of SCARED.

    Parameters
    ----------
    path : path
        `left_depth_map.tiff`: X, Y and Z of each pixel of the left picture as it is, with its distortion, mm;
        nan, or 0, where unknown.

    Returns
    -------
    z : (H, W) float array
        mm.
    known : (H, W) bool array
        Where z is known.
    """
    points = read_floats(path, "X, Y and Z of each pixel, a TIFF of floats")
    if points.shape[2:] != (3,) or points.dtype.kind != "f":
        raise ValueError(
            f"{path}: expected X, Y and Z of each pixel, found {points.dtype} of shape {points.shape}"
        )
    z = points[..., 2].astype(np.float64)
    return z, np.isfinite(z) & (z > 0)


def _left_camera(path: Path, width: int, height: int) -> Camera:
    """Read the left camera, OpenCV's M1 and D1, of pictures of a size, px."""
    content = read_bytes(path, "calibration file", 100_000)
    with name_damage(path, "a calibration with M1 and D1, as OpenCV writes it"), quiet:
        mode = cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY
        storage = cv2.FileStorage(content.decode(), mode)
        matrix = storage.getNode("M1").mat()
        k = storage.getNode("D1").mat().ravel()
        if np.any(k[8:]):  # of a prism, or a tilted sensor
            raise ValueError
        fx, cx, fy, cy = matrix[[0, 0, 1, 1], [0, 2, 1, 2]].tolist()
        return BrownConrady(width, height, fx, fy, cx, cy, tuple(k[:8].tolist()))


def read_scared(folder: PathLike) -> Sample:
    """Load a keyframe of SCARED.

    Parameters
    ----------
    folder : path
        `dataset_N/keyframe_M`, with `Left_Image.png`, `left_depth_map.tiff` and `endoscope_calibration.yaml`.

    Returns
    -------
    Sample
        Of the left camera, whose picture keeps its distortion; the whole of it is in the mask. The light is
        nominal.
    """
    camera = partial(_left_camera, Path(folder) / CAMERAS)
    return load_sample(folder, COLOUR, DEPTH, read_scared_depth, camera)
