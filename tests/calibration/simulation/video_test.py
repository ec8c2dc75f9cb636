"""The simulated calibration video: geometry and light against brute force, and what a hand may do."""

from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab.calibration.geometric.pose import Pose
from endolab.calibration.simulation.sheet_image import (
    GAIN_RULES,
    Sensor,
    automatic_gain,
    render_sheet,
)
from endolab.calibration.simulation.trajectory import Movement, trajectory
from endolab.calibration.simulation.video import PAPER_SHEET, simulate_samples
from tests.tools.sheet_views import reflectance

FULL = el.load_calibration("paper").camera
CAMERA = FULL.resize(480, 360)
PAPER = el.Photometry(k=2.5, gamma=2.2, brdf=PAPER_SHEET)
FLAT = el.TARGETS["vicalib_small"]
FOLDED = el.TARGETS["vicalib_folded"]
CLEAN = Sensor(noise=0.0, bits=16)
TABLE = el.TabulatedBRDF((0.0, 0.5, 1.5), (0.3, 0.25, 0.1))
BESIDE = el.SpotLight((3.0, 0.0, 0.0), exponent=1.0)
# Frontal, the sheet's middle on the axis.
AHEAD = Pose(np.eye(3), np.array([-38.0, -19.0, 45.0]))


def meet(pose, rays):
    """Where rays meet the plane of a panel, in the camera's frame; nan behind."""
    with np.errstate(invalid="ignore", divide="ignore"):
        reach = (pose.translation @ pose.normal) / (rays @ pose.normal)
    return rays * np.where(reach > 0, reach, np.nan)[..., None]


def brute(
    target,
    poses,
    camera,
    photometry,
    rows,
    columns,
    sub=8,
):
    """Linear light of a window, each pixel the mean of sub × sub rays; black beside the paper."""
    r, c = ((np.arange(a * sub, b * sub) + 0.5) / sub - 0.5 for a, b in (rows, columns))
    rays = camera.unproject(np.stack(np.meshgrid(c, r), axis=-1))
    light = np.zeros(rays.shape[:2])
    for number, pose in enumerate(poses):
        points = meet(pose, rays)
        xy = (points - pose.translation) @ pose.rotation[:, :2]
        value = reflectance(target, xy)
        good = (
            np.isfinite(value)
            & (target.panel_of(xy) == number)
            & (rays @ pose.normal < 0)
        )
        normals = np.broadcast_to(pose.normal, points[good].shape)
        light[good] = (
            value[good]
            * photometry.intensity(points[good], normals) ** photometry.gamma
        )
    h, w = light.shape
    return light.reshape(h // sub, sub, w // sub, sub).mean(axis=(1, 3))


@pytest.mark.parametrize(
    ("target", "fold", "photometry"),
    [
        (FLAT, 0.0, PAPER),
        (FOLDED, 0.6, PAPER),
        (el.TARGETS["vicalib_grey"], 0.0, replace(PAPER, brdf=TABLE)),
        (el.TARGETS["charuco"], 0.0, replace(PAPER, lights=(BESIDE,))),
    ],
    ids=["flat", "folded", "grey, table", "charuco, off-centre light"],
)
def test_a_picture_is_the_brute_force_average(target, fold, photometry):
    poses = trajectory(target, CAMERA, 5, Movement(fold, (30.0, 60.0)), seed=2)[1]
    frame = render_sheet(
        target,
        poses,
        CAMERA,
        photometry,
        CLEAN,
    )
    x = target.fold_x or target.points[:, 0].mean()
    middle = CAMERA.project(poses[0].transform([x, 19.0, 0.0]))
    column, row = np.clip(middle, 35, np.array([480, 360]) - 35).astype(int)
    rows = (row - 30, row + 30)
    columns = (column - 30, column + 30)
    known = replace(photometry, gain=frame.gain)
    truth = np.clip(brute(target, poses, CAMERA, known, rows, columns), 0.0, 1.0)
    found = frame.image[slice(*rows), slice(*columns)]
    assert truth.max() > 0.1
    error = found**photometry.gamma - truth
    assert abs(error.mean()) < 2e-3 * truth.mean()
    assert np.sqrt(np.mean(error**2)) < 0.02
    even = np.abs(truth ** (1 / photometry.gamma) - found) < 0.1 / 255
    assert even.mean() > 0.3  # where nothing printed passes through the pixel


def test_noise_rounding_and_spots_are_as_asked():
    def seen(sensor, seed=0):
        return render_sheet(FLAT, [AHEAD], CAMERA, PAPER, sensor, seed=seed).image

    clean = seen(CLEAN)
    noisy = seen(replace(CLEAN, noise=3.0))
    grey = (clean > 0.2) & (clean < 0.8)
    assert np.std((noisy - clean)[grey]) * 255 == pytest.approx(3.0, rel=0.02)
    assert not np.array_equal(noisy, seen(replace(CLEAN, noise=3.0), seed=1))
    coarse = seen(replace(CLEAN, bits=8))
    np.testing.assert_allclose(coarse * 255, np.round(coarse * 255), atol=1e-9)
    assert np.abs(coarse - clean).max() <= 0.5001 / 255
    spotted = seen(replace(CLEAN, outliers=0.015))
    paper = clean**2.2 > 0.1
    assert 0.008 < np.mean(np.abs(spotted - clean)[paper] > 0.02) < 0.022


@pytest.mark.parametrize(
    "fold",
    [0.0, 0.05, 1.2],
)
def test_panels_share_the_fold_and_turn_away(fold):
    ridge = np.array([[FOLDED.fold_x, y, 0.0] for y in (0.0, 38.0)])
    for left, right in trajectory(FOLDED, CAMERA, 30, Movement(fold)):
        np.testing.assert_allclose(
            left.transform(ridge), right.transform(ridge), atol=1e-9
        )
        assert left.normal @ right.normal == pytest.approx(np.cos(fold), abs=1e-12)
        # Convex: each panel lies behind the plane of the other, seen from where the sheet is read.
        tip = right.transform([[76.0, 19.0, 0.0]])
        assert np.all((tip - left.translation) @ left.normal <= 1e-9)


def test_a_hand_goes_everywhere_and_smoothly():
    poses = [pose for (pose,) in trajectory(FLAT, FULL, 300)]
    centres = np.array([pose.transform([38.0, 19.0, 0.0]) for pose in poses])
    assert centres[:, 2].min() == pytest.approx(25, abs=3)
    assert centres[:, 2].max() == pytest.approx(100, abs=3)
    tilts = np.rad2deg([pose.tilt for pose in poses])
    assert tilts.min() < 10
    assert 45 < tilts.max() <= 55 + 1e-6
    assert np.linalg.norm(np.diff(centres, axis=0), axis=1).max() < 12
    turn = np.diff([pose.rotation for pose in poses], axis=0)
    assert np.linalg.norm(turn, axis=(1, 2)).max() < 0.3 * np.sqrt(2)  # about rad


def test_the_gain_follows_the_distance_within_its_range():
    poses = trajectory(FLAT, CAMERA, 300)
    gains = automatic_gain(
        FLAT,
        poses,
        CAMERA,
        PAPER,
    )
    depth = [pose.transform([38.0, 19.0, 0.0])[2] for (pose,) in poses]
    assert 2.0 < gains.max() / gains.min() <= GAIN_RULES.largest_ratio * (1 + 1e-9)
    assert np.corrcoef(np.log(gains), np.log(depth))[0, 1] > 0.7
    # It lags.
    assert np.abs(np.diff(np.log(gains))).max() < np.log(GAIN_RULES.largest_ratio) / 3
    locked = automatic_gain(
        FLAT,
        poses,
        CAMERA,
        PAPER,
        locked=True,
    )
    assert np.ptp(locked) == 0
    assert gains.min() < locked[0] < gains.max()


def test_samples_obey_the_model():
    target = el.TARGETS["vicalib_grey"]
    samples, gains = simulate_samples(
        target,
        FULL,
        PAPER,
        40,
        sensor=CLEAN,
    )
    level = replace(PAPER, gain=1.0).intensity(samples.points, samples.normals)
    known = gains[samples.frame] * np.where(samples.material == 1, 0.5, 1.0)
    level = np.clip(level * known ** (1 / 2.2), 0, 1)
    np.testing.assert_allclose(samples.level, level, atol=1e-5)
    assert set(samples.material) == {0, 1}
    assert np.array_equal(np.unique(samples.frame), np.arange(40))
    pixels = FULL.project(samples.points)
    assert np.all((pixels >= 0) & (pixels <= [1439, 1079]))
