"""What the tuner's settings write and save makes, to the last bit, what the tuner shows."""

from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.io.settings import read_settings, write_settings
from endolab.workbench.tuning.engine import Tuner
from endolab.workbench.tuning.source import Knobs

PAPER = datasets.load_calibration("paper")


@pytest.fixture(scope="module")
def seen():
    """A frame of a tube, its calibration and its true distance."""
    small = PAPER.resize(200, 150)
    view = el.render(el.SCENES["tube"], small.camera, small.photometry, noise=1, bits=8)
    return (
        el.Frame(view.image, view.mask),
        el.Calibration(view.camera, view.photometry),
        view.distance,
    )


@pytest.mark.parametrize(
    "settings",
    [
        Knobs(scene="tube", width=160, noise=2.0, lam=0.3),
        Knobs(
            scene="plane",
            width=160,
            k=2.0,
            gamma=2.0,
            gain=1.5,
            xi="d",
            regulariser="first",
        ),
        Knobs(
            scene="colon", width=128, channel="red", solver="fast_marching", epsilon=1e-2
        ),
        Knobs(scene=None, width=160, albedo=(0.7, 0.4, 0.3), channel="auto"),
        Knobs(scene=None, width=400, k=2.2, gain=0.5),  # wider than the frame
    ],
)
def test_the_code_a_wish_and_the_saved_settings_make_the_same(seen, settings, tmp_path):
    frame, calibration, _ = seen
    known = PAPER if settings.scene else calibration
    tuner = Tuner(known, frame=None if settings.scene else frame)
    tuner.ask(settings)
    shown = tuner.wait(60)
    tuner.close()
    names = {"el": el, "replace": replace, "calibration": known, "frame": frame}
    exec(settings.code(known, shown.subject.grey), names)
    assert np.array_equal(names["result"].distance, shown.result.distance, equal_nan=True)
    write_settings(
        settings.solving_settings(shown.subject.calibration, shown.subject.grey),
        tmp_path / "s.json",
    )
    written = read_settings(tmp_path / "s.json")
    believed = written.apply(shown.subject.calibration)
    again = el.reconstruct(shown.subject.frame, believed, **written.keywords)
    assert np.array_equal(again.distance, shown.result.distance, equal_nan=True)


def test_only_what_is_believed_otherwise_is_saved(seen):
    _, calibration, _ = seen
    assert Knobs(scene=None).solving_settings(calibration, grey=False).photometry == {}
    light = calibration.photometry
    other = Knobs(scene=None, k=light.k + 0.5, gain=2.0).solving_settings(
        calibration, grey=True
    )
    assert other.photometry == {"k": light.k + 0.5, "gain": 2.0 * light.gain}
    assert other.keywords["channel"] == "grey"
    with pytest.raises(ValueError, match="albedo"):
        Knobs(albedo=(1.0, 2.0))


def test_frame_truth_and_calibration_must_fit(seen):
    frame, calibration, truth = seen
    tuner = Tuner(calibration)
    with pytest.raises(ValueError, match="200x150 px"):
        tuner.use(PAPER, frame)
    for given in ((frame, truth[1:]), (None, truth), (frame, -truth)):
        with pytest.raises(ValueError, match="truth"):
            tuner.use(calibration, *given)
    tuner.use(calibration, frame, truth)
    tuner.ask(Knobs(scene=None, width=160))
    assert tuner.wait(60).median_error < 5
    tuner.close()
