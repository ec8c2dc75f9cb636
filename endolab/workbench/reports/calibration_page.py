"""The report of a calibration: a page with pictures, and its numbers as JSON."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from endolab._extras import lacking
from endolab.calibration import summary
from endolab.calibration.session import Named, Session
from endolab.io.atomic import as_json, write_atomically
from endolab.io.descriptions import write_camera
from endolab.io.images import write_figure
from endolab.io.video import Frames
from endolab.workbench.plots import calibration as figures
from endolab.workbench.plots.style import page


def _frames_of(session: Session) -> list[dict[str, Any]]:
    """Name, error, reason to be left out, and corners of the panels, mm, of each frame."""
    left, top, width, height = session.target.sheet
    fold = session.target.fold_x
    edges = [left, left + width] if fold is None else [left, fold, left + width]
    listed = []
    for name in session.detections:
        panels = []
        for panel, pose in enumerate(session.poses.get(name, ())):
            if pose is not None:
                x = np.repeat(edges[panel : panel + 2], 2)
                y = top + height * np.array([0, 1, 1, 0])
                panels.append(pose.transform(np.stack([x, y, 0 * x], axis=-1)).tolist())
        why = session.dropped.get(name, "")
        error = session.errors.get(name)
        listed.append({"name": name, "error": error, "why": why, "panels": panels})
    return listed


def write_report(
    session: Session, frames: Named, folder: Path, channel: str = "grey"
) -> None:
    """Write `report.html` with its pictures, `report.json` and `camera.json` into a folder that is there.

    `frames` are those that were calibrated from: one is shown. `channel` is the one whose response was
    calibrated. Without Jinja2, of the extra `lab`, there is all but the page.
    """
    source = str(frames.path) if isinstance(frames, Frames) else ""
    name = figures.best_frame(session)
    worst = figures.worst_frames(session)
    # Black where one can no longer be read.
    black = np.zeros((session.camera.height, session.camera.width))
    pictures = dict.fromkeys({name, *worst}, black)
    read = frames.read(sorted(pictures)) if isinstance(frames, Frames) else frames
    pictures |= {one: image for one, image in read if one in pictures and image is not None}
    image = pictures[name]
    drawn: dict[str, Figure] = {}
    if session.geometry is None:
        with page(10, 8) as drawn["detection"]:
            ax = drawn["detection"].subplots()
            figures.show_detection(image, session.detections[name], session.target, ax)
    else:
        drawn["camera"] = figures.geometry_figure(session, image)
    if worst:
        of_worst = {name: pictures[name] for name in worst}
        drawn["frames"] = figures.frames_figure(session, of_worst)
    if session.light is not None:
        drawn["light"] = figures.light_figure(session, image)
    if session.geometry is not None or session.light is not None:
        drawn["uncertainty"] = figures.uncertainty_figure(session)
    for title, figure in drawn.items():
        write_figure(folder / f"{title}.png", figure)
    account = summary.account(session)
    if not lacking("jinja2"):
        from jinja2 import Environment, StrictUndefined

        environment = Environment(autoescape=True, undefined=StrictUndefined)
        environment.trim_blocks = environment.lstrip_blocks = True
        template = Path(__file__).with_suffix(".html.j2").read_text(encoding="utf-8")
        text = environment.from_string(template).render(
            session=session,
            summary=summary,
            account=account,
            source=source,
            shown=name,
            frames=_frames_of(session),
        )
        write_atomically(folder / "report.html", text.encode())
    facts = summary.evidence(session, source, channel)
    content = as_json({"endolab": 1, **facts, "account": account})
    write_atomically(folder / "report.json", content)
    write_camera(session.camera, folder / "camera.json")
