"""The pose of a flat target from the rays to its points: a start without a guess, at any field of view."""

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from endolab.calibration import constants
from endolab.calibration.geometric.pose import Pose
from endolab.calibration.refusals import Refusal
from endolab.model.cameras import Camera
from endolab.numerics.arrays import FloatArray


def planar_pose(pixels: FloatArray, points: FloatArray, camera: Camera) -> Pose:
    """Find the pose of a plane from pixels (n ≥ 8, 2), anywhere, of its points (n, 3), z = 0, mm.

    Some may be wrong. A pinhole camera is turned to the middle of the rays; what it sees of the plane
    is a homography (least median of squares), whose first two columns are made orthonormal. ValueError if
    the points are too few or in disorder, or if the pose would show the paper from behind.
    """
    rays = camera.unproject(pixels)
    has_ray = np.isfinite(rays[:, 0])
    Refusal.FEW_POINTS.if_(has_ray.sum() < constants.LEAST_POINTS, count=has_ray.sum())
    rays = rays[has_ray]
    points = points[has_ray, :2]
    middle = points.mean(axis=0)
    centred = points - middle
    # A pinhole camera that looks along the middle ray.
    ahead, _ = Rotation.align_vectors([[0.0, 0.0, 1.0]], [np.median(rays, axis=0)])
    look = ahead.as_matrix()
    turned = rays @ look.T
    seen = turned[:, 2] > 0.15  # cosine: others have no place in its picture
    plane = turned[seen, :2] / turned[seen, 2:]
    homography, _ = cv2.findHomography(centred[seen], plane, cv2.LMEDS)
    if homography is None:
        raise Refusal.DISORDER.error()
    expected = np.column_stack([centred, np.ones(len(points))]) @ homography.T
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    miss = np.median(np.linalg.norm(expected - turned, axis=1))
    spread = np.median(np.linalg.norm(rays - rays.mean(axis=0), axis=1))
    # Beyond it no view of a plane is, whatever the lens.
    Refusal.DISORDER.if_(miss > 0.25 * spread)
    Refusal.BEHIND.if_(np.linalg.det(homography) <= 0)
    scale = np.sqrt(np.linalg.norm(homography[:, 0]) * np.linalg.norm(homography[:, 1]))
    x, y, t = (look.T @ homography / scale).T
    nearly = np.column_stack([x, y, np.cross(x, y)])
    rotation = Rotation.from_matrix(nearly).as_matrix()
    return Pose(rotation, t - rotation[:, :2] @ middle)
