"""The endoscopes that endolab knows by name."""

import os
from pathlib import Path

from endolab.io.atomic import PathLike
from endolab.io.cameras.formats import read_calibration, split_choice
from endolab.io.cameras.readers import Size
from endolab.model.brdf import Lambertian
from endolab.model.cameras import KannalaBrandt, Pinhole, Scaramuzza
from endolab.model.endoscope import Calibration
from endolab.model.photometry import Photometry
from endolab.numerics.checks import PATH, check_int, check_kinds, unknown_name

# Evidence of a light that was taken from the paper.
NOMINAL_EVIDENCE = {"photometry": {"nominal": True}}
C3VD_PHOTOMETRY = Photometry(k=1.18, gamma=2.24, brdf=Lambertian((0.69, 0.4, 0.34)))
# Evidence for C3VD's: one scene, so that its errors are large.
C3VD_LIGHT = {
    "photometry": {
        "standard_errors": {
            "k": 0.374,
            "gamma": 0.159,
            "red": 0.085,
            "green": 0.103,
            "blue": 0.092,
        }
    },
    "known_surface": {
        "frames": ["0001_color.png", "0006_color.png"],
        "misfit_grey_levels": 4.58,
    },
}

CALIBRATIONS: dict[str, Calibration] = {
    # The paper's endoscope (Section IV-A) over tissue of a colon's mean albedo.
    "paper": Calibration(
        KannalaBrandt(
            1440,
            1080,
            717.21,
            717.48,
            735.37,
            552.80,
            (-0.13893, -1.2396e-3, 9.1258e-4, -4.0716e-5),
        ),
        Photometry(k=2.5, gamma=2.2, brdf=Lambertian((0.75, 0.38, 0.30))),
    ),
    # A camera without distortion and 90° wide, for the simple scenes.
    "simple": Calibration(
        Pinhole(320, 240, 160.0, 160.0, 159.5, 119.5),
        Photometry(k=2.5, gamma=2.2, brdf=Lambertian((0.75, 0.38, 0.30))),
    ),
    # C3VD (Bobrow et al., 2023): its omnidirectional camera; its light by
    # `tests.benchmarks.known_surface` on two frames.
    "c3vd": Calibration(
        Scaramuzza(
            1350,
            1080,
            678.544839,
            542.975888,
            (
                769.243600037,
                0.0,
                -0.000812770624150226,
                6.25674244578925e-07,
                -1.1966218214428e-09,
            ),
            0.99998686,
            0.00288274,
            -0.00296316,
        ),
        C3VD_PHOTOMETRY,
        C3VD_LIGHT,
    ),
    # C3VDv2 (Golhar et al., 2025): the camera that it comes with; its light is C3VD's, of the same endoscope.
    "c3vd_v2": Calibration(
        Scaramuzza(
            1350,
            1080,
            677.739464,
            543.057998,
            (
                767.733695862103,
                0.0,
                -0.000592506426558248,
                -2.694402666e-07,
                -2.16380341010063e-10,
            ),
            0.9999,
            1.1e-4,
            -1.83e-4,
        ),
        C3VD_PHOTOMETRY,
        NOMINAL_EVIDENCE,
    ),
    # SimCol3D (Rau et al., 2023). Published with the picture's corner as origin, c = 237.5. Its light, a game
    # engine's, is no endoscope's: of k from 0.7 to 2.5, this one's depths are nearest to five frames' truth.
    "simcol3d": Calibration(
        Pinhole(475, 475, 227.60416, 227.60416, 237.0, 237.0),
        Photometry(k=1.5, gamma=2.2),
        NOMINAL_EVIDENCE,
    ),
}


@check_kinds(name_or_path=PATH)
def load_calibration(
    name_or_path: PathLike, width: int | None = None, size: Size | None = None
) -> Calibration:
    """Return an endoscope that endolab knows by name, or one that a file describes.

    Parameters
    ----------
    name_or_path : {"paper", "simple", "c3vd", "c3vd_v2", "simcol3d"} or path
        The paper's endoscope, a 90° pinhole, those of three data sets; or a file: `endoscope.json`, or
        another program's calibration, ``FILE#NAME`` for one of several cameras.
    width : int, optional
        For pictures of this many columns and the same shape, px.
    size : (columns, rows), optional
        Of the pictures, px, if the file does not say.

    Returns
    -------
    Calibration
        Camera and light, of `width` columns if that is given.

    Raises
    ------
    OSError, ValueError
        In one sentence, if there is none of that name, or as `read_calibration`.

    Examples
    --------
    >>> import endolab as el
    >>> known = el.load_calibration("paper", width=480)
    >>> known.camera.width, known.camera.height, known.photometry.k
    (480, 360, 2.5)
    """
    name = str(name_or_path)
    if name in CALIBRATIONS and not os.path.exists(name):
        calibration = CALIBRATIONS[name]
    elif not os.path.exists(split_choice(name)[0]) and not Path(name).suffix:
        raise unknown_name("calibration", name, CALIBRATIONS, "a file")
    else:
        calibration = read_calibration(name, size)
    if width is None:
        return calibration
    camera = calibration.camera
    height = camera.height * check_int("width", width, 1) / camera.width
    return calibration.resize(width, max(1, round(height)))
