"""The calibration's board without a browser: bars, frames that are left out, fits that follow, bad input."""

import signal
import threading
import time
from dataclasses import replace

import cv2
import numpy as np
import pytest

import endolab as el
from endolab.batch.calibrate import calibrate_to_files
from endolab.calibration.geometric.projection import camera_vector
from endolab.calibration.photometric.samples import Samples
from endolab.calibration.simulation.video import PAPER_SHEET, simulate_samples, simulate_video
from endolab.datasets import load_calibration
from endolab.io.video import open_frames
from endolab.tuning.calibration import board as module
from endolab.tuning.calibration.board import LEFT_OUT
from endolab.tuning.calibration.judged import LEVELS_OFF, PERCENT, PIXELS
from endolab.tuning.calibration.material import light_options
from endolab.tuning.calibration.space import camera_lines, panel_corners, surroundings
from endolab.tuning.calibration.words import beginning
from tests.tools.sheet_views import PAPER, make_views
from tests.tools.simulated_session import simulated

SHEET = el.TARGETS["vicalib_small"]
SIZE = PAPER.width, PAPER.height
BAD = 3  # number of the frame that was damaged
CAMERA = load_calibration("paper", width=480).camera
LIGHT = el.Photometry(k=2.5, gamma=2.2, brdf=PAPER_SHEET)


@pytest.fixture
def make():
    """Function that makes a board; all are closed at the end."""
    made = []

    def make(*given, **options):
        made.append(el.tune_calibration(*given, **options))
        return made[-1]

    yield make
    for box in made:
        box.close()
        assert box.refits.complaint == ""


@pytest.fixture(scope="module")
def views():
    """Eight views, one of them of a picture that was stretched by 0.2 %."""
    views, _ = make_views(PAPER, SHEET, 8, np.random.default_rng(7), wrong=0, far=60, noise=0.05)
    centre = np.array([PAPER.cx, PAPER.cy])
    views[BAD] = replace(views[BAD], pixels=centre + (views[BAD].pixels - centre) * [1.002, 1])
    return views


@pytest.fixture(scope="module")
def fitted(views):
    return el.calibrate_camera(views, SHEET, *SIZE)


@pytest.fixture(scope="module")
def lit():
    """Samples of 20 frames, of which one has a vignette of its own, and the fit."""
    samples, _ = simulate_samples(SHEET, CAMERA, LIGHT, 20, per_frame=60, outliers=0.01, seed=1)
    dimmer = samples.level * samples.cos_alpha**0.4
    samples = replace(samples, level=np.where(samples.frame == BAD, dimmer, samples.level))
    return samples, el.calibrate_light(samples)


def values(box):
    return [bar["value"] for bar in box.bars.bars]


def decoded(picture):
    return cv2.imdecode(np.frombuffer(picture.value, np.uint8), cv2.IMREAD_COLOR)


def test_the_fit_of_the_camera_follows_and_comes_nearer_to_the_truth(make, views, fitted):
    box = make(fitted, SHEET)
    assert box.bars.title.startswith("rms error of each frame, px")
    assert int(np.argmax(values(box))) == BAD
    assert box.bars.chosen == BAD  # the worst is shown first
    box.leave_out(views[BAD].name)
    state = box.wait(60)
    cold = el.calibrate_camera([v for i, v in enumerate(views) if i != BAD], SHEET, *SIZE)
    assert state.left_out == {views[BAD].name}
    off = camera_vector(state.camera.camera) - camera_vector(cold.camera)
    assert np.abs(off / list(cold.standard_errors.values())).max() < 1e-4
    assert abs(state.camera.camera.fx - PAPER.fx) < 0.2 * abs(fitted.camera.fx - PAPER.fx)
    assert f"fx {fitted.camera.fx:.2f} → {state.camera.camera.fx:.2f} px" in box.status.value
    bar = box.bars.bars[BAD]
    assert bar["state"] == "left out by hand"
    assert bar["value"] > 1.1 * max(value for i, value in enumerate(values(box)) if i != BAD)
    assert "left out by hand" in box.picture.caption
    assert "by a pose of its own" in box.legend.value
    box.take_back()
    again = box.wait(60)
    assert again.camera.camera.fx == pytest.approx(fitted.camera.fx, abs=1e-6)


def test_a_fit_that_begins_at_another_one_is_the_same(views, fitted):
    few = el.calibrate_camera(views[:4], SHEET, *SIZE)
    for start in (few, fitted):
        warm = el.calibrate_camera(views, SHEET, *SIZE, start=start)
        off = camera_vector(warm.camera) - camera_vector(fitted.camera)
        assert np.abs(off / list(fitted.standard_errors.values())).max() < 1e-4
    with pytest.raises(ValueError, match="needs 3 views from different directions at least, got 2"):
        el.calibrate_camera(views[:2], SHEET, *SIZE, start=fitted)  # it has to tell the camera by itself
    assert len(el.calibrate_camera(views[:2], SHEET, *SIZE, start=fitted.camera).views) == 2


def test_the_fit_of_the_light_follows_bit_for_bit(make, lit):
    samples, fit = lit
    box = make(fit, samples=samples, camera=CAMERA)
    assert int(np.argmax(values(box))) == BAD
    box.leave_out(str(BAD))
    state = box.wait(60)
    alone = el.calibrate_light(samples[samples.frame != BAD])
    assert state.light.photometry == alone.photometry
    assert abs(alone.photometry.k - 2.5) < abs(fit.photometry.k - 2.5)
    assert f"k {fit.k:.3f} → {alone.k:.3f}" in box.status.value
    assert "γ" not in box.status.value  # which was given
    assert box.bars.bars[BAD]["value"] > 4
    missing = np.sum(samples.frame == BAD) + np.sum(~alone.used)
    assert box.why.caption == f"{missing} of {len(samples)} samples left out"
    assert f"{np.sum(samples.frame == BAD)} its frame was left out" in box.whys.value


def test_a_session_has_both_and_what_is_counted_adds_up(make):
    session, frames, _ = simulated()
    box = make(session, frames=frames)
    assert box.quantity.options == (PIXELS, LEVELS_OFF, PERCENT)
    assert [bar["state"] for bar in box.bars.bars].count("nothing found") == 2
    assert len(box.space.sheets) == len(session.geometry.views)
    first = box.picture.value
    box.quantity.value = LEVELS_OFF
    assert box.beside.value == LEFT_OUT
    assert box.picture.value != first
    used = session.light.residuals[session.light.used]
    assert box.bars.level == pytest.approx(np.sqrt(np.mean(used**2)))
    out = np.sum(~session.light.used)
    assert box.why.caption == f"{out} of {len(session.samples)} samples left out"
    counted = [int(line.split()[0]) for line in box.whys.value.split("</b> ")[1:]]
    assert sum(counted) == len(session.samples)
    grey = values(box)
    box.quantity.value = PERCENT
    assert box.bars.title.startswith("rms error of each frame, %")
    assert values(box) != grey
    box.order.value = "worst first"
    assert values(box)[:-2] == sorted((v for v in values(box) if v is not None), reverse=True)


def test_bars_dots_and_sheets_can_be_pointed_at(make):
    session, frames, _ = simulated()
    box = make(session, frames=frames)
    box.bars.chosen = 7
    assert box.frame.value == box.space.chosen == "frame_7"
    assert box.picture.caption.startswith("frame_7")
    shown = box.picture.value
    box.picture.point = [0.1, 0.9, 0, 1, 1.0]
    assert box.picture.value != shown
    assert "this one" in box.legend.value
    box.space.chosen = "frame_2"
    assert box.bars.chosen == 2
    box.bars.toggled = [2, 10.0]
    assert box.wait(60).left_out == {"frame_2"}
    assert "frame_2" in box.status.value
    box.bars.toggled = [2, 20.0]
    assert box.wait(60).left_out == frozenset()
    box.bars.chosen, box.frame.value = 5, "frame_3"  # nothing was found there
    assert "nothing found: too dark" in box.picture.caption
    assert decoded(box.picture).shape == (720, 960, 3)


def test_the_last_wish_wins_and_a_stop_keeps_the_best_so_far(make, views, fitted, monkeypatch):
    box = make(fitted, SHEET)
    for view in views[:3]:
        box.leave_out(view.name)
    assert box.wait(60).left_out == {view.name for view in views[:3]}
    monkeypatch.setattr(box.refits, "_on_step", lambda *_: time.sleep(0.2))
    box.take_back()
    box.refits.stop()
    state = box.wait(60)
    assert state.camera.status is el.Status.STOPPED
    assert state.steps == 1
    assert "stopped, the best so far" in box.status.value


def test_an_interrupt_keeps_the_best_so_far(make, views, fitted, monkeypatch):
    box = make(fitted, SHEET)
    main, steps = threading.main_thread().ident, []

    def on_step(*_):
        steps.append(None)
        if len(steps) == 2:
            signal.pthread_kill(main, signal.SIGINT)
        time.sleep(0.3)

    monkeypatch.setattr(box.refits, "_on_step", on_step)
    box.leave_out(views[BAD].name)
    state = box.wait(60)
    assert state.left_out == {views[BAD].name}
    assert state.camera.status is el.Status.STOPPED
    assert 1 < state.steps < 10


def test_what_cannot_be_done_is_one_sentence_and_the_fits_stay(make, views, fitted):
    box = make(fitted, SHEET, frames={views[0].name: np.zeros((10, 12))})
    names = [view.name for view in views]
    with pytest.raises(ValueError, match="no frame would be left to fit: take another one back first"):
        box.leave_out(*names)
    with pytest.raises(ValueError, match="unknown frame 'frame_9'"):
        box.leave_out("frame_9")
    assert box.left_out == frozenset()
    box.leave_out(*names[2:])
    state = box.wait(60)
    assert state.complaints == ("a calibration needs 3 views from different directions at least, got 2",)
    assert state.complaints[0] in box.status.value
    assert state.camera is fitted
    assert all(value is not None for value in values(box))
    box.choose(names[0])
    assert "is 12x10 px, and the calibration is for 1440x1080 px: it is not shown" in box.status.value
    for bad in ([99, 1.0], [1], ["a", 2.0]):
        box.bars.toggled = bad
        assert "a bar is a whole number below 8" in box.status.value
    box.picture.point = [float("nan"), 0, 0, 1, 0]
    assert "five numbers" in box.status.value


@pytest.mark.parametrize(
    ("given", "options", "sentence"),
    [
        ("camera", {}, "a fit of the camera needs its target beside it"),
        ("light", {}, "a fit of the light needs its 1200 samples beside it, got none"),
        ("light", {"samples": Samples.concatenate([])}, "needs its 1200 samples beside it, got 0"),
        (3, {}, "found must be a Session, .* got int"),
        ("nowhere", {}, "report.json"),
    ],
)
def test_what_is_missing_is_one_sentence(fitted, lit, given, options, sentence):
    found = {"camera": fitted, "light": lit[1]}.get(given, given)
    with pytest.raises((ValueError, OSError), match=sentence) as caught:
        el.tune_calibration(found, **options)
    assert "\n" not in str(caught.value)


def test_a_fit_tells_how_it_was_asked(lit):
    samples, _ = lit
    locked, _ = simulate_samples(SHEET, CAMERA, LIGHT, 20, per_frame=60, locked=True)
    for some, asked in (
        (samples, {"gamma": 2.1, "brdf": "lambertian", "gain": "free"}),
        (locked, {"gamma": "free", "brdf": "tabulated", "gain": "locked"}),
    ):
        told = light_options(el.calibrate_light(some, **asked))
        assert {name: told[name] for name in asked} == asked


def test_of_very_many_frames_the_worst_have_bars(make, lit, monkeypatch):
    samples, fit = lit
    monkeypatch.setattr(module, "MOST_BARS", 5)
    box = make(fit, samples=samples, camera=CAMERA)
    assert len(box.bars.bars) <= 6
    assert "largest of 20" in box.bars.title
    assert str(BAD) in [bar["label"] for bar in box.bars.bars]


def test_the_folder_of_a_report_is_enough(make, tmp_path):
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for number, shot in enumerate(simulate_video(SHEET, CAMERA, LIGHT, 8, distance=(30, 55), seed=4)):
        cv2.imwrite(str(pictures / f"{number}.png"), np.round(255 * shot.image).astype(np.uint8))
    done = calibrate_to_files(
        open_frames(pictures), SHEET, tmp_path / "scope.json", brdf="lambertian", gamma=2.1
    )
    box = make(tmp_path / "scope_report")
    assert box.material.names == tuple(done.detections)
    assert box.state.light.photometry == done.light.photometry
    assert decoded(box.picture).std() > 10  # the frame is there
    (tmp_path / "scope_report" / "report.json").write_text("[1]")
    with pytest.raises(ValueError, match="not the report of a calibration"):
        el.tune_calibration(tmp_path / "scope_report")


def test_sheets_and_camera_in_space():
    session, _, _ = simulated("vicalib_folded")
    left, right = panel_corners(session.target, session.poses["frame_0"])
    for corners, pose in zip((left, right), session.poses["frame_0"], strict=True):
        np.testing.assert_allclose((np.array(corners) - pose.translation) @ pose.normal, 0, atol=2e-3)
    np.testing.assert_allclose(left[1], right[0], atol=1e-2)  # they meet at the fold
    outline, *spokes = (np.array(line) for line in camera_lines(session.camera, 10.0))
    np.testing.assert_allclose(np.linalg.norm(outline, axis=1), 10, atol=2e-3)
    assert len(spokes) == 4
    about = surroundings([left, right])
    assert about.axis[-1] <= max(corner[2] for corner in left + right)


@pytest.mark.parametrize(
    ("names", "common"),
    [(["frame_01", "frame_12"], "frame_"), (["101.png", "102.png"], ""), (["a"], ""), (["a1", "b1"], "")],
)
def test_labels_are_short(names, common):
    assert beginning(names) == common
