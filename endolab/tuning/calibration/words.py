"""What a calibration became without some frames, in numbers and in words."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence

import numpy as np

from endolab.calibration.geometric.projection import NAMES, camera_vector
from endolab.calibration.summary import counted, light_values, plus_minus
from endolab.tuning.calibration.refit import State

Row = tuple[str, float, float, str]  # name, value, standard error (nan if it has none), unit
TIGHT = "padding: 0 6px; white-space: nowrap"
STAY = "The light's samples stay where the first camera saw them."
NAMED = 6  # frames that a line names
LINE = {"fx": (".2f", " px"), "rms": (".4f", " px"), "k": (".3f", ""), "γ": (".3f", "")}
LINE |= {"σ": (".2f", " grey levels")}


def rows(state: State, camera: bool = True, light: bool = True) -> list[Row]:
    """List the numbers of the fits, or of one of them."""
    found: list[Row] = []
    if camera and state.camera is not None:
        values, errors = camera_vector(state.camera.camera).tolist(), state.camera.standard_errors
        both = zip(NAMES, values, strict=True)
        found += [(name, value, errors[name], "" if name[0] == "k" else "px") for name, value in both]
        found.append(("rms", state.camera.rmse, math.nan, "px"))
    if light and state.light is not None:
        found += light_values(state.light)
        found.append(("σ", state.light.sigma, math.nan, "grey levels"))
    return found


def table(first: State, now: State, of_camera: bool) -> str:
    """Set the fit of the camera, or else of the light, as it is beside the first one, as HTML."""
    pair = (rows(state, of_camera, not of_camera) for state in (first, now))
    lines = []
    for (name, old, error, unit), (_, new, new_error, _) in zip(*pair, strict=True):
        if math.isnan(error):
            cells = [f"{old:.4g}", f"{new:.4g}", f"{new - old:+.2g}"]
        else:
            moved = f"{(new - old) / error + 0.0:+.1f} s.e." if 0 < error < np.inf else ""
            cells = [plus_minus(old, error), plus_minus(new, new_error), moved]
        row = "".join(
            f'<td style="text-align: right; padding: 0 6px; white-space: nowrap">{cell}</td>'
            for cell in cells
        )
        unit = unit.replace("grey levels", "grey")
        named = f"{name} [{unit}]" if unit else name
        lines.append(f'<tr><td style="{TIGHT}">{named}</td>{row}</tr>')
    out = counted(len(now.left_out), "frame")
    then = f"without {out}" if now.left_out else "now"
    head = f"<tr><th></th><th>first</th><th>{then}</th><th>moved</th></tr>"
    style = "font-size: 12px; line-height: 1.35; border-collapse: collapse"
    if not of_camera and now.camera is not None and now.left_out:
        lines.append(f'<tr><td colspan="4" style="padding: 0 6px">{STAY}</td></tr>')
    return f'<table class="endolab-numbers" style="{style}">{head}{"".join(lines)}</table>'


def legend(entries: Sequence[tuple[str, Sequence[int], str]], apart: str = " &nbsp; ") -> str:
    """Set marks in their colours, R, G, B, beside what they mean, as HTML, with something between them."""
    said = []
    for mark, (red, green, blue), text in entries:
        sign = f'<b style="color: rgb({red}, {green}, {blue})">{mark}</b> ' if mark else ""
        said.append(f"<span>{sign}{html.escape(text)}</span>")
    return f'<div style="font-size: 12px; line-height: 1.4">{apart.join(said)}</div>'


def fates(places: Mapping[str, int]) -> str:
    """Say what became of the places on the sheets before they were samples, as HTML; empty if unknown."""
    if not places:
        return ""
    told = "; ".join(f"{count} {html.escape(what)}" for what, count in places.items() if count)
    total = f"Of {sum(places.values())} places on the sheets of these frames: "
    return f'<div style="font-size: 12px; line-height: 1.4; margin-top: 4px">{total}{told}.</div>'


def change(first: State, now: State, names: Sequence[str]) -> str:
    """Say in a line how k, γ, focal length and rms changed; `names` are those of all frames, in order."""
    old, new = ({row[0]: row for row in rows(state)} for state in (first, now))
    told = []
    for name, (how, unit) in LINE.items():
        if name in old and name in new and old[name][2] != 0:  # not what was given
            told.append(f"{name} {old[name][1]:{how}} → {new[name][1]:{how}}{unit}")
    out = [name for name in names if name in now.left_out]
    without = ", ".join(out[:NAMED]) + (f" and {len(out) - NAMED} more" if len(out) > NAMED else "")
    said = f"without {without}" if out else "with all frames"
    return f"{said}: {'; '.join(told)} ({counted(now.steps, 'step')}, {now.seconds:.2f} s)"


def beginning(names: Sequence[str]) -> str:
    """Return what all names begin with, up to the last sign that is no digit."""
    if len(names) < 2:
        return ""
    first, last = min(names), max(names)
    length = next((i for i, (a, b) in enumerate(zip(first, last, strict=False)) if a != b), 0)
    return first[:length].rstrip("0123456789")
