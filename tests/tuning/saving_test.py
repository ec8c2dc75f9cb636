"""What the tuner saves makes, by ``reconstruct --settings``, what the tuner shows, to the last bit."""

import numpy as np
import pytest

import endolab as el
from endolab.cli import main as cli
from endolab.io.images import read_frame
from endolab.io.settings import read_settings, write_settings
from endolab.io.surfaces import save_depth
from endolab.tuning.engine import Tuner
from endolab.tuning.saving import saved
from endolab.tuning.source import Settings


@pytest.fixture(scope="module")
def sim(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sim")
    options = ["--calibration", "simple", "--width", "96", "--out"]
    assert cli.main(["simulate", "curved", *options, str(folder)]) == 0
    return folder


@pytest.mark.parametrize(
    "settings",
    [
        Settings(scene=None, width=64, lam=0.1 + 0.2, epsilon=2e-3, xi="d", regulariser="first"),
        Settings(scene=None, width=320, k=2.0, gamma=2.1, gain=1.5),  # wider than the frame
        Settings(scene=None, width=48, channel="blue", solver="primal_dual"),
    ],
)
def test_the_command_makes_what_the_tuner_shows(sim, tmp_path, settings):
    calibration = el.Calibration.load(sim / "endoscope.json")
    tuner = Tuner(calibration, frame=read_frame(sim / "frame.png", calibration))
    shown = tuner.cold(settings).result
    tuner.close()
    save_depth(tmp_path / "shown.npz", shown, shown.metric)
    write_settings(saved(settings, calibration), tmp_path / "s.json")
    command = ["reconstruct", str(sim / "frame.png"), "--calibration", str(sim / "endoscope.json")]
    assert cli.main([*command, "--settings", str(tmp_path / "s.json"), "--out", str(tmp_path / "out")]) == 0
    with np.load(tmp_path / "shown.npz") as expected, np.load(tmp_path / "out/depth.npz") as made:
        for name in expected.files:
            assert np.array_equal(made[name], expected[name], equal_nan=expected[name].dtype.kind == "f"), (
                name
            )


def test_only_what_is_believed_otherwise_is_saved(sim, tmp_path):
    calibration = el.Calibration.load(sim / "endoscope.json")
    assert saved(Settings(scene=None), calibration).photometry == {}
    light = calibration.photometry
    other = saved(Settings(scene=None, k=light.k + 0.5, gain=2.0), calibration)
    assert other.photometry == {"k": light.k + 0.5, "gain": 2.0 * light.gain}
    assert saved(Settings(scene=None), calibration, grey=True).keywords["channel"] in ("grey", "auto")
    write_settings(other, tmp_path / "s.json")
    assert read_settings(tmp_path / "s.json") == other
