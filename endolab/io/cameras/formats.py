"""Calibration files of many programs: told by their content, and read as one `Calibration`."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Any

from endolab.io.atomic import PathLike
from endolab.io.cameras.documents import read_document
from endolab.io.cameras.readers import MissingSize, Size, list_cameras, make_camera
from endolab.model.cameras import Camera
from endolab.model.endoscope import NOMINAL_LIGHT, Calibration
from endolab.model.photometry import NOMINAL
from endolab.numerics.checks import shorten, unknown_name


def split_choice(name: PathLike) -> tuple[str, str | None]:
    """Split ``camchain.yaml#cam1`` into the file and which of its cameras is wanted, if any."""
    file = os.fspath(name)
    if "#" not in file or os.path.exists(file):
        return file, None
    file, _, which = file.rpartition("#")
    return file, which


def _choose(path: PathLike, size: Size | None) -> tuple[Any, Camera | None, dict[str, Any]]:
    """Read the document; the camera that is taken from it, unless it is endolab's; and where that is from."""
    file, which = split_choice(path)
    document = read_document(file)
    if isinstance(document, dict) and {"endolab", "photometry"} & document.keys():
        camera = document.get("camera")
        if isinstance(camera, dict) and "a0" in camera:  # a polynomial as C3VD's
            a = [camera.pop(f"a{power}", 0.0) for power in range(5)]
            document["camera"] = camera | {"a": a}
        return document, None, {}
    try:
        form, cameras = list_cameras(document)
        if not cameras:
            raise ValueError(
                "no calibration that can be read, which are endoscope.json and those of OpenCV, ROS, "
                "Kalibr, COLMAP, Vicalib and C3VD; for MATLAB's, mrcal's and OCamCalib's the guide "
                "bring_your_own says which numbers to type where"
            )
        if which is not None and which not in cameras:
            raise unknown_name("camera", which, cameras, "none at all")
        taken = next(iter(cameras)) if which is None else which
        camera = make_camera(form, cameras[taken], size)
    except MissingSize as error:
        raise MissingSize(f"{file}: {error}") from error
    except (KeyError, ValueError, TypeError, AttributeError, OverflowError) as error:
        what = f"there is no {error}" if isinstance(error, KeyError) else str(error)
        raise ValueError(f"{file}: {shorten(what, 400)}") from error
    source = {"file": Path(file).name, "format": form, "camera": shorten(taken)}
    if which is None and len(cameras) > 1:
        source["others"] = shorten(", ".join(cameras))
    return document, camera, source


def read_camera(path: PathLike, size: Size | None = None) -> Camera:
    """Read the camera of a calibration file of any kind; parameters as of `read_calibration`."""
    document, camera, _ = _choose(path, size)
    return (
        Calibration.from_dict(document, str(Path(path))).camera
        if camera is None
        else camera
    )


def read_calibration(path: PathLike, size: Size | None = None) -> Calibration:
    """Read a calibration file of any kind; a light that it lacks is `NOMINAL`, which is logged.

    Parameters
    ----------
    path : path
        An `endoscope.json`, or a file of OpenCV, ROS, Kalibr, COLMAP, Vicalib or C3VD; ``FILE#NAME`` for
        one of several cameras.
    size : (columns, rows), optional
        Of the pictures, px, for a file that does not say.

    Returns
    -------
    Calibration
        The evidence of another program's says which file, format and camera it is from.

    Raises
    ------
    OSError, ValueError
        In one sentence that names the file and what in it is wrong; `MissingSize` if that is all.
    """
    document, camera, source = _choose(path, size)
    nominal = f"its light is nominal: k {NOMINAL.k:g}, γ {NOMINAL.gamma:g}, gain unknown"
    log = logging.getLogger("endolab")
    if camera is None:
        if "photometry" not in document:
            log.warning("%s: %s", path, nominal)
        return Calibration.from_dict(document, str(Path(path)))
    text = f"{source['file']}: {source['format']}; {nominal}"
    if "others" in source:
        text += f"; {source['camera']} is taken, {source['file']}#NAME takes one of {source['others']}"
    log.warning("%s", text)
    return Calibration(camera, NOMINAL, NOMINAL_LIGHT | {"converted": source})
