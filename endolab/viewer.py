"""The Rerun viewer: how it is started, how it opens, and what a camera looks like in it."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from endolab.cameras import Camera, Pinhole
from endolab.iteration import Iterate
from endolab.operators import FloatArray

TIMELINE = "iteration"
PORT = 9876  # the viewer's own default
START = (86, 180, 233)
THIN = rr.Radius.ui_points(1.5)


def viewer_address() -> str:
    """Where the native viewer listens."""
    return f"rerun+http://127.0.0.1:{PORT}/proxy"


def start_viewer() -> subprocess.Popen[bytes] | None:
    """Start the native viewer, unless one is there; not by ``rr.spawn``, which listens to the network."""
    if _listening():
        return None
    command = [sys.executable, "-m", "rerun_cli", "--bind", "127.0.0.1", "--port", str(PORT)]
    viewer = subprocess.Popen(
        [*command, "--expect-data-soon"],
        env={**os.environ, "CI": "1"},  # the one variable by which the viewer sends no usage data
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # an interrupt ends the run and leaves the window
    )
    started = time.monotonic()
    # Without a screen it listens for a moment before it gives up.
    while time.monotonic() < started + 1.5 or (not _listening() and time.monotonic() < started + 20):
        if viewer.poll() is not None:
            raise OSError("the Rerun viewer did not start: it needs a screen; record to a file instead")
        time.sleep(0.1)
    return viewer


def _listening() -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", PORT)) == 0


def camera_shape(camera: Camera, size: float) -> rr.Pinhole | rr.LineStrips3D:
    """The camera in space, about `size` long."""
    if isinstance(camera, Pinhole):
        matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
        return rr.Pinhole(
            image_from_camera=matrix, resolution=[camera.width, camera.height], image_plane_distance=size
        )
    # Rerun's Pinhole knows no distortion, and near 90° off the axis no pinhole comes close: draw
    # the rim of what the camera really sees. Outwards from the axis a model ends once and for all.
    centre = camera.project([0.0, 0.0, 1.0])
    angle = np.linspace(0, 2 * np.pi, 97)
    radius = np.linspace(0, np.hypot(camera.width, camera.height), 400)
    pixels = centre + radius[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    rays = camera.unproject(pixels)
    end = np.array([camera.width, camera.height]) - 0.5
    seen = np.isfinite(rays).all(axis=-1) & ((pixels >= -0.5) & (pixels <= end)).all(axis=-1)
    last = np.maximum(seen.sum(axis=0) - 1, 0)
    rim = size * rays[last, np.arange(angle.size)]
    spokes = [np.array([[0.0, 0.0, 0.0], end]) for end in rim[:-1:12]]
    return rr.LineStrips3D([rim, *spokes], colors=START, radii=THIN)


def blueprint(iterate: Iterate, points: FloatArray, far: float) -> rrb.Blueprint:
    """How the viewer opens: pictures above, the surface and the curves below."""
    low, high = np.percentile(points, [1, 99], axis=0)
    target = (low + high) / 2
    # From behind the camera, to its left and above it.
    eye = target + 0.9 * np.linalg.norm(high - low) * np.array([-0.5, -0.35, -0.8])
    bounds = rrb.VisualBounds2D(x_range=[-0.1 * far, 1.1 * far], y_range=[1.2 * low[1], 1.2 * high[1]])
    terms = [f"/plots/{name}" for name in ("energy", *iterate.terms)]
    residual: list[rrb.View] = [rrb.Spatial2DView(origin="/residual", name="Residual")]
    residual += [rrb.Spatial2DView(origin=f"/front/{name}", name=name.capitalize()) for name in iterate.maps]
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                rrb.Spatial2DView(origin="/", contents=["/input"], name="Frame"),
                rrb.Spatial2DView(
                    origin="/", contents=["/depth", "/mask"], name=f"Distance [{iterate.problem.unit}]"
                ),
                rrb.Spatial2DView(origin="/normals", name="Normals"),
                rrb.Tabs(*residual, active_tab=len(residual) - 1),
            ),
            rrb.Horizontal(
                rrb.Spatial3DView(
                    origin="/world",
                    name="Surface",
                    eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=[0, -1, 0]),
                    overrides={"/world/truth": rrb.EntityBehavior(visible=False)},
                    background=(45, 50, 58),
                    line_grid=False,
                ),
                rrb.Vertical(
                    rrb.TimeSeriesView(origin="/plots", contents=terms, name="Energy"),
                    rrb.Spatial2DView(origin="/section", name="Middle column", visual_bounds=bounds),
                ),
                rrb.Tabs(
                    rrb.TextDocumentView(origin="/settings", name="Settings"),
                    rrb.TimeSeriesView(
                        origin="/plots",
                        contents=["/plots/**", *(f"- {term}" for term in terms)],
                        name="Steps",
                    ),
                ),
                column_shares=[2, 1.4, 1],
            ),
            row_shares=[1, 1.4],
        ),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )
