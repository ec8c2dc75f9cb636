"""Endoscopes, cameras and targets in JSON files."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from endolab.calibration.targets import (
    PRINTED,
    TARGETS,
    AnyTarget,
    Target,
    target_in_words,
)
from endolab.io.atomic import PathLike, as_json, read_json, write_atomically
from endolab.io.cameras.documents import read_document
from endolab.model.cameras import Camera
from endolab.model.endoscope import Calibration
from endolab.model.photometry import NOMINAL
from endolab.numerics.checked_types import from_content, to_content
from endolab.numerics.checks import PATH, check_kinds, unknown_name

if TYPE_CHECKING:
    from endolab.calibration.session import Session


def write_camera(camera: Camera, path: PathLike) -> None:
    """Write an `endoscope.json` that holds a camera alone, whole or not at all."""
    write_atomically(path, as_json({"endolab": 1, "camera": to_content(camera)}))


@check_kinds(calibration=Calibration, path=PATH)
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
def read_target(name_or_path: PathLike) -> Target:
    """Find a target by its name in `TARGETS`, as it is bought (`PRINTED`), or in a JSON file.

    Such as ``{"endolab_target": 1, "kind": "dots", "columns": 19, "rows": 10, "spacing": 5.2797,
    "small": 1.05885, "large": 1.58266}``. Also "margin" (mm) and "fold" (columns on the left of it); for dots
    "seed" and "greys"; for charuco "marker", "dictionary", "first_id" and "legacy".
    """
    name = str(name_or_path)
    found = TARGETS.get(name) or target_in_words(name)
    if found:
        return found
    if not os.path.exists(name) and Path(name).suffix.lower() != ".json":
        raise unknown_name("target", name, [*TARGETS, PRINTED], "a JSON file")
    board = read_document(name) if name.endswith((".yaml", ".yml")) else {}
    if isinstance(board, dict) and "target_type" in board:
        known = PRINTED
        if board["target_type"] == "checkerboard":
            size = f"{board['targetCols'] + 1}x{board['targetRows'] + 1}"
            known = f"chessboard:{size}:{1000 * board['rowSpacingMeters']:g}mm"
        raise ValueError(
            f"{name}: a board by Kalibr, of corners and metres: give --target {known}"
        )
    return from_content(AnyTarget, read_json(name, "target file"), name)
