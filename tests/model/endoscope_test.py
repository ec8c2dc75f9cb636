"""`endoscope.json`: there and back again, and one sentence about whatever is wrong with it."""

import copy
import json

import pytest

import endolab as el
from endolab.model.brdf import Glossy

EXAMPLE = """
{"endolab": 1,
 "camera": {"model": "kannala_brandt", "width": 1440, "height": 1080, "fx": 717.21, "fy": 717.48,
            "cx": 735.37, "cy": 552.80, "k": [-0.13893, -0.0012396, 0.00091258, -0.000040716]},
 "photometry": {"k": 2.5, "gamma": 2.2, "gain": null,
                "brdf": {"model": "lambertian", "albedo": [0.75, 0.38, 0.30]}}}
"""
LIGHT = {
    "position": [4.0, -2.0, 0.5],
    "direction": [0.0, 0.6, 0.8],
    "exponent": 1.5,
    "weight": 2.0,
}
POLYNOMIAL = (769.2, 0.0, -8.1e-4, 6.3e-7, -1.2e-9)
CAMERAS = {
    "kannala_brandt": el.KannalaBrandt(
        1440, 1080, 717.21, 717.48, 735.37, 552.8, (-0.139, 1e-3, 0.0, 1e-9)
    ),
    "pinhole": el.Pinhole(320, 240, 160.0, 161.0, 159.5, 119.1),
    "brown_conrady": el.BrownConrady(
        640, 480, 420.0, 425.0, 310.0, 245.0, (-0.3, 0.1, 1e-3, 1e-9, 0.0)
    ),
    "scaramuzza": el.Scaramuzza(
        1350, 1080, 678.5, 543.0, POLYNOMIAL, 0.99998686, 0.00288, -0.00296
    ),
}
CAMERAS |= {
    f"{name}, resized": camera.resize(333, 222) for name, camera in CAMERAS.items()
}
BRDFS = {
    "one albedo": el.Lambertian(0.3),
    "three": el.Lambertian((0.75, 0.38, 0.30)),
    "table": el.TabulatedBRDF((0.0, 0.1, 1.5), (0.3, 0.2, 1 / 3)),
}
SPOTS = (el.SpotLight((1, 2, 3), (0.0, 0.6, 0.8), 1.7, 0.3), el.SpotLight())


def content(**changes):
    """The example with one light, and values at dotted keys changed; ... takes a key out."""
    whole = json.loads(EXAMPLE)
    whole["photometry"]["lights"] = [copy.deepcopy(LIGHT)]
    for dotted, value in changes.items():
        *path, key = (
            int(part) if part.isdigit() else part for part in dotted.split(".")
        )
        place = whole
        for part in path:
            place = place[part]
        if value is ...:
            del place[key]
        else:
            place[key] = value
    return whole


def complaint(path, text):
    """The one sentence with which a file of that content is refused, after its name."""
    text = json.dumps(text) if isinstance(text, dict) else text
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises((ValueError, OSError)) as caught:
        el.load_calibration(path)
    sentence = str(caught.value)
    assert sentence.startswith(f"{path}: ")
    assert "\n" not in sentence
    assert len(sentence) < 500 + len(str(path))
    return sentence.removeprefix(f"{path}: ")


def test_the_example_loads(tmp_path):
    path = tmp_path / "endoscope.json"
    path.write_text(EXAMPLE, encoding="utf-8")
    calibration = el.load_calibration(path)
    k = (-0.13893, -0.0012396, 0.00091258, -0.000040716)
    assert calibration.camera == el.KannalaBrandt(
        1440, 1080, 717.21, 717.48, 735.37, 552.80, k
    )
    assert calibration.photometry == el.Photometry(
        2.5, 2.2, None, el.Lambertian((0.75, 0.38, 0.30))
    )
    assert calibration.evidence == {}
    assert json.loads(json.dumps(calibration.to_dict())) == json.loads(EXAMPLE)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())
@pytest.mark.parametrize("brdf", BRDFS.values(), ids=BRDFS.keys())
def test_what_is_saved_loads_unchanged(tmp_path, camera, brdf):
    for lights, gain in (((), None), (SPOTS, 1234.5678901234567)):
        evidence = {"from": "é", "sd": [1.5, {"k": 0.1}]} if lights else {}
        saved = el.Calibration(
            camera, el.Photometry(1.1, 2.3, gain, brdf, lights), evidence
        )
        el.write_calibration(saved, tmp_path / "c.json")
        loaded = el.load_calibration(tmp_path / "c.json")
        assert (loaded, type(loaded.camera)) == (saved, type(camera))


def test_optional_keys():
    light = {key: LIGHT[key] for key in ("position", "direction", "exponent")}
    changes = {
        "photometry.lights": [light],
        "photometry.brdf.albedo": ...,
        "evidence": {"a": [1]},
    }
    calibration = el.Calibration.from_dict(content(**changes))
    assert calibration.photometry.lights[0].weight == 1.0
    assert calibration.photometry.brdf == el.Lambertian(1.0)
    assert calibration.evidence == {"a": [1]}


NUMBERS = (
    "camera.width",
    "camera.fx",
    "photometry.gamma",
    "photometry.gain",
    "photometry.lights.0.exponent",
)
LISTS = ("camera.k", "photometry.lights.0.position")
SECTIONS = (
    "endolab",
    "camera",
    "camera.model",
    "photometry.brdf",
    "photometry.brdf.model",
)


def named(dotted):
    return dotted.replace(".0.", "[0].")


@pytest.mark.parametrize(
    "value",
    ["7", True, [1.0], {}, 10**400, float("nan"), "x" * 10**6],
    ids=lambda v: str(v)[:9],
)
def test_numbers_and_lists_are_of_finite_numbers(tmp_path, value):
    for key in (*NUMBERS, *LISTS):
        assert complaint(tmp_path / "c.json", content(**{key: value})).startswith(
            f"{named(key)}: "
        )
    for key in LISTS:
        assert complaint(tmp_path / "c.json", content(**{key: [value] * 4})).startswith(
            f"{named(key)}: "
        )


@pytest.mark.parametrize("key", [*NUMBERS, *LISTS, *SECTIONS])
def test_a_missing_key(tmp_path, key):
    assert complaint(tmp_path / "c.json", content(**{key: ...})).startswith(
        f"{named(key)}: missing"
    )


@pytest.mark.parametrize(
    ("key", "meant"),
    [
        *(("Camera", "camera"), ("camera.f", "fx"), ("photometry.Gamma", "gamma")),
        *(("photometry.brdf.albdo", "albedo"), ("photometry.lights.0.pos", "position")),
    ],
)
def test_a_key_that_is_none_is_told_what_there_is(tmp_path, key, meant):
    known, could_be = complaint(tmp_path / "c.json", content(**{key: 1.0})).split(
        "; expected "
    )
    assert known.startswith(f"{named(key)}: ")
    assert meant in could_be.split(", ")


def test_a_misspelt_key_is_named_beside_the_one_that_is_missing(tmp_path):
    whole = content(**{"camera.fx": ..., "camera.f_x": 1.0})
    sentence = complaint(tmp_path / "c.json", whole)
    assert sentence.startswith("camera.fx: missing")
    assert "f_x" in sentence


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("endolab", 2, "endolab: "),
        ("camera", [], "camera: "),
        ("camera.model", "fisheye", "camera.model: "),
        ("camera.model", ["pinhole"], "camera.model: "),
        ("camera.width", 0, "camera.width: "),
        ("camera.width", 1e300, "camera.width: "),
        ("camera.fx", -1, "camera: fx "),
        ("photometry.k", -0.1, "photometry: k "),
        ("photometry.gain", 0, "photometry: gain "),
        ("photometry.brdf", None, "photometry.brdf: "),
        ("photometry.brdf.model", "phong", "photometry.brdf.model: "),
        ("photometry.brdf.albedo", [0.5, 0.5], "photometry.brdf.albedo: "),
        (
            "photometry.brdf",
            {"model": "tabulated", "theta": [1, 0], "value": [1, 1]},
            "photometry.brdf: theta ",
        ),
        ("photometry.lights", {}, "photometry.lights: "),
        ("photometry.lights.0", 3, "photometry.lights[0]: "),
        ("photometry.lights.0.weight", 0, "photometry.lights[0]: weight "),
        ("evidence", [1], "evidence: "),
    ],
)
def test_a_bad_value(tmp_path, key, value, message):
    assert complaint(tmp_path / "c.json", content(**{key: value})).startswith(message)


@pytest.mark.parametrize(
    "text", ["", EXAMPLE + "}", "[1]", b'{"endolab": "\xe9"}', "[" * 100_000]
)
def test_not_a_calibration_at_all(tmp_path, text):
    assert complaint(tmp_path / "c.json", text)


@pytest.mark.parametrize(
    ("brdf", "evidence", "message"),
    [(Glossy(), {}, "BRDF"), (el.Lambertian(), {"sd": float("nan")}, "JSON")],
)
def test_what_a_file_cannot_hold_leaves_the_old_one(tmp_path, brdf, evidence, message):
    path = tmp_path / "c.json"
    path.write_text("old")
    with pytest.raises(ValueError, match=message):
        el.write_calibration(
            el.Calibration(CAMERAS["pinhole"], el.Photometry(brdf=brdf), evidence), path
        )
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("c.json", "old")]
