"""What the tuner's settings write and save makes, to the last bit, what the tuner shows."""

from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.io.settings import read_settings, write_settings
from endolab.workbench.tuning.engine import Tuner
from endolab.workbench.tuning.source import Knobs, Source

PAPER = datasets.load_calibration("paper")


@pytest.mark.parametrize(
    "settings",
    [
        Knobs(scene="tube", width=160, noise=2.0, lam=0.3),
        Knobs(scene="plane", width=160, k=2.0, gamma=2.0, gain=1.5, xi="d"),
        Knobs(scene="colon", width=128, channel="red", solver="fast_marching"),
        Knobs(scene=None, width=128, albedo=(0.7, 0.4, 0.3), channel="auto"),
        Knobs(scene=None, width=400, k=2.2, gain=0.5),  # wider than the frame
    ],
)
def test_the_code_and_the_saved_settings_make_the_same(seen, settings, tmp_path):
    frame, calibration, _ = seen
    known = PAPER if settings.scene else calibration
    tuner = Tuner(known, frame=None if settings.scene else frame)
    shown = tuner.solve_cold(settings)
    names = {"el": el, "replace": replace, "calibration": known, "frame": frame}
    exec(settings.code(shown.subject), names)
    write_settings(settings.solving_settings(shown.subject), tmp_path / "s.json")
    written = read_settings(tmp_path / "s.json")
    believed = written.apply(shown.subject.calibration)
    again = el.reconstruct(shown.subject.frame, believed, **written.keywords)
    for distance in (names["result"].distance, again.distance):
        assert np.array_equal(distance, shown.result.distance, equal_nan=True)


def test_only_what_is_believed_otherwise_is_saved(seen):
    frame, calibration, _ = seen
    grey = el.Frame(frame.image[..., 1], frame.mask)
    subject = Source(calibration, grey).subject(Knobs(scene=None))
    assert Knobs(scene=None).solving_settings(subject).photometry == {}
    light = calibration.photometry
    other = Knobs(scene=None, k=light.k + 0.5, gain=2.0).solving_settings(subject)
    assert other.photometry == {"k": light.k + 0.5, "gain": 2.0 * light.gain}
    assert other.keywords["channel"] == "grey"
