"""A calibration from end to end, on pictures in memory."""

from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.calibration import session
from endolab.calibration.detection.detect import Detection
from endolab.calibration.session import calibrate, choose_views, detect_all
from endolab.calibration.simulation.sheet_image import Sensor
from endolab.calibration.simulation.trajectory import Movement
from endolab.calibration.simulation.video import PAPER_SHEET, simulate_video
from endolab.calibration.summary import evidence

CAMERA = datasets.load_calibration("paper", width=480).camera
SIZE = CAMERA.width, CAMERA.height
LIGHT = el.Photometry(2.5, 2.2, None, PAPER_SHEET)
SHEET = el.TARGETS["vicalib_small"]


def seen(count):
    return Detection(np.arange(count), np.zeros((count, 2)), "" if count else "no dots")


@pytest.fixture(scope="module")
def video():
    """Frames of a flat sheet, in colour, their names and truth; and what was detected in them."""
    truth = list(
        simulate_video(
            SHEET,
            CAMERA,
            LIGHT,
            18,
            movement=Movement(distance=(25, 60)),
            sensor=Sensor(noise=1.0),
        )
    )
    colour = np.array([1.0, 0.8, 0.6])  # of the sensor's channels, in linear light
    frames = [
        (f"{n}.png", f.image[..., None] * colour ** (1 / 2.2)) for n, f in enumerate(truth)
    ]
    detections, size = detect_all(frames, SHEET)
    assert size == SIZE
    return frames, truth, detections


@pytest.fixture(scope="module")
def done(video):
    frames, _, detections = video
    calls = []
    how = {"channel": "green", "progress": lambda *what: calls.append(what)}
    return calibrate(frames, SHEET, detections=detections, size=SIZE, **how), calls


def test_camera_poses_and_light_come_back(video, done):
    _, truth, _ = video
    found, _ = done
    assert abs(found.camera.fx - CAMERA.fx) < 0.1
    assert found.geometry.rmse < 0.08
    for name, (pose,) in found.poses.items():
        true = truth[int(name.split(".")[0])].poses[0]
        assert np.linalg.norm(pose.translation - true.translation) < 0.1  # mm
    assert found.refused == ""
    assert abs(found.light.k - 2.5) < 4 * found.light.standard_errors["k"] + 0.005
    assert (
        abs(found.light.sigma - 1.04 * 0.8 ** (1 / 2.2)) < 0.06
    )  # noise and rounding, grey levels
    assert len(found.light.gains) == len(np.unique(found.samples.frame))


def test_the_error_of_a_frame_is_how_far_its_dots_lie_from_where_they_are_expected(done):
    found, _ = done
    for name in found.poses:
        off = np.linalg.norm(
            found.detections[name].pixels - found.predict_pixels(name), axis=1
        )
        assert np.quantile(off, 0.3) < found.errors[name] < 0.2  # px
        assert found.errors[name] <= np.sqrt(np.mean(off**2)) + 1e-9


def test_frames_that_are_left_out_count_for_nothing(video):
    """Frames that lie are left out; the camera is that of the others alone, and an unknown name is named."""
    frames, _, detections = video
    liars = [name for name in detections if len(detections[name].ids)][:2]
    wrong = {
        name: replace(detections[name], pixels=detections[name].pixels * 1.1)
        for name in liars
    }
    found = calibrate(
        frames, SHEET, detections=detections | wrong, size=SIZE, leave_out=liars
    )
    assert abs(found.camera.fx - CAMERA.fx) < 0.1
    assert [found.dropped[name] for name in liars] == [session.LEFT_OUT_REASON] * 2
    assert not set(liars) & (set(found.poses) | set(found.errors))
    assert evidence(found)["frames"]["errors_px"] == found.errors
    with pytest.raises(ValueError, match=r"leave_out.*'none'"):
        calibrate(frames, SHEET, detections=detections, size=SIZE, leave_out=["none"])


def test_a_known_camera_is_kept(video):
    frames, _, detections = video
    few = {name: detections[name] for name in list(detections)[:6]}
    found = calibrate(frames, SHEET, camera=CAMERA, detections=few, size=SIZE)
    assert found.geometry is None
    assert found.camera is CAMERA
    assert set(found.poses) | set(found.dropped) == set(few)
    with pytest.raises(ValueError, match="the camera is for 500x360 px"):
        calibrate(
            frames, SHEET, camera=replace(CAMERA, width=500), detections=few, size=SIZE
        )
    read = iter(frames)
    with pytest.raises(ValueError, match="the camera is for 500x360 px"):
        calibrate(read, SHEET, camera=replace(CAMERA, width=500))
    assert next(read) == frames[1]  # no more than one was looked at


def test_the_light_that_cannot_be_told_is_refused_and_the_camera_kept(video):
    frames, _, detections = video
    found = calibrate(frames, SHEET, detections=detections, size=SIZE, gamma="free")
    assert (found.light, found.scores) == (None, None)
    assert "gamma" in found.refused
    assert abs(found.camera.fx - CAMERA.fx) < 0.1


@pytest.mark.parametrize(
    ("expose", "word"),
    [
        (np.ones_like, "dark nor saturated"),
        (np.zeros_like, "dark nor saturated"),
        (lambda image: np.full_like(image, 0.5), "lit room"),
        (lambda image: np.where(image < 0.25, 0.0, 1.0), "do not determine k"),
    ],
    ids=["over-exposed", "dark", "even", "black and white"],
)
@pytest.mark.parametrize("known", [None, CAMERA], ids=["camera sought", "camera given"])
def test_a_light_that_cannot_be_fitted_leaves_the_camera(video, expose, word, known):
    frames, _, detections = video
    bad = [(name, expose(image)) for name, image in frames]
    found = calibrate(bad, SHEET, camera=known, detections=detections, size=SIZE)
    assert (found.light, found.scores) == (None, None)
    assert word in found.refused
    assert abs(found.camera.fx - CAMERA.fx) < 0.1
    assert evidence(found)["photometry"] == {"refused": found.refused, "nominal": True}


def test_too_few_samples_leave_the_camera(video):
    """The pictures of all frames, or of all but one, are lost after the search."""
    frames, _, detections = video
    one = [
        (name, image if number == 4 else None)
        for number, (name, image) in enumerate(frames)
    ]
    assert "single frame" in calibrate(one, SHEET, detections=detections, size=SIZE).refused
    none = [(name, None) for name, _ in frames]
    found = calibrate(none, SHEET, detections=detections, size=SIZE)
    assert "0 of 0 samples" in found.refused
    assert found.geometry.rmse < 0.08


def test_a_fit_that_breaks_down_leaves_the_camera_but_a_wrong_option_is_an_error(
    video, monkeypatch
):
    frames, _, detections = video
    with pytest.raises(ValueError, match="brdf"):
        calibrate(frames, SHEET, detections=detections, size=SIZE, brdf="shiny")

    def fail(*_, **__):
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(session, "calibrate_light", fail)
    found = calibrate(frames, SHEET, detections=detections, size=SIZE)
    assert (found.light, found.refused) == (None, "Singular matrix")


def test_pictures_that_cannot_be_read_are_named(video):
    frames, _, _ = video
    found, size = detect_all([("a.png", None), frames[0], ("b.png", None)], SHEET)
    assert (found["a.png"].reason, len(found["a.png"].ids)) == ("it cannot be read", 0)
    assert size == SIZE
    assert detect_all([("a.png", None)], SHEET)[1] is None
    message = r"in none of 1 frames; looked for 19 x 10 dots .* it cannot be read in 1"
    with pytest.raises(ValueError, match=message):
        calibrate([("a.png", None)], SHEET)


def test_frames_of_another_size_are_named(video):
    frames, _, _ = video
    other = ("small.png", np.zeros((90, 120)))
    with pytest.raises(ValueError, match=r"0\.png is 480x360 px, small\.png is 120x90 px"):
        detect_all([frames[0], other], SHEET)
    with pytest.raises(
        ValueError, match=r"the others are 480x360 px, small\.png is 120x90 px"
    ):
        detect_all([other], SHEET, size=(480, 360))


def test_frames_of_another_size_that_are_left_out_stop_nothing(video):
    frames, _, _ = video
    others = [("small.png", np.zeros((90, 120))), ("broken.png", None)]
    for mixed in (others + frames[:1], frames[:1] + others):
        found, size = detect_all(mixed, SHEET, leave_out=["small.png", "broken.png"])
        assert size == SIZE
        assert len(found[frames[0][0]].ids)
        assert {found[name].reason for name, _ in others} == {session.LEFT_OUT_REASON}
        with pytest.raises(ValueError, match=r"differ in size.*120x90.*--leave-out"):
            detect_all(mixed, SHEET)


def test_the_geometry_takes_the_best_of_every_few_frames():
    """A short video is not thinned, and blind frames are left out."""
    many = {str(number): seen(number % 7 * 10) for number in range(400)}
    chosen = choose_views(many, 20)
    assert len(chosen) == 20
    assert all(len(many[name].ids) == 60 for name in chosen)
    assert [int(name) // 20 for name in chosen] == list(range(20))
    few = {str(number): seen(50 if number % 3 else 0) for number in range(24)}
    assert choose_views(few, 20) == [name for name in few if len(few[name].ids)]
    assert choose_views({"0": seen(0)}, 20) == []
