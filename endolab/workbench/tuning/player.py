"""A tuner without Python: answers for each regulariser and λ in one HTML file, under the tuner's page.

Neighbouring λ differ little, so that each map is stored as what it differs by from the one before, deflated:
log d in 4,094 even steps, of which two bytes, model - frame in 255.
"""

from __future__ import annotations

import base64
import html
import json
import zlib
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from endolab.numerics.threads import limit_threads, threads
from endolab.solvers.problem import REGULARISERS
from endolab.workbench.tuning.engine import Answer, Engine
from endolab.workbench.tuning.maps import PANELS, as_texts
from endolab.workbench.tuning.messages import curve_of, message_of, still_said
from endolab.workbench.tuning.script import page_script
from endolab.workbench.tuning.source import Knobs

PLAYED_LAMS = [
    float(f"{lam:.2g}") for lam in 10 ** np.linspace(-2, 2, 21)
]  # as the slider has them

PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title><link rel="icon" href="data:,">
<style>body {{ margin: 0; padding: 8px 12px; }}
@media (prefers-color-scheme: dark) {{ body {{ background: #191919; }} }}
{style}</style></head>
<body><div id="tuner">loading …</div>
<script type="module">{script}
const place = document.getElementById("tuner");
place.textContent = "";
await play({content}, place);
</script></body></html>
"""


def pack(answers: Sequence[Answer]) -> dict[str, Any]:
    """Pack distances and residuals."""
    logs = np.stack([answer.result.iterate.log_distance for answer in answers])
    low = float(np.nanmin(logs))
    step = max((float(np.nanmax(logs)) - low) / 4093, 1e-9)
    codes = np.where(np.isnan(logs), 0, np.round((logs - low) / step) + 1)
    codes = codes.astype(np.uint16)
    left = np.stack([answer.residual for answer in answers])
    largest = np.nanpercentile(np.abs(left), 98, axis=(1, 2))
    end = max(float(np.median(largest)), 5.0)  # that is told apart
    left = np.where(np.isnan(left), 0, np.round(127 * left / end).clip(-127, 127) + 128)
    content = b""
    for plane in (codes & 255, codes >> 8, left):
        bytewise = plane.astype(np.uint8)
        content += np.diff(bytewise, axis=0, prepend=np.uint8(0)).tobytes()
    packed = base64.b64encode(zlib.compress(content, 9)).decode()
    return {"packed": packed, "low": low - step, "step": step, "end": end}


def page_of(
    answer: Answer,
    engine: Engine,
    facts: dict[str, Any],
    progress: Callable[[int, int], object],
) -> str:
    """Return the page: λ × regulariser, with the light and the contours of an answer."""
    if answer.settings.solver != "gauss_newton":
        raise ValueError("only Gauss-Newton's answers are played over λ")
    orders: Any = REGULARISERS
    wishes = [
        replace(answer.settings, lam=lam, regulariser=order)
        for order in orders
        for lam in PLAYED_LAMS
    ]

    def solve(wish: Knobs) -> Answer:
        with limit_threads(
            1
        ):  # cores share out the answers: less waiting than for bands of one
            return engine.solve(wish, answer.still)

    answers: list[Answer] = []
    with ThreadPoolExecutor(threads()) as pool:
        for one in pool.map(solve, wishes):
            answers.append(one)
            progress(len(answers), len(wishes))
    messages = [message_of(one, PANELS[:2], engine)[0] for one in answers]
    best = curve_of(answer, engine.curve_of(answer))  # as the tuner suggests it
    own = answer.result.problem.regulariser
    for message, one in zip(messages, answers, strict=True):
        order = one.settings.regulariser
        alike = [other for other in answers if other.settings.regulariser == order]
        message["curve"] = curve_of(one, alike)
        if order == own:
            message["curve"] |= {name: best.get(name) for name in ("title", "best")}
    words, arrays = still_said(answer)
    specs = [spec for spec in facts["specs"] if spec["name"] in ("lam", "regulariser")]
    specs[1] = specs[1] | {"options": [*REGULARISERS]}
    knobs = {"lam": answer.settings.lam, "regulariser": own}
    content = {
        "facts": facts | {"specs": specs, "panels": [*PANELS[:2]], "alone": True},
        "first": words | {"knobs": knobs, "anew": True},
        "messages": messages,
        "still": as_texts(arrays),
    }
    style = Path(__file__).with_name("tuner.css").read_text(encoding="utf-8")
    return PAGE.format(
        title=html.escape(f"{answer.still.subject.frame.name} · endolab"),
        style=style,
        script=page_script("player"),
        content=json.dumps(content | pack(answers)).replace("</", "<\\/"),
    )
