"""Where a camera sees the features of a flat target, and how that changes.

What is measured of a printed dot is the centroid of its image, which is not the image of its
centre. By Green's theorem it is a ratio of integrals along the rim of the image, which the
trapezoidal rule takes from eight points of the rim with spectral accuracy: the error is of sixth
order in the radius. The derivatives follow from those of the eight points.

The camera is a vector here, in the order of `camera_names`: of 8 numbers for `KannalaBrandt`, of 12 for
`BrownConrady`. Its polynomial is used as it stands, also where it no longer grows, because a solver may
pass there.
"""

import cv2
import numpy as np

from endolab.calibration.geometric.pose import Pose
from endolab.model.cameras import BrownConrady, KannalaBrandt
from endolab.numerics.arrays import FloatArray

Lens = KannalaBrandt | BrownConrady
CAMERA_NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")
BROWN_NAMES = (*CAMERA_NAMES[:6], "p1", "p2", "k3", "k4", "k5", "k6")
# Points on the rim of a unit disc, (8, 3), and the matrix that differentiates a function of their angle.
RIM_ANGLES = np.linspace(0, 2 * np.pi, 8, endpoint=False)
RIM = np.stack([np.cos(RIM_ANGLES), np.sin(RIM_ANGLES), 0 * RIM_ANGLES], axis=-1)
FREQUENCIES = np.array([0, 1, 2, 3, 0, -3, -2, -1])
RIM_DERIVATIVE = np.fft.ifft(
    1j * FREQUENCIES[:, None] * np.fft.fft(np.eye(8), axis=0), axis=0
).real


def camera_names(camera: Lens) -> tuple[str, ...]:
    """Name the numbers of a camera's vector."""
    return BROWN_NAMES if isinstance(camera, BrownConrady) else CAMERA_NAMES


def camera_vector(camera: Lens) -> FloatArray:
    """Return a camera's fx, fy, cx, cy (px) and k, (8,) or (12,)."""
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.k])


def camera_of(vector: FloatArray, width: int, height: int) -> Lens:
    """Return the camera of a vector (8,) or (12,) for pictures of a size, px."""
    fx, fy, cx, cy, *k = vector.tolist()
    kind = KannalaBrandt if len(k) == 4 else BrownConrady
    return kind(width, height, fx, fy, cx, cy, tuple(k))


def to_pixels(
    vector: FloatArray, points: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Project points (n, 3) of the camera frame.

    Returns pixels (n, 2), and their derivatives by the camera's vector, (n, 2, p), and by the points,
    (n, 2, 3).
    """
    focal = vector[:2]
    centre = vector[2:4]
    if len(vector) == 12:
        matrix = np.array([[focal[0], 0, centre[0]], [0, focal[1], centre[1]], [0, 0, 1]])
        still = np.zeros(3)
        found = cv2.projectPoints(points, still, still, matrix, vector[4:])
        pixels, slopes = (np.asarray(part, dtype=np.float64) for part in found)
        slopes = slopes.reshape(len(points), 2, 18)  # by a turn, a shift, f, c, k
        return pixels[:, 0], slopes[..., 6:], slopes[..., 3:6]
    # cv2.fisheye takes what is behind the image plane for what is before it. In polar coordinates
    #     pixel = f h(ϑ) d + c,  h = ϑ + k1 ϑ³ + …,  d = (x, y) / s,  ϑ = atan(s / z)
    # s is never 0, so that on the axis h/s is 1/z.
    z = points[:, 2]
    length = np.linalg.norm(points, axis=1)
    s = np.hypot(np.linalg.norm(points[:, :2], axis=1), 1e-9 * length)
    theta = np.arctan2(s, z)
    direction = points[:, :2] / s[:, None]
    orders = np.array([1, 3, 5, 7, 9])
    terms = np.append(1.0, vector[4:])
    powers = theta[:, None] ** orders
    h = powers @ terms
    slope = (powers / theta[:, None]) @ (orders * terms)  # ∂h/∂ϑ
    by_theta = np.column_stack([z[:, None] * direction, -s]) / length[:, None] ** 2
    by_point = direction[:, :, None] * (slope[:, None] * by_theta)[:, None]
    across = np.eye(2) - direction[:, :, None] * direction[:, None]
    by_point[..., :2] += (h / s)[:, None, None] * across
    plane = h[:, None] * direction
    by_camera = np.zeros((len(points), 2, 8))
    by_camera[:, [0, 1], [0, 1]] = plane
    by_camera[:, [0, 1], [2, 3]] = 1.0
    by_camera[..., 4:] = powers[:, None, 1:] * (direction * focal)[..., None]
    return plane * focal + centre, by_camera, by_point * focal[:, None]


def _centroid(curves: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find the centroids of what closed curves enclose, from points along them, (n, vertices, 2).

    Returns them, (n, 2), and their derivatives by the points, (n, vertices, 2, 2). A curve of one vertex is
    that point.
    """
    if curves.shape[1] == 1:
        return curves[:, 0], np.eye(2)[None, None]
    # About a point inside, for the sake of rounding.
    middle = curves.mean(axis=1)
    x, y = np.moveaxis(curves - middle[:, None], -1, 0)
    dx = x @ RIM_DERIVATIVE.T
    dy = y @ RIM_DERIVATIVE.T
    area = np.sum(x * dy, axis=1)
    moments = np.sum([x * x * dy, -y * y * dx], axis=2)
    offset = (0.5 * moments / area).T
    # The derivatives do not depend on the origin; about the centroid the area's change has no effect.
    x = x - offset[:, :1]
    y = y - offset[:, 1:]
    by_x = [x * dy, 0.5 * (y * y) @ RIM_DERIVATIVE.T]
    by_y = [-0.5 * (x * x) @ RIM_DERIVATIVE.T, -y * dx]
    weights = np.stack([np.stack(by_x, -1), np.stack(by_y, -1)], axis=-1)
    return middle + offset, weights / area[:, None, None, None]


def project(
    vector: FloatArray,
    rotation: FloatArray,
    translation: FloatArray,
    points: FloatArray,
    radii: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Predict where features are measured, with derivatives.

    `vector` is the camera's; `rotation` (n, 3, 3) and `translation` (n, 3), mm, bring each feature
    from the target's frame to the camera's; `points` (n, 3) lie in the target's plane z = 0, mm; `radii`
    (n,), mm, are of their discs, all 0 for corners.

    Returns pixels (n, 2), and their derivatives by the vector, (n, 2, p), and by the pose, (n, 2, 6): a turn
    ω, rad, and a shift, mm, R ← exp(ω) R, t ← t + δ.
    """
    rim = RIM if radii.any() else np.zeros((1, 3))
    turned = (points[:, None] + radii[:, None, None] * rim) @ np.swapaxes(rotation, 1, 2)
    seen = (turned + translation[:, None]).reshape(-1, 3)
    pixels, by_camera, by_point = (
        part.reshape(len(points), len(rim), *part.shape[1:])
        for part in to_pixels(vector, seen)
    )
    by_turn = np.cross(turned[:, :, None], by_point)  # a turn ω moves a point by ω × turned
    slopes = np.concatenate([by_camera, by_turn, by_point], axis=-1)
    centroid, weights = _centroid(pixels)
    slopes = (weights @ slopes).sum(axis=1)
    return centroid, slopes[..., :-6], slopes[..., -6:]


def predict_view(
    camera: Lens, pose: Pose, points: FloatArray, radii: FloatArray
) -> FloatArray:
    """Predict where the features of one panel are measured, (n, 2), px; nan beyond the camera's range.

    `points` (n, 3) lie in the target's plane z = 0, mm; `radii` (n,), mm, are all 0 for corners.
    """
    rotation = np.broadcast_to(pose.rotation, (len(points), 3, 3))
    translation = np.broadcast_to(pose.translation, points.shape)
    pixels, *_ = project(camera_vector(camera), rotation, translation, points, radii)
    return np.where(np.isfinite(camera.project(pose.transform(points))), pixels, np.nan)
