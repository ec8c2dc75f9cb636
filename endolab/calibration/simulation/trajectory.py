"""How a hand moves a sheet of paper in front of a camera."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d
from scipy.spatial.transform import Rotation

from endolab.calibration.geometric.pose import Pose
from endolab.calibration.targets import Target
from endolab.model.cameras import Camera
from endolab.numerics.arrays import BoolArray, FloatArray, IntArray, nan_if_undefined
from endolab.numerics.checks import check_int, number

Panels = tuple[Pose, ...]  # one pose a panel


@dataclass(frozen=True)
class Movement:
    """How a hand moves a sheet."""

    fold: float = 0.0  # angle between the normals of a folded sheet's panels, rad
    # Nearest and farthest depth z of its middle, mm.
    distance: tuple[float, float] = (25.0, 100.0)
    # The largest angles of its normal to the axis (0: frontal), and of its middle off the axis, rad.
    tilt: float = float(np.deg2rad(55))
    reach: float = float(np.deg2rad(40))

    def __post_init__(self) -> None:
        nearest, farthest = self.distance
        if not 0 < nearest <= farthest < np.inf:
            raise ValueError(
                f"distance must be two growing positive numbers (mm), got {nearest} and {farthest}"
            )
        for name, most in (("tilt", 1.4), ("reach", 1.4), ("fold", 2.0)):
            number(
                name,
                getattr(self, name),
                0,
                most,
            )


MOVEMENT = Movement()


def fold_pose(
    target: Target,
    pose: Pose,
    fold: float,
) -> Panels:
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


def _wander(
    count: int,
    columns: int,
    rng: np.random.Generator,
) -> FloatArray:
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
    x = square[..., 0]
    y = square[..., 1]
    return np.stack([x * np.sqrt(1 - y**2 / 2), y * np.sqrt(1 - x**2 / 2)], axis=-1)


def on_sheet(
    target: Target,
    poses: Sequence[Panels],
    places: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Places of the sheet and the normals there in the camera frame, (frames, n, 3)."""
    panel = target.panel_of(places)
    flat = np.column_stack([places[:, :2], np.zeros(len(places))])
    points, normals = np.empty((2, len(poses), len(places), 3))
    for side in range(target.panels):
        on_panel = panel == side
        rotation = np.stack([frame[side].rotation for frame in poses])
        shift = np.stack([frame[side].translation for frame in poses])
        points[:, on_panel] = flat[on_panel] @ np.swapaxes(rotation, 1, 2) + shift[:, None]
        normals[:, on_panel] = -rotation[:, None, :, 2]
    return points, normals


def in_view(
    camera: Camera,
    points: FloatArray,
    normals: FloatArray,
) -> BoolArray:
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
    check_int("count", count, 1)
    fold = movement.fold
    if fold and target.fold_x is None:
        raise ValueError("fold needs a target that has a fold; this one is flat")
    # The least share of the features within the picture: the sheet comes towards the axis, then goes away,
    # until it is reached.
    least_seen = 1.0 if target.found_whole else 0.25
    wander = _wander(count, 6, np.random.default_rng([check_int("seed", seed), 0]))
    lean = movement.tilt * _disc(wander[:, :2])
    aside = movement.reach * _disc(wander[:, 2:4])
    depth = np.exp(np.interp(wander[:, 4], [-1, 1], np.log(movement.distance)))
    axis = np.column_stack([-lean[:, 1], lean[:, 0], np.zeros(count)])
    turns = Rotation.from_rotvec(axis) * Rotation.from_euler("z", np.pi * wander[:, 5:])
    left, top, width, height = target.sheet
    middle = np.array([left + width / 2, top + height / 2, 0.0])
    if target.fold_x is not None:
        middle[0] = target.fold_x

    def place(which: IntArray, pull: FloatArray) -> list[Panels]:
        """Poses with the sheet pulled to the axis (0 to 1) and then away to the far end (1 to 2)."""
        side = aside[which] * np.clip(1 - pull, 0, 1)[:, None]
        angle = np.linalg.norm(side, axis=1, keepdims=True)
        z = depth[which] * (movement.distance[1] / depth[which]) ** np.clip(pull - 1, 0, 1)
        off_axis = side * np.tan(angle) / np.where(angle > 0, angle, 1)
        centre = np.column_stack([off_axis, np.ones(len(which))]) * z[:, None]
        turn = turns[which].as_matrix()
        shift = centre - turn @ middle
        flat = map(Pose, turn, shift)
        return [fold_pose(target, pose, fold) for pose in flat]

    def settle(pull: FloatArray) -> FloatArray:
        """Pull the frames that show too little, step by step."""
        short = np.arange(count)
        while len(short):
            points, normals = on_sheet(target, place(short, pull[short]), target.points)
            enough = in_view(camera, points, normals).mean(axis=1) >= least_seen
            short = short[~enough & (pull[short] < 2)]
            pull[short] += 0.05
        return pull

    pull = settle(np.zeros(count))
    # The steps would show as jerks: smooth them, on the safe side.
    wide = max(count // 30, 1)
    pull = settle(gaussian_filter1d(maximum_filter1d(pull, 2 * (wide // 2) + 1), wide / 8))
    return place(np.arange(count), pull)
