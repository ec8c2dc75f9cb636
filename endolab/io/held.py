"""`held.npz`: what the tuner held while λ or the light was turned, for `reconstruct` to give its bits."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from endolab.io.atomic import PathLike, name_damage, write_atomically
from endolab.io.surfaces import read_arrays
from endolab.model.endoscope import Calibration
from endolab.numerics.checked_types import from_content
from endolab.numerics.checks import PATH, check_kinds
from endolab.reconstruction.held import Held
from endolab.solvers.problem import Problem
from endolab.solvers.provenance import Report

HELD_FILE = "what endolab's tuner held"
ARRAYS = ("image", "mask", "evidence", "cuts", "picture")


def save_held(held: Held, path: PathLike) -> None:
    """Write light, cuts, start, camera and photometry, whole or not at all."""
    problem = held.problem
    facts = {
        "report": TypeAdapter(Report).dump_python(problem.report, mode="json"),
        "metric": problem.metric,
        "own": Calibration(problem.camera, problem.photometry).to_dict(),
        "believed": Calibration(problem.camera, held.light).to_dict(),
    }
    texts = json.dumps(facts)
    arrays = {name: getattr(problem, name) for name in ARRAYS}
    arrays |= {"start": held.start, "texts": np.frombuffer(texts.encode(), np.uint8)}
    content = io.BytesIO()
    known = {name: array for name, array in arrays.items() if array is not None}
    np.savez_compressed(content, **known)
    write_atomically(path, content.getvalue())


@check_kinds(path=PATH)
def load_held(path: PathLike) -> Held:
    """Read what the tuner held when it exported a result, for `reconstruct(held=...)`.

    Parameters
    ----------
    path : path
        A `held.npz`.

    Returns
    -------
    Held
        Direct light, contours and a start.

    Raises
    ------
    OSError, ValueError
        In one sentence, if it cannot be read.
    """
    arrays: Any = read_arrays(path, HELD_FILE, (*ARRAYS, "start", "texts"))
    with name_damage(path, HELD_FILE):
        texts = json.loads(arrays.pop("texts").tobytes())
        start = arrays.pop("start")
        own = Calibration.from_dict(texts["own"])
        believed = Calibration.from_dict(texts["believed"])
        problem = Problem(
            camera=own.camera,
            photometry=own.photometry,
            metric=texts["metric"],
            report=from_content(Report, texts["report"], HELD_FILE),
            **arrays,
        )
        return Held(problem, believed.photometry, start)
