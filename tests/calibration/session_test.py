"""A calibration from end to end, on pictures in memory."""

from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.calibration.session import (
    LEFT_OUT,
    calibrate,
    detect_all,
    locate,
)
from endolab.calibration.simulation.video import PAPER_SHEET, simulate_video
from endolab.calibration.summary import evidence
from endolab.calibration.targets import Chessboard
from tests.tools.simulated_session import simulated

CAMERA = datasets.load_calibration("paper", width=480).camera
SIZE = CAMERA.width, CAMERA.height
LIGHT = el.Photometry(2.5, 2.2, None, PAPER_SHEET)
SHEET = el.TARGETS["vicalib_small"]


@pytest.fixture(scope="module")
def video():
    """Frames of a flat sheet, in colour, their names and truth; and what was detected in them."""
    how = {"distance": (25, 60), "noise": 1.0}
    truth = list(simulate_video(SHEET, CAMERA, LIGHT, 18, **how))
    colour = np.array([1.0, 0.8, 0.6])  # of the sensor's channels, in linear light
    frames = [
        (f"{n}.png", f.image[..., None] * colour ** (1 / 2.2))
        for n, f in enumerate(truth)
    ]
    detections, size = detect_all(frames, SHEET)
    assert size == SIZE
    return frames, truth, detections


def test_camera_poses_and_light_come_back(video):
    frames, truth, detections = video
    done = calibrate(frames, SHEET, detections=detections, size=SIZE, channel="green")
    assert abs(done.camera.fx - CAMERA.fx) < 0.1
    assert done.geometry.rmse < 0.08
    for name, (pose,) in done.poses.items():
        true = truth[int(name.split(".")[0])].poses[0]
        assert np.linalg.norm(pose.translation - true.translation) < 0.1  # mm
    assert abs(done.light.k - 2.5) < 4 * done.light.standard_errors["k"] + 0.005
    # Noise and rounding, grey levels.
    assert abs(done.light.sigma - 1.04 * 0.8 ** (1 / 2.2)) < 0.06


def test_frames_that_are_left_out_count_for_nothing(video):
    """Frames that lie are left out; the camera is that of the others alone."""
    frames, _, detections = video
    liars = [name for name in detections if len(detections[name].ids)][:2]
    mixed = dict(detections)
    for name in liars:
        mixed[name] = replace(mixed[name], pixels=mixed[name].pixels * 1.1)
    how = {"detections": mixed, "size": SIZE}
    found = calibrate(frames, SHEET, leave_out=liars, **how)
    assert abs(found.camera.fx - CAMERA.fx) < 0.1
    assert [found.dropped[name] for name in liars] == [LEFT_OUT.reason] * 2
    assert not set(liars) & (set(found.poses) | set(found.errors))
    with pytest.raises(ValueError, match="none"):
        calibrate(frames, SHEET, leave_out=["none"], **how)


def test_frames_that_can_be_read_once_are_enough(video):
    frames = video[0][:3]
    several, once = (
        calibrate(given, SHEET, camera=CAMERA).samples
        for given in (frames, iter(frames))
    )
    assert len(once) == len(several) > 0


def test_a_known_camera_is_kept(video):
    frames, _, detections = video
    few = {name: detections[name] for name in list(detections)[:6]}
    found = calibrate(frames, SHEET, camera=CAMERA, detections=few, size=SIZE)
    assert (found.geometry, found.camera) == (None, CAMERA)
    assert set(found.poses) | set(found.dropped) == set(few)
    with pytest.raises(ValueError, match="500x360"):
        calibrate(frames, SHEET, camera=replace(CAMERA, width=500))


@pytest.mark.parametrize(
    ("expose", "word", "gamma"),
    [
        (np.zeros_like, "dark nor saturated", 2.2),
        (lambda image: np.full_like(image, 0.5), "lit room", 2.2),
        (lambda image: np.where(image < 0.25, 0.0, 1.0), "too large for a lamp", 2.2),
        (lambda image: ValueError("lost"), "samples", 2.2),
        (np.asarray, "gamma", "free"),
    ],
    ids=["dark", "even", "black and white", "lost", "gamma sought"],
)
def test_a_light_that_cannot_be_fitted_leaves_the_camera(video, expose, word, gamma):
    frames, _, detections = video
    bad = [(name, expose(image)) for name, image in frames]
    found = calibrate(bad, SHEET, detections=detections, size=SIZE, gamma=gamma)
    assert found.light is None
    assert word in found.refused
    assert abs(found.camera.fx - CAMERA.fx) < 0.1
    assert evidence(found)["photometry"] == {"refused": found.refused, "nominal": True}


def test_frames_of_another_size_are_named_and_those_left_out_stop_nothing(video):
    frames, _, _ = video
    others = [("small.png", np.zeros((90, 120))), ("broken.png", ValueError("lost"))]
    for mixed in (others + frames[:1], frames[:1] + others):
        found, size = detect_all(mixed, SHEET, leave_out=[name for name, _ in others])
        assert (size, len(found[frames[0][0]].ids) > 0) == (SIZE, True)
        with pytest.raises(ValueError, match=r"(0|small)\.png is .*--leave-out"):
            detect_all(mixed, SHEET)


def test_what_is_seen_instead_is_said():
    """A board of another size by that size, too few views by what became of the others."""
    board = np.kron(np.indices((7, 10)).sum(axis=0) % 2 * 0.8 + 0.1, np.ones((40, 40)))
    frames = [(f"{n}.png", np.pad(board, 60, constant_values=0.9)) for n in range(2)]
    for board in ("chessboard", "charuco"):
        message = rf"no {board} of 12×8 squares.*chessboard:10x7:SIZE"
        with pytest.raises(ValueError, match=message):
            calibrate(frames, el.TARGETS[board])
    with pytest.raises(ValueError, match="part"):
        calibrate(frames, SHEET)
    frames.append(("dark.png", np.zeros((400, 520))))
    with pytest.raises(ValueError, match=r"got 2.*2 of 3 frames; 1: "):
        calibrate(frames, Chessboard(10, 7, 3.0))


def test_a_frame_whose_half_does_not_belong_is_left_out_and_named():
    """A folded sheet of which one panel was placed far from its points: it counted as used."""
    session, _ = simulated("vicalib_folded")
    target = session.target
    detections = {name: session.detections[name] for name in session.poses}
    found = detections["frame_5"]
    half = target.panel_of(target.points[found.ids]) == 1
    rng = np.random.default_rng(0)
    shaken = found.pixels + half[:, None] * rng.normal(0, 3, found.pixels.shape)
    detections["frame_5"] = replace(found, pixels=shaken)
    found = locate(detections, (160, 120), target, camera=session.camera)
    assert set(found.dropped) == {"frame_5"}
    assert "px off" in found.dropped["frame_5"]
    assert set(found.poses) == set(found.errors) == set(detections) - {"frame_5"}
