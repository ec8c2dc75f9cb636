"""EndoMapper's calibration files: what their numbers mean here, and which files are refused."""

import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose

import endolab as el
from endolab.cli import main as cli
from endolab.io.datasets import endomapper

# Written as Vicalib does; the numbers are of the data set's Endoscope_01.
GEOMETRY = """<rig>
    <camera>
        <camera_model name="" index="0" serialno="0" type="calibu_fu_fv_u0_v0_kb4" version="8">
            <width> 1440 </width>
            <height> 1080 </height>
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

    def files(old="", new=""):
        folder = tmp_path / "Endoscope_01"
        folder.mkdir(exist_ok=True)
        paths = []
        for kind, text in {
            "geometrical": GEOMETRY,
            "photometrical": PHOTOMETRY,
        }.items():
            paths.append(folder / f"Endoscope_01_{kind}.xml")
            paths[-1].write_text(text.replace(old, new), encoding="utf-8")
        return paths

    return files


def test_a_light_off_the_axis_is_in_mm(write):
    light = endomapper.read_endomapper(*write()).photometry
    (spot,) = light.lights
    assert_allclose(spot.position, (-0.061, -1.135, -3.612))
    assert_allclose(spot.direction, (0.011092, 0.0, 0.999938), atol=1e-6)
    assert (light.gamma, light.k, light.gain) == (2.2, 0.0, None)


def test_the_light_falls_as_it_did_there(write):
    """cosⁿψ stands for exp(-μ (1 - cos ψ)): nowhere within 60° is a distance off by more than 6 %."""
    (spot,) = endomapper.read_endomapper(*write()).photometry.lights
    angles = np.deg2rad(np.linspace(0, 60, 61))
    direction = np.asarray(spot.direction)
    side = np.cross(direction, (0, 1, 0))
    ways = np.outer(np.cos(angles), direction)
    ways += np.outer(np.sin(angles), side / np.linalg.norm(side))
    radiance, distance = spot.illuminate(np.asarray(spot.position) + 30 * ways)
    ratio = radiance * distance**2 / np.exp(-2.767302 * (1 - np.cos(angles)))
    assert np.abs(np.sqrt(ratio) - 1).max() < 0.06


def test_a_light_at_the_centre_becomes_k(write, monkeypatch):
    text = PHOTOMETRY.replace("-6.1e-05; -0.001135; -0.003612", "0; 0; 0")
    text = text.replace("0.011092; 0.0; 0.999938", "0; 0; 1")
    monkeypatch.setattr(sys.modules[__name__], "PHOTOMETRY", text)
    plain = endomapper.read_endomapper(*write()).photometry
    assert plain.lights == ()
    assert 1.9 < plain.k < 2.767302
    more = "</gamma><vignetting> [ 0.500000 ] </vignetting>"
    vignetted = endomapper.read_endomapper(*write("</gamma>", more)).photometry
    assert vignetted.k == pytest.approx(plain.k + 0.5)


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("kb4", "w", "no lens"),
        ("717.6911", "nan", "finite"),
        ("<mu> 2.767302 </mu>", "", "sls"),
    ],
)
def test_what_cannot_be_used_is_one_sentence(write, old, new, word):
    with pytest.raises(ValueError, match=rf"^[^\n]*metrical\.xml: [^\n]*{word}[^\n]*$"):
        endomapper.read_endomapper(*write(old, new))


def test_convert(write, tmp_path):
    geometry, photometry = write()
    out = tmp_path / "a.json"
    assert cli.main(["convert", str(geometry.parent), "--out", str(out)]) == 0
    expected = endomapper.read_endomapper(geometry, photometry)
    assert el.load_calibration(out).to_dict() == expected.to_dict()
