"""`found.npz`: light and contours that were found, for `solve_found` to give the same bits again."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from endolab.io.atomic import PathLike, name_damage, write_atomically
from endolab.io.surfaces import read_arrays
from endolab.model.endoscope import Calibration
from endolab.numerics.checked_types import from_content
from endolab.numerics.checks import PATH, check_kinds
from endolab.reconstruction.found import Found
from endolab.reconstruction.settings import Settings
from endolab.solvers.problem import Problem
from endolab.solvers.provenance import Report

FOUND_FILE = "light and contours that endolab found"
ARRAYS = ("image", "mask", "evidence", "cuts", "picture", "seen", "lamp_ratio")


def save_found(found: Found, path: PathLike) -> None:
    """Write what was found, whole or not at all."""
    problem = found.problem
    facts = {
        "report": TypeAdapter(Report).dump_python(
            replace(problem.report, calibration=None), mode="json"
        ),
        "own": Calibration(problem.camera, problem.photometry).to_dict(),
        "believed": replace(found.believed, evidence={}).to_dict(),
        "settings": found.settings.as_dict(),
    }
    texts = json.dumps(facts)
    arrays = {name: getattr(problem, name) for name in ARRAYS}
    arrays |= {"start": found.start, "texts": np.frombuffer(texts.encode(), np.uint8)}
    content = io.BytesIO()
    known = {name: array for name, array in arrays.items() if array is not None}
    np.savez_compressed(content, **known)
    write_atomically(path, content.getvalue())


@check_kinds(path=PATH)
def load_found(path: PathLike) -> Found:
    """Read light and contours that were found, for `endolab.solve_found`.

    Parameters
    ----------
    path : path
        A `found.npz` of the tuner's export, or a `held.npz` of endolab 0.2.

    Returns
    -------
    Found
        Direct light, contours and a start.

    Raises
    ------
    OSError, ValueError
        In one sentence, if it cannot be read.
    """
    arrays: Any = read_arrays(path, FOUND_FILE, (*ARRAYS, "start", "texts"))
    with name_damage(path, FOUND_FILE):
        texts = json.loads(arrays.pop("texts").tobytes())
        start = arrays.pop("start", None)
        own = Calibration.from_dict(texts["own"])
        believed = Calibration.from_dict(texts["believed"])
        is_new = "settings" in texts
        if (
            not is_new
        ):  # of 0.2: its unit may be that of a length, and its picture is not told
            unknown = {"fingerprint": None, "scale": "", "length": None}
            texts["report"] |= unknown | {"length_by_gain": None}
        problem = Problem(
            camera=own.camera,
            photometry=own.photometry,
            metric=believed.photometry.gain is not None,
            report=from_content(Report, texts["report"], FOUND_FILE),
            **arrays,
        )
        settings = texts["settings"] if is_new else texts["report"]["asked"]
        return Found(
            problem=problem,
            settings=from_content(Settings, settings, FOUND_FILE),
            believed=believed,
            start=start,
            halvings=1 if is_new else 2,
        )
