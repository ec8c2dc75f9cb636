import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from endolab.calibration.geometric.pose import Pose
from endolab.calibration.geometric.projection import (
    CAMERA_NAMES,
    camera_vector,
    predict,
    predict_view,
    project,
)
from endolab.calibration.targets import TARGETS
from tests.tools.sheet_views import PAPER, WIDE, exact_centroids, pose_of

SHEET = TARGETS["vicalib_small"]
POSES = {
    "near": pose_of([0.5, -0.4, 0.2, -35, -20, 40]),
    "tilted": pose_of([0.9, 0.3, 1.5, 10, -40, 45]),
    "frontal": pose_of([0, 0, 0, -38, -19, 90]),
    "to the side": pose_of([0.1, -1.2, 0.1, 30, -20, -5]),
}
CASES = {
    f"paper {name}": (PAPER, pose) for name, pose in POSES.items() if name != "to the side"
}
CASES |= {f"wide {name}": (WIDE, pose) for name, pose in POSES.items()}


def spread(pose, count):
    return np.broadcast_to(pose.rotation, (count, 3, 3)), np.broadcast_to(
        pose.translation, (count, 3)
    )


def moved(pose, step):
    """Return the pose after a small turn, rad, about the target's origin and a shift, mm."""
    turn = Rotation.from_rotvec(step[:3]).as_matrix()
    return Pose(turn @ pose.rotation, pose.translation + step[3:])


def at(camera, pose, points, radii):
    return camera_vector(camera), *spread(pose, len(points)), points, radii


@pytest.mark.parametrize(
    "vector", [[0.3, -0.5, 0.2, 1, 2, 30], [0, np.pi - 1e-3, 0, 5, -5, 20]]
)
def test_a_poses_vector_comes_back(vector):
    assert pose_of(vector).vector == pytest.approx(vector, abs=1e-12)


@pytest.mark.parametrize(("camera", "pose"), CASES.values(), ids=CASES)
def test_corners_are_where_the_camera_projects_them(camera, pose):
    seen = camera.project(pose.transform(SHEET.points))
    known = np.isfinite(seen[:, 0])
    none = np.zeros(len(SHEET.points))
    assert known.sum() > 20
    assert predict(*at(camera, pose, SHEET.points, none))[known] == pytest.approx(
        seen[known], abs=1e-9
    )
    exact = project(*at(camera, pose, SHEET.points, none)).pixels
    assert exact[known] == pytest.approx(seen[known], abs=1e-9)


@pytest.mark.parametrize(("camera", "pose"), CASES.values(), ids=CASES)
def test_dots_are_seen_at_the_centroid_of_their_image(camera, pose):
    points = SHEET.points
    radii = SHEET.radii
    exact = exact_centroids(camera, pose, points, radii, rings=12, spokes=48)
    seen = predict(*at(camera, pose, points, radii))
    assert np.abs(seen - exact).max() < 2e-3
    assert np.median(np.abs(seen - exact)) < 1e-6


@pytest.mark.parametrize("discs", [True, False], ids=["discs", "corners"])
@pytest.mark.parametrize(("camera", "pose"), CASES.values(), ids=CASES)
def test_derivatives_are_those_of_finite_differences(camera, pose, discs):
    points = SHEET.points
    radii = SHEET.radii * discs
    vector = camera_vector(camera)
    n = len(points)
    exact = project(vector, *spread(pose, n), points, radii)
    for j in range(8):
        h = 1e-3 if j < 4 else 1e-5
        ahead, behind = (
            predict(vector + s * np.eye(8)[j], *spread(pose, n), points, radii)
            for s in (h, -h)
        )
        slope = (ahead - behind) / (2 * h)
        assert exact.by_camera[:, :, j] == pytest.approx(
            slope, abs=1e-6 * np.abs(slope).max()
        ), CAMERA_NAMES[j]
    for j, h in enumerate(1e-5 * np.eye(6)):
        ahead, behind = (
            predict(vector, *spread(moved(pose, s), n), points, radii) for s in (h, -h)
        )
        slope = (ahead - behind) / 2e-5
        assert exact.by_pose[:, :, j] == pytest.approx(
            slope, abs=1e-6 * np.abs(slope).max()
        ), j


@pytest.mark.parametrize("discs", [True, False], ids=["discs", "corners"])
def test_derivatives_hold_on_the_axis(discs):
    offsets = np.array(
        [[0.0, 0, 0], [1e-12, 0, 0], [1e-8, -1e-8, 0], [1e-4, 1e-4, 0], [0.05, 0, 0]]
    )
    radii = np.full(len(offsets), 1.2 * discs)
    pose = pose_of([0, 0, 0, 0, 0, 40.0])
    exact = project(*at(PAPER, pose, offsets, radii))
    assert np.all(np.isfinite(exact.by_camera))
    for j, h in enumerate(1e-5 * np.eye(6)):
        ahead, behind = (
            predict(*at(PAPER, moved(pose, s), offsets, radii)) for s in (h, -h)
        )
        assert exact.by_pose[:, :, j] == pytest.approx((ahead - behind) / 2e-5, abs=1e-5)


def test_what_is_beyond_the_camera_is_not_predicted():
    pose = pose_of([0, 0, 0, 0, 0, 40.0])
    points = np.array([[0.0, 0, 0], [40 * np.tan(np.radians(89.0)), 0, 0], [1e5, 0, 0]])
    assert PAPER.max_angle == pytest.approx(np.radians(90.8), abs=1e-3)
    assert np.all(np.isfinite(predict_view(PAPER, pose, points, np.zeros(3))))
    behind = pose_of([0, 1.8, 0, 0, 0, -1.0])
    assert np.isnan(predict_view(PAPER, behind, points, np.zeros(3))[0]).all()
