"""What the tuner's page is told of an answer. `messages.json` lists all that is said, and asked for."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence, Set
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from endolab.metrics.contrast import suggest_lam
from endolab.reconstruction.report import (
    SOLVER_NAMES,
    advice,
    describe,
    warnings,
    what_changed,
)
from endolab.workbench.tuning.engine import Answer, Engine
from endolab.workbench.tuning.maps import map_of, rgba, still_of
from endolab.workbench.tuning.source import Knobs, Subject

MESSAGES = json.loads(Path(__file__).with_name("messages.json").read_text(encoding="utf-8"))
# The widget's methods, and the names of what they are given.
ACTIONS = {row["name"]: (row["method"], row["given"]) for row in MESSAGES["asks"]}
NOMINAL = (
    "No calibration: camera, k and γ are nominal, and only the shape is told. γ moves the far end most: "
    "turn it, and see."
)
ELSEWHERE = 10.0  # %; two surfaces that differ by more are not the same
SLOW = 3.0  # s, after which somebody asks where the other dots of the curve are
LEAST_ELSEWHERE = 1.0  # % of the pixels, of which it is said


def message_of(
    answer: Answer, names: Iterable[str], engine: Engine, change: str = ""
) -> tuple[dict[str, Any], dict[str, NDArray]]:
    """What is said of an answer and of some of its maps, and these; `change` by asking anew."""
    line = describe(answer.result, answer.explained, answer.kind, answer.errors)
    first = int(answer.uses_lam)  # which tells more than its solver's name
    label = " · ".join(line.split(" · ")[first : first + 3])
    if answer.is_final and answer.is_anew and change:
        line = f"{change} · {line}"
    several = engine.curve_of(answer)
    maps = {name: map_of(name, answer, several) for name in names}
    message = {
        "label": label,
        "badge": "" if answer.is_anew else "held",
        "nominal": NOMINAL if "camera" in answer.result.report.nominal else "",
        "state": answer.state,
        "found": engine.number_of(answer),
        "line": line,
        "tone": "",
        "curve": curve_of(answer, several),
        "asked": vars(answer.settings),
        "moving": not answer.is_final,
        "maps": {name: words for name, (words, _) in maps.items()},
    }
    return message, {name: a for name, (_, a) in maps.items() if a is not None}


def run_of(answer: Answer) -> dict[str, Any]:
    """How the run of a final answer went."""
    rows = answer.result.history
    columns = ("k", "data", "regulariser", "energy")
    energy = {name: [row[name] for row in rows] for name in columns}
    return {"path": [one.k for one in answer.path], "energy": energy}


def still_said(answer: Answer) -> tuple[dict[str, Any], dict[str, NDArray]]:
    """What stays while energy and light are turned, and its arrays."""
    truth = answer.still.truth_in(answer.result)
    facts, arrays = still_of(answer.result.problem, truth)
    gain = answer.still.subject.calibration.photometry.gain
    return {"still": facts | {"has_gain": gain is not None}}, arrays


def picture_said(
    subject: Subject, knobs: Knobs
) -> tuple[dict[str, Any], dict[str, NDArray]]:
    """What can be said before there is an answer, and the picture."""
    image = subject.frame.image
    step = -(-image.shape[1] // knobs.width)
    picture = rgba(image[::step, ::step])
    height, width = picture.shape[:2]
    still = {"width": width, "height": height, "window": [0, 0, width, height]}
    still["has_gain"] = subject.calibration.photometry.gain is not None
    message = {"still": still, "line": "solving ...", "knobs": vars(knobs)}
    return message, {"picture": picture}


def curve_of(answer: Answer, tried: Sequence[Answer]) -> dict[str, Any]:
    """What each λ explains that was `tried` with the solver, the light and the contours of an answer."""
    if not answer.uses_lam:
        return {"title": f"{answer.settings.solver.replace('_', ' ')} has no λ"}
    errors = [one.errors for one in tried]
    slow = ""
    if len(tried) == 1 and tried[0].result.seconds > SLOW:
        slow = f"{SOLVER_NAMES[answer.settings.solver]} takes {tried[0].result.seconds:.0f} s for each λ"
    curve: dict[str, Any] = {
        "title": slow,
        "lams": [one.settings.lam for one in tried],
        "explained": [one.explained for one in tried],
        "errors": [None if one is None else one[0] for one in errors],
        "now": answer.settings.lam,
    }
    if len(tried) > 3:  # of fewer nothing follows
        best, at_least = suggest_lam(curve["lams"], curve["explained"])
        title = "no λ tried explains 99 %: wet or stained walls, or another light"
        if best is not None:
            title = f"99 % explained up to {'≥ ' if at_least else ''}{best:.2g}"
        curve |= {"title": title, "best": best}
    return curve


def chips_of(
    answer: Answer, best: float | None, moved: float, turned: Set[str]
) -> list[dict[str, Any]]:
    """What asks for a look: advice, warnings, and what share of the pixels `moved` by asking anew, %.

    `best` is the largest λ that explains enough, if one does.
    What may be their cause begins with the knobs that were `turned`.
    """
    chips: list[dict[str, Any]] = []
    advised = advice(answer.explained, answer.settings.lam, best)
    if advised:
        text = "A smaller λ follows the picture more closely; click to take it."
        chips.append({"chip": advised, "text": text, "lam": float(f"{best:.2g}")})
    chips += [
        {"chip": re.split("[:;,]", text)[0].rstrip("."), "text": text}
        for text in warnings(answer.result, turned)
        if not (advised and "λ too large" in text)
    ]
    if answer.is_anew and moved >= LEAST_ELSEWHERE:
        share = f"{moved:.2g} %"
        text = f"{share} of the pixels moved by more than {ELSEWHERE:g} % as all was asked anew."
        chip = f"not unique: {share} of pixels"
        chips.append({"chip": chip, "text": text, "panel": "B / A - 1"})
    return chips


def change_of(before: Answer | None, answer: Answer) -> tuple[str, float]:
    """Say what asking anew has changed, and what share of the pixels is elsewhere now, %."""
    if before is None or before.still.subject is not answer.still.subject:
        return "", 0.0
    old = before.result
    new = answer.result
    if old.mask.shape != new.mask.shape:
        return "", 0.0
    sentence = what_changed(old, new, answer.contours - before.contours)
    if before.settings != answer.settings:
        return sentence, 0.0
    change = 100 * np.abs(old.distance / new.distance - 1)[new.mask]
    return sentence, 100 * float(np.mean(change > ELSEWHERE))
