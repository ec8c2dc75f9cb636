"""Numbers that no endoscope has are refused where they come in."""

import json
from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab.model.brdf import Glossy, Lambertian, TabulatedBRDF
from endolab.model.lights import SpotLight
from endolab.model.ranges import RANGES, check_range

PAPER = el.load_calibration("paper")
C3VD = el.load_calibration("c3vd").camera


@pytest.mark.parametrize("name", RANGES)
def test_the_ends_of_a_range_are_in_it(name):
    low, high = RANGES[name]
    check_range(name, (low, high))
    for value in (np.nextafter(low, -np.inf), np.nextafter(high, np.inf), np.nan):
        with pytest.raises(ValueError, match=rf"{name} must lie in \["):
            check_range(name, (low, value))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Lambertian(1e-320), r"albedo must lie in \[1e-09, 1\], got"),
        (lambda: Lambertian((0.5, 1e-300, 0.5)), r"albedo must lie in"),
        (lambda: el.Photometry(k=1e300), r"k must lie in \[0, 100\], got 1e\+300"),
        (lambda: el.Photometry(gamma=1e-300), r"gamma must lie in \[0.1, 10\]"),
        (lambda: el.Photometry(gamma=1e300), "gamma must lie in"),
        (lambda: el.Photometry(gain=1e-320), r"gain must lie in \[1e-15, 1e\+15\]"),
        (lambda: TabulatedBRDF((0, 1), (0.3, 1e-300)), "value must lie in"),
        (lambda: Glossy(0.5, 1e300), "specular must lie in"),
        (lambda: SpotLight(position=(0, 1e300, 0)), "position must lie in"),
        (lambda: SpotLight(direction=(0, 0, 1e300)), "direction must be 1e-06 to 1e"),
        (lambda: SpotLight(direction=(0, 0, 1e-320)), "direction must be 1e-06 to 1e"),
        (lambda: SpotLight(exponent=1e9), "exponent must lie in"),
        (lambda: SpotLight(weight=1e-320), "weight must lie in"),
        (lambda: el.Pinhole(9, 9, 1e-320, 5, 4, 4), "fx must lie in"),
        (lambda: el.Pinhole(9, 9, 5, 5, 1e300, 4), "cx must lie in"),
        (lambda: replace(PAPER.camera, k=(1e300, 0, 0, 0)), "distortion must lie in"),
        (lambda: replace(C3VD, a=(769, 0, 1e300, 0, 0)), "a must lie in"),
        (lambda: replace(C3VD, c=1e-320, d=0.0), "c - d·e must lie in"),
    ],
)
def test_absurd_numbers_are_refused_without_a_warning(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def file_with(folder, place, value):
    """A calibration's file in which one value is another."""
    content = json.loads(json.dumps(PAPER.to_dict()))
    *sections, key = place.split(".")
    part = content
    for name in sections:
        part = part[name]
    part[key] = value
    (folder / "c.json").write_text(json.dumps(content))
    return folder / "c.json"


@pytest.mark.parametrize(
    ("place", "value"),
    [
        ("camera.fx", 1e300),
        ("camera.k", [1e300, 0, 0, 0]),
        ("photometry.k", 1e300),
        ("photometry.gamma", 1e-300),
        ("photometry.gain", 1e-320),
        ("photometry.brdf.albedo", [1e-320, 0.5, 0.5]),
    ],
)
def test_a_file_with_an_absurd_number_says_where(tmp_path, place, value):
    file = file_with(tmp_path, place, value)
    with pytest.raises(ValueError, match=rf"c\.json: {place.rpartition('.')[0]}: .* must lie in \["):
        el.load_calibration(file)


@pytest.mark.parametrize("value", ["x" * 10**6, "9" * 10**5, [0] * 10**5, {"a" * 10**5: 1}])
@pytest.mark.parametrize("place", ["endolab", "camera", "camera.width", "camera.k", "photometry.brdf.model"])
def test_a_long_value_is_not_said_whole(tmp_path, place, value):
    file = file_with(tmp_path, place, value)
    with pytest.raises(ValueError, match=r"c\.json: ") as caught:
        el.load_calibration(file)
    assert len(str(caught.value)) < 500 + len(str(tmp_path))


def test_a_file_of_hundreds_of_megabytes_is_not_read(tmp_path):
    with (tmp_path / "c.json").open("wb") as stream:
        stream.truncate(300_000_000)
    with pytest.raises(
        ValueError, match=r"c\.json: expected a calibration file of at most 10 MB, found 300 MB"
    ):
        el.load_calibration(tmp_path / "c.json")
