"""Views of a flat target: their residuals as a least-squares problem, and the pose of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from endolab.calibration.detection.detect import Detection
from endolab.calibration.geometric.planar_pose import LEAST_POINTS, pose_from_rays
from endolab.calibration.geometric.pose import Pose
from endolab.calibration.geometric.projection import (
    Lens,
    camera_of,
    camera_vector,
    project,
)
from endolab.calibration.least_squares import Linearised, fit
from endolab.calibration.targets import Target
from endolab.numerics.arrays import BoolArray, FloatArray, IntArray

# Lenses' coefficients are well below these; where the views say nothing, this is what is known.
USUAL_K = np.array([1.0, 0.5, 0.25, 0.125])
USUAL_BROWN = np.array([1.0, 1.0, 0.02, 0.02, 1.0, 1.0, 1.0, 1.0])


# How wrong the points of a panel are, beside their noise.
#
# They are not off independently, but as the panel's light makes them, and all frames alike: poses are off
# by `SHARED` times what independent points would give, and by more where few px lie between them.
SHARED = 2.0
# px between points, where errors have doubled; they grow with the fourth power.
DOUBLED_AT = 17.0
# Spacings from a fold, within which light and paper break, and sway a point.
BESIDE_FOLD = 0.75
# px; detectors have systematic errors of that size, whatever the noise.
FINEST = 0.03


@dataclass(frozen=True)
class View:
    """One panel of the target in one frame."""

    name: str  # of the frame
    panel: int
    ids: IntArray  # (n,), rows of `target.points`
    pixels: FloatArray  # (n, 2), column and row, px


def views_of(name: str, detection: Detection, target: Target) -> list[View]:
    """Split what was detected in the frame `name` by panels, without those of fewer than 8 points.

    Points beside a fold are left out.
    """
    points = target.points[detection.ids]
    panel = target.panel_of(points)
    if target.fold_x is not None:
        panel = np.where(
            np.abs(points[:, 0] - target.fold_x) < BESIDE_FOLD * target.spacing,
            -1,
            panel,
        )
    views = []
    for number in range(target.panels):
        on_panel = panel == number
        if np.sum(on_panel) >= LEAST_POINTS:
            ids = detection.ids[on_panel]
            views.append(View(name, number, ids, detection.pixels[on_panel]))
    return views


@dataclass(frozen=True)
class Geometry:
    """The unknowns: a camera's vector and the poses of all views."""

    vector: FloatArray
    rotation: FloatArray  # (views, 3, 3)
    translation: FloatArray  # (views, 3), mm

    @classmethod
    def of(cls, vector: FloatArray, poses: Sequence[Pose]) -> Geometry:
        """Put a camera and poses together."""
        return cls(
            vector,
            np.stack([p.rotation for p in poses]),
            np.stack([p.translation for p in poses]),
        )

    def only(self, kept: Sequence[bool]) -> Geometry:
        """The camera with some of the poses."""
        return Geometry(
            self.vector, self.rotation[list(kept)], self.translation[list(kept)]
        )

    @property
    def poses(self) -> list[Pose]:
        """The poses, one by one."""
        return [Pose(r, t) for r, t in zip(self.rotation, self.translation, strict=True)]

    @property
    def facing(self) -> BoolArray:
        """Which panels show their printed side, (views,)."""
        return np.einsum("gi,gi->g", self.rotation[:, :, 2], self.translation) > 0


class Reprojection:
    """The residuals of views as a `Model`.

    The first `free` numbers of the camera's vector are fitted; its k are known to be near `usual`, (4 or 8,).
    """

    def __init__(
        self,
        views: Sequence[View],
        target: Target,
        free: int,
        usual: FloatArray,
    ) -> None:
        self.group: IntArray = np.repeat(
            np.arange(len(views)), [len(view.ids) for view in views]
        )
        ids = np.concatenate([view.ids for view in views])
        self.points = target.points[ids]
        self.radii = target.radii[ids]
        self.pixels = np.concatenate([view.pixels for view in views])
        self.free = free
        self.usual = usual

    def linearise(self, unknowns: Geometry) -> Linearised:  # noqa: D102
        projection = project(
            unknowns.vector,
            unknowns.rotation[self.group],
            unknowns.translation[self.group],
            self.points,
            self.radii,
        )
        residual = self.pixels - projection.pixels
        by_common = -projection.by_camera[..., : self.free]
        spread = USUAL_K if len(self.usual) == 4 else USUAL_BROWN
        prior = (unknowns.vector[4:] - self.usual) / spread
        by_prior = np.eye(len(unknowns.vector))[4:, : self.free] / spread[:, None]
        return Linearised(residual, by_common, -projection.by_pose, prior, by_prior)

    def take_step(  # noqa: D102
        self, unknowns: Geometry, common: FloatArray, own: FloatArray
    ) -> Geometry | None:
        vector = unknowns.vector.copy()
        vector[: self.free] += common
        if not (np.all(np.isfinite(vector)) and np.all(vector[:2] > 0)):
            return None
        turn = scipy.spatial.transform.Rotation.from_rotvec(own[:, :3]).as_matrix()
        return Geometry(vector, turn @ unknowns.rotation, unknowns.translation + own[:, 3:])

    def angles(self, unknowns: Geometry) -> FloatArray:
        """Angle of each point off the axis, (n,), rad."""
        turned = np.einsum("nij,nj->ni", unknowns.rotation[self.group], self.points)
        x, y, z = (turned + unknowns.translation[self.group]).T
        return np.arctan2(np.hypot(x, y), z)

    def medians(self, unknowns: Geometry) -> FloatArray:
        """Median length of the residuals of each view, px."""
        size = np.linalg.norm(self.linearise(unknowns).residual, axis=1)
        return np.array(
            [np.median(size[self.group == g]) for g in range(len(unknowns.rotation))]
        )

    def usable(self, unknowns: Geometry) -> BoolArray:  # noqa: D102
        largest = camera_of(unknowns.vector, 1, 1).max_angle
        return (self.angles(unknowns) < largest) & unknowns.facing[self.group]


def linear_pose(view: View, target: Target, camera: Lens) -> Pose:
    """Find where a panel stands from its rays alone; ValueError if nowhere. A start for `find_pose`."""
    rays = camera.unproject(view.pixels)
    seen = np.isfinite(rays[:, 0])
    return pose_from_rays(rays[seen], target.points[view.ids[seen]])


def find_pose(
    view: View, target: Target, camera: Lens
) -> tuple[Pose, BoolArray, FloatArray]:
    """Find where a panel stands, and which of its points say so; up to a third of them may be wrong.

    Returns the pose, the inliers (n,) within 3.5 standard deviations, and the residual (n, 2), measured
    less predicted, px. ValueError if the points are too few, or fewer than half agree, or the paper would
    be seen from behind.
    """
    pose = linear_pose(view, target, camera)
    model = Reprojection([view], target, 0, np.array(camera.k))
    fitted = fit(model, Geometry.of(camera_vector(camera), [pose]), smallest=FINEST)
    inliers = fitted.used
    if inliers.sum() < max(LEAST_POINTS, len(inliers) / 2):
        raise ValueError(
            f"only {inliers.sum()} of its {len(inliers)} points agree with one pose"
        )
    pose = fitted.unknowns.poses[0]
    # Scale of the panel in the picture about its middle, where it is least, px/mm.
    middle = target.points[view.ids].mean(axis=0, keepdims=True)
    at = camera_vector(camera), pose.rotation[None], pose.translation[None], middle
    by_shift = project(*at, np.zeros(1)).by_pose[0, :, 3:]
    scale = np.linalg.svd(by_shift @ pose.rotation[:, :2], compute_uv=False)[-1]
    apart = scale * target.spacing
    worse = SHARED * (1 + (DOUBLED_AT / apart) ** 4)
    pose = replace(pose, covariance=worse**2 * fitted.covariance.own[0])
    return pose, inliers, fitted.residual
