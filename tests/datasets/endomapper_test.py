"""EndoMapper's calibration files: what their numbers mean here, and which files are refused."""

import json
import re

import numpy as np
import pytest
from numpy.testing import assert_allclose

import endolab as el
from endolab import datasets
from endolab.cli import main as cli
from endolab.datasets import endomapper
from endolab.io.descriptions import read_camera

# Written as Vicalib does; the numbers are of the data set's Endoscope_01.
GEOMETRY = """<rig>
    <camera>
        <camera_model name="" index="0" serialno="0" type="calibu_fu_fv_u0_v0_kb4" version="8">
            <width> 1440 </width>
            <height> 1080 </height>
            <!-- Use RDF matrix, [right down forward], to define the coordinate frame convention -->
            <right> [ 1; 0; 0 ] </right>
            <down> [ 0; 1; 0 ] </down>
            <forward> [ 0; 0; 1 ] </forward>
            <!-- Camera parameters ordered as per type name. -->
            <params> [ 717.6911; 718.0214; 734.7278; 552.0724; -0.1396589; -0.0003139987; 0.001505504;
                -0.0001316715 ] </params>
        </camera_model>
        <pose>
            <T_wc> [ 1, 0, 0, 0; 0, 1, 0, 0; 0, 0, 1, 0 ] </T_wc>
        </pose>
    </camera>
</rig>
"""
# The example in the tool's README.
PHOTOMETRY = """<rig>
    <camera>
        <camera_model index="0" name="" serialno="0" type="gamma" version="1.0">
            <!-- Camera response model -->
            <gamma> [ 2.2 ] </gamma>
        </camera_model>
    </camera>
    <light>
        <light_model index="0" name="" serialno="0" type="sls" version="1.0">
            <sigma> 1.000000 </sigma>
            <mu> 2.767302 </mu>
            <P> [ -6.1e-05; -0.001135; -0.003612 ] </P>
            <D> [ 0.011092; 0.0; 0.999938 ] </D>
        </light_model>
    </light>
</rig>
"""


@pytest.fixture
def write(tmp_path):
    """Write the two files, with a text in one of them replaced."""

    def files(old="", new="", photometry=PHOTOMETRY, geometry=GEOMETRY):
        assert old in geometry + photometry
        folder = tmp_path / "Endoscope_01"
        folder.mkdir(exist_ok=True)
        paths = folder / "Endoscope_01_geometrical.xml", folder / "Endoscope_01_photometrical.xml"
        for path, text in zip(paths, (geometry, photometry), strict=True):
            path.write_text(text.replace(old, new) if old else text, encoding="utf-8")
        return paths

    return files


def test_the_camera(write):
    camera = endomapper.read_vicalib(write()[0])
    assert isinstance(camera, el.KannalaBrandt)
    assert (camera.width, camera.height) == (1440, 1080)
    assert endomapper.read_vicalib(write("734.7278", "0.51")[0]).cx == 0.51
    theta, k = 0.7, (-0.1396589, -0.0003139987, 0.001505504, -0.0001316715)
    radius = theta + sum(c * theta**power for c, power in zip(k, (3, 5, 7, 9), strict=True))
    pixel = camera.project([0.0, np.sin(theta), np.cos(theta)])  # down in the picture
    assert_allclose(pixel, (734.7278, 552.0724 + 718.0214 * radius), rtol=1e-12)


def test_a_pinhole(write):
    text = re.sub(r"_kb4|; -0\.139[^]]*", "", GEOMETRY)
    camera = endomapper.read_vicalib(write(geometry=text)[0])
    assert camera == el.Pinhole(1440, 1080, 717.6911, 718.0214, 734.7278, 552.0724)


def test_a_light_off_the_axis_is_in_mm(write):
    calibration = endomapper.read_endomapper(*write())
    light = calibration.photometry
    (spot,) = light.lights
    assert_allclose(spot.position, (-0.061, -1.135, -3.612))
    assert_allclose(spot.direction, (0.011092, 0.0, 0.999938), atol=1e-6)
    assert (light.gamma, light.k, light.gain) == (2.2, 0.0, None)
    assert 0.7 * 2.767302 < spot.exponent < 2.767302
    known = calibration.evidence["converted"]
    assert known["geometry"] == "Endoscope_01_geometrical.xml"
    assert known["lights"][0]["mu"] == 2.767302


def test_the_light_falls_as_it_did_there(write):
    """cosⁿψ stands for exp(-μ (1 - cos ψ)): nowhere within 60° is a distance off by more than 6 %."""
    calibration = endomapper.read_endomapper(*write())
    (spot,) = calibration.photometry.lights
    angles = np.deg2rad(np.linspace(0, 60, 61))
    direction = np.asarray(spot.direction)
    side = np.cross(direction, (0, 1, 0))
    side /= np.linalg.norm(side)
    ways = np.cos(angles)[:, None] * direction + np.sin(angles)[:, None] * side
    radiance, distance = spot.illuminate(np.asarray(spot.position) + 30 * ways)
    ratio = radiance * distance**2 / np.exp(-2.767302 * (1 - np.cos(angles)))
    error = np.abs(np.sqrt(ratio) - 1)
    assert error.max() < 0.06
    assert error[:46].max() < 0.05
    told = calibration.evidence["converted"]["lights"][0]["worst_distance_percent"]
    assert told == pytest.approx(100 * error.max(), abs=0.5)


def test_a_light_at_the_centre_becomes_k(write):
    text = PHOTOMETRY.replace("-6.1e-05; -0.001135; -0.003612", "0; 0; 0")
    text = text.replace("0.011092; 0.0; 0.999938", "0; 0; 1")
    plain = endomapper.read_endomapper(*write(photometry=text)).photometry
    assert plain.lights == ()
    assert 1.9 < plain.k < 2.767302
    text = text.replace("</gamma>", "</gamma><vignetting> [ 0.500000 ] </vignetting>")
    vignetted = endomapper.read_endomapper(*write(photometry=text)).photometry
    assert vignetted.k == pytest.approx(plain.k + 0.5)


def test_several_lights_and_an_even_one(write):
    light = PHOTOMETRY[PHOTOMETRY.index("    <light>") : PHOTOMETRY.index("</rig>")]
    even = light.replace("2.767302", "0").replace("1.000000", "0.5")
    both = write(photometry=PHOTOMETRY.replace("</rig>", f"{even}</rig>"))
    _, second = endomapper.read_endomapper(*both).photometry.lights
    assert (second.exponent, second.weight) == (0.0, 0.5)


@pytest.mark.parametrize("mu", [0.1, 1.0, 5.0])
def test_near_the_axis_the_exponent_is_mu(mu):
    exponent, weight, worst = endomapper.cosine_power(mu, np.cos(np.deg2rad(np.linspace(0, 10, 50))))
    assert exponent == pytest.approx(mu, rel=0.01)
    assert weight == pytest.approx(1.0, abs=1e-3)
    assert worst < 1e-3


def refused(read, path, message):
    """In one sentence that names the file."""
    with pytest.raises(ValueError, match=message) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("kb4", "w", "camera_model: expected the type calibu_fu_fv_u0_v0_kb4 or .*found calibu_.*_w"),
        (' type="calibu_fu_fv_u0_v0_kb4"', "", "expected the type .*found None"),
        ("<width> 1440 </width>", "", "camera_model/width: missing"),
        ("1440 <", "14.5 <", "width: expected a whole number of pixels, found 14.5"),
        ("1440 <", "-3 <", "width: expected at least 1, found -3"),
        ("1440 <", "wide <", "width: expected a finite number, found wide"),
        ("717.6911; ", "", r"params: expected 8 finite numbers .*found \[ 718.0214"),
        ("717.6911", "nan", "params: expected 8 finite numbers"),
        ("717.6911", "-717", "params: fx must be positive"),
        ("734.7278", "7347", "params: u0 = 7347 lies outside the picture of 1440 px"),
        ("<params>", "<skew>1</skew><params>", "camera_model/skew: unknown element; expected width"),
        ("</rig>", "<camera><camera_model/></camera></rig>", "rig/camera: expected one, found 2"),
        ("rig>", "cameras>", "expected <rig>, found <cameras>"),
        ("</rig>", "", "not valid XML: no element found"),
    ],
)
def test_a_camera_that_cannot_be_used(write, old, new, message):
    refused(endomapper.read_vicalib, write(old, new, photometry="")[0], message)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"gamma"', '"lut"', "camera_model: expected the type gamma, found lut"),
        ("[ 2.2 ]", "[ 2.2; 2.1 ]", "gamma: expected a finite number"),
        ("[ 2.2 ]", "[ 0 ]", "gamma: expected more than 0, found 0"),
        ("[ 2.2 ]", "[ 2.2", "gamma: expected a finite number"),
        ("</gamma>", "</gamma><vignetting> [ 1; 0.9 ] </vignetting>", "vignetting: expected a finite number"),
        ("</gamma>", "</gamma><exposure/>", "exposure: unknown element; expected gamma, vignetting"),
        ('"sls"', '"point"', "light_model: expected the type sls, found point"),
        ("2.767302", "-1", "mu: expected at least 0, found -1"),
        ("1.000000", "0", "sigma: expected more than 0"),
        ("<mu> 2.767302 </mu>", "", "light_model/mu: missing"),
        ("-0.003612", "-3.612", r"P: expected metres, at most 0.05 m off, found"),
        ("0.999938", "0.5", "D: expected a unit vector that looks forward"),
        ("0.999938", "-0.999938", "D: expected a unit vector that looks forward"),
        ("light>", "lamp>", "rig/lamp: unknown element; expected camera, light"),
        ("<sigma>", "<hue/><sigma>", "hue: unknown element"),
    ],
)
def test_a_light_that_cannot_be_used(write, old, new, message):
    camera = datasets.load_calibration("paper").camera
    refused(lambda path: endomapper.read_photometry(path, camera), write(old, new)[1], message)


def test_no_light_at_all(write):
    start, end = PHOTOMETRY.index("<light>"), PHOTOMETRY.index("</rig>")
    paths = write(photometry=PHOTOMETRY[:start] + PHOTOMETRY[end:])
    with pytest.raises(ValueError, match="rig/light: missing"):
        endomapper.read_endomapper(*paths)


def test_one_file_in_place_of_the_other(write):
    geometry, photometry = write()
    with pytest.raises(ValueError, match=r"expected the type calibu_fu_fv_u0_v0_kb4 .*found gamma"):
        endomapper.read_endomapper(photometry, geometry)
    with pytest.raises(ValueError, match="rig/camera/camera_model: expected the type gamma, found calibu"):
        endomapper.read_endomapper(geometry, geometry)


BOMB = '<!DOCTYPE rig [<!ENTITY a "aaaaaaaa"><!ENTITY b "&a;&a;&a;">]><rig>&b;</rig>'


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (BOMB.encode(), "XML with a document type or entities is not read"),
        (b'<?xml version="1.0"?><!doctype rig SYSTEM "file:///etc/passwd"><rig/>', "document type"),
        (BOMB.encode("utf-16"), "not UTF-8 text"),
        (BOMB.encode("utf-7"), None),
        (b"", "not valid XML"),
        (b"\x00" * 20, "not valid XML"),
        (b"\x89PNG\r\n\x1a\n", "not UTF-8 text"),
        (
            b"<rig>" + b" " * 1_000_000 + b"</rig>",
            "expected a calibration XML of at most 1 MB",
        ),
        (b"<rig>" * 100_000, "not valid XML"),
        (b"<rig>&secret;</rig>", "not valid XML: undefined entity"),
        (b"\xef\xbb\xbf<rig/>", "rig/camera: missing"),
    ],
)
def test_files_that_are_not_read(tmp_path, content, message):
    path = tmp_path / "a_geometrical.xml"
    path.write_bytes(content)
    refused(endomapper.read_vicalib, path, message)


def test_files_that_are_not_there_and_several_of_a_kind(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.xml: there is no such calibration XML"):
        endomapper.read_vicalib(tmp_path / "none.xml")
    with pytest.raises(FileNotFoundError, match=r"expected a file \*_geometrical\.xml"):
        endomapper.find_calibrations(tmp_path)
    for name in ("Endoscope_01", "Endoscope_02"):
        (tmp_path / f"{name}_geometrical.xml").touch()
    with pytest.raises(ValueError, match=r"expected one \*_geometrical\.xml, found 2"):
        endomapper.find_calibrations(tmp_path)


def convert(*arguments):
    try:
        return cli.main(["convert", *map(str, arguments)])
    except SystemExit as exit:
        return exit.code


def test_convert(write, tmp_path, capsys):
    geometry, photometry = write()
    for name, sources in {"a": (geometry, photometry), "b": (geometry.parent,)}.items():
        assert convert(*sources, "--out", tmp_path / f"{name}.json") == 0
    said = capsys.readouterr().out
    assert "γ = 2.2, k = 0, lights: 1" in said
    assert "% of a distance" in said
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    expected = endomapper.read_endomapper(geometry, photometry)
    assert el.Calibration.load(tmp_path / "a.json").to_dict() == expected.to_dict()


def test_convert_the_camera_alone(write, tmp_path, capsys):
    geometry, photometry = write()
    photometry.unlink()
    for source in (geometry, geometry.parent):
        assert convert(source, "--out", tmp_path / "camera.json", "--overwrite") == 0
        assert "the camera alone" in capsys.readouterr().out
        assert read_camera(tmp_path / "camera.json") == endomapper.read_vicalib(geometry)
    assert set(json.loads((tmp_path / "camera.json").read_text())) == {"endolab", "camera"}


def test_convert_replaces_nothing_else_unasked(write, capsys):
    geometry, photometry = write()
    out = geometry.with_name("cal.json")
    out.write_text("mine")
    assert convert(geometry, photometry, "--out", out) == 2
    assert "cal.json is there already; choose another name, or replace it with --overwrite" in (
        capsys.readouterr().err
    )
    assert out.read_text() == "mine"
    assert convert(geometry, photometry, "--out", out, "--overwrite") == 0
    geometry.rename(out)
    assert convert(out, photometry, "--out", out, "--overwrite") == 2
    assert "cal.json is read by this very call" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda g, p: (g, p, "--out", g.parent / "cal.xml"), "the calibration's name ends in .json"),
        (lambda g, p: (g.parent, p, "--out", g.parent / "cal.json"), "name no other"),
        (lambda g, p: (p, "--out", g.parent / "cal.json"), "found gamma"),
        (lambda g, p: (g, p, "--out", g.parent / "no" / "cal.json"), "cannot write"),
    ],
)
def test_convert_refuses(write, capsys, change, message):
    geometry, photometry = write()
    before = sorted(geometry.parent.iterdir())
    assert convert(*change(geometry, photometry)) == 2
    error = capsys.readouterr().err
    assert error.startswith("endolab: ")
    assert error.count("\n") == 1
    assert message in error
    assert sorted(geometry.parent.iterdir()) == before
