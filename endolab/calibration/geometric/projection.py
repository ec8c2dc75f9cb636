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
from endolab.numerics.arrays import FloatArray, IntArray

Lens = KannalaBrandt | BrownConrady
CAMERA_NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")
BROWN_NAMES = (*CAMERA_NAMES[:6], "p1", "p2", "k3", "k4", "k5", "k6")
# Points on the rim of a unit disc, (8, 3), and the matrix that differentiates a function of their angle.
RIM_ANGLES = np.linspace(0, 2 * np.pi, 8, endpoint=False)
RIM = np.stack([np.cos(RIM_ANGLES), np.sin(RIM_ANGLES), 0 * RIM_ANGLES], axis=-1)
RIM_DERIVATIVE = np.fft.irfft(
    1j * np.arange(5)[:, None] * np.fft.rfft(np.eye(8), axis=0), axis=0
)


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
    #     pixel = f u (x, y) + c,  u = h(ϑ) / s,  h = ϑ + k1 ϑ³ + …,  ϑ = atan(s / z),  s = |(x, y)|
    # s is never 0, so that on the axis u is 1/z.
    xy = points[:, :2]
    square = np.sum(points**2, axis=1)
    s = np.hypot(np.linalg.norm(xy, axis=1), 1e-9 * np.sqrt(square))
    theta = np.arctan2(s, points[:, 2])
    orders = np.array([1, 3, 5, 7, 9])
    terms = np.append(1.0, vector[4:])
    powers = theta[:, None] ** orders
    u = powers @ terms / s
    slope = powers @ (orders * terms) / theta / square  # ∂h/∂ϑ / |point|²
    # ∂u by the point: along (x, y), and by z.
    gradient = xy * ((slope * points[:, 2] - u) / s**2)[:, None]
    gradient = np.column_stack([gradient, -slope])
    by_point = u[:, None, None] * np.eye(2, 3) + xy[:, :, None] * gradient[:, None]
    by_camera = np.zeros((len(points), 2, 8))
    by_camera[:, [0, 1], [0, 1]] = u[:, None] * xy
    by_camera[:, [0, 1], [2, 3]] = 1.0
    by_camera[..., 4:] = powers[:, None, 1:] * (focal * xy / s[:, None])[..., None]
    return focal * u[:, None] * xy + centre, by_camera, by_point * focal[:, None]


def _centroid(curves: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find the centroids of what closed curves enclose, from points along them, (n, vertices, 2).

    Returns them, (n, 2), and their derivatives by the points' numbers, (n, 2, 2 · vertices). A curve of one
    vertex is that point.
    """
    if curves.shape[1] == 1:
        return curves[:, 0], np.eye(2)[None]
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
    weights = np.stack([by_x, by_y], axis=-1) / area[:, None, None]
    return middle + offset, np.swapaxes(weights, 0, 1).reshape(len(curves), 2, -1)


def project(
    vector: FloatArray,
    poses: FloatArray,
    view: IntArray,
    points: FloatArray,
    radii: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Predict where features are measured, with derivatives.

    `vector` is the camera's, `poses` (v, 6) are those of some views, `Pose.vector`, and `view` (n,) says
    which of them each feature is in; `points` (n, 3) lie in the target's plane z = 0, mm; `radii`
    (n,), mm, are of their discs, all 0 for corners.

    Returns pixels (n, 2), and their derivatives by the vector, (n, 2, p), and by the pose, (n, 2, 6).
    """
    rotation, by_vector = zip(*(cv2.Rodrigues(turn) for turn in poses[:, :3]), strict=True)
    rim = RIM if radii.any() else np.zeros((1, 3))
    places = points[:, None] + radii[:, None, None] * rim
    seen = places @ np.swapaxes(rotation, 1, 2)[view] + poses[view, None, 3:]
    pixels, by_camera, by_point = (
        part.reshape(len(points), len(rim), *part.shape[1:])
        for part in to_pixels(vector, seen.reshape(-1, 3))
    )
    # Of a place's point by the rotation vector.
    turns = np.swapaxes(np.reshape(by_vector, (-1, 3, 3, 3)), 1, 3).reshape(-1, 3, 9)
    by_turn = by_point @ (places @ turns[view]).reshape(*places.shape, 3)
    slopes = np.concatenate([by_camera, by_turn, by_point], axis=-1)
    centroid, weights = _centroid(pixels)
    slopes = weights @ slopes.reshape(len(points), 2 * len(rim), len(vector) + 6)
    return centroid, slopes[..., :-6], slopes[..., -6:]


def predict_view(
    camera: Lens, pose: Pose, points: FloatArray, radii: FloatArray
) -> FloatArray:
    """Predict where the features of one panel are measured, (n, 2), px; nan beyond the camera's range.

    `points` (n, 3) lie in the target's plane z = 0, mm; `radii` (n,), mm, are all 0 for corners.
    """
    view = np.zeros(len(points), int)
    pixels, *_ = project(camera_vector(camera), pose.vector[None], view, points, radii)
    return np.where(np.isfinite(camera.project(pose.transform(points))), pixels, np.nan)
