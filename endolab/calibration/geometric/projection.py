"""Where a Kannala-Brandt camera sees the features of a flat target, and how that changes.

What is measured of a printed dot is the centroid of its image, which is not the image of its
centre. By Green's theorem it is a ratio of integrals along the rim of the image, which the
trapezoidal rule takes from eight points of the rim with spectral accuracy: the error is of sixth
order in the radius. The derivatives follow from those of the eight points.

The camera is a vector here, in the order of `CAMERA_NAMES`; its polynomial is used as it stands, also
where it no longer grows, because a solver may pass there.
"""

from dataclasses import dataclass

import numpy as np

from endolab.calibration.geometric.pose import Pose
from endolab.model.cameras import KannalaBrandt
from endolab.numerics.arrays import FloatArray

CAMERA_NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")
RIM_ANGLES = np.linspace(0, 2 * np.pi, 8, endpoint=False)  # of points on the rim of a disc


def _rim_derivative() -> FloatArray:
    """Return the matrix that differentiates a periodic function of the angle, given at `RIM_ANGLES`."""
    count = len(RIM_ANGLES)
    frequency = np.fft.fftfreq(count, 1 / count)
    frequency[count // 2] = 0.0
    waves = np.fft.fft(np.eye(count), axis=0)
    return np.fft.ifft(1j * frequency[:, None] * waves, axis=0).real


RIM_DERIVATIVE = _rim_derivative()


def camera_vector(camera: KannalaBrandt) -> FloatArray:
    """Return a camera's fx, fy, cx, cy (px) and k1 to k4, (8,)."""
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.k])


def camera_of(vector: FloatArray, width: int, height: int) -> KannalaBrandt:
    """Return the camera of a vector (8,) for pictures of a size, px."""
    fx, fy, cx, cy, k1, k2, k3, k4 = vector.tolist()
    return KannalaBrandt(width, height, fx, fy, cx, cy, (k1, k2, k3, k4))


@dataclass(frozen=True)
class Projection:
    """Features as a camera sees them."""

    pixels: FloatArray  # (n, 2), column and row, px
    by_camera: FloatArray  # (n, 2, 8), derivatives by the camera's vector
    by_pose: (
        FloatArray  # (n, 2, 6), by a turn ω, rad, and a shift, mm: R ← exp(ω) R, t ← t + δ
    )


def _to_plane(
    points: FloatArray, k: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Project points (3, vertices, n) on the camera's plane, before focal length and centre.

    Returns x, y there, (2, vertices, n), and their derivatives by the points, (2, 3, vertices, n), and by
    k, (2, 4, vertices, n).
    """
    xy = points[:2]
    z = points[2]
    side = np.hypot(points[0], points[1])
    axial = side == 0
    safe = np.where(axial, 1.0, side)
    theta = np.arctan2(side, z)
    t = theta * theta
    k1, k2, k3, k4 = k
    value = 1 + t * (k1 + t * (k2 + t * (k3 + t * k4)))  # h/ϑ
    slope = 1 + t * (3 * k1 + t * (5 * k2 + t * (7 * k3 + t * 9 * k4)))  # dh/dϑ
    # On the axis ϑ/side → 1/z.
    ratio = value * np.where(axial, 1 / np.where(axial, z, 1.0), theta / safe)
    direction = xy / safe
    direction[0][axial] = 1.0
    fall = slope / (side * side + z * z)
    by_point = np.empty((2, 3, *side.shape))
    by_point[:, :2] = (fall * z - ratio) * direction[:, None] * direction
    by_point[0, 0] += ratio
    by_point[1, 1] += ratio
    by_point[:, 2] = -fall * xy
    by_k = np.empty((2, 4, *side.shape))
    power = theta * direction
    for number in range(4):
        power = power * t
        by_k[:, number] = power
    return xy * ratio, by_point, by_k


def _centroid(plane: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find the centroids of what closed curves enclose, from points along them, (2, vertices, n).

    Returns them, (2, n), and their derivatives by the points, (2, 2, vertices, n). A curve of one vertex is
    that point.
    """
    if plane.shape[1] == 1:
        return plane[:, 0], np.eye(2)[..., None, None]
    # About a point inside, for the sake of rounding.
    middle = plane.mean(axis=1)
    x, y = plane - middle[:, None]
    dx = RIM_DERIVATIVE @ x
    dy = RIM_DERIVATIVE @ y
    area = (x * dy).sum(axis=0)
    offset = 0.5 * np.stack([(x * x * dy).sum(axis=0), -(y * y * dx).sum(axis=0)]) / area
    # The derivatives do not depend on the origin; about the centroid the area's change has no effect.
    x = x - offset[0]
    y = y - offset[1]
    by_x = np.stack([x * dy, 0.5 * RIM_DERIVATIVE @ (y * y)])
    by_y = np.stack([-0.5 * RIM_DERIVATIVE @ (x * x), -y * dx])
    return middle + offset, np.stack([by_x, by_y], axis=1) / area


def _rims(rotation: FloatArray, points: FloatArray, radii: FloatArray) -> FloatArray:
    """Return points around discs, turned, or corners as they are: (3, vertices, n), mm."""
    centre = np.einsum("nij,nj->in", rotation, points)[:, None]
    if not radii.any():
        return centre
    right, down = rotation[:, :, :2].transpose(2, 1, 0)[:, :, None] * radii  # (3, 1, n)
    return centre + right * np.cos(RIM_ANGLES)[:, None] + down * np.sin(RIM_ANGLES)[:, None]


def project(
    vector: FloatArray,
    rotation: FloatArray,
    translation: FloatArray,
    points: FloatArray,
    radii: FloatArray,
) -> Projection:
    """Predict where features are measured, with derivatives.

    `vector` is the camera's, (8,); `rotation` (n, 3, 3) and `translation` (n, 3), mm, bring each feature
    from the target's frame to the camera's; `points` (n, 3) lie in the target's plane z = 0, mm; `radii`
    (n,), mm, are of their discs, all 0 for corners.
    """
    turned = _rims(rotation, points, radii)
    plane, by_point, by_k = _to_plane(turned + translation.T[:, None], vector[4:])
    centroid, weights = _centroid(plane)
    focal = vector[:2]
    by_point = (weights[:, :, None] * by_point).sum(axis=1)
    by_k = (weights[:, :, None] * by_k).sum(axis=1)
    by_camera = np.zeros((len(points), 2, 8))
    by_camera[:, 0, 0], by_camera[:, 1, 1] = centroid
    by_camera[:, 0, 2] = by_camera[:, 1, 3] = 1.0
    by_camera[:, :, 4:] = by_k.sum(axis=2).T.swapaxes(1, 2) * focal[:, None]
    # A turn ω moves the point by ω × (turned point).
    by_turn = np.cross(turned, by_point, axisa=0, axisb=1, axisc=1)
    by_pose = np.concatenate([by_turn, by_point], axis=1).sum(axis=2)
    by_pose = by_pose.T.swapaxes(1, 2) * focal[:, None]
    return Projection(centroid.T * focal + vector[2:4], by_camera, by_pose)


def predict_view(
    camera: KannalaBrandt, pose: Pose, points: FloatArray, radii: FloatArray
) -> FloatArray:
    """Predict where the features of one panel are measured, (n, 2), px; nan beyond the camera's range.

    `points` (n, 3) lie in the target's plane z = 0, mm; `radii` (n,), mm, are all 0 for corners.
    """
    n = len(points)
    rotation = np.broadcast_to(pose.rotation, (n, 3, 3))
    translation = np.broadcast_to(pose.translation, (n, 3))
    pixels = project(camera_vector(camera), rotation, translation, points, radii).pixels
    return np.where(np.isfinite(camera.project(pose.transform(points))), pixels, np.nan)
