"""The report of a calibration: a page with pictures, and its numbers as JSON."""

from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from endolab._extras import lacking
from endolab.calibration import summary
from endolab.calibration.photometric.result import PhotometricFit
from endolab.calibration.session import Named, Session, describe_target
from endolab.io.atomic import as_json, write_atomically
from endolab.io.descriptions import write_camera
from endolab.io.images import write_figure
from endolab.io.video import Frames
from endolab.model.brdf import TabulatedBRDF
from endolab.numerics.arrays import FloatArray
from endolab.workbench.plots import calibration as figures
from endolab.workbench.plots.style import HOUSE, house
from endolab.workbench.plots.uncertainty import uncertainty_figure


def _values(rows: Iterable[tuple[str, float, float, str]]) -> list[tuple[str, str]]:
    return [
        (name, f"{summary.plus_minus(value, error)} {unit}")
        for name, value, error, unit in rows
    ]


def _brdf(light: PhotometricFit) -> list[tuple[str, str, str]]:
    """Rows of its nodes; none if the surface was taken to be matt."""
    if not isinstance(light.photometry.brdf, TabulatedBRDF):
        return []
    theta, relative, errors = summary.brdf_of(light)
    nodes = zip(np.rad2deg(theta), relative, errors, strict=True)
    return [
        (
            f"f{j}",
            f"{angle:.1f}°",
            "1 (pinned)" if error == 0 else summary.plus_minus(value, error),
        )
        for j, (angle, value, error) in enumerate(nodes)
    ]


def _page(session: Session, source: str, shown: str) -> str:
    from jinja2 import Environment, StrictUndefined

    light = session.light
    lines = summary.account(session)
    blocks: dict[str, Any] = {"trim_blocks": True, "lstrip_blocks": True}
    environment = Environment(autoescape=True, undefined=StrictUndefined, **blocks)
    environment.filters["by_reason"] = summary.by_reason
    template = Path(__file__).with_suffix(".html.j2")
    return environment.from_string(template.read_text(encoding="utf-8")).render(
        session=session,
        light=light,
        source=source,
        shown=shown,
        target=describe_target(session.target),
        account=lines,
        lines=[line for line in lines if light is None or line not in light.verdict],
        camera_values=_values(summary.camera_values(session)),
        light_values=[] if light is None else _values(summary.light_values(light)),
        brdf=[] if light is None else _brdf(light),
        correlation=[] if light is None else np.nan_to_num(light.correlation),
    )


def _pictures(
    frames: Named, names: Collection[str], session: Session
) -> dict[str, FloatArray]:
    """Read some frames; black where one can no longer be read."""
    pictures = dict.fromkeys(names, np.zeros((session.camera.height, session.camera.width)))
    for name, image in frames.read(sorted(names)) if isinstance(frames, Frames) else frames:
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
    facts: dict[str, Any] = {"endolab": 1} | summary.evidence(session, source, channel)
    facts |= {"account": summary.account(session)}
    if session.geometry is None:
        with house(HOUSE.page_text_size):
            figure = Figure(figsize=(10, 8), dpi=100, layout="constrained")
            figures.show_detection(
                image, session.detections[name], session.target, figure.subplots()
            )
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
