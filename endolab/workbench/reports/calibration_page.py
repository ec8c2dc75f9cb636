"""The report of a calibration: a page with pictures, and its numbers as JSON."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from endolab._extras import lacking
from endolab.calibration import summary
from endolab.calibration.photometric.result import PhotometricFit
from endolab.calibration.session import Named, Session
from endolab.io.atomic import as_json, say_undrawn, write_atomically
from endolab.io.descriptions import write_camera
from endolab.io.images import write_figure
from endolab.numerics.arrays import FloatArray
from endolab.workbench.plots import calibration as figures
from endolab.workbench.plots.scales import in_colour

WIDTH = 480  # px, of the small picture of a frame


def _frames_of(session: Session) -> list[dict[str, Any]]:
    """Name, errors, reason to be left out, and corners of the panels, mm, of each frame."""
    greys = summary.light_errors(session)
    left, top, width, height = session.target.sheet
    right = left + width
    fold = session.target.fold_x
    edges = [left, right] if fold > right else [left, fold, right]
    bottom = top + height
    sheets = [
        np.array([(x, top, 0), (end, top, 0), (end, bottom, 0), (x, bottom, 0)])
        for x, end in pairwise(edges)
    ]
    listed = []
    for name in session.detections:
        placed = zip(sheets, session.poses.get(name, ()), strict=False)
        listed.append(
            {
                "name": name,
                "error": session.errors.get(name),
                "grey": np.nan_to_num(greys.get(name, 0.0)),
                "why": session.dropped.get(name, ""),
                "panels": [
                    pose.transform(sheet).tolist() for sheet, pose in placed if pose
                ],
            }
        )
    return listed


def _lamps_of(light: PhotometricFit) -> list[list[float]]:
    """X and y, mm, of each lamp that was found, and the matrix that makes its ellipse of a circle."""
    listed = []
    for number, lamp in enumerate(light.photometry.lights, 1):
        first = light.names.index(f"lamp {number} x")
        covariance = light.covariance[first : first + 2, first : first + 2]
        ellipse = np.linalg.cholesky(covariance).T.ravel()
        listed.append([*lamp.position[:2], *ellipse.tolist()])
    return listed


def _small(image: FloatArray, points: FloatArray) -> bytes:
    """A small JPEG of a frame, with rings around the points that were found in it."""
    scale = WIDTH / image.shape[1]
    stored = np.asarray(255 * in_colour(image)[..., ::-1], np.uint8)
    small = cv2.resize(stored, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    for centre in np.round(scale * points).astype(int).tolist():
        cv2.circle(small, centre, 4, (0, 94, 213), 1, cv2.LINE_AA)
    return cv2.imencode(".jpg", small)[1].tobytes()


def write_report(
    session: Session, frames: Named, folder: Path, channel: str = "grey"
) -> None:
    """Write `report.html` with its pictures, `report.json` and `camera.json` into a folder that is there.

    `frames` are those that were calibrated from: each becomes a small picture, too. `channel` is the one
    whose response was calibrated. Without Jinja2, of the extra `lab`, there is all but the page. The
    `warnings` in `report.json` say what could not be drawn.
    """
    undrawn: list[str] = []
    source = str(getattr(frames, "path", ""))
    name = figures.best_frame(session)
    # Black where it can no longer be read.
    image = np.zeros((session.camera.height, session.camera.width))
    for number, (one, picture) in enumerate(frames):
        if not isinstance(picture, ValueError):
            found = session.detections[one].pixels
            with say_undrawn(folder / f"frame_{number}.jpg", undrawn) as path:
                write_atomically(path, _small(picture, found))
            image = picture if one == name else image
    pages = {"camera": lambda: figures.geometry_figure(session, image)}
    if session.light is not None:
        pages["light"] = lambda: figures.light_figure(session, image)
    if session.geometry is not None or session.light is not None:
        pages["uncertainty"] = lambda: figures.uncertainty_figure(session)
    for title, draw in pages.items():
        with say_undrawn(folder / f"{title}.png", undrawn) as path:
            write_figure(path, draw())
    if not lacking("jinja2"):
        from jinja2 import StrictUndefined, Template

        with say_undrawn(folder / "report.html", undrawn) as path:
            page = Template(
                Path(__file__).with_suffix(".html.j2").read_text(encoding="utf-8"),
                autoescape=True,
                lstrip_blocks=True,
                trim_blocks=True,
                undefined=StrictUndefined,
            )
            text = page.render(
                session=session,
                summary=summary,
                source=source,
                shown=name,
                frames=_frames_of(session),
                lamps=_lamps_of(session.light) if session.light else [],
            )
            write_atomically(path, text.encode())
    facts = {
        "endolab": 1,
        "warnings": undrawn,
        **summary.evidence(session, source, channel),
    }
    write_atomically(folder / "report.json", as_json(facts))
    write_camera(session.camera, folder / "camera.json")
