"""The synthetic colonoscopy frames of UCL, 2019 (Rau et al. [1]_), with true depth.

Pairs `…_FrameBuffer_NNNN.png` and `…_Depth_NNNN.png` of 256×256 px, 8 bits; what comes before is the
series, as in `T1_L2_1_resized`: texture 1, light 2, camera path 1.

The data set's own page could not be consulted. That grey 0 to 255 is 0 to 20 cm is what its users'
loaders take, and what the same author documents for SimCol3D, which followed; there the depth is z,
along the axis, and so it is taken here. The camera is documented nowhere that we know of: pass one.

.. [1] Rau et al., "Implicit domain adaptation with conditional generative adversarial networks for
   depth prediction in endoscopy", IJCARS 14, 2019.
"""

from endolab.io.atomic import PathLike
from endolab.io.datasets.sample import Sample, load_sample, read_stored_depth
from endolab.model.cameras import Camera
from endolab.model.endoscope import Calibration
from endolab.model.photometry import Photometry
from endolab.numerics.arrays import BoolArray, FloatArray


def read_ucl2019_depth(path: PathLike) -> tuple[FloatArray, BoolArray]:
    """Read a depth map of UCL 2019.

    Parameters
    ----------
    path : path
        `…_Depth_NNNN.png`, 8 bits, 256×256 px: z in cm is the value / 255 · 20.

    Returns
    -------
    z : (256, 256) float array
        mm, in steps of 0.78 mm.
    known : (256, 256) bool array
        Where the value is neither 0 nor 255, 200 mm or more.
    """
    step = 200 / 255  # mm
    stored = read_stored_depth(path, "uint8", step)
    if stored.shape != (256, 256):
        raise ValueError(
            f"{path}: expected 256x256 px, found {stored.shape[1]}x{stored.shape[0]} px"
        )
    return stored * step, (stored > 0) & (stored < 255)


def read_ucl2019(folder: PathLike, series: str, index: int, camera: Camera) -> Sample:
    """Load a frame of UCL 2019.

    Parameters
    ----------
    folder : path
    series : str
        What comes before `_FrameBuffer_NNNN.png`, as `T1_L1_1_resized`.
    index : int
        NNNN.
    camera : Camera
        Of 256×256 px; the data set does not say which, and distances off the axis depend on it.

    Returns
    -------
    Sample
        The whole picture is in the mask; the light is endolab's default, not the data set's, and
        the gain is unknown.
    """
    colour = f"{series}_FrameBuffer_{index:04d}.png"
    depth = f"{series}_Depth_{index:04d}.png"
    return load_sample(
        folder, colour, depth, read_ucl2019_depth, Calibration(camera, Photometry())
    )
