"""The report of a calibration: a page with pictures, and its numbers as JSON."""

from collections.abc import Collection
from pathlib import Path

import numpy as np

from endolab._extras import lacking
from endolab.calibration import summary
from endolab.calibration.session import Named, Session, describe_target
from endolab.io.atomic import as_json, write_atomically
from endolab.io.descriptions import write_camera
from endolab.io.images import write_figure
from endolab.io.video import Frames
from endolab.numerics.arrays import FloatArray
from endolab.workbench.plots import calibration as figures
from endolab.workbench.plots.calibration import uncertainty_figure
from endolab.workbench.plots.style import page


def _page(session: Session, source: str, shown: str) -> str:
    from jinja2 import Environment, StrictUndefined

    environment = Environment(autoescape=True, undefined=StrictUndefined)
    environment.trim_blocks = environment.lstrip_blocks = True
    template = Path(__file__).with_suffix(".html.j2").read_text(encoding="utf-8")
    return environment.from_string(template).render(
        session=session,
        light=session.light,
        summary=summary,
        account=summary.account(session),
        source=source,
        shown=shown,
        target=describe_target(session.target),
    )


def _pictures(
    frames: Named, names: Collection[str], session: Session
) -> dict[str, FloatArray]:
    """Read some frames; black where one can no longer be read."""
    black = np.zeros((session.camera.height, session.camera.width))
    pictures = dict.fromkeys(names, black)
    read = frames.read(sorted(names)) if isinstance(frames, Frames) else frames
    for name, image in read:
        if name in pictures and image is not None:
            pictures[name] = image
    return pictures


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
    pictures = _pictures(frames, {name, *worst}, session)
    image = pictures[name]
    facts = {"endolab": 1, **summary.evidence(session, source, channel)}
    facts["account"] = summary.account(session)
    if session.geometry is None:
        detection = session.detections[name]
        with page(10, 8) as figure:
            ax = figure.subplots()
            figures.show_detection(image, detection, session.target, ax)
        write_figure(folder / "detection.png", figure)
    else:
        write_figure(folder / "camera.png", figures.geometry_figure(session, image))
    if worst:
        shown = {name: pictures[name] for name in worst}
        write_figure(folder / "frames.png", figures.frames_figure(session, shown))
    if session.light is not None:
        write_figure(folder / "light.png", figures.light_figure(session, image))
    if session.geometry is not None or session.light is not None:
        write_figure(folder / "uncertainty.png", uncertainty_figure(session))
    if not lacking("jinja2"):
        write_atomically(folder / "report.html", _page(session, source, name).encode())
    write_atomically(folder / "report.json", as_json(facts))
    write_camera(session.camera, folder / "camera.json")
