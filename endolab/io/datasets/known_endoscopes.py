"""The endoscopes that endolab knows by name."""

import os
from pathlib import Path

from endolab.io.atomic import PathLike
from endolab.io.cameras.formats import read_calibration, split_choice
from endolab.io.cameras.readers import Size
from endolab.model.endoscope import Calibration
from endolab.numerics.checks import PATH, check_int, check_kinds, unknown_name

# Files as of any endoscope:
# - paper: the paper's endoscope (Section IV-A) over tissue of a colon's mean albedo.
# - simple: a camera without distortion and 90° wide, for the simple scenes.
# - c3vd: C3VD (Bobrow et al., 2023), its omnidirectional camera; its light and lamp by
#   `tests.research.known_surface` on two frames of one scene, so that its errors are large.
# - c3vd_v2: C3VDv2 (Golhar et al., 2025), the camera that it comes with; its light is C3VD's, of the same
#   endoscope.
# - simcol3d: SimCol3D (Rau et al., 2023), published with the picture's corner as origin, c = 237.5. Its
#   light, a game engine's, is no endoscope's: of k from 0.7 to 2.5, this one's depths are nearest to five
#   frames' truth.
CALIBRATIONS = {
    name: read_calibration(Path(__file__).parent / "endoscopes" / f"{name}.json")
    for name in ("paper", "simple", "c3vd", "c3vd_v2", "simcol3d")
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
        another program's calibration, ``FILE#NAME`` for one of several cameras. A name is the endoscope's,
        whatever lies in the folder: ``./c3vd`` is a file.
    width : int, optional
        For pictures of this many columns and the same shape, px.
    size : (columns, rows), optional
        Of the pictures, px, if the file does not say, or of others of the same shape.

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
    if name in CALIBRATIONS:
        calibration = CALIBRATIONS[name]
    elif not os.path.exists(split_choice(name)[0]) and not Path(name).suffix:
        raise unknown_name("calibration", name, CALIBRATIONS, "a file")
    else:
        calibration = read_calibration(name, size)
    if size is not None:
        calibration = calibration.fit("size", *size)
    if width is None:
        return calibration
    camera = calibration.camera
    height = camera.height * check_int("width", width, 1) / camera.width
    return calibration.resize(width, max(1, round(height)))
