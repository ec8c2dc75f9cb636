from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab.calibration.detection.detect import Detection
from endolab.calibration.geometric.fit import calibrate_camera
from endolab.calibration.geometric.projection import camera_vector
from endolab.calibration.geometric.reprojection import View, find_pose, views_of
from tests.tools.sheet_views import (
    BROWN,
    PAPER,
    WIDE,
    make_views,
    map_error,
    random_pose,
    view_of,
)

SHEET = el.TARGETS["vicalib_small"]
CORNERS = el.TARGETS["charuco"]
SIZE = (PAPER.width, PAPER.height)


@pytest.fixture(scope="module")
def twenty():
    """Twenty views through the paper's camera, and their true poses."""
    return make_views(PAPER, SHEET, 20, np.random.default_rng(5))


@pytest.fixture(scope="module")
def fitted(twenty):
    return calibrate_camera(twenty[0], SHEET, *SIZE)


def turn_between(a, b):
    return np.arccos(np.clip((np.trace(a.rotation.T @ b.rotation) - 1) / 2, -1, 1))


def far_off(found, camera):
    """The largest error of the camera's numbers, in standard errors; k4 to k6 are 0, as given."""
    off = np.abs(camera_vector(found.camera) - camera_vector(camera))
    return np.max(off / (1e-15 + np.array(list(found.standard_errors.values()))))


def test_the_papers_camera_is_found_without_a_guess(twenty, fitted):
    assert (fitted.status, fitted.dropped) == (el.Status.CONVERGED, {})
    assert (fitted.camera.width, fitted.camera.height) == SIZE
    assert np.radians(75) < fitted.max_angle_seen < fitted.camera.max_angle
    off = camera_vector(fitted.camera) - camera_vector(PAPER)
    assert np.abs(off[:2]).max() < 0.15
    assert np.abs(off[2:4]).max() < 0.06
    assert far_off(fitted, PAPER) < 4.5
    assert fitted.sigma == pytest.approx(0.08, rel=0.04)
    assert fitted.rmse == pytest.approx(np.sqrt(2) * 0.08, rel=0.04)
    assert map_error(fitted.camera, PAPER, np.radians(68)).max() < 0.15
    for pose, true in zip(fitted.poses, twenty[1], strict=True):
        assert turn_between(pose, true) < np.radians(0.05)
        assert pose.translation == pytest.approx(true.translation, abs=0.05)


@pytest.mark.parametrize("shared", [0.0, 0.2])
def test_standard_errors_are_honest(shared):
    """Also where neighbours share a part of their error, px."""
    pulls = []
    for seed in range(5):
        random = np.random.default_rng(seed)
        how = {"noise": 0.05, "wrong": 0, "tilt": 45}
        views, _ = make_views(PAPER, CORNERS, 9, random, **how)
        for number, view in enumerate(views):
            waves = random.normal(0, 0.005, (2, 2)), random.uniform(0, 6, 2)
            error = shared * np.sin(view.pixels @ waves[0] + waves[1])
            views[number] = replace(view, pixels=view.pixels + error)
        found = calibrate_camera(views, CORNERS, *SIZE)
        off = camera_vector(found.camera) - camera_vector(PAPER)
        pulls.append(off / list(found.standard_errors.values()))
    assert 0.4 < np.mean(np.square(pulls)) < 1.6  # 40 numbers


PINHOLE_K = (1 / 3, 2 / 15, 17 / 315, 62 / 2835)
LENSES = {
    "190 degrees": WIDE,
    "laparoscope": el.KannalaBrandt(1920, 1080, 1770, 1772, 915, 459, PINHOLE_K),
    "pinhole": el.KannalaBrandt(1000, 800, 400, 400, 495, 405, PINHOLE_K),
    "capsule": el.KannalaBrandt(320, 320, 100, 99, 165, 150, (-0.1, 0.02, 0, 0)),
}


@pytest.mark.parametrize("name", LENSES)
def test_other_lenses_need_no_guess_either(name):
    camera = LENSES[name]
    near = 80 if name == "laparoscope" else 25  # mm
    views, _ = make_views(
        camera, CORNERS, 10, np.random.default_rng(2), near=near, far=3 * near
    )
    found = calibrate_camera(views, CORNERS, camera.width, camera.height)
    assert found.status is el.Status.CONVERGED
    assert far_off(found, camera) < 4.5
    seen = min(found.max_angle_seen, np.radians(70))
    # In a narrow field a shift of the centre and a turn of all poses are nearly the same.
    limit = 0.8 if near == 80 else 0.2
    assert map_error(found.camera, camera, 0.8 * seen).max() < limit


def test_a_brown_conrady_lens_is_told_from_a_fisheye_and_found():
    random = np.random.default_rng(4)
    views, _ = make_views(BROWN, CORNERS, 12, random, near=50, far=120)
    found = calibrate_camera(views, CORNERS, BROWN.width, BROWN.height, lens="auto")
    assert found.status is el.Status.CONVERGED
    assert found.held_out["brown"] < 0.9 * found.held_out["fisheye"]
    assert found.held_out["brown"] == pytest.approx(np.sqrt(2) * 0.08, rel=0.15)
    assert far_off(found, BROWN) < 4.5
    assert map_error(found.camera, BROWN, 0.9 * found.max_angle_seen).max() < 0.5


def test_the_papers_fisheye_is_told_from_a_brown_conrady_lens(twenty):
    found = calibrate_camera(twenty[0], SHEET, *SIZE, lens="auto")
    assert isinstance(found.camera, el.KannalaBrandt)


def mirror(view):
    """The view with the columns of its ids in the wrong order."""
    return replace(view, ids=view.ids // 19 * 19 + 18 - view.ids % 19)


def cut(view):
    return replace(view, ids=view.ids[:7], pixels=view.pixels[:7])


def test_views_that_are_wrong_are_named_and_dropped(twenty):
    views = list(twenty[0][:12])
    random = np.random.default_rng(0)
    shaken = views[7].pixels + random.normal(0, 3, views[7].pixels.shape)
    views[3] = replace(views[3], name="scrambled", ids=random.permutation(views[3].ids))
    views[5] = replace(mirror(views[5]), name="mirrored")
    views[7] = replace(views[7], name="shaken", pixels=shaken)
    views[9] = replace(cut(views[9]), name="short")
    found = calibrate_camera(views, SHEET, *SIZE)
    assert set(found.dropped) == {"scrambled", "mirrored", "shaken", "short"}
    assert "mirrored" in found.dropped["mirrored"]
    of_views = (found.views, found.poses, found.residuals, found.inliers)
    assert [len(values) for values in of_views] == [8, 8, 8, 8]
    assert abs(found.camera.fx - PAPER.fx) < 0.3


def test_a_third_of_wrong_points_is_survived_and_exact_ones_are_fitted_exactly():
    views, _ = make_views(PAPER, SHEET, 8, np.random.default_rng(6), wrong=0.3)
    found = calibrate_camera(views, SHEET, *SIZE)
    assert found.dropped == {}
    assert abs(found.camera.fx - PAPER.fx) < 0.4
    assert found.sigma == pytest.approx(0.08, rel=0.07)
    views, _ = make_views(PAPER, CORNERS, 6, np.random.default_rng(7), noise=0, wrong=0)
    found = calibrate_camera(views, CORNERS, *SIZE)
    assert (found.status, found.agreement) == (el.Status.CONVERGED, 1)
    assert found.rmse < 1e-4
    assert found.sigma == 0.03  # no detector is better
    assert camera_vector(found.camera) == pytest.approx(camera_vector(PAPER), abs=1e-3)


DISTANT = el.KannalaBrandt(640, 480, 2000.0, 2000.0, 320.0, 240.0)
TOLD_BY_NOBODY = {"near": 2000, "far": 2500, "tilt": 8, "noise": 0.5}  # no perspective
REFUSED = {
    "3 views": lambda views: (SHEET, views[:1]),
    "8 points": lambda views: (SHEET, [cut(view) for view in views[:4]]),
    "hardly moves": lambda views: (SHEET, [replace(views[0], name=n) for n in "abcde"]),
    "mirrored": lambda views: (SHEET, [mirror(view) for view in views[:4]]),
    "tilt the sheet": lambda views: made(PAPER, 6, 8, tilt=2),
    "do not tell f|square": lambda views: made(DISTANT, 4, 9, **TOLD_BY_NOBODY),
}


def made(camera, count, seed, **how):
    views, _ = make_views(camera, CORNERS, count, np.random.default_rng(seed), **how)
    return CORNERS, views


@pytest.mark.parametrize("word", REFUSED)
def test_views_that_do_not_tell_a_camera_are_refused(twenty, word):
    target, views = REFUSED[word](twenty[0])
    size = (640, 480) if "tell" in word else SIZE
    with pytest.raises(ValueError, match=word):
        calibrate_camera(views, target, *size)


@pytest.mark.parametrize("camera", [PAPER, WIDE], ids=["paper", "wide"])
def test_poses_are_found_and_wrong_points_with_them(camera):
    random = np.random.default_rng(11)
    for _ in range(6):
        true = random_pose(camera, SHEET, random, near=30)
        view = view_of(camera, SHEET, true, random, wrong=0)
        if len(view.ids) < 60:
            continue
        wrong = random.random(len(view.ids)) < 0.2
        ids = view.ids + 19 * wrong * random.choice([-2, -1, 1, 2], len(wrong))
        pose, inliers, _ = find_pose(replace(view, ids=ids % 190), SHEET, camera)
        assert turn_between(pose, true) < np.radians(0.1)
        assert pose.translation == pytest.approx(true.translation, abs=0.1)
        assert not inliers[wrong].any()
        assert inliers[~wrong].mean() > 0.97


def test_panels_are_views_of_their_own(rng):
    folded = el.TARGETS["vicalib_folded"]
    views = []
    for number in range(4):
        pose = random_pose(PAPER, folded, rng, near=40)
        whole = view_of(PAPER, folded, pose, rng, f"f{number}", wrong=0)
        views += views_of(whole.name, Detection(whole.ids, whole.pixels), folded)
    views[0] = replace(views[0], ids=rng.permutation(views[0].ids))
    found = calibrate_camera(views, folded, *SIZE)
    assert set(found.dropped) == {"f0, panel 0"}
    assert abs(found.camera.fx - PAPER.fx) < 1


def test_one_view_of_the_real_sheet_refines_a_start(data):
    path = data / "vicalib_frame/dots_detected.csv"
    column, row, *pixel = np.loadtxt(path, delimiter=",", skiprows=1).T[:4]
    view = View("real", 0, (19 * row + column).astype(int), np.column_stack(pixel))
    found = calibrate_camera([view], el.TARGETS["vicalib_big"], *SIZE, start=PAPER)
    assert all(inliers.all() for inliers in found.inliers)
    assert found.rmse < 0.14
    assert found.standard_errors["fx"] > 0.3  # one view tells little
