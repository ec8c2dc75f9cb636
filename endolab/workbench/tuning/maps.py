"""What the tuner's page is sent of an answer: numbers, with how they are shown; the page draws."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from endolab.numerics.arrays import FloatArray
from endolab.reconstruction.uncertainty import bounced_light
from endolab.solvers.problem import LOWER_BOUND, NONE, Problem
from endolab.workbench.plots.scales import (
    MAPS,
    OKABE_ITO,
    SOURCE_COLOURS,
    Colour,
    in_colour,
    limits,
)
from endolab.workbench.tuning.engine import Answer, Engine

# Those that the page makes of the others, and those that are sent.
PANELS = (
    "frame",
    "distance",
    "model - frame",
    "section",
    "3D",
    "λ curve",
    "error",
    "B / A - 1",
    "normals",
    "spread over λ",
    "contours",
    "bounced light",
    "σ",
    "what determined each pixel",
    "energy",
)
NEED_UNCERTAINTY = ("σ", "what determined each pixel")
LEFT_OUT: Colour = (128, 128, 128)


# How a map is shown, or why there is none; with its numbers, (H, W), or its picture, (H, W, 4) bytes.
Sent = tuple[dict[str, Any], NDArray | None]


def as_buffers(arrays: Mapping[str, NDArray]) -> tuple[list[tuple[str, str]], list[bytes]]:
    """Arrays as they are sent: names, each with its kind, bytes or floats, and contents."""
    names = []
    buffers = []
    for name, array in arrays.items():
        kind = "u1" if array.dtype == np.uint8 else "f4"
        names.append((name, kind))
        buffers.append(array.astype(kind).tobytes())
    return names, buffers


def rgba(picture: FloatArray) -> NDArray[np.uint8]:
    """A picture in [0, 1], (H, W) or (H, W, 3), as the page draws it; nothing where it is nan."""
    colours = in_colour(picture)
    known = np.isfinite(colours).all(axis=-1, keepdims=True)
    filled = np.concatenate([np.where(known, colours, 0), known], axis=-1)
    return np.round(255 * filled).clip(0, 255).astype(np.uint8)


def still_of(
    problem: Problem, truth: FloatArray | None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """What stays while energy and light are turned: facts, and arrays by their names."""
    height, width = problem.mask.shape
    rows = np.flatnonzero(problem.mask.any(axis=1))
    columns = np.flatnonzero(problem.mask.any(axis=0))
    cuts = np.zeros((height, width), np.uint8)
    if problem.cuts is not None:
        cuts = (problem.cuts[0] + 2 * problem.cuts[1]).astype(np.uint8)
    facts = {
        "width": width,
        "height": height,
        "unit": problem.unit,
        "metric": problem.metric,
        "window": [
            int(edge) for edge in (columns[0], rows[0], columns[-1] + 1, rows[-1] + 1)
        ],
    }
    arrays = {
        "picture": rgba(problem.shown),
        "rays": np.nan_to_num(problem.field.rays),
        "cuts": cuts,
        "truth": np.empty(0) if truth is None else truth,
    }
    return facts, arrays


Held = dict[str, tuple[float, float]]  # limits of maps


def map_of(name: str, answer: Answer, engine: Engine, held: Held) -> Sent:
    """Make a map of an answer, on the scale that is held; if none is, it is held from now on."""
    result = answer.result
    problem = result.problem
    if name == "distance":
        return _numbers(held, name, result.distance, f"[{problem.unit}]", problem.unit)
    if name == "model - frame":
        floor = 2 * 255 * answer.still.noise_left  # two standard deviations are no news
        known = np.isfinite(answer.residual)
        quiet = np.mean(np.abs(answer.residual[known]) <= floor) if known.any() else 1.0
        title = f"[of 255], {100 * quiet:.0f} % within the noise"
        return _numbers(held, name, answer.residual, title)
    if name == "normals":
        return {"title": "(n + 1)/2"}, rgba((result.normals + 1) / 2)
    if name == "contours":
        return _contours(answer)
    if not answer.is_final:
        return {"empty": "once the hand rests"}, None
    if name == "spread over λ":
        several = engine.curve_of(answer)
        logs = np.stack([one.result.iterate.log_distance for one in several])
        spread = 100 * np.expm1(logs.max(axis=0) - logs.min(axis=0))
        return _numbers(held, name, spread, f"[%], {len(several)} λ")
    if name == "bounced light":
        share = -100 * np.expm1(-bounced_light(result.iterate))
        taken = "left in" if result.report.albedo is None else "removed"
        return _numbers(
            held, name, np.where(result.mask, share, np.nan), f"[% of all], {taken}"
        )
    uncertainty = answer.uncertainty
    if uncertainty is None:
        return {"empty": "press find σ"}, None
    if name == "σ":
        percent = 100 * uncertainty.sigma / result.distance
        median = np.nanmedian(percent)
        return _numbers(held, name, percent, f"of the distance [%], median {median:.2g}")
    colours = np.array([(*LEFT_OUT, 0), *((*one, 255) for one in SOURCE_COLOURS.values())])
    picture = colours.astype(np.uint8)[uncertainty.dominant_source]
    return {"title": "", "keys": [*SOURCE_COLOURS.items()]}, picture


def _numbers(held: Held, name: str, values: FloatArray, title: str, unit: str = "") -> Sent:
    scale = MAPS[name]
    if name not in held:
        held[name] = limits(name, values)
    low, high = held[name]
    spec = {
        "title": title,
        "unit": unit or scale.unit,
        "palette": scale.palette,
        "low": low,
        "high": high,
        "log": scale.kind == "log",
    }
    return spec, values


def _contours(answer: Answer) -> Sent:
    """Where the surface is cut, and what pixels say."""
    problem = answer.result.problem
    picture = rgba(0.35 + 0.5 * np.mean(np.atleast_3d(problem.shown), axis=-1))
    nowhere = np.zeros(problem.mask.shape, bool)
    evidence = nowhere if problem.evidence is None else problem.evidence
    cut = nowhere if problem.cuts is None else problem.cuts.any(axis=0)
    keys = []
    for text, where, colour in (
        ("saturated: at least so bright", evidence == LOWER_BOUND, OKABE_ITO.orange),
        ("highlight: ignored", evidence == NONE, OKABE_ITO.purple),
        ("left out", ~problem.mask, LEFT_OUT),
        (f"cut, {answer.contours} lines", cut, OKABE_ITO.vermilion),
    ):
        picture[where, :3] = colour
        if where.any():
            keys.append((text, colour))
    return {"title": "and highlights", "keys": keys}, picture
