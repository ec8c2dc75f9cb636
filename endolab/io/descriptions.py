"""Endoscopes, cameras and targets in JSON files."""

from __future__ import annotations

import os
from dataclasses import MISSING, asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from endolab.calibration.targets import (
    TARGETS,
    AprilGrid,
    Charuco,
    Chessboard,
    CircleGrid,
    DotGrid,
    Target,
)
from endolab.io.atomic import PathLike, as_json, read_json, write_atomically
from endolab.model.cameras import Camera
from endolab.model.endoscope import Calibration, CameraFile
from endolab.model.photometry import Photometry
from endolab.model.schema import Section, quote, unknown_name
from endolab.numerics.checked_types import from_content, to_content

if TYPE_CHECKING:
    from endolab.calibration.session import Session

# The paper's, of an endoscope whose light was not measured.
NOMINAL = Photometry(k=2.5, gamma=2.2)


def read_camera(path: PathLike) -> Camera:
    """Read the camera of an `endoscope.json`, which may hold nothing else."""
    content = read_json(path, "calibration file")
    return from_content(CameraFile, content, str(Path(path))).camera


def write_camera(camera: Camera, path: PathLike) -> None:
    """Write an `endoscope.json` that holds a camera alone, whole or not at all."""
    write_atomically(path, as_json({"endolab": 1, "camera": to_content(camera)}))


def read_calibration(path: PathLike) -> Calibration:
    """Read `endoscope.json`; ValueError names the key of what in it is missing, misspelt or wrong."""
    return Calibration.from_dict(read_json(path, "calibration file"), str(Path(path)))


def write_calibration(calibration: Calibration, path: PathLike) -> None:
    """Write `endoscope.json`, whole or not at all; OSError or ValueError in one sentence, if it cannot be."""
    write_atomically(path, as_json(calibration.to_dict()))


def make_calibration(
    session: Session, source: str = "", channel: str = "grey"
) -> Calibration:
    """Make what `endoscope.json` holds: camera, light and the evidence for them.

    Parameters as of `evidence`. The BRDF is that of the sheet; the gain is None unless one was fitted to
    all frames. If the light was refused, it is `NOMINAL`, and the evidence says so.

    Returns
    -------
    Calibration
        What a session found, with its evidence.
    """
    # Here, for whoever reads a calibration need not be able to calibrate.
    from endolab.calibration.summary import evidence

    light = NOMINAL if session.light is None else session.light.photometry
    return Calibration(session.camera, light, evidence(session, source, channel))


# Descriptions ---------------------------------------------------------------------------
KINDS: dict[str, type[Target]] = {
    make.kind: make for make in (DotGrid, CircleGrid, Chessboard, Charuco, AprilGrid)
}


def read_target(name_or_path: PathLike) -> Target:
    """Find a target by its name in `TARGETS`, or read its description, a JSON file.

    Such as ``{"endolab_target": 1, "kind": "dots", "columns": 19, "rows": 10, "spacing": 5.2797,
    "small": 1.05885, "large": 1.58266}``. Also "margin" (mm), "fold" (columns on the left of it), "inverted"
    (white on black); for dots "seed" and "greys"; for circles "radius" and "symmetric"; for charuco and
    aprilgrid "marker", "dictionary" and "first_id", and "legacy" or "border" and "squares".
    """
    name = str(name_or_path)
    if name in TARGETS:
        return TARGETS[name]
    if not os.path.exists(name) and Path(name).suffix.lower() != ".json":
        raise unknown_name("target", name, TARGETS, "a JSON file")
    top = Section(read_json(name, "target file"), "", name)
    version = top.take("endolab_target")
    if version != 1 or isinstance(version, bool):
        raise top.error("endolab_target", f"expected version 1, found {quote(version)}")
    kind = top.choice("kind", tuple(KINDS))
    values: dict[str, Any] = {}
    for part in fields(KINDS[kind]):
        is_needed = part.default is MISSING or (part.type is float and part.default == 0)
        if top.content.get(part.name) is None and not is_needed:
            top.take(part.name, None)
        elif part.type is str:
            values[part.name] = str(top.take(part.name))
        elif part.type is bool:  # which the target itself refuses, if it is another value
            values[part.name] = top.take(part.name)
        else:
            is_integer = part.type in (int, int | None)
            read = top.integer if is_integer else top.positive
            values[part.name] = read(part.name)
    return top.build(KINDS[kind], **values)


def write_target(target: Target, path: PathLike) -> None:
    """Write the description of a target as JSON, whole or not at all; `read_target` reads it."""
    values = {key: value for key, value in asdict(target).items() if value is not None}
    write_atomically(path, as_json({"endolab_target": 1, "kind": target.kind} | values))
