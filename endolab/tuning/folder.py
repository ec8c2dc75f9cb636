"""What the app is given: pictures of a folder, and the truth of a frame."""

from pathlib import Path

import numpy as np

from endolab.datasets.folders import depth_layout, true_z
from endolab.io.surfaces import read_depth
from endolab.io.video import is_sequence, open_frames
from endolab.model.endoscope import Endoscope
from endolab.numerics.arrays import FloatArray
from endolab.preprocessing.frame import check_size


def find_pictures(source: str | Path) -> list[Path]:
    """Find a picture, or those of a folder in the order of their numbers, but for depth maps.

    OSError or ValueError in one sentence, if there is none.
    """
    path = Path(source)
    if not is_sequence(path):
        return [path]
    if not path.is_dir():
        raise ValueError(f"{path}: the tuner takes a picture or a folder of pictures, not a video")
    found = open_frames(path).names
    names = [name for name in found if depth_layout(name) is None]
    if not names:
        raise ValueError(f"{path}: only depth maps are in this folder, no picture")
    return [path / name for name in names]


def read_truth(path: str | Path, calibration: Endoscope) -> FloatArray:
    """Read the true distance, (H, W), mm, of a frame of this size: truth.npz, or a data set's depth map."""
    camera = calibration.camera
    if str(path).endswith(".npz"):
        known = read_depth(path, ("distance",))["distance"]
        check_size(str(path), (known.shape[1], known.shape[0]), camera)
        return known
    z = true_z(path)
    check_size(str(path), (z.shape[1], z.shape[0]), camera)
    cosine = camera.field.cos_alpha
    truth: FloatArray = z / np.where(cosine > 0, cosine, np.nan)
    return truth
