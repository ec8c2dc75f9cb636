"""Views of a flat target: their residuals as a least-squares problem, and the pose of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

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
from endolab.model.cameras import KannalaBrandt
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
    def of(cls, camera: Lens, poses: Sequence[Pose]) -> Geometry:
        """Put a camera and poses together."""
        rotation = np.stack([pose.rotation for pose in poses])
        translation = np.stack([pose.translation for pose in poses])
        return cls(camera_vector(camera), rotation, translation)

    @property
    def poses(self) -> list[Pose]:
        """The poses, one by one."""
        return [Pose(r, t) for r, t in zip(self.rotation, self.translation, strict=True)]


class Reprojection:
    """The residuals of views as a `Model`.

    The first `free` numbers of the camera's vector are fitted; its k are known to be near those of `usual`.
    """

    def __init__(
        self, views: Sequence[View], target: Target, usual: Lens, free: int
    ) -> None:
        self.group: IntArray = np.repeat(
            np.arange(len(views)), [len(view.ids) for view in views]
        )
        ids = np.concatenate([view.ids for view in views])
        self.points = target.points[ids]
        self.radii = target.radii[ids]
        self.pixels = np.concatenate([view.pixels for view in views])
        self.free = free
        self.usual = camera_vector(usual)[:free]
        spread = USUAL_K if isinstance(usual, KannalaBrandt) else USUAL_BROWN
        self.certainty = np.append(np.zeros(4), spread**-2)[:free]

    def linearise(self, unknowns: Geometry) -> Linearised:  # noqa: D102
        pixels, by_camera, by_pose = project(
            unknowns.vector,
            unknowns.rotation[self.group],
            unknowns.translation[self.group],
            self.points,
            self.radii,
        )
        off = unknowns.vector[: self.free] - self.usual
        by_common = -by_camera[..., : self.free]
        return Linearised(self.pixels - pixels, by_common, -by_pose, off, self.certainty)

    def take_step(  # noqa: D102
        self, unknowns: Geometry, common: FloatArray, own: FloatArray
    ) -> Geometry | None:
        vector = unknowns.vector.copy()
        vector[: self.free] += common
        if not (np.all(np.isfinite(vector)) and np.all(vector[:2] > 0)):
            return None
        turn = Rotation.from_rotvec(own[:, :3]).as_matrix()
        return Geometry(vector, turn @ unknowns.rotation, unknowns.translation + own[:, 3:])

    def angles(self, unknowns: Geometry) -> FloatArray:
        """Angle of each point off the axis, (n,), rad."""
        turned = np.einsum("nij,nj->ni", unknowns.rotation[self.group], self.points)
        x, y, z = (turned + unknowns.translation[self.group]).T
        return np.arctan2(np.hypot(x, y), z)

    def usable(self, unknowns: Geometry) -> BoolArray:  # noqa: D102
        largest = camera_of(unknowns.vector, 1, 1).max_angle
        # Panels that show their printed side.
        turned = np.einsum("gi,gi->g", unknowns.rotation[:, :, 2], unknowns.translation)
        return (self.angles(unknowns) < largest) & (turned > 0)[self.group]


def disagree(used: BoolArray) -> str:
    """Say that too few points of a view are used, if so."""
    if used.sum() >= max(LEAST_POINTS, len(used) / 2):
        return ""
    return f"only {used.sum()} of its {len(used)} points agree with the others"


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
    start = Geometry.of(camera, [linear_pose(view, target, camera)])
    fitted = fit(Reprojection([view], target, camera, 0), start, smallest=FINEST)
    inliers = fitted.used
    if why := disagree(inliers):
        raise ValueError(why)
    found: Geometry = fitted.unknowns
    # Scale of the panel in the picture about its middle, where it is least, px/mm.
    middle = target.points[view.ids].mean(axis=0, keepdims=True)
    at = found.vector, found.rotation, found.translation, middle, np.zeros(1)
    by_shift = project(*at)[2][0, :, 3:] @ found.rotation[0, :, :2]
    apart = target.spacing * np.linalg.svd(by_shift, compute_uv=False)[-1]
    worse = SHARED * (1 + (DOUBLED_AT / apart) ** 4)
    covariance = worse**2 * fitted.own_covariance[0]
    pose = Pose(found.rotation[0], found.translation[0], covariance)
    return pose, inliers, fitted.residual
