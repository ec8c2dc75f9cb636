"""Settings in a file: what is written is what is read, and what is wrong is said in one sentence."""

import json
import math

import pytest

import endolab as el
from endolab.depth.problem import REGULARISERS
from endolab.io.settings import KEYWORDS, LIGHT, SolvingSettings, read_settings, write_settings

EVERY = {
    "solver": "primal_dual",
    "channel": "green",
    "xi": "d",
    "regulariser": REGULARISERS[0],
    "lam": 0.1 + 0.2,  # no short number
    "epsilon": 1e-3,
    "threshold": 0.05,
    "max_iterations": 7,
    "width": 160,
    "smooth": 1.25,
    "highlights": "ignore",
    "contours": False,
    "median_distance": 30.0,
    "known_distance": (30.0, 80.0, 60.0),
    "known_diameter": (8.0, (10.0, 20.0), (30.0, 20.5)),
}
BELIEFS = {"k": 2.4, "gamma": 1.0 / 3 + 2, "gain": 12.5, "albedo": (0.5, 0.3, 0.2)}


def test_everything_comes_back_as_it_was(tmp_path):
    assert set(EVERY) == set(KEYWORDS)
    assert set(BELIEFS) == set(LIGHT)
    settings = SolvingSettings(EVERY, BELIEFS)
    write_settings(settings, tmp_path / "s.json")
    assert read_settings(tmp_path / "s.json") == settings
    write_settings(SolvingSettings({"lam": "auto"}, {"albedo": 0.5}), tmp_path / "s.json")
    assert read_settings(tmp_path / "s.json") == SolvingSettings({"lam": "auto"}, {"albedo": 0.5})


def test_the_file_is_small_and_readable(tmp_path):
    write_settings(SolvingSettings({"lam": 0.002, "contours": None}), tmp_path / "s.json")
    assert json.loads((tmp_path / "s.json").read_text()) == {"endolab_settings": 1, "lam": 0.002}


def test_keywords_are_those_of_reconstruct():
    import inspect

    taken = set(inspect.signature(el.reconstruct).parameters)
    assert set(KEYWORDS) - {"epsilon", "threshold"} <= taken  # the two are of the energy, in its options


def test_the_light_is_believed():
    known = el.Calibration(el.Pinhole(32, 24, 16, 16, 15.5, 11.5), el.Photometry(gain=1.0))
    believed = SolvingSettings({}, BELIEFS).believed(known)
    assert believed.camera == known.camera
    assert believed.photometry == el.Photometry(2.4, 1.0 / 3 + 2, 12.5, el.Lambertian((0.5, 0.3, 0.2)))
    assert SolvingSettings().believed(known) == known


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("[1]", r"s\.json: the file: expected an object"),
        ("{}", r"s\.json: endolab_settings: missing"),
        ('{"endolab_settings": 2}', r"endolab_settings: expected version 1, found 2"),
        ('{"endolab_settings": true}', r"expected version 1, found true"),
        ('{"endolab_settings": 1, "lamb": 1}', r"lamb: unknown key; expected .*lam, .*photometry"),
        ('{"endolab_settings": 1, "lam": [1]}', r"lam: expected a finite number, found \[1\]"),
        ('{"endolab_settings": 1, "lam": 1e999}', r"lam: expected a finite number"),
        ('{"endolab_settings": 1, "xi": 3}', r"xi: expected a word in quotes, found 3"),
        ('{"endolab_settings": 1, "contours": "yes"}', r"contours: expected true or false, found \"yes\""),
        ('{"endolab_settings": 1, "width": 0}', r"width: expected at least 1, found 0"),
        ('{"endolab_settings": 1, "known_distance": [1, 2]}', r"known_distance: expected 3 finite numbers"),
        ('{"endolab_settings": 1, "known_diameter": [1, [2], [3]]}', r"known_diameter: expected 5 finite"),
        ('{"endolab_settings": 1, "known_diameter": 4}', r"known_diameter: expected \[mm, \[column, row\]"),
        ('{"endolab_settings": 1, "photometry": {"brdf": 1}}', r"photometry\.brdf: unknown key; expected k"),
        ('{"endolab_settings": 1, "photometry": []}', r"photometry: expected an object"),
        ("{", r"s\.json: not valid JSON"),
    ],
)
def test_what_is_wrong_is_said(content, said, tmp_path):
    (tmp_path / "s.json").write_text(content)
    with pytest.raises(ValueError, match=said) as caught:
        read_settings(tmp_path / "s.json")
    assert "\n" not in str(caught.value)


def test_what_no_file_can_hold_is_refused_and_nothing_is_written(tmp_path):
    with pytest.raises(ValueError, match=r"unknown setting 'lamda'; choose .*did you mean lam"):
        SolvingSettings({"lamda": 1.0})
    with pytest.raises(ValueError, match="unknown part of the photometry 'kk'"):
        SolvingSettings({}, {"kk": 1.0})
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_settings(SolvingSettings({"lam": math.nan}), tmp_path / "s.json")
    assert list(tmp_path.iterdir()) == []
