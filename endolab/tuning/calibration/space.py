"""Sheets and a camera as lines in space, in the camera's frame: x right, y down, z forward; mm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from endolab.calibration.geometric.pose import Pose
from endolab.calibration.targets import Target
from endolab.model.cameras import Camera
from endolab.plots.scales import round_length

Line = list[list[float]]  # places, (n, 3)


def panel_corners(target: Target, poses: Sequence[Pose | None]) -> list[Line]:
    """Corners of the panels that have a pose, from the sheet's upper left and round."""
    left, top, width, height = target.sheet
    fold = target.fold_x
    ends = [(left, left + width)] if fold is None else [(left, fold), (fold, left + width)]
    found = []
    for (a, b), pose in zip(ends, poses, strict=False):
        if pose is not None:
            flat = [[a, top, 0], [b, top, 0], [b, top + height, 0], [a, top + height, 0]]
            found.append(np.round(pose.transform(flat), 3).tolist())
    return found


def camera_lines(camera: Camera, length: float) -> list[Line]:
    """The border of what a camera sees of its picture, at a distance, mm, and lines to its corners."""
    width, height = camera.width - 0.5, camera.height - 0.5
    corners = [(-0.5, -0.5), (width, -0.5), (width, height), (-0.5, height)]
    border = np.concatenate(
        [np.linspace(a, b, 9)[:-1] for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    )
    centre = np.array([camera.width - 1, camera.height - 1]) / 2
    rays = np.full((len(border), 3), np.nan)
    for share in np.linspace(1, 0.5, 26):  # a fisheye may not see the corners
        dark = ~np.isfinite(rays).all(axis=1)
        rays[dark] = camera.unproject(centre + share * (border[dark] - centre))
    seen = length * rays[np.isfinite(rays).all(axis=1)]
    spokes = [[[0.0, 0.0, 0.0], (length * ray).tolist()] for ray in rays[::8] if np.isfinite(ray).all()]
    return [np.round([*seen, *seen[:1]], 3).tolist(), *spokes]


@dataclass(frozen=True)
class Surroundings:
    """What a view of sheets turns about and shows, mm."""

    centre: list[float]
    reach: float  # half of its extent, but for what lies farthest out
    axis: list[float]  # places along the optical axis that are named


def surroundings(sheets: Sequence[Line]) -> Surroundings:
    """Choose what to show of some sheets and the camera, which is at the origin."""
    places = np.concatenate([np.zeros((1, 3)), *(np.asarray(corners) for corners in sheets)])
    low, high = places.min(axis=0), places.max(axis=0)
    centre = (low + high) / 2
    reach = max(0.8 * float(np.linalg.norm(places - centre, axis=1).max()), 1.0)
    step = round_length(max(high[2], 1.0) / 3)
    axis = [float(step * k) for k in range(1, int(max(high[2], 1.0) / step) + 1)]
    return Surroundings(centre.tolist(), reach, axis or [step])
