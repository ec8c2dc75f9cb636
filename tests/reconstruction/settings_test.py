"""Every option stands once, in `Settings`, and a file of settings comes back as it was."""

import inspect

import pytest

import endolab as el
from endolab.cli.main import main
from endolab.io.settings import SolvingSettings, read_settings, write_settings
from endolab.reconstruction.settings import Settings, option_types
from endolab.workbench.tuning.widget import KNOBS

EVERY = {
    "solver": "primal_dual",
    "channel": "green",
    "xi": "d",
    "regulariser": "second",
    "lam": 0.1 + 0.2,  # no short number
    "epsilon": 1e-3,
    "threshold": 0.05,
    "max_iterations": 7,
    "width": 160,
    "smooth": 1.25,
    "highlights": "ignore",
    "contours": False,
}
LENGTHS = {
    "median_distance": 30.0,
    "known_distance": (30.0, 80.0, 60.0),
    "known_diameter": (8.0, (10.0, 20.0), (30.0, 20.5)),
}
LIGHT = {"k": 2.4, "gamma": 1.0 / 3 + 2, "gain": 12.5, "albedo": (0.5, 0.3, 0.2)}


@pytest.mark.parametrize("name", option_types())
def test_an_option_is_one_field_that_is_seen_everywhere(name, capsys):
    assert name in inspect.signature(el.reconstruct).parameters
    assert f"\n{name} : " in el.reconstruct.__doc__
    assert main(["reconstruct", "--help"]) == 0
    assert f"--{name.replace('_', '-')}" in capsys.readouterr().out
    assert name in {spec["name"] for spec in KNOBS} | {"known_diameter"}
    assert name in EVERY | LENGTHS


@pytest.mark.parametrize("length", LENGTHS)
def test_everything_comes_back_as_it_was(length, tmp_path):
    settings = SolvingSettings(EVERY | {length: LENGTHS[length]}, LIGHT)
    write_settings(settings, tmp_path / "s.json")
    assert read_settings(tmp_path / "s.json") == settings
    assert Settings(**settings.keywords).as_dict().items() >= settings.keywords.items()


def test_the_light_is_believed():
    lens = el.Pinhole(32, 24, 16, 16, 15.5, 11.5)
    known = el.Calibration(lens, el.Photometry(gain=1.0))
    believed = SolvingSettings({}, LIGHT).apply(known)
    light = el.Photometry(2.4, 1.0 / 3 + 2, 12.5, el.Lambertian((0.5, 0.3, 0.2)))
    assert (believed.camera, believed.photometry) == (lens, light)
    assert SolvingSettings().apply(known) == known
