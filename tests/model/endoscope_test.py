"""`endoscope.json`: there and back again."""

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab.io.datasets import CALIBRATIONS
from endolab.model.brdf import Glossy

EXAMPLE = """
{"endolab": 1,
 "camera": {"model": "kannala_brandt", "width": 1440, "height": 1080, "fx": 717.21, "fy": 717.48,
            "cx": 735.37, "cy": 552.80, "k": [-0.13893, -0.0012396, 0.00091258, -0.000040716]},
 "photometry": {"k": 2.5, "gamma": 2.2, "gain": null,
                "brdf": {"model": "lambertian", "albedo": [0.75, 0.38, 0.30]}}}
"""
BROWN = el.BrownConrady(640, 480, 420.0, 425.0, 310.0, 245.0, (-0.3, 0.1, 1e-3, 1e-9))
CAMERAS = [*(one.camera for one in CALIBRATIONS.values()), BROWN]
BRDFS = {
    "one albedo": el.Lambertian(0.3),
    "three": el.Lambertian((0.75, 0.38, 0.30)),
    "table": el.TabulatedBRDF((0.0, 0.1, 1.5), (0.3, 0.2, 1 / 3)),
    "wet": Glossy(0.5, 0.1, 30.0),
}
SPOTS = (el.SpotLight((1, 2, 3), (0.0, 0.6, 0.8), 1.7, 0.3), el.SpotLight())


def test_numpys_numbers_and_lists_are_taken():
    table = el.TabulatedBRDF(np.array([0, 0.5]), [1, np.float32(0.5)])
    light = el.Photometry(np.float32(0.25), np.array(2), np.int64(7), table)
    table = el.TabulatedBRDF((0.0, 0.5), (1.0, 0.5))
    assert light == el.Photometry(0.25, 2.0, 7.0, table)
    assert hash(light) == hash(pickle.loads(pickle.dumps(light)))


def test_the_example_loads(tmp_path):
    path = tmp_path / "endoscope.json"
    path.write_text(EXAMPLE, encoding="utf-8")
    calibration = el.load_calibration(path)
    k = (-0.13893, -0.0012396, 0.00091258, -0.000040716)
    camera = el.KannalaBrandt(1440, 1080, 717.21, 717.48, 735.37, 552.80, k)
    light = el.Photometry(2.5, 2.2, None, el.Lambertian((0.75, 0.38, 0.30)))
    assert calibration == el.Calibration(camera, light, {})
    content = json.loads(EXAMPLE)
    del content["photometry"]["brdf"]["albedo"], content["photometry"]["gain"]
    found = el.Calibration.from_dict(content).photometry
    assert found == replace(light, brdf=el.Lambertian(1.0))


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.model)
@pytest.mark.parametrize("brdf", BRDFS.values(), ids=BRDFS)
def test_what_is_saved_loads_unchanged(tmp_path, camera, brdf):
    for lights, gain in (((), None), (SPOTS, 1234.5678901234567)):
        evidence = {"from": "é", "sd": [1.5, {"k": 0.1}]} if lights else {}
        saved = el.Calibration(
            camera, el.Photometry(1.1, 2.3, gain, brdf, lights), evidence
        )
        el.write_calibration(saved, tmp_path / "c.json")
        loaded = el.load_calibration(tmp_path / "c.json")
        assert (loaded, type(loaded.camera)) == (saved, type(camera))
