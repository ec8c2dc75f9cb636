"""EndoSLAM (Ozyoruk et al., 2021): the frames of its Unity camera, rendered with their depth.

Its authors do not say the depths' unit, only that they come from Unity's recorder [1]_; their users' loaders
take a grey level for 1 cm, which is taken here: divide by it, or scale by the median, if you have another.
Whether they are z is not said either; Unity's are. Users found colours and depths to be out of line [2]_, as
if the depths had no lens distortion; nothing is done about that. Its other cameras have no depths.

.. [1] github.com/CapsuleEndoscope/VirtualCapsuleEndoscopy/issues/5
.. [2] github.com/CapsuleEndoscope/EndoSLAM/issues/13
"""

from functools import partial
from pathlib import Path

from endolab.io.atomic import PathLike
from endolab.io.datasets.sample import (
    Sample,
    load_sample,
    read_intrinsics,
)
from endolab.io.images import read_stored
from endolab.numerics.arrays import BoolArray, FloatArray

COLOURS = ("Frames", r"image_(\d+)\.png")  # their folder and names
STEP = 10.0  # mm that a grey level is taken for


def read_endoslam_depth(path: PathLike) -> tuple[FloatArray, BoolArray]:
    """Read a depth map of EndoSLAM.

    Parameters
    ----------
    path : path
        `aov_image_NNNN.png`, 8 bits, whose red is z in cm.

    Returns
    -------
    z : (H, W) float array
        mm, in steps of 10 mm.
    known : (H, W) bool array
        Where it is above 0.
    """
    stored = read_stored(path)
    if stored.dtype != "uint8":
        raise ValueError(f"{path}: expected 8 bits a channel, found {stored.dtype}")
    red = stored.reshape(*stored.shape[:2], -1)[..., 0]
    return red * STEP, red > 0


def read_endoslam(folder: PathLike, index: int) -> Sample:
    """Load a frame of EndoSLAM's Unity camera.

    Parameters
    ----------
    folder : path
        An organ, as `UnityCam/Colon`, with `Frames/image_NNNN.png` and `Pixelwise Depths/aov_image_NNNN.png`;
        the camera's matrix is in `Calibration/cam.txt`, there or beside it. Where its pixels count from is
        not said: from the centre of the first one, as here.
    index : int
        NNNN.

    Returns
    -------
    Sample
        The whole picture is in the mask; the light is nominal.
    """
    place = Path(folder)
    cameras = [where / "Calibration/cam.txt" for where in (place, place.parent)]
    camera = partial(read_intrinsics, cameras[not cameras[0].exists()])
    name = f"image_{index:04d}.png"
    pair = (f"Frames/{name}", f"Pixelwise Depths/aov_{name}")
    return load_sample(place, *pair, read_endoslam_depth, camera)
