"""How a hand moves a sheet of paper in front of a camera."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from endolab.calibration.geometric.pose import Pose
from endolab.calibration.targets import Target
from endolab.model.cameras import Camera
from endolab.numerics.arrays import BoolArray, FloatArray, nan_if_undefined
from endolab.numerics.checked_types import checked

Panels = tuple[Pose, ...]  # one pose a panel
LEAST_SEEN = 0.25  # of the features, in every frame
Angle = Annotated[float, Field(ge=0, le=1.4)]


@checked
class Movement:
    """How a hand moves a sheet."""

    # Angle between the normals of a folded sheet's panels, rad.
    fold: Annotated[float, Field(ge=0, le=2)] = 0.0
    # Nearest and farthest depth z of its middle, mm.
    distance: tuple[float, float] = (25.0, 100.0)
    # The largest angles of its normal to the axis (0: frontal), and of its middle off the axis, rad.
    tilt: Angle = float(np.deg2rad(55))
    reach: Angle = float(np.deg2rad(40))


MOVEMENT = Movement()


def fold_pose(target: Target, pose: Pose, fold: float) -> Panels:
    """Fold a flat sheet's pose: each panel turns away from the camera by half of `fold`, rad, at least 0.

    One pose a panel; the ridge is towards the camera and stays in place.
    """
    if target.fold_x is None:
        return (pose,)
    ridge = np.array([target.fold_x, 0.0, 0.0])
    panels = []
    for turn in Rotation.from_euler("y", [[fold / 2], [-fold / 2]]).as_matrix():
        shift = pose.transform(ridge - turn @ ridge)
        panels.append(Pose(pose.rotation @ turn, shift))
    return tuple(panels)


def _wander(count: int, columns: int, rng: np.random.Generator) -> FloatArray:
    """Return smooth random motions, (count, columns), that spend their time evenly over [-1, 1]."""
    time = np.linspace(0, 1, count)[:, None]
    slow = rng.uniform(1.5, 3.5, columns)
    fast = rng.uniform(2.0, 5.0, columns)
    start, other_start = rng.uniform(0, 2 * np.pi, (2, columns))
    sway = np.sin(2 * np.pi * fast * time + other_start)
    phase = 2 * np.pi * slow * time + start + 0.6 * sway
    # a triangle wave with round corners.
    return np.arcsin(0.99 * np.sin(phase)) / np.arcsin(0.99)


def _disc(square: FloatArray) -> FloatArray:
    """Map the square [-1, 1]² onto the unit disc, (..., 2)."""
    return square * np.sqrt(1 - square[..., ::-1] ** 2 / 2)


def on_sheet(
    target: Target, poses: Sequence[Panels], places: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Places of the sheet and the normals there in the camera frame, (frames, n, 3)."""
    panel = target.panel_of(places)
    rotation = np.array([[pose.rotation for pose in frame] for frame in poses])[:, panel]
    shift = np.array([[pose.translation for pose in frame] for frame in poses])[:, panel]
    points = np.einsum("fnij,nj->fni", rotation[..., :2], places[:, :2]) + shift
    return points, -rotation[..., 2]


def in_view(camera: Camera, points: FloatArray, normals: FloatArray) -> BoolArray:
    """Whether the camera sees the front of the sheet at these points, within the picture."""
    with nan_if_undefined():
        pixel = camera.project(points)
        last = [camera.width - 1, camera.height - 1]
        inside = np.all((pixel >= 0) & (pixel <= last), axis=-1)
    distance = np.linalg.norm(points, axis=-1)
    facing = np.einsum("...i,...i->...", points, normals) < -0.1 * distance
    return inside & facing & (points[..., 2] > 0)


def trajectory(
    target: Target,
    camera: Camera,
    count: int,
    movement: Movement = MOVEMENT,
    *,
    seed: int = 0,
) -> list[Panels]:
    """Move a sheet by hand in front of a camera: for each of `count` frames the poses, one a panel."""
    if movement.fold and target.fold_x is None:
        raise ValueError("fold needs a target that has a fold; this one is flat")
    wander = _wander(count, 6, np.random.default_rng([seed, 0]))
    lean = movement.tilt * _disc(wander[:, :2])
    aside = movement.reach * _disc(wander[:, 2:4])
    near, far = movement.distance
    depth = np.exp(np.interp(wander[:, 4], [-1, 1], np.log([near, far])))
    axis = np.column_stack([-lean[:, 1], lean[:, 0], np.zeros(count)])
    turns = Rotation.from_rotvec(axis) * Rotation.from_euler("z", np.pi * wander[:, 5:])
    left, top, width, height = target.sheet
    middle = np.array([left + width / 2, top + height / 2, 0.0])
    if target.fold_x is not None:
        middle[0] = target.fold_x
    least_seen = 1.0 if target.found_whole else LEAST_SEEN
    poses = []
    for turn, side, z in zip(turns.as_matrix(), aside, depth, strict=True):
        # The sheet is pulled to the axis (0 to 1) and then away (1 to 2), until enough of it is in view.
        for pull in np.arange(0, 2.01, 0.05):
            angle = max(1 - pull, 0.0) * np.hypot(*side)
            off = np.tan(angle) * side / (np.hypot(*side) or 1.0)
            centre = np.append(off, 1) * z * (far / z) ** max(pull - 1, 0)
            pose = fold_pose(target, Pose(turn, centre - turn @ middle), movement.fold)
            if (
                in_view(camera, *on_sheet(target, [pose], target.points)).mean()
                >= least_seen
            ):
                break
        poses.append(pose)
    return poses
