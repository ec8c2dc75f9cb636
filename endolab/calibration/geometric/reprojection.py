"""Views of a flat target: their residuals as a least-squares problem, and the pose of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from endolab.calibration import constants
from endolab.calibration.detection.detect import Detection
from endolab.calibration.geometric.planar_pose import planar_pose
from endolab.calibration.geometric.pose import Pose
from endolab.calibration.geometric.projection import (
    Lens,
    camera_of,
    camera_vector,
    project,
)
from endolab.calibration.least_squares import Model, fit
from endolab.calibration.refusals import Refusal
from endolab.calibration.targets import Target
from endolab.numerics.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class View:
    """One panel of the target in one frame."""

    name: str  # of the frame
    panel: int
    ids: IntArray  # (n,), rows of `target.points`
    pixels: FloatArray  # (n, 2), column and row, px


def views_of(name: str, detection: Detection, target: Target) -> list[View]:
    """Split what was detected in the frame `name` by panels, without those of fewer than 8 points.

    Points beside a fold are left out: light and paper break there, and sway them.
    """
    points = target.points[detection.ids]
    apart = np.abs(points[:, 0] - target.fold_x)
    panel = np.where(apart < 0.75 * target.spacing, -1, target.panel_of(points))
    views = []
    for number in range(target.panels):
        on_panel = panel == number
        if np.sum(on_panel) >= constants.LEAST_POINTS:
            ids = detection.ids[on_panel]
            views.append(View(name, number, ids, detection.pixels[on_panel]))
    return views


@dataclass(frozen=True, eq=False)
class Reprojection(Model):
    """The residuals of views, by the camera's vector and `Pose.vector` of each view."""

    points: FloatArray  # (n, 3), mm
    radii: FloatArray  # (n,), mm
    pixels: FloatArray  # (n, 2), where they were measured
    smallest: ClassVar = constants.FINEST

    @classmethod
    def of(
        cls, views: Sequence[View], target: Target, usual: Lens, free: int
    ) -> Reprojection:
        """Fit the first `free` numbers of the camera's vector; its k are near those of `usual`."""
        ids = np.concatenate([view.ids for view in views])
        mean = camera_vector(usual)
        # Lenses' coefficients are below 1; where the views say nothing, this is what is known.
        sd = np.where(np.arange(len(mean)) < 4, np.inf, 1.0)
        sd[free:] = 0
        return cls(
            group=np.repeat(np.arange(len(views)), [len(view.ids) for view in views]),
            mean=mean,
            sd=sd,
            points=target.points[ids],
            radii=target.radii[ids],
            pixels=np.concatenate([view.pixels for view in views]),
        )

    def linearise(  # noqa: D102
        self, common: FloatArray, own: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        pixels, by_camera, by_pose = project(
            common, own, self.group, self.points, self.radii
        )
        if np.any(common[:2] <= 0):  # would mirror the picture
            pixels = pixels * np.nan
        return self.pixels - pixels, -by_camera, -by_pose

    def angles(self, own: FloatArray) -> FloatArray:
        """Angle of each point off the axis, (n,), rad."""
        poses = own[self.group]
        x, y, z = (Rotation.from_rotvec(poses[:, :3]).apply(self.points) + poses[:, 3:]).T
        return np.arctan2(np.hypot(x, y), z)

    def usable(self, common: FloatArray, own: FloatArray) -> BoolArray:  # noqa: D102
        largest = camera_of(common, 1, 1).max_angle
        # Panels that show their printed side.
        behind = Rotation.from_rotvec(own[:, :3]).apply([0.0, 0.0, 1.0])
        turned = np.sum(behind * own[:, 3:], axis=1) > 0
        return (self.angles(own) < largest) & turned[self.group]


def check_agreement(used: BoolArray) -> None:
    """Refuse a view of which too few points, (n,), are used."""
    is_poor = used.sum() < max(constants.LEAST_POINTS, len(used) / 2)
    Refusal.DISAGREE.if_(is_poor, good=used.sum(), count=len(used))


def find_pose(
    view: View, target: Target, camera: Lens
) -> tuple[Pose, BoolArray, FloatArray]:
    """Find where a panel stands, and which of its points say so; up to a third of them may be wrong.

    Returns the pose, the inliers (n,) within 3.5 standard deviations, and the residual (n, 2), measured
    less predicted, px. ValueError if the points are too few, or fewer than half agree, or the paper would
    be seen from behind.
    """
    model = Reprojection.of([view], target, camera, 0)
    start = planar_pose(view.pixels, model.points, camera)
    fitted = fit(model, model.mean, start.vector[None])
    check_agreement(fitted.used)
    return Pose.of(fitted.own[0]), fitted.used, fitted.residual
