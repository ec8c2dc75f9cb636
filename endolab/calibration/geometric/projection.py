"""Where a camera sees the features of a flat target, and how that changes.

What is measured of a printed dot is the centroid of its image, which is not the image of its
centre. By Green's theorem it is a ratio of integrals along the rim of the image, which the
trapezoidal rule takes from eight points of the rim with spectral accuracy: the error is of sixth
order in the radius. The derivatives follow from those of the eight points.

The camera is a vector here, in the order of `camera_names`: of 8 numbers for `KannalaBrandt`, of 12 for
`BrownConrady`. Its polynomial is used as it stands, also where it no longer grows, because a solver may
pass there.
"""

from dataclasses import dataclass

import numpy as np

from endolab.calibration.geometric.pose import Pose
from endolab.model.cameras import BrownConrady, KannalaBrandt, distort
from endolab.numerics.arrays import FloatArray

Lens = KannalaBrandt | BrownConrady
CAMERA_NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")
BROWN_NAMES = (*CAMERA_NAMES[:6], "p1", "p2", "k3", "k4", "k5", "k6")
RIM_ANGLES = np.linspace(0, 2 * np.pi, 8, endpoint=False)  # of points on the rim of a disc


def _rim_derivative() -> FloatArray:
    """Return the matrix that differentiates a periodic function of the angle, given at `RIM_ANGLES`."""
    count = len(RIM_ANGLES)
    frequency = np.fft.fftfreq(count, 1 / count)
    frequency[count // 2] = 0.0
    waves = np.fft.fft(np.eye(count), axis=0)
    return np.fft.ifft(1j * frequency[:, None] * waves, axis=0).real


RIM_DERIVATIVE = _rim_derivative()


def camera_names(camera: Lens) -> tuple[str, ...]:
    """Name the numbers of a camera's vector."""
    return BROWN_NAMES if isinstance(camera, BrownConrady) else CAMERA_NAMES


def camera_vector(camera: Lens) -> FloatArray:
    """Return a camera's fx, fy, cx, cy (px) and k, (8,) or (12,)."""
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.k])


def camera_of(vector: FloatArray, width: int, height: int) -> Lens:
    """Return the camera of a vector (8,) or (12,) for pictures of a size, px."""
    fx, fy, cx, cy, *k = vector.tolist()
    if len(k) == 4:
        return KannalaBrandt(width, height, fx, fy, cx, cy, tuple(k))
    return BrownConrady(width, height, fx, fy, cx, cy, tuple(k))


@dataclass(frozen=True)
class Projection:
    """Features as a camera sees them."""

    pixels: FloatArray  # (n, 2), column and row, px
    by_camera: FloatArray  # (n, 2, p), derivatives by the camera's vector
    by_pose: (
        FloatArray  # (n, 2, 6), by a turn ω, rad, and a shift, mm: R ← exp(ω) R, t ← t + δ
    )


def _to_plane(
    points: FloatArray, k: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Project points (3, vertices, n) on the camera's plane, before focal length and centre.

    Returns x, y there, (2, vertices, n), and their derivatives by the points, (2, 3, vertices, n), and by
    k, (2, 4 or 8, vertices, n).
    """
    if len(k) == 8:
        return _to_distorted_plane(points, k)
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


def _to_distorted_plane(
    points: FloatArray, k: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Do the same for Brown and Conrady's distortion."""
    z = np.where(points[2] == 0, np.finfo(float).eps, points[2])
    x, y = xy = points[:2] / z
    at = x + 1j * y
    w, a, b = distort(at, k)
    by_point = np.empty((2, 3, *z.shape))
    by_point[0, 0] = (a + b.real) / z
    by_point[0, 1] = by_point[1, 0] = b.imag / z
    by_point[1, 1] = (a - b.real) / z
    by_point[:, 2] = -by_point[:, 0] * xy[0] - by_point[:, 1] * xy[1]
    s = x * x + y * y
    k4, k5, k6 = k[5:]
    denominator = 1 + s * (k4 + s * (k5 + s * k6))
    above = at / denominator
    below = -above * (1 + s * (k[0] + s * (k[1] + s * k[4]))) / denominator
    by_p1 = 2 * y * at + 1j * s
    by_p2 = 2 * x * at + s
    powers = [above * s, above * s**2, by_p1, by_p2, above * s**3]
    by_k = np.stack([*powers, below * s, below * s**2, below * s**3])
    return np.stack([w.real, w.imag]), by_point, np.stack([by_k.real, by_k.imag])


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

    `vector` is the camera's; `rotation` (n, 3, 3) and `translation` (n, 3), mm, bring each feature
    from the target's frame to the camera's; `points` (n, 3) lie in the target's plane z = 0, mm; `radii`
    (n,), mm, are of their discs, all 0 for corners.
    """
    turned = _rims(rotation, points, radii)
    plane, by_point, by_k = _to_plane(turned + translation.T[:, None], vector[4:])
    centroid, weights = _centroid(plane)
    focal = vector[:2]
    by_point = (weights[:, :, None] * by_point).sum(axis=1)
    by_k = (weights[:, :, None] * by_k).sum(axis=1)
    by_camera = np.zeros((len(points), 2, len(vector)))
    by_camera[:, 0, 0], by_camera[:, 1, 1] = centroid
    by_camera[:, 0, 2] = by_camera[:, 1, 3] = 1.0
    by_camera[:, :, 4:] = by_k.sum(axis=2).T.swapaxes(1, 2) * focal[:, None]
    # A turn ω moves the point by ω × (turned point).
    by_turn = np.cross(turned, by_point, axisa=0, axisb=1, axisc=1)
    by_pose = np.concatenate([by_turn, by_point], axis=1).sum(axis=2)
    by_pose = by_pose.T.swapaxes(1, 2) * focal[:, None]
    return Projection(centroid.T * focal + vector[2:4], by_camera, by_pose)


def predict_view(
    camera: Lens, pose: Pose, points: FloatArray, radii: FloatArray
) -> FloatArray:
    """Predict where the features of one panel are measured, (n, 2), px; nan beyond the camera's range.

    `points` (n, 3) lie in the target's plane z = 0, mm; `radii` (n,), mm, are all 0 for corners.
    """
    n = len(points)
    rotation = np.broadcast_to(pose.rotation, (n, 3, 3))
    translation = np.broadcast_to(pose.translation, (n, 3))
    pixels = project(camera_vector(camera), rotation, translation, points, radii).pixels
    return np.where(np.isfinite(camera.project(pose.transform(points))), pixels, np.nan)
