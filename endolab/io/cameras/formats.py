"""Calibration files of many programs: told by their content, and read as one `Calibration`."""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from endolab.io.atomic import PathLike
from endolab.io.cameras.documents import ROWS, read_document
from endolab.io.cameras.readers import (
    MATRIX_NAME,
    Cameras,
    Size,
    colmap_cameras,
    flat_cameras,
    kalibr_cameras,
    matlab_cameras,
    matlab_structs,
    mrcal_cameras,
    ocam_cameras,
    opencv_cameras,
    vicalib_cameras,
)
from endolab.io.descriptions import NOMINAL
from endolab.model.cameras import Camera
from endolab.model.endoscope import Calibration, camera_from_dict
from endolab.model.schema import shorten, unknown_name


@dataclass(frozen=True)
class Format:
    """A kind of file: what it is called, how it is told, and what reads it."""

    name: str
    recognise: Callable[[dict[str, Any]], bool]
    list_cameras: Callable[[Any, str, Size | None], Cameras]


def _has_matrix(document: dict[str, Any]) -> bool:
    content = document.get("opencv_storage", document)
    return isinstance(content, dict) and any(map(MATRIX_NAME.fullmatch, content))


def _is_flat(document: dict[str, Any]) -> bool:
    camera = document.get("camera", document)
    return isinstance(camera, dict) and "a0" in camera


def _is_colmap(document: dict[str, Any]) -> bool:
    return all(
        len(row) > 4 and isinstance(row[0], float) and isinstance(row[1], str)
        for row in document.get(ROWS, [[]])
    )


def _is_ocam(document: dict[str, Any]) -> bool:
    rows = document.get(ROWS, [])
    return len(rows) == 5 and all(isinstance(word, float) for row in rows for word in row)


# The first that recognises a file reads it.
FORMATS = (
    Format("Vicalib's XML", lambda document: "rig" in document, vicalib_cameras),
    Format(
        "Kalibr's camchain",
        lambda document: any(re.fullmatch(r"cam\d+", name) for name in document),
        kalibr_cameras,
    ),
    Format("mrcal's cameramodel", lambda document: "lensmodel" in document, mrcal_cameras),
    Format("C3VD's a0 to a4", _is_flat, flat_cameras),
    Format(
        "MATLAB's parameters as a struct (.mat, JSON)",
        lambda document: any(True for _ in matlab_structs(document)),
        matlab_cameras,
    ),
    Format(
        "OpenCV's FileStorage (YAML, XML, JSON) or ROS's camera_info",
        _has_matrix,
        opencv_cameras,
    ),
    Format("COLMAP's cameras.txt", _is_colmap, colmap_cameras),
    Format("OCamCalib's calib_results.txt", _is_ocam, ocam_cameras),
)


def split_choice(name: PathLike) -> tuple[str, str | None]:
    """Split ``camchain.yaml#cam1`` into the file and which of its cameras is wanted, if any."""
    file = os.fspath(name)
    if "#" not in file or os.path.exists(file):
        return file, None
    file, _, which = file.rpartition("#")
    return file, which


def _as_endolab(document: Any) -> dict[str, Any]:
    """Return an endoscope.json, whose polynomial may be flat, as C3VD's."""
    camera = document.get("camera")
    if isinstance(camera, dict) and "a0" in camera:
        a = [camera.get(f"a{power}", 0.0) for power in range(5)]
        flat = {f"a{power}" for power in range(5)}
        kept = {key: value for key, value in camera.items() if key not in flat}
        return document | {"camera": kept | {"a": a}}
    return dict(document)


def _choose(path: PathLike, size: Size | None) -> tuple[Any, Camera | None, dict[str, Any]]:
    """Read the document; the camera that is taken from it, unless it is endolab's; and where that is from."""
    file, which = split_choice(path)
    document = read_document(file)
    if isinstance(document, dict) and {"endolab", "photometry"} & document.keys():
        return _as_endolab(document), None, {}
    is_object = isinstance(document, dict)
    known = next((kind for kind in FORMATS if is_object and kind.recognise(document)), None)
    if known is None:
        names = ", ".join(kind.name for kind in FORMATS)
        raise ValueError(
            f"{file}: no calibration that can be read, which are endoscope.json, {names}"
        )
    cameras = known.list_cameras(document, file, size)
    if not cameras:
        raise ValueError(f"{file}: {known.name} without a camera")
    if which is not None and which not in cameras:
        raise unknown_name(f"camera of {file}", which, cameras, "none at all")
    taken = next(iter(cameras)) if which is None else which
    camera = cameras[taken]()
    if size is not None and (camera.width, camera.height) != tuple(size):
        raise ValueError(
            f"{file}: it says {camera.width}x{camera.height} px, but the size given is {size[0]}x{size[1]}"
        )
    source = {"file": Path(file).name, "format": known.name, "camera": shorten(taken)}
    others = [name for name in cameras if name != taken]
    if which is None and others:
        source["others"] = shorten(", ".join(others))
    return document, camera, source


def read_camera(path: PathLike, size: Size | None = None) -> Camera:
    """Read the camera of a calibration file of any kind; parameters as of `read_calibration`."""
    document, camera, _ = _choose(path, size)
    return camera_from_dict(document, str(Path(path))) if camera is None else camera


def read_calibration(path: PathLike, size: Size | None = None) -> Calibration:
    """Read a calibration file of any kind; a light that it lacks is `NOMINAL`, which is logged.

    Parameters
    ----------
    path : path
        An `endoscope.json`, or a file of one of the `FORMATS`; ``FILE#NAME`` for one of several cameras.
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
    if camera is None:
        return Calibration.from_dict(document, str(Path(path)))
    text = f"{source['file']}: {source['format']}; its light is nominal: k 2.5, γ 2.2, gain unknown"
    if "others" in source:
        text += f"; {source['camera']} is taken, {source['file']}#NAME takes another: {source['others']}"
    logging.getLogger("endolab").warning("%s", text)
    return Calibration(
        camera, NOMINAL, {"photometry": {"nominal": True}, "converted": source}
    )
