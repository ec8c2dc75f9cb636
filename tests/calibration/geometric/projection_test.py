import numpy as np
import pytest

from endolab.calibration.geometric.projection import (
    camera_vector,
    predict_view,
    project,
)
from endolab.calibration.targets import TARGETS
from tests.tools.sheet_views import BROWN, PAPER, WIDE, exact_centroids, pose_of

SHEET = TARGETS["vicalib_small"]
POSES = {
    "near": pose_of([0.5, -0.4, 0.2, -35, -20, 40]),
    "tilted": pose_of([0.9, 0.3, 1.5, 10, -40, 45]),
    "frontal": pose_of([0, 0, 0, -38, -19, 90]),
    "to the side": pose_of([0.1, -1.2, 0.1, 30, -20, -5]),
}
CASES = {
    f"paper {name}": (PAPER, pose)
    for name, pose in POSES.items()
    if name != "to the side"
}
CASES |= {f"brown {name}": (BROWN, POSES[name]) for name in ("near", "frontal")}
CASES |= {f"wide {name}": (WIDE, pose) for name, pose in POSES.items()}


def see(camera, pose, points, radii):
    """What a camera, or its vector, sees of the points of a panel."""
    vector = camera if isinstance(camera, np.ndarray) else camera_vector(camera)
    return project(vector, pose.vector[None], np.zeros(len(points), int), points, radii)


def check_derivatives(camera, pose, points, radii, atol=0.0):
    """Hold derivatives against finite differences, along random directions."""
    _, by_camera, by_pose = see(camera, pose, points, radii)
    vector = camera_vector(camera)
    rng = np.random.default_rng(0)
    for _ in range(8):
        step = np.where(np.arange(len(vector)) < 4, 1e-3, 1e-6)
        step *= rng.normal(size=len(vector))
        turn = 1e-6 * rng.normal(size=6)
        ahead, _, _ = see(vector + step, pose_of(pose.vector + turn), points, radii)
        back, _, _ = see(vector - step, pose_of(pose.vector - turn), points, radii)
        slope = (ahead - back) / 2
        limit = 1e-6 * np.abs(slope).max() + 1e-6 * atol
        assert by_camera @ step + by_pose @ turn == pytest.approx(slope, abs=limit)


@pytest.mark.parametrize(("camera", "pose"), CASES.values(), ids=CASES)
def test_dots_are_seen_at_the_centroid_of_their_image_and_corners_where_they_are(
    camera, pose
):
    sheet = SHEET.points, SHEET.radii
    exact = exact_centroids(camera, pose, *sheet, rings=12, spokes=48)
    off = np.abs(see(camera, pose, *sheet)[0] - exact)
    assert off.max() < 2e-3
    assert np.median(off) < 1e-6
    corners = camera.project(pose.transform(SHEET.points))
    known = np.isfinite(corners[:, 0])
    found = see(camera, pose, SHEET.points, 0 * SHEET.radii)[0]
    assert found[known] == pytest.approx(corners[known], abs=1e-9)


@pytest.mark.parametrize("discs", [True, False], ids=["discs", "corners"])
@pytest.mark.parametrize("name", [*CASES, "axis"])
def test_derivatives_are_those_of_finite_differences(name, discs):
    if name == "axis":
        points = np.zeros((5, 3))
        points[1:, 0] = 1e-12, 1e-8, 1e-4, 0.05
        points[2:4, 1] = -1e-8, 1e-4
        pose = pose_of([0, 0, 0, 0, 0, 40.0])
        check_derivatives(PAPER, pose, points, np.full(5, 1.2 * discs), 1e-5)
    else:
        check_derivatives(*CASES[name], SHEET.points, SHEET.radii * discs)


def test_what_is_beyond_the_camera_is_not_predicted():
    points, radii = np.zeros((1, 3)), np.zeros(1)
    ahead, behind = pose_of([0, 0, 0, 0, 0, 40.0]), pose_of([0, 1.8, 0, 0, 0, -1.0])
    assert np.isfinite(predict_view(PAPER, ahead, points, radii)).all()
    assert np.isnan(predict_view(PAPER, behind, points, radii)).all()
    assert predict_view(PAPER, ahead, points[:0], radii[:0]).shape == (0, 2)
