"""Calibration files of many programs: told by their content, and read as one `Calibration`."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Any

from endolab.io.atomic import PathLike
from endolab.io.cameras.documents import INI, read_document
from endolab.io.cameras.readers import MissingSize, Size, leaves, list_cameras, make_camera
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


def _check_camera(camera: Any) -> str:
    """Say that the centre is far off the middle of the picture; ValueError for what no camera has."""
    focal = getattr(camera, "fx", camera.width)
    if focal < 0.05 * camera.width:  # a fisheye of 230° has a quarter
        raise ValueError(
            f"fx {focal:g} of {camera.width} columns: normalised by the size, or in mm? Expected px"
        )
    place = f"the principal point, {camera.cx:g}, {camera.cy:g} px of {camera.width}x{camera.height}"
    sides = (camera.cx, camera.width), (camera.cy, camera.height)
    off = max(abs((at + 0.5) / length - 0.5) for at, length in sides)
    if off > 0.5:
        raise ValueError(
            f"{place}, lies outside the picture: is the size another? For a part of a picture give "
            "the calibration of the whole, and --crop"
        )
    return f"{place}, is far off its middle: is the size another?" if off > 0.2 else ""


def _read(path: PathLike, size: Size | None) -> tuple[Calibration, list[str]]:
    """Read a calibration file of any kind, and what is to be said of it."""
    file, which = split_choice(path)
    document = read_document(file)
    nominal = f"its light is nominal: k {NOMINAL.k:g}, γ {NOMINAL.gamma:g}, gain unknown"
    is_own = isinstance(document, dict) and bool(
        {"endolab", "photometry"} & document.keys()
    )
    notes = []
    if is_own:
        camera = document.get("camera")
        if isinstance(camera, dict) and "a0" in camera:  # a polynomial as C3VD's
            a = [camera.pop(f"a{power}", 0.0) for power in range(5)]
            document["camera"] = camera | {"a": a}
        made = Calibration.from_dict(document, str(Path(path)))
        if "photometry" not in document:
            notes.append(nominal)
    try:
        if not is_own:
            # What is not read, by how a suffix or a key begins, and what helps.
            metashape = "Metashape's: save it as OpenCV's, in its Camera Calibration"
            remedies = {
                ".bin": "COLMAP's binary: `colmap model_converter --output_type TXT` makes cameras.txt of it",
                INI: "an .ini: ROS's `camera_calibration_parsers convert` makes YAML of it, and its .yaml is "
                "beside it",
                "calibration.projection": metashape,
                "document.chunk": metashape,
                "target_type": "a board of Kalibr, which --target is for",
            }
            names = [Path(file).suffix, *(name for name, _ in leaves(document))]
            for known, remedy in remedies.items():
                if any(name.startswith(known) for name in names):
                    raise ValueError(remedy)
            form, cameras = list_cameras(document)
            if not cameras:
                raise ValueError(
                    "no calibration that can be read, which are endoscope.json and those of OpenCV, ROS, "
                    "Kalibr, COLMAP, ORB-SLAM, nerfstudio, Vicalib and C3VD; for MATLAB's, mrcal's and "
                    "OCamCalib's the guide bring_your_own says which numbers to type where"
                )
            if which is not None and which not in cameras:
                raise unknown_name("camera", which, cameras, "none at all")
            taken = which or next(iter(cameras))
            source = {"file": Path(file).name, "format": form, "camera": shorten(taken)}
            notes.append(f"{form}; {nominal}")
            if which is None and len(cameras) > 1:
                source["others"] = shorten(", ".join(cameras))
                one = f"{source['file']}#NAME takes one of {source['others']}"
                notes.append(f"{source['camera']} is taken, {one}")
            camera = make_camera(form, cameras[taken], size)
            made = Calibration(camera, NOMINAL, NOMINAL_LIGHT | {"converted": source})
        if "crop" not in made.evidence:
            notes.append(_check_camera(made.camera))
    except MissingSize as error:
        raise MissingSize(f"{file}: {error}") from error
    except (KeyError, ValueError, TypeError, AttributeError, OverflowError) as error:
        what = f"there is no {error}" if isinstance(error, KeyError) else str(error)
        raise ValueError(f"{file}: {shorten(what, 400)}") from error
    return made, [note for note in notes if note]


def read_camera(path: PathLike, size: Size | None = None) -> Camera:
    """Read the camera of a calibration file of any kind; parameters as of `read_calibration`."""
    return _read(path, size)[0].camera


def read_calibration(path: PathLike, size: Size | None = None) -> Calibration:
    """Read a calibration file of any kind; a light that it lacks is `NOMINAL`, which is logged.

    Parameters
    ----------
    path : path
        An `endoscope.json`, or a file of OpenCV, ROS, Kalibr, COLMAP, ORB-SLAM, nerfstudio, NumPy, Vicalib
        or C3VD, or with one's own names; ``FILE#NAME`` for one of several cameras.
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
    made, notes = _read(path, size)
    if notes:
        name = made.evidence.get("converted", {}).get("file", path)
        logging.getLogger("endolab").warning("%s: %s", name, "; ".join(notes))
    return made
