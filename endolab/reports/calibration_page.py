"""The report of a calibration: a page with pictures, and its numbers as JSON."""

from __future__ import annotations

import io
from collections.abc import Iterable
from html import escape
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from endolab.calibration.photometric.result import PhotometricFit
from endolab.calibration.session import Named, Session, describe
from endolab.calibration.summary import (
    account,
    brdf_of,
    by_reason,
    camera_values,
    evidence,
    light_values,
    plus_minus,
)
from endolab.io.atomic import PathLike, as_json, staged_folder, write_atomically
from endolab.io.descriptions import make_calibration
from endolab.io.video import Frames
from endolab.model.brdf import TabulatedBRDF
from endolab.model.endoscope import camera_to_dict
from endolab.numerics.arrays import FloatArray
from endolab.plots.calibration import best_frame, geometry_figure, light_figure, show_detection
from endolab.plots.style import PAGE_SIZE, house

__all__ = ["account", "evidence", "make_calibration", "write_report"]

CSS = """
:root { color-scheme: light dark; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 75rem; margin: 2rem auto; padding: 0 1rem; }
h1 { margin-bottom: 0; } h2 { margin-top: 2.2rem; }
img { max-width: 100%; background: white; border-radius: 6px; }
table { border-collapse: collapse; margin: .8rem 0; }
th, td { padding: .15rem .8rem .15rem 0; text-align: left; border-bottom: 1px solid #8885; }
td { font-variant-numeric: tabular-nums; }
pre { white-space: pre-wrap; }
.note { opacity: .75; }
.verdict { border-left: .4rem solid #009e73; background: #009e731c; padding: .1rem 1rem; margin: 1rem 0; }
.refused { border-color: #d55e00; background: #d55e0022; }
.correlation { font-size: .72rem; display: block; overflow-x: auto; }
.correlation th, .correlation td { padding: .15rem .3rem; text-align: right; border: 0; }
.side { display: flex; flex-wrap: wrap; gap: 0 4rem; }
"""


def _cell(tag: str, value: str, style: str = "") -> str:
    return f"<{tag}{style}>{escape(value)}</{tag}>"


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    top = "".join(_cell("th", name) for name in head)
    body = "".join(f"<tr>{''.join(_cell('td', value) for value in row)}</tr>\n" for row in rows)
    return f"<table><tr>{top}</tr>\n{body}</table>"


def _list(items: Iterable[str]) -> str:
    return f"<ul>{''.join(_cell('li', item) for item in items)}</ul>"


def _symbol(name: str) -> str:
    """Shorten the name of an unknown for the head of a matrix."""
    kind, _, rest = name.partition(" ")
    return {"gamma": "γ", "brdf": "f", "reflectance": "ρ"}.get(kind, kind) + rest.replace("tilt ", "t")


def _correlation(light: PhotometricFit) -> str:
    """Correlation matrix as a table, orange where positive, blue where negative."""
    names = [_symbol(name) for name in light.names]
    rows = []
    for name, row in zip(names, light.correlation, strict=True):
        cells = [_cell("th", name)]
        for value in np.nan_to_num(row):
            colour = "213, 94, 0" if value > 0 else "0, 114, 178"
            shade = f' style="background: rgba({colour}, {0.75 * abs(value):.2f})"'
            cells.append(_cell("td", f"{value:+.2f}".replace("0.", "."), shade))
        rows.append(f"<tr>{''.join(cells)}</tr>\n")
    head = "".join(_cell("th", name) for name in ["", *names])
    return f'<table class="correlation"><tr>{head}</tr>\n{"".join(rows)}</table>'


def _values(rows: Iterable[tuple[str, float, float, str]]) -> str:
    shown = [(name, f"{plus_minus(value, error)} {unit}") for name, value, error, unit in rows]
    return _table(["", "value ± standard error"], shown)


def _brdf(light: PhotometricFit) -> str:
    theta, relative, errors = brdf_of(light)
    nodes = zip(np.rad2deg(theta), relative, errors, strict=True)
    rows = [
        (f"f{j}", f"{angle:.1f}°", "1 (pinned)" if error == 0 else plus_minus(value, error))
        for j, (angle, value, error) in enumerate(nodes)
    ]
    return _table(["node", "incidence θ", "relative to the pinned node ± s.e."], rows)


def _light_section(light: PhotometricFit) -> str:
    spot = "" if not light.photometry.lights else " The light's place and direction were fitted."
    parts = [
        "<h2>Light</h2>",
        f'<p><img src="light.png" alt="{escape(_ALT)}"></p>',
        f'<p class="note">I = (cos<sup>k</sup>α / d² · f<sub>r</sub>(θ) · cos θ · g)<sup>1/γ</sup>.{spot} '
        "The BRDF is that of the calibration sheet: replace it by that of what is to be seen.</p>",
        '<div class="side"><div>',
        _values(light_values(light)),
        "</div>",
    ]
    if isinstance(light.photometry.brdf, TabulatedBRDF):
        parts.append(f"<div>{_brdf(light)}</div>")
    parts += ["</div>", "<h3>Correlations</h3>", _correlation(light)]
    return "\n".join(parts)


_ALT = "samples in a frame, their residuals, fall-off of the light, gains, BRDF, score on frames held out"


def _camera_section(session: Session) -> str:
    if session.geometry is None:
        what = f"As given: {session.camera.model}, {session.camera.width} x {session.camera.height} px."
        return f'<h2>Camera</h2>\n<p>{escape(what)}</p>\n<p><img src="detection.png" alt="detection"></p>'
    alt = "features found in a frame, reprojection residuals, field covered, their histogram"
    parts = [
        "<h2>Camera</h2>",
        f'<p><img src="camera.png" alt="{alt}"></p>',
        _values(camera_values(session)),
    ]
    if session.geometry.dropped:
        parts += ["<p>Views left out of the camera:</p>", _list(by_reason(session.geometry.dropped))]
    return "\n".join(parts)


def _frames_section(session: Session) -> str:
    parts = ["<h2>Frames</h2>", _cell("p", account(session)[0] + ".")]
    if session.dropped:
        table = _table(["dropped", "why"], session.dropped.items())
        parts += [
            _list(by_reason(session.dropped)),
            f"<details><summary>dropped, one by one</summary>{table}</details>",
        ]
    names = ", ".join(session.poses)
    parts.append(f"<details><summary>used: {len(session.poses)}</summary>{_cell('p', names)}</details>")
    return "\n".join(parts)


def _page(session: Session, source: str, shown: str) -> str:
    light = session.light
    told = [] if light is None else light.verdict
    if light is None:
        reason = f"<p><b>The light was not calibrated.</b> {escape(session.refused)}</p>"
        verdict = f'<div class="verdict refused">{reason}</div>'
    else:
        verdict = f'<div class="verdict">{_list(light.verdict)}</div>'
    parts = [
        "<!doctype html>",
        '<html lang="en"><head><meta charset="utf-8"><title>Calibration</title>',
        f'<meta name="viewport" content="width=device-width"><style>{CSS}</style></head><body>',
        "<h1>Calibration</h1>",
        _cell("p", f"{source}{' · ' if source else ''}target: {describe(session.target)}"),
        verdict,
        _cell("pre", "\n".join(line for line in account(session) if line not in told)),
        _camera_section(session),
        "" if light is None else _light_section(light),
        _cell("p", f"The frame shown is {shown}.", ' class="note"'),
        _frames_section(session),
        "</body></html>",
    ]
    return "\n".join(parts) + "\n"


def _png(figure: Figure) -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return stream.getvalue()


def _detection_figure(session: Session, image: FloatArray, name: str) -> Figure:
    with house(PAGE_SIZE):
        figure = Figure(figsize=(10, 8), dpi=100, layout="constrained")
        show_detection(image, session.detections[name], session.target, figure.subplots())
    return figure


def _picture(frames: Named, name: str, session: Session) -> FloatArray:
    """Read one frame; black if it can no longer be read."""
    only = frames.read([name]) if isinstance(frames, Frames) else frames
    image = next((image for found, image in only if found == name), None)
    return np.zeros((session.camera.height, session.camera.width)) if image is None else image


def write_report(session: Session, frames: Named, folder: PathLike, channel: str = "grey") -> None:
    """Write `report.html` with its pictures, `report.json` and `camera.json` into a folder.

    Parameters
    ----------
    session : Session
    frames : Frames, or iterable of (str, image)
        What was calibrated from; one frame of it is shown.
    folder : path
        Made if need be. Either all files are written or none.
    channel : str
        Whose response was calibrated.

    Raises
    ------
    OSError
        In one sentence, if they cannot be written.
    """
    source = str(frames.path) if isinstance(frames, Frames) else ""
    name = best_frame(session)
    image = _picture(frames, name, session)
    facts: dict[str, Any] = evidence(session, source, channel) | {"account": account(session)}
    with staged_folder(folder) as staging:
        if session.geometry is None:
            pictures = {"detection.png": _detection_figure(session, image, name)}
        else:
            pictures = {"camera.png": geometry_figure(session, image, name)}
        if session.light is not None:
            pictures["light.png"] = light_figure(session, image, name)
        for file, figure in pictures.items():
            write_atomically(staging / file, _png(figure))
        write_atomically(staging / "report.html", _page(session, source, name).encode())
        write_atomically(staging / "report.json", as_json(facts))
        camera = {"endolab": 1, "camera": camera_to_dict(session.camera)}
        write_atomically(staging / "camera.json", as_json(camera))
