"""The pose of a flat target from the rays to its points: a start without a guess, at any field of view."""

import numpy as np

from endolab.calibration.geometric.pose import Pose
from endolab.numerics.arrays import FloatArray

# How a plane is sought among points of which some are wrong.
SUBSETS = 50  # with 30 % wrong points, one set in six is right
SUBSET_SIZE = 5  # points; four would do, but noise would rule
LEAST_POINTS = 8  # points of a view that count as evidence
# Of the rays' spread: a median miss beyond it is no view of a plane, whatever the lens.
DISORDER = 0.25


def _normal_matrices(rays: FloatArray, plane: FloatArray) -> FloatArray:
    """Normal equations of ray × (H x) = 0 in the nine entries of H, of each point: (n, 9, 9)."""
    across = np.eye(3) - rays[:, :, None] * rays[:, None]
    return np.einsum("nij,nk,nl->nikjl", across, plane, plane).reshape(-1, 9, 9)


def _solve(matrix: FloatArray) -> FloatArray:
    """Solve for homographies, (s, 3, 3), from normal equations, (s, 9, 9)."""
    _, vectors = np.linalg.eigh(matrix)
    return vectors[:, :, 0].reshape(-1, 3, 3)


def _misses(
    homography: FloatArray, rays: FloatArray, plane: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Sines-and-beyond between rays and where homographies put them, (s, n), and their signs, (s,)."""
    towards = np.einsum("sij,nj->sni", homography, plane)
    towards /= np.maximum(
        np.linalg.norm(towards, axis=2, keepdims=True), np.finfo(float).tiny
    )
    along = np.einsum("sni,ni->sn", towards, rays)
    sign = np.where(np.median(along, axis=1) < 0, -1.0, 1.0)
    return np.sqrt(np.maximum(2 - 2 * sign[:, None] * along, 0.0)), sign


def pose_from_rays(rays: FloatArray, points: FloatArray) -> Pose:
    """Find the pose of a plane from unit rays (n ≥ 8, 3), any direction, to its points (n, 3), z = 0, mm.

    Some points may be wrong. A linear solution (DLT) for the homography from the plane to rays, first from
    small random sets of points (least median of squares), then from all that agree; the homography's first
    two columns are made orthonormal. ValueError if the points are too few, on a line or in disorder, or if
    the pose would show the paper from behind.
    """
    if len(rays) < LEAST_POINTS:
        raise ValueError(f"a pose needs {LEAST_POINTS} points at least, got {len(rays)}")
    middle = points[:, :2].mean(axis=0)
    centred = points[:, :2] - middle
    extent = np.linalg.svd(centred, compute_uv=False)
    if extent[1] <= 1e-6 * extent[0]:
        raise ValueError("its points lie on one line")
    size = float(np.sqrt(np.mean(centred**2)))
    plane = np.column_stack([centred / size, np.ones(len(points))])
    matrices = _normal_matrices(rays, plane)
    random = np.random.default_rng(0)
    sets = np.argsort(random.random((SUBSETS, len(rays))), axis=1)[:, :SUBSET_SIZE]
    miss, _ = _misses(_solve(matrices[sets].sum(axis=1)), rays, plane)
    miss = miss[np.argmin(np.median(miss, axis=1))]
    for _ in range(3):
        # The median of the length of two-dimensional noise is 1.18 σ.
        good = miss <= 3.5 * np.median(miss) / 1.18 * (1 + 5 / len(rays))
        homography = _solve(matrices[good].sum(axis=0, keepdims=True))
        misses, sign = _misses(homography, rays, plane)
        miss = misses[0]
    spread = np.median(np.linalg.norm(rays - rays.mean(axis=0), axis=1))
    if np.median(miss) > DISORDER * spread:
        raise ValueError("its points do not lie to each other as the target's do")
    homography = sign[0] * homography[0] / np.array([size, size, 1.0])
    if np.linalg.det(homography) <= 0:
        raise ValueError("its points are mirrored: the paper would be seen from behind")
    scale = np.sqrt(np.linalg.norm(homography[:, 0]) * np.linalg.norm(homography[:, 1]))
    x, y, t = (homography / scale).T
    u, _, vt = np.linalg.svd(np.column_stack([x, y, np.cross(x, y)]))
    rotation = u @ vt
    return Pose(rotation, t - rotation[:, :2] @ middle)
