"""`held.npz`: what the tuner held while λ or the light was turned, for `reconstruct` to give its bits."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np

from endolab.io.atomic import PathLike, name_damage, write_atomically
from endolab.io.surfaces import read_arrays
from endolab.model.endoscope import Calibration
from endolab.numerics.checks import PATH, check_kinds
from endolab.reconstruction.held import Held
from endolab.solvers.problem import Problem
from endolab.solvers.provenance import ContourOutcome, LightOutcome, Report

HELD_FILE = "what endolab's tuner held"
ARRAYS = ("image", "mask", "evidence", "cuts", "picture")
# Of the report: what became of indirect light, and which channel it is.
FACTS = (
    "channel",
    "smooth",
    "wall_albedo",
    "albedo_given",
    "indirect_percent",
    "cut_links",
    "nominal",
)


def save_held(held: Held, path: PathLike) -> None:
    """Write light, cuts, start, camera and photometry, whole or not at all."""
    problem = held.problem
    report = problem.report
    facts = {name: getattr(report, name) for name in FACTS}
    facts["light"] = report.light and report.light.name
    facts["contours"] = report.contours and report.contours.name
    facts["metric"] = problem.metric
    own = Calibration(problem.camera, problem.photometry).to_dict()
    believed = Calibration(problem.camera, held.light).to_dict()
    texts = json.dumps({"facts": facts, "own": own, "believed": believed})
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
        facts = texts["facts"]
        metric = facts.pop("metric")
        for name in ("wall_albedo", "indirect_percent", "nominal"):
            facts[name] = tuple(facts[name])
        for name, outcome in (("light", LightOutcome), ("contours", ContourOutcome)):
            facts[name] = facts[name] and outcome[facts[name]]
        report = Report(**facts, width=start.shape[1], height=start.shape[0])
        own = Calibration.from_dict(texts["own"])
        believed = Calibration.from_dict(texts["believed"])
        problem = Problem(
            camera=own.camera,
            photometry=own.photometry,
            metric=metric,
            report=report,
            **arrays,
        )
        return Held(problem, believed.photometry, start)
