"""The simulated calibration video: geometry and light against brute force, and what a hand may do."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab.calibration.geometric.pose import Pose
from endolab.calibration.simulation.sheet_image import GAIN_RANGE, WHITE, automatic_gain, render_sheet
from endolab.calibration.simulation.trajectory import trajectory
from endolab.calibration.simulation.video import PAPER_SHEET, simulate_samples, simulate_video
from tests.tools.sheet_views import exact_centroids

FULL = el.load_calibration("paper").camera
CAMERA, LARGE = FULL.resize(480, 360), FULL.resize(960, 720)
PAPER = el.Photometry(k=2.5, gamma=2.2, brdf=PAPER_SHEET)
FLAT, FOLDED = el.TARGETS["vicalib_small"], el.TARGETS["vicalib_folded"]
CLEAN = {"noise": 0.0, "bits": 16}
AHEAD = Pose(np.eye(3), np.array([-38.0, -19.0, 45.0]))  # frontal, the sheet's middle on the axis


def meet(pose, rays):
    """Where rays meet the plane of a panel, in the camera's frame; nan behind."""
    with np.errstate(invalid="ignore", divide="ignore"):
        reach = (pose.translation @ pose.normal) / (rays @ pose.normal)
    return rays * np.where(reach > 0, reach, np.nan)[..., None]


def brute(target, poses, camera, photometry, rows, columns, sub=8):
    """Linear light of a window, each pixel the mean of sub × sub rays; black beside the paper."""
    r, c = ((np.arange(a * sub, b * sub) + 0.5) / sub - 0.5 for a, b in (rows, columns))
    rays = camera.unproject(np.stack(np.meshgrid(c, r), axis=-1))
    light = np.zeros(rays.shape[:2])
    for number, pose in enumerate(poses):
        points = meet(pose, rays)
        xy = (points - pose.translation) @ pose.rotation[:, :2]
        value = target.reflectance(xy)
        good = np.isfinite(value) & (target.panel_of(xy) == number) & (rays @ pose.normal < 0)
        normals = np.broadcast_to(pose.normal, points[good].shape)
        light[good] = value[good] * photometry.intensity(points[good], normals) ** photometry.gamma
    h, w = light.shape
    return light.reshape(h // sub, sub, w // sub, sub).mean(axis=(1, 3))


@pytest.mark.parametrize(
    ("target", "fold", "photometry"),
    [
        (FLAT, 0.0, PAPER),
        (FOLDED, 0.6, PAPER),
        (el.TARGETS["vicalib_grey"], 0.0, PAPER),
        (el.TARGETS["charuco"], 0.0, PAPER),
        (FLAT, 0.0, replace(PAPER, brdf=el.TabulatedBRDF((0.0, 0.5, 1.5), (0.3, 0.25, 0.1)))),
        (FLAT, 0.0, replace(PAPER, k=1.0, lights=(el.SpotLight((3.0, 0.0, 0.0), exponent=1.0),))),
    ],
    ids=["flat", "folded", "grey", "charuco", "table", "off-centre light"],
)
def test_a_picture_is_the_brute_force_average(target, fold, photometry):
    poses = trajectory(target, CAMERA, 5, fold=fold, distance=(30.0, 60.0), seed=2)[1]
    frame = render_sheet(target, poses, CAMERA, photometry, **CLEAN)
    middle = CAMERA.project(poses[0].transform([target.fold_x or target.points[:, 0].mean(), 19.0, 0.0]))
    column, row = (int(np.clip(value, 35, side - 35)) for value, side in zip(middle, (480, 360), strict=True))
    rows, columns = (row - 30, row + 30), (column - 30, column + 30)
    known = replace(photometry, gain=frame.gain)
    truth = np.clip(brute(target, poses, CAMERA, known, rows, columns), 0.0, 1.0)
    found = frame.image[slice(*rows), slice(*columns)] ** photometry.gamma
    assert truth.max() > 0.1
    error = found - truth
    assert abs(error.mean()) < 2e-3 * truth.mean()
    assert np.sqrt(np.mean(error**2)) < 0.02
    even = np.abs(truth ** (1 / photometry.gamma) - frame.image[slice(*rows), slice(*columns)]) < 0.1 / 255
    assert even.mean() > 0.3  # where nothing printed passes through the pixel


@pytest.mark.parametrize(("target", "fold"), [(FLAT, 0.0), (FOLDED, 0.5)])
def test_discs_lie_where_the_pose_puts_them(target, fold):
    poses = trajectory(target, LARGE, 3, fold=fold, distance=(35.0, 60.0), tilt=0.7, seed=1)[1]
    known = replace(PAPER, gain=automatic_gain(target, [poses], LARGE, PAPER)[0] / 4)  # no saturation
    # Ink against none at all: what is left is how much of each pixel the disc covers.
    how = ({**CLEAN, "black": black} for black in (0.0, 0.9999))
    inked, bare = (render_sheet(target, poses, LARGE, known, **each).image ** 2.2 for each in how)
    cover = 1 - inked / np.where(bare > 1e-6, bare, np.inf) - (bare <= 1e-6)
    errors, turn = [], np.linspace(0, 2 * np.pi, 49)
    for index in range(0, len(target.points), 5):
        pose, point = poses[target.panel_of(target.points[index])], target.points[index]
        radius = target.radii[index]
        (truth,) = exact_centroids(LARGE, pose, point[None], target.radii[index : index + 1])
        rim = pose.transform(point + radius * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=-1))
        half = int(np.ptp(LARGE.project(rim), axis=0).max() / 2) + 4
        column, row = np.round(truth).astype(int)
        if not (half < column < 959 - half and half < row < 719 - half):
            continue
        dv, du = np.mgrid[-half : half + 1, -half : half + 1]
        near = meet(pose, LARGE.unproject(np.stack([column + du, row + dv], axis=-1)))
        away = np.linalg.norm(near - pose.transform(point), axis=-1)
        window = cover[row - half : row + half + 1, column - half : column + half + 1]
        window = np.where(away < 1.2 * radius + 0.2, window, 0)
        found = np.array([(window * du).sum(), (window * dv).sum()]) / window.sum() + [column, row]
        errors.append(found - truth)
    assert len(errors) >= 15
    assert np.hypot(*np.transpose(errors)).max() < 0.02
    assert np.all(np.abs(np.mean(errors, axis=0)) < 0.005)


def test_a_sheet_behind_the_camera_or_seen_from_behind_leaves_no_trace():
    known = replace(PAPER, gain=5000.0)
    for turn, place in (([1.0, 1.0, 1.0], [-38.0, -19.0, -45.0]), ([-1.0, 1.0, -1.0], [38.0, -19.0, 45.0])):
        pose = Pose(np.diag(turn), np.array(place))
        assert render_sheet(FLAT, [pose], CAMERA, known, **CLEAN).image.max() < 0.3  # the dark cloth at most


def test_each_option_does_what_it_says():
    clean = render_sheet(FLAT, [AHEAD], CAMERA, PAPER, **CLEAN).image
    x, y, _ = FLAT.white_places()[0]
    column, row = np.round(CAMERA.project(AHEAD.transform([x, y, 0.0]))).astype(int)
    noisy, again = (
        render_sheet(FLAT, [AHEAD], CAMERA, PAPER, noise=3.0, bits=16, seed=n).image for n in (0, 1)
    )
    grey = (clean > 0.2) & (clean < 0.8)
    assert np.std((noisy - clean)[grey]) * 255 == pytest.approx(3.0, rel=0.02)
    assert not np.array_equal(noisy, again)
    coarse = render_sheet(FLAT, [AHEAD], CAMERA, PAPER, noise=0.0, bits=8).image
    np.testing.assert_allclose(coarse * 255, np.round(coarse * 255), atol=1e-9)
    assert np.abs(coarse - clean).max() <= 0.5001 / 255
    linear = clean**2.2
    for options in ({"blur": 2.0}, {"motion": 9.0}):
        soft = render_sheet(FLAT, [AHEAD], CAMERA, PAPER, **CLEAN, **options).image ** 2.2
        assert soft[40:-40, 40:-40].sum() == pytest.approx(linear[40:-40, 40:-40].sum(), rel=1e-3)
        assert np.abs(np.diff(soft, axis=1)).sum() < 0.9 * np.abs(np.diff(linear, axis=1)).sum()

    spotted = render_sheet(FLAT, [AHEAD], CAMERA, PAPER, **CLEAN, outliers=0.015).image
    paper = linear > 0.1
    assert 0.008 < np.mean(np.abs(spotted - clean)[paper] > 0.02) < 0.022
    over = render_sheet(FLAT, [AHEAD], CAMERA, replace(PAPER, gain=1e5), **CLEAN).image
    assert over.max() == over[row, column] == 1.0


def test_an_unknown_gain_puts_the_white_near_its_level():
    frame = render_sheet(FLAT, [AHEAD], CAMERA, PAPER, **CLEAN)
    assert np.quantile(frame.image[frame.image > 0.4], 0.8) == pytest.approx(WHITE, abs=0.05)
    known = render_sheet(FLAT, [AHEAD], CAMERA, replace(PAPER, gain=frame.gain), **CLEAN)
    np.testing.assert_array_equal(frame.image, known.image)
    assert known.gain == frame.gain


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"seed": 1.5}, "seed must be a whole number of at least 0, got 1.5"),
        ({"noise": -1.0}, "noise must be finite and at least 0, got -1"),
        ({"blur": np.inf}, r"blur must lie in \[0, 480\], got inf"),
        ({"motion": np.nan}, r"motion must lie in \[0, 480\], got nan"),
        ({"outliers": 1.0}, "outliers must be from 0 to below 1"),
        ({"black": -0.1}, "black must be from 0 to below 1"),
        ({"bits": 0}, "bits must be from 1 to 16, got 0"),
    ],
)
def test_wrong_options_of_a_picture_are_named(options, complaint):
    with pytest.raises(ValueError, match=complaint):
        render_sheet(FLAT, [AHEAD], CAMERA, PAPER, **options)


def test_a_folded_sheet_needs_two_poses_and_no_gain_suits_a_sheet_out_of_sight():
    with pytest.raises(ValueError, match="one for each of 2 panels, got 1"):
        render_sheet(FOLDED, [AHEAD], CAMERA, PAPER)
    with pytest.raises(ValueError, match="the sheet is in none of the frames"):
        render_sheet(FLAT, [Pose(np.eye(3), np.array([900.0, 0.0, 45.0]))], CAMERA, PAPER)


@pytest.mark.parametrize("fold", [0.0, 0.05, 0.5, 1.2])
def test_panels_share_the_fold_and_turn_away(fold):
    ridge = np.array([[FOLDED.fold_x, y, 0.0] for y in (0.0, 38.0)])
    for left, right in trajectory(FOLDED, CAMERA, 30, fold=fold):
        np.testing.assert_allclose(left.transform(ridge), right.transform(ridge), atol=1e-9)
        assert left.normal @ right.normal == pytest.approx(np.cos(fold), abs=1e-12)
        for pose in (left, right):
            np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-12)
            assert np.linalg.det(pose.rotation) == pytest.approx(1)
        # Convex: each panel lies behind the plane of the other, seen from where the sheet is read.
        tip = right.transform([[76.0, 19.0, 0.0]])
        assert np.all((tip - left.translation) @ left.normal <= 1e-9)


def test_a_hand_goes_everywhere_and_smoothly_and_can_be_held_back():
    frames = trajectory(FLAT, FULL, 300)
    poses = [frame[0] for frame in frames]
    centres = np.array([pose.transform([38.0, 19.0, 0.0]) for pose in poses])
    assert centres[:, 2].min() == pytest.approx(25, abs=3)
    assert centres[:, 2].max() == pytest.approx(100, abs=3)
    tilts = np.array([pose.tilt for pose in poses])
    assert np.deg2rad(45) < tilts.max() <= np.deg2rad(55) + 1e-9
    assert tilts.min() < np.deg2rad(10)
    roll = np.array([np.arctan2(pose.rotation[1, 0], pose.rotation[0, 0]) for pose in poses])
    assert np.ptp(roll) > 5
    assert np.linalg.norm(np.diff(centres, axis=0), axis=1).max() < 12
    turns = [np.arccos((np.trace(a.rotation.T @ b.rotation) - 1) / 2) for a, b in itertools.pairwise(poses)]
    assert max(turns) < 0.3
    for (pose,) in trajectory(FLAT, CAMERA, 40, tilt=0.0, distance=(50.0, 50.0)):
        np.testing.assert_allclose(pose.normal, [0, 0, -1], atol=1e-12)
        assert pose.transform([38.0, 19.0, 0.0])[2] == pytest.approx(50)
    tilts = [pose.tilt for (pose,) in trajectory(FLAT, CAMERA, 40, tilt=0.1)]
    assert 0.05 < max(tilts) <= 0.1 + 1e-9


@pytest.mark.parametrize(
    ("name", "seen"), [("vicalib_big", None), ("charuco", 0.6), ("circles", None), ("chessboard", None)]
)
def test_enough_of_the_sheet_is_in_the_picture(name, seen):
    target = el.TARGETS[name]
    least = seen or (1.0 if name in ("circles", "chessboard") else 0.25)
    for (pose,) in trajectory(target, CAMERA, 60, seen=seen, distance=(40.0, 100.0), seed=3):
        pixels = CAMERA.project(pose.transform(target.points))
        inside = np.all((pixels >= 0) & (pixels <= [479, 359]), axis=1)
        assert inside.mean() >= least


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"count": 0}, "count must be at least 1, got 0"),
        ({"distance": (50.0, 20.0)}, "distance must be two growing positive numbers"),
        ({"distance": (0.0, 20.0)}, "distance must be two"),
        ({"tilt": 2.0}, "tilt must be from 0 to 1.4 rad, got 2"),
        ({"reach": -0.1}, "reach must be from 0"),
        ({"fold": 0.2}, "fold needs a target that has a fold"),
        ({"fold": -0.2}, "fold must be from 0"),
        ({"seen": 1.5}, "seen must be a share from 0 to 1"),
    ],
)
def test_wrong_options_of_a_motion_are_named(options, complaint):
    with pytest.raises(ValueError, match=complaint):
        trajectory(FLAT, CAMERA, **({"count": 5} | options))


def test_the_gain_follows_the_distance_within_its_range():
    poses = trajectory(FLAT, CAMERA, 300)
    gains = automatic_gain(FLAT, poses, CAMERA, PAPER)
    depth = [pose.transform([38.0, 19.0, 0.0])[2] for (pose,) in poses]
    assert 2.0 < gains.max() / gains.min() <= GAIN_RANGE * (1 + 1e-9)
    assert np.corrcoef(np.log(gains), np.log(depth))[0, 1] > 0.7
    assert np.abs(np.diff(np.log(gains))).max() < np.log(GAIN_RANGE) / 3  # it lags
    locked = automatic_gain(FLAT, poses, CAMERA, PAPER, locked=True)
    assert np.ptp(locked) == 0
    assert gains.min() < locked[0] < gains.max()


def test_a_video_is_its_trajectory_rendered():
    options = {"fold": 0.4, "distance": (30.0, 70.0), "tilt": 0.5, "reach": 0.3, "seen": 0.5}
    frames = list(simulate_video(FOLDED, CAMERA, PAPER, 4, **options, blur=0.5, seed=7))
    poses = trajectory(FOLDED, CAMERA, 4, **options, seed=7)
    gains = automatic_gain(FOLDED, poses, CAMERA, PAPER)
    for number, frame in enumerate(frames):
        assert (frame.image.shape, frame.gain) == ((360, 480), gains[number])
        for a, b in zip(frame.poses, poses[number], strict=True):
            np.testing.assert_array_equal(a.vector, b.vector)
    clean = render_sheet(FOLDED, poses[2], CAMERA, replace(PAPER, gain=gains[2]), **CLEAN, blur=0.5).image
    assert np.std(frames[2].image - clean) < 4 / 255
    assert all(np.std(frame.image - frames[0].image) > 0 for frame in frames[1:])


def test_samples_obey_the_model_and_lie_on_their_panels():
    target = el.TARGETS["vicalib_grey"]
    samples, gains = simulate_samples(target, FULL, PAPER, 40, noise=0.0, bits=16, outliers=0.0)
    linear = replace(PAPER, gain=1.0).intensity(samples.points, samples.normals) ** 2.2 * gains[samples.frame]
    linear = linear * np.where(samples.material == 1, 0.5, 1.0)
    np.testing.assert_allclose(samples.level, np.clip(linear ** (1 / 2.2), 0, 1), atol=1e-5)
    assert set(samples.material) == {0, 1}
    assert gains.shape == (40,)
    assert np.array_equal(np.unique(samples.frame), np.arange(40))
    pixels = FULL.project(samples.points)
    assert np.all((pixels >= 0) & (pixels <= [1439, 1079]))
    assert samples.cos_theta.min() > 0
    poses = trajectory(FOLDED, FULL, 20, fold=0.5, seed=4)
    samples, _ = simulate_samples(FOLDED, FULL, PAPER, 20, fold=0.5, seed=4)
    for number, frame in enumerate(poses):
        here = samples[samples.frame == number]
        heights = np.stack([(here.points - pose.translation) @ pose.normal for pose in frame])
        agree = np.stack([np.all(np.abs(here.normals - pose.normal) < 1e-12, axis=1) for pose in frame])
        assert np.all(agree.sum(axis=0) == 1)
        np.testing.assert_allclose(heights[agree], 0, atol=1e-9)


def test_noise_outliers_and_saturation_of_samples():
    options = {"distance": (60.0, 100.0), "seed": 5}
    clean, gains = simulate_samples(FLAT, FULL, PAPER, 100, noise=0.0, bits=16, outliers=0.0, **options)
    noisy, same = simulate_samples(FLAT, FULL, PAPER, 100, outliers=0.0, **options)
    np.testing.assert_array_equal(gains, same)
    np.testing.assert_array_equal(clean.points, noisy.points)
    error = 255 * (noisy.level - clean.level)[(clean.level > 0.1) & (clean.level < 0.9)]
    assert np.std(error) == pytest.approx(np.hypot(3.0, 12**-0.5), rel=0.03)
    assert abs(error.mean()) < 0.12
    np.testing.assert_allclose(noisy.level * 255, np.round(noisy.level * 255), atol=1e-9)
    wild, _ = simulate_samples(FLAT, FULL, PAPER, 100, outliers=0.1, **options)
    assert np.mean(np.abs(wild.level - clean.level) > 12 / 255) == pytest.approx(0.1 * 0.93, rel=0.15)
    near, _ = simulate_samples(FLAT, FULL, PAPER, 100)
    assert 0.005 < np.mean(near.level == 1) < 0.2
    assert np.bincount(near.frame).max() == 100


def test_a_whole_video_samples_the_angles_that_calibration_needs():
    samples, _ = simulate_samples(FLAT, FULL, PAPER)
    alpha, theta = np.rad2deg(np.arccos(samples.cos_alpha)), np.rad2deg(np.arccos(samples.cos_theta))
    assert np.histogram(alpha, np.arange(0, 61, 10))[0].min() > 300
    assert np.histogram(theta, np.arange(0, 71, 10))[0].min() > 300
    assert len(samples) > 20_000


def test_paper_is_brightest_when_seen_straight_on():
    cosine = np.cos(np.linspace(0, np.pi / 2, 200))
    value = PAPER_SHEET.value(cosine, cosine)
    assert np.all(np.diff(value) <= 0)
    assert value[-1] > 0
    assert 1.2 < value[0] / value[-1] < 1.35
    assert PAPER.slant_table() is not None
