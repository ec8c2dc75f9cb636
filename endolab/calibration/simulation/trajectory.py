"""How a hand moves a sheet of paper in front of a camera."""

from typing import Annotated, Any

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from endolab.calibration.geometric.pose import Pose
from endolab.calibration.targets import Target
from endolab.model.cameras import Camera
from endolab.numerics.arrays import BoolArray, FloatArray, nan_if_undefined
from endolab.numerics.checked_types import checked
from endolab.numerics.checks import check_int

Panels = tuple[Pose, ...]  # one pose a panel
LEAST_SEEN = 0.25  # of the features, in every frame
REACH = np.deg2rad(40)  # the largest angle of the sheet's middle off the axis


@checked
class Shooting:
    """How a hand moves a sheet, and what the endoscope's camera makes of the light."""

    # Angle between the normals of a folded sheet's panels, rad.
    fold: Annotated[float, Field(ge=0, le=2)] = 0.0
    # Nearest and farthest depth z of its middle, mm.
    distance: tuple[float, float] = (25.0, 100.0)
    # The largest angle of its normal to the axis, rad; 0: frontal.
    tilt: Annotated[float, Field(ge=0, le=1.4)] = float(np.deg2rad(55))
    # Standard deviation, grey levels of 255.
    noise: Annotated[float, Field(ge=0)] = 3.0
    # Share of glints and dust; of samples, of those that have any level.
    outliers: Annotated[float, Field(ge=0, lt=1)] = 0.0
    # One gain for all frames of a video, instead of one that follows the sheet.
    locked: bool = False

    @property
    def bits(self) -> int | None:
        """To how many a level is rounded; without noise it is not."""
        return 8 if self.noise else None


def fold_pose(target: Target, pose: Pose, fold: float) -> Panels:
    """Fold a flat sheet's pose: each panel turns away from the camera by half of `fold`, rad, at least 0.

    One pose a panel; the ridge is towards the camera and stays in place.
    """
    if target.fold is None:
        return (pose,)
    ridge = np.array([target.fold_x, 0.0, 0.0])
    turns = Rotation.from_euler("y", [[fold / 2], [-fold / 2]]).as_matrix()
    return tuple(
        Pose(pose.rotation @ turn, pose.transform(ridge - turn @ ridge)) for turn in turns
    )


def see(
    target: Target, panels: Panels, camera: Camera, places: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Places of a sheet, (n, 2 or more), and the normals there in the camera frame, (n, 3) each.

    And at which of them the camera sees the front of the sheet, within the picture, (n,).
    """
    rotation = np.array([pose.rotation for pose in panels])[target.panel_of(places)]
    shift = np.array([pose.translation for pose in panels])[target.panel_of(places)]
    points = np.einsum("nij,nj->ni", rotation[..., :2], places[:, :2]) + shift
    normals = -rotation[..., 2]
    last = [camera.width - 1, camera.height - 1]
    with nan_if_undefined():
        pixel = camera.project(points)
        inside = np.all((pixel >= 0) & (pixel <= last), axis=-1)
    facing = -np.sum(points * normals, axis=-1) > 0.1 * np.linalg.norm(points, axis=-1)
    return points, normals, inside & facing & (points[..., 2] > 0)


def trajectory(
    target: Target, camera: Camera, count: int, *, seed: int = 0, **shooting: Any
) -> list[Panels]:
    """Move a sheet by hand, as `Shooting` says: for each of `count` frames the poses, one a panel."""
    check_int("count", count, 1)
    how = Shooting(**shooting)
    if how.fold and target.fold is None:
        raise ValueError("fold needs a target that has a fold; this one is flat")
    # Smooth random motions that spend their time evenly over [-1, 1]: triangle waves with round corners.
    rng = np.random.default_rng([seed, 0])
    slow = rng.uniform(1.5, 3.5, 6)
    fast = rng.uniform(2.0, 5.0, 6)
    start, other_start = rng.uniform(0, 2 * np.pi, (2, 6))
    time = 2 * np.pi * np.linspace(0, 1, count)[:, None]
    phase = slow * time + start + 0.6 * np.sin(fast * time + other_start)
    wander = np.arcsin(0.99 * np.sin(phase)) / np.arcsin(0.99)
    # Of the square [-1, 1]² onto the unit disc.
    lean, aside = (
        square * np.sqrt(1 - square[:, ::-1] ** 2 / 2)
        for square in (wander[:, :2], wander[:, 2:4])
    )
    near, far = how.distance
    depth = near * (far / near) ** ((wander[:, 4] + 1) / 2)
    axis = how.tilt * np.column_stack([-lean[:, 1], lean[:, 0], np.zeros(count)])
    turns = Rotation.from_rotvec(axis) * Rotation.from_euler("z", np.pi * wander[:, 5:])
    left, top, width, height = target.sheet
    across = left + width / 2 if target.fold is None else target.fold_x
    middle = np.array([across, top + height / 2, 0.0])
    least_seen = 1.0 if target.found_whole else LEAST_SEEN
    poses = []
    for turn, side, z in zip(turns.as_matrix(), aside, depth, strict=True):
        # The sheet is pulled to the axis (0 to 1) and then away (1 to 2), until enough of it is in view.
        for pull in np.arange(0, 2.01, 0.05):
            angle = max(1 - pull, 0.0) * REACH * np.hypot(*side)
            centre = np.append(np.tan(angle) / np.hypot(*side) * side, 1.0)
            centre *= z * (far / z) ** max(pull - 1, 0.0)
            pose = fold_pose(target, Pose(turn, centre - turn @ middle), how.fold)
            if see(target, pose, camera, target.points)[2].mean() >= least_seen:
                break
        poses.append(pose)
    return poses
