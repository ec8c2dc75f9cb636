"""What the tuner's page is sent of an answer: numbers and pictures, with their titles; the page draws."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from endolab.numerics.arrays import FloatArray
from endolab.reconstruction.uncertainty import bounced_light
from endolab.solvers.problem import LOWER_BOUND, NONE, Problem
from endolab.workbench.plots.scales import OKABE_ITO, SOURCE_COLOURS, Colour, in_colour
from endolab.workbench.tuning.engine import Answer

# Others the page makes of these.
PANELS = (
    "distance",
    "model - frame",
    "normals",
    "spread over λ",
    "contours",
    "bounced light",
    "σ",
    "what determined each pixel",
)
LEFT_OUT: Colour = (128, 128, 128)


def as_buffers(arrays: Mapping[str, NDArray]) -> tuple[list[tuple[str, str]], list[bytes]]:
    """Arrays as they are sent: names, each with its kind, bytes or floats, and contents."""
    names = []
    buffers = []
    for name, array in arrays.items():
        kind = "u1" if array.dtype == np.uint8 else "f4"
        names.append((name, kind))
        buffers.append(array.astype(kind).tobytes())
    return names, buffers


def as_texts(arrays: Mapping[str, NDArray]) -> list[tuple[str, str, str]]:
    """Arrays as they lie in a page: names, kinds and contents."""
    named = zip(*as_buffers(arrays), strict=True)
    return [(name, kind, b64encode(buffer).decode()) for (name, kind), buffer in named]


def rgba(picture: FloatArray) -> NDArray[np.uint8]:
    """A picture in [0, 1], (H, W) or (H, W, 3), as the page draws it; nothing where it is nan."""
    colours = in_colour(picture)
    known = np.isfinite(colours).all(axis=-1, keepdims=True)
    filled = np.concatenate([np.where(known, colours, 0), known], axis=-1)
    return np.round(255 * filled).clip(0, 255).astype(np.uint8)


def still_of(
    problem: Problem, truth: FloatArray | None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """What stays while energy and light are turned: facts, and arrays by their names.

    What is left out is hatched on the picture.
    """
    height, width = problem.mask.shape
    rows = np.flatnonzero(problem.mask.any(axis=1))
    columns = np.flatnonzero(problem.mask.any(axis=0))
    left_out = ~problem.mask
    if problem.evidence is not None:
        left_out |= problem.evidence == NONE
    picture = rgba(problem.shown)
    hatched = left_out & (np.indices(left_out.shape).sum(axis=0) % 6 == 0)
    is_dark = picture[hatched, :3].max(axis=-1, keepdims=True) < 128
    picture[hatched, :3] = np.where(is_dark, 128, 64)
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
        "picture": picture,
        "rays": np.nan_to_num(problem.field.rays),
        "cuts": cuts,
        "truth": np.empty(0) if truth is None else truth,
    }
    return facts, arrays


def map_of(
    name: str, answer: Answer, several: Sequence[Answer]
) -> tuple[dict[str, Any], NDArray | None]:
    """Make one of `PANELS` of an answer, or say why there is none: its words, and numbers or a picture.

    `several` are answers that differ by λ alone.
    """
    result = answer.result
    uncertainty = answer.uncertainty
    if name == "distance":
        return {"title": f"[{result.problem.unit}]"}, result.distance
    if name == "model - frame":
        floor = 2 * 255 * answer.still.noise_left  # two standard deviations are no news
        known = np.isfinite(answer.residual)
        quiet = np.mean(np.abs(answer.residual[known]) <= floor) if known.any() else 1.0
        return {"title": f"[of 255], {100 * quiet:.0f} % within the noise"}, answer.residual
    if name == "normals":
        return {"title": "(n + 1)/2"}, rgba((result.normals + 1) / 2)
    if name == "contours":
        return _contours(answer)
    if not answer.is_final:
        return {"empty": "once the hand rests"}, None
    if name == "spread over λ":
        if len(several) < 2:
            return {"empty": "once another λ is solved"}, None
        logs = np.stack([one.result.iterate.log_distance for one in several])
        spread = 100 * np.expm1(logs.max(axis=0) - logs.min(axis=0))
        return {"title": f"[%], {len(several)} λ"}, spread
    if name == "bounced light":
        share = -100 * np.expm1(-bounced_light(result.iterate))
        if not share.any():
            return {"empty": "none found"}, None
        taken = "left in" if result.report.albedo is None else "removed"
        return {"title": f"[% of all], {taken}"}, np.where(result.mask, share, np.nan)
    if uncertainty is None:
        return {"empty": "press find σ"}, None
    if name == "σ":
        percent = 100 * uncertainty.sigma / result.distance
        return {
            "title": f"of the distance [%], median {np.nanmedian(percent):.2g}"
        }, percent
    colours = np.array([(*LEFT_OUT, 0), *((*one, 255) for one in SOURCE_COLOURS.values())])
    picture = colours.astype(np.uint8)[uncertainty.dominant_source]
    return {"title": "", "keys": [*SOURCE_COLOURS.items()]}, picture


def _contours(answer: Answer) -> tuple[dict[str, Any], NDArray]:
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
