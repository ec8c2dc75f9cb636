"""The pose of a flat target from the rays to its points: a start without a guess, at any field of view."""

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from endolab.calibration import constants
from endolab.calibration.geometric.pose import Pose
from endolab.model.cameras import Camera
from endolab.numerics.arrays import FloatArray

DISORDER = "its points do not lie to each other as the target's do"


def planar_pose(pixels: FloatArray, points: FloatArray, camera: Camera) -> Pose:
    """Find the pose of a plane from pixels (n ≥ 8, 2), anywhere, of its points (n, 3), z = 0, mm.

    Some may be wrong. A pinhole camera is turned to the middle of the rays; what it sees of the plane
    is a homography (least median of squares), whose first two columns are made orthonormal. ValueError if
    the points are too few, on a line or in disorder, or if the pose would show the paper from behind.
    """
    rays = camera.unproject(pixels)
    has_ray = np.isfinite(rays[:, 0])
    rays = rays[has_ray]
    points = points[has_ray]
    if len(rays) < constants.LEAST_POINTS:
        raise ValueError(
            f"a pose needs {constants.LEAST_POINTS} points at least, got {len(rays)}"
        )
    middle = points[:, :2].mean(axis=0)
    centred = points[:, :2] - middle
    extent = np.linalg.svd(centred, compute_uv=False)
    if extent[1] <= 1e-6 * extent[0]:
        raise ValueError("its points lie on one line")
    # A pinhole camera that looks along the middle ray.
    look = Rotation.align_vectors([[0.0, 0.0, 1.0]], [np.median(rays, axis=0)])[
        0
    ].as_matrix()
    turned = rays @ look.T
    seen = turned[:, 2] > constants.WIDEST
    plane = turned[seen, :2] / turned[seen, 2:]
    homography = None
    if seen.sum() >= constants.LEAST_POINTS:
        size = extent[0] / np.sqrt(len(points))
        homography, _ = cv2.findHomography(centred[seen] / size, plane, cv2.LMEDS)
    if homography is None:
        raise ValueError(DISORDER)
    homography = homography / [size, size, 1.0]
    expected = np.column_stack([centred, np.ones(len(points))]) @ homography.T
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    miss = np.median(np.linalg.norm(expected - turned, axis=1))
    if miss > constants.LARGEST_MISS * np.median(
        np.linalg.norm(rays - rays.mean(axis=0), axis=1)
    ):
        raise ValueError(DISORDER)
    if np.linalg.det(homography) <= 0:
        raise ValueError("its points are mirrored: the paper would be seen from behind")
    scale = np.sqrt(np.linalg.norm(homography[:, 0]) * np.linalg.norm(homography[:, 1]))
    x, y, t = (look.T @ homography / scale).T
    nearly = np.column_stack([x, y, np.cross(x, y)])
    rotation = Rotation.from_matrix(nearly).as_matrix()
    return Pose(rotation, t - rotation[:, :2] @ middle)
