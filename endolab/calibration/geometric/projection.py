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
from numpy.typing import ArrayLike

from endolab.calibration.geometric.pose import Pose
from endolab.model.cameras import KannalaBrandt
from endolab.numerics.arrays import FloatArray

CAMERA_NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")
RIM_ANGLES = np.linspace(0, 2 * np.pi, 8, endpoint=False)  # of points on the rim of a disc


def _rim_derivative() -> FloatArray:
    """Return the matrix that differentiates a periodic function of the angle, given at `RIM_ANGLES`."""
    apart = RIM_ANGLES[:, None] - RIM_ANGLES
    number = np.arange(len(RIM_ANGLES))
    sign = 0.5 * (-1.0) ** (number[:, None] - number)
    return np.where(apart == 0, 0.0, sign / np.tan(np.where(apart == 0, 1.0, apart) / 2))


RIM_DERIVATIVE = _rim_derivative()


def camera_vector(camera: KannalaBrandt) -> FloatArray:
    """Return a camera's fx, fy, cx, cy (px) and k1 to k4, (8,)."""
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.k])


def camera_of(vector: ArrayLike, width: int, height: int) -> KannalaBrandt:
    """Return the camera of a vector (8,) for pictures of a size, px."""
    fx, fy, cx, cy, *k = (float(value) for value in np.asarray(vector))
    return KannalaBrandt(width, height, fx, fy, cx, cy, (k[0], k[1], k[2], k[3]))


@dataclass(frozen=True)
class Projection:
    """Features as a camera sees them."""

    pixels: FloatArray  # (n, 2), column and row, px
    by_camera: FloatArray  # (n, 2, 8), derivatives by the camera's vector
    by_pose: (
        FloatArray  # (n, 2, 6), by a turn ω, rad, and a shift, mm: R ← exp(ω) R, t ← t + δ
    )


@dataclass(frozen=True)
class _Fan:
    """Images of many directions on the camera's plane, before focal length and centre.

    Arrays are (vertices, n): x, y in the plane; c, s the direction off the axis; and what the
    derivatives need.
    """

    x: FloatArray
    y: FloatArray
    c: FloatArray
    s: FloatArray
    theta: FloatArray
    slope: FloatArray  # dh/dϑ
    ratio: FloatArray  # h / side
    over: FloatArray  # 1 / (side² + z²)


def _fan(points: FloatArray, k: FloatArray) -> _Fan:
    """Project points (3, vertices, n) of the camera frame."""
    x, y, z = points
    side = np.hypot(x, y)
    axial = side == 0
    safe = np.where(axial, 1.0, side)
    theta = np.arctan2(side, z)
    t = theta * theta
    k1, k2, k3, k4 = k
    value = 1 + t * (k1 + t * (k2 + t * (k3 + t * k4)))  # h/ϑ
    slope = 1 + t * (3 * k1 + t * (5 * k2 + t * (7 * k3 + t * 9 * k4)))
    # On the axis ϑ/side → 1/z.
    ratio = value * np.where(axial, 1 / np.where(axial, z, 1.0), theta / safe)
    over = 1 / (side * side + z * z)
    return _Fan(
        x * ratio,
        y * ratio,
        np.where(axial, 1.0, x / safe),
        y / safe,
        theta,
        slope,
        ratio,
        over,
    )


def _centroid(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centroids of what closed curves enclose, from points along them, (vertices, n); two (n,)."""
    # About a point inside, for the sake of rounding.
    x0 = x.mean(axis=0)
    y0 = y.mean(axis=0)
    x = x - x0
    y = y - y0
    dx = RIM_DERIVATIVE @ x
    dy = RIM_DERIVATIVE @ y
    area = (x * dy).sum(axis=0)
    return x0 + 0.5 * (x * x * dy).sum(axis=0) / area, y0 - 0.5 * (y * y * dx).sum(
        axis=0
    ) / area


def _centroid_weights(
    x: FloatArray, y: FloatArray
) -> tuple[tuple[FloatArray, ...], FloatArray]:
    """Derivatives of the centroids by the points: ∂X/∂x, ∂X/∂y, ∂Y/∂x, ∂Y/∂y; and the centroids, (2, n)."""
    cx, cy = _centroid(x, y)
    # The derivatives do not depend on the origin; about the centroid the area's change has no effect.
    x = x - cx
    y = y - cy
    dx = RIM_DERIVATIVE @ x
    dy = RIM_DERIVATIVE @ y
    over = 1 / (x * dy).sum(axis=0)
    weights = (
        x * dy * over,
        -0.5 * over * (RIM_DERIVATIVE @ (x * x)),
        0.5 * over * (RIM_DERIVATIVE @ (y * y)),
        -y * dx * over,
    )
    return weights, np.stack([cx, cy])


def _rims(rotation: FloatArray, points: FloatArray, radii: FloatArray) -> FloatArray:
    """Return points around discs, turned, or corners as they are: (3, vertices, n), mm."""
    centre = np.einsum("nij,nj->in", rotation, points)[:, None]
    if not radii.any():
        return centre
    right, down = rotation[:, :, :2].transpose(2, 1, 0)[:, :, None] * radii  # (3, 1, n)
    return centre + right * np.cos(RIM_ANGLES)[:, None] + down * np.sin(RIM_ANGLES)[:, None]


def predict(
    vector: FloatArray,
    rotation: FloatArray,
    translation: FloatArray,
    points: FloatArray,
    radii: FloatArray,
) -> FloatArray:
    """Predict where features are measured; see `project`. Returns pixels (n, 2)."""
    fan = _fan(_rims(rotation, points, radii) + translation.T[:, None], vector[4:])
    x, y = _centroid(fan.x, fan.y) if len(fan.x) > 1 else (fan.x[0], fan.y[0])
    return np.stack([x, y], axis=-1) * vector[:2] + vector[2:4]


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
    x, y, z = at = turned + translation.T[:, None]
    fan = _fan(at, vector[4:])
    if len(fan.x) > 1:
        (xx, xy, yx, yy), plane = _centroid_weights(fan.x, fan.y)
    else:
        ones = np.ones_like(fan.x)
        zeros = np.zeros_like(fan.x)
        (xx, xy, yx, yy), plane = (ones, zeros, zeros, ones), np.stack([fan.x[0], fan.y[0]])
    focal = vector[:2]
    n = plane.shape[1]
    by_camera = np.zeros((n, 2, 8))
    by_camera[:, 0, 0], by_camera[:, 1, 1] = plane
    by_camera[:, 0, 2] = by_camera[:, 1, 3] = 1.0
    # ∂(plane)/∂(point), symmetric in x and y.
    out = fan.slope * z * fan.over - fan.ratio
    dxx = fan.ratio + out * fan.c**2
    dxy = out * fan.c * fan.s
    dyy = fan.ratio + out * fan.s**2
    fall = fan.slope * fan.over
    dxz = -fall * x
    dyz = -fall * y
    by_pose = np.empty((n, 2, 6))
    for row, (wx, wy) in enumerate(((xx, xy), (yx, yy))):
        gx = wx * dxx + wy * dxy
        gy = wx * dxy + wy * dyy
        gz = wx * dxz + wy * dyz
        # A turn ω moves the point by ω × (turned point).
        a, b, c = turned
        turns = (b * gz - c * gy, c * gx - a * gz, a * gy - b * gx)
        for column, part in enumerate((*turns, gx, gy, gz)):
            by_pose[:, row, column] = part.sum(axis=0) * focal[row]
        along = (wx * fan.c + wy * fan.s) * fan.theta
        for column in range(4, 8):
            along = along * fan.theta**2
            by_camera[:, row, column] = along.sum(axis=0) * focal[row]
    return Projection(plane.T * focal + vector[2:4], by_camera, by_pose)


def predict_view(
    camera: KannalaBrandt, pose: Pose, points: ArrayLike, radii: ArrayLike
) -> FloatArray:
    """Predict where the features of one panel are measured, (n, 2), px; nan beyond the camera's range.

    `points` (n, 3) lie in the target's plane z = 0, mm; `radii` (n,), mm, are all 0 for corners.
    """
    points = np.asarray(points, dtype=np.float64)
    radii = np.asarray(radii, dtype=np.float64)
    n = len(points)
    rotation = np.broadcast_to(pose.rotation, (n, 3, 3))
    translation = np.broadcast_to(pose.translation, (n, 3))
    pixels = predict(camera_vector(camera), rotation, translation, points, radii)
    return np.where(np.isfinite(camera.project(pose.transform(points))), pixels, np.nan)
