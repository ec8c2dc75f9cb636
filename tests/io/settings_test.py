"""Settings in a file: what is written is what is read, and what is wrong is said in one sentence."""

import json
import math

import pytest

import endolab as el
from endolab.io.settings import (
    BELIEFS,
    SolvingSettings,
    read_settings,
    write_settings,
)
from endolab.reconstruction.settings import option_fields

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


def test_everything_comes_back_as_it_was(tmp_path):
    # An array, which no file holds.
    options = {part.name for part in option_fields()} - {"cuts"}
    assert {*EVERY, *LENGTHS} == options
    assert set(LIGHT) == set(BELIEFS)
    for name, length in LENGTHS.items():
        settings = SolvingSettings(EVERY | {name: length}, LIGHT)
        write_settings(settings, tmp_path / "s.json")
        assert read_settings(tmp_path / "s.json") == settings
    write_settings(
        SolvingSettings({"lam": 0.002, "contours": None}), tmp_path / "s.json"
    )
    assert json.loads((tmp_path / "s.json").read_text()) == {
        "endolab_settings": 1,
        "lam": 0.002,
    }


def test_the_light_is_believed():
    known = el.Calibration(
        el.Pinhole(32, 24, 16, 16, 15.5, 11.5), el.Photometry(gain=1.0)
    )
    believed = SolvingSettings({}, LIGHT).apply(known)
    assert believed.camera == known.camera
    assert believed.photometry == el.Photometry(
        2.4, 1.0 / 3 + 2, 12.5, el.Lambertian((0.5, 0.3, 0.2))
    )
    assert SolvingSettings().apply(known) == known


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[1]", "object"),
        ("{}", "endolab_settings"),
        ('{"endolab_settings": 2}', "endolab_settings"),
        ('{"endolab_settings": 1, "lamb": 1}', "lamb: .*lam"),
        ('{"endolab_settings": 1, "lam": [1]}', "lam"),
        ('{"endolab_settings": 1, "xi": 3}', "xi"),
        ('{"endolab_settings": 1, "contours": "yes"}', "contours"),
        ('{"endolab_settings": 1, "width": 0}', "width"),
        ('{"endolab_settings": 1, "known_distance": [1, 2]}', "known_distance"),
        ('{"endolab_settings": 1, "known_diameter": [1, [2], [3]]}', "known_diameter"),
        ('{"endolab_settings": 1, "photometry": {"brdf": 1}}', r"photometry\.brdf"),
        ('{"endolab_settings": 1, "photometry": {"k": "2"}}', "k"),
        ('{"endolab_settings": 1, "photometry": []}', "photometry"),
    ],
)
def test_what_is_wrong_is_said(text, named, tmp_path):
    (tmp_path / "s.json").write_text(text)
    with pytest.raises(ValueError, match=rf"^[^\n]*s\.json: [^\n]*{named}[^\n]*$"):
        read_settings(tmp_path / "s.json")


def test_what_no_file_can_hold_is_not_written(tmp_path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_settings(SolvingSettings({"lam": math.nan}), tmp_path / "s.json")
    assert list(tmp_path.iterdir()) == []
