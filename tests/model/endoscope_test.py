"""`endoscope.json`: there and back again, and one sentence about whatever is wrong with it."""

import copy
import json

import pytest

import endolab as el

EXAMPLE = """
{"endolab": 1,
 "camera": {"model": "kannala_brandt", "width": 1440, "height": 1080, "fx": 717.21, "fy": 717.48,
            "cx": 735.37, "cy": 552.80, "k": [-0.13893, -0.0012396, 0.00091258, -0.000040716]},
 "photometry": {"k": 2.5, "gamma": 2.2, "gain": null,
                "brdf": {"model": "lambertian", "albedo": [0.75, 0.38, 0.30]}}}
"""
LIGHT = {"position": [4.0, -2.0, 0.5], "direction": [0.0, 0.6, 0.8], "exponent": 1.5, "weight": 2.0}
POLYNOMIAL = (769.2, 0.0, -8.1e-4, 6.3e-7, -1.2e-9)
CAMERAS = {
    "kannala_brandt": el.KannalaBrandt(1440, 1080, 717.21, 717.48, 735.37, 552.8, (-0.139, 1e-3, 0.0, 1e-9)),
    "pinhole": el.Pinhole(320, 240, 160.0, 161.0, 159.5, 119.1),
    "scaramuzza": el.Scaramuzza(1350, 1080, 678.5, 543.0, POLYNOMIAL, 0.99998686, 0.00288, -0.00296),
}
CAMERAS |= {f"{name}, resized": camera.resize(333, 222) for name, camera in CAMERAS.items()}
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
        *path, key = (int(part) if part.isdigit() else part for part in dotted.split("."))
        place = whole
        for part in path:
            place = place[part]
        if value is ...:
            del place[key]
        else:
            place[key] = value
    return whole


def table(theta, value):
    whole = {"model": "tabulated", "theta": theta, "value": value}
    return {key: part for key, part in whole.items() if part is not ...}


def complaint(path, text):
    """The one sentence with which a file of that content is refused, after its name."""
    text = json.dumps(text) if isinstance(text, dict) else text
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises((ValueError, OSError)) as caught:
        el.Calibration.load(path)
    sentence = str(caught.value)
    assert sentence.startswith(f"{path}: ")
    assert "\n" not in sentence
    return sentence.removeprefix(f"{path}: ")


def test_the_example_loads(tmp_path):
    path = tmp_path / "endoscope.json"
    path.write_text(EXAMPLE, encoding="utf-8")
    calibration, k = el.Calibration.load(path), (-0.13893, -0.0012396, 0.00091258, -0.000040716)
    assert calibration.camera == el.KannalaBrandt(1440, 1080, 717.21, 717.48, 735.37, 552.80, k)
    assert calibration.photometry == el.Photometry(2.5, 2.2, None, el.Lambertian((0.75, 0.38, 0.30)))
    assert calibration.evidence == {}
    assert json.loads(json.dumps(calibration.to_dict())) == json.loads(EXAMPLE)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())
@pytest.mark.parametrize("brdf", BRDFS.values(), ids=BRDFS.keys())
def test_what_is_saved_loads_unchanged(tmp_path, camera, brdf):
    for lights, gain in (((), None), (SPOTS, 1234.5678901234567)):
        evidence = {"from": "é", "sd": [1.5, {"k": 0.1}]} if lights else {}
        saved = el.Calibration(camera, el.Photometry(1.1, 2.3, gain, brdf, lights), evidence)
        saved.save(tmp_path / "c.json")
        loaded = el.Calibration.load(tmp_path / "c.json")
        assert (loaded, type(loaded.camera)) == (saved, type(camera))
    assert [path.name for path in tmp_path.iterdir()] == ["c.json"]


def test_the_directions_of_lights_load_unchanged(rng):
    lights = tuple(el.SpotLight(direction=direction) for direction in rng.normal(size=(50, 3)))
    saved = el.Calibration(CAMERAS["pinhole"], el.Photometry(lights=lights))
    assert el.Calibration.from_dict(json.loads(json.dumps(saved.to_dict()))) == saved


def test_saving_again_changes_nothing(tmp_path):
    first, second = tmp_path / "1.json", tmp_path / "2.json"
    el.Calibration(CAMERAS["scaramuzza"], el.Photometry(lights=(el.SpotLight((1, 0, 0)),))).save(first)
    el.Calibration.load(first).save(second)
    assert first.read_bytes() == second.read_bytes()
    json.loads(first.read_text(encoding="utf-8"), parse_constant=pytest.fail)


def test_a_calibration_resizes_with_its_picture():
    calibration = el.Calibration(CAMERAS["pinhole"], el.Photometry(k=1.0), {"a": 1})
    half = calibration.resize(160, 120)
    assert half == el.Calibration(CAMERAS["pinhole"].resize(160, 120), el.Photometry(k=1.0), {"a": 1})


def test_optional_keys():
    light = {key: LIGHT[key] for key in ("position", "direction", "exponent")}
    changes = {"photometry.lights": [light], "photometry.brdf.albedo": ..., "evidence": {"a": [1]}}
    calibration = el.Calibration.from_dict(content(**changes))
    assert calibration.photometry.lights[0].weight == 1.0
    assert calibration.photometry.brdf == el.Lambertian(1.0)
    assert calibration.evidence == {"a": [1]}


NUMBERS = [
    *(f"camera.{key}" for key in ("width", "height", "fx", "fy", "cx", "cy")),
    *(f"photometry.{key}" for key in ("k", "gamma", "gain")),
    *(f"photometry.lights.0.{key}" for key in ("exponent", "weight")),
]
NOT_NUMBERS = {"text": "7", "true": True, "list": [1.0], "object": {}, "huge": 10**400}
NOT_NUMBERS |= {"NaN": float("nan"), "Infinity": float("inf")}
every_no_number = pytest.mark.parametrize("value", NOT_NUMBERS.values(), ids=NOT_NUMBERS)


def named(dotted):
    return dotted.replace(".0.", "[0].")


@every_no_number
@pytest.mark.parametrize("key", NUMBERS)
def test_numbers_are_finite_numbers(tmp_path, key, value):
    sentence = complaint(tmp_path / "c.json", content(**{key: value}))
    assert sentence.startswith(f"{named(key)}: expected a finite number, found ")


@every_no_number
@pytest.mark.parametrize(
    ("key", "count"),
    [("camera.k", 4), ("photometry.lights.0.position", 3), ("photometry.lights.0.direction", 3)],
)
def test_lists_are_of_finite_numbers(tmp_path, key, count, value):
    for wrong in ([value, *[1.0] * (count - 1)], [1.0] * (count - 1), [1.0] * (count + 1), value, None):
        sentence = complaint(tmp_path / "c.json", content(**{key: wrong}))
        assert sentence.startswith(f"{named(key)}: expected {count} finite numbers, found ")


@pytest.mark.parametrize(
    "key",
    [
        *(key for key in NUMBERS if not key.endswith("weight")),
        *("endolab", "camera", "photometry", "camera.model", "camera.k"),
        *("photometry.brdf", "photometry.brdf.model"),
        *("photometry.lights.0.position", "photometry.lights.0.direction"),
    ],
)
def test_a_missing_key(tmp_path, key):
    assert complaint(tmp_path / "c.json", content(**{key: ...})) == f"{named(key)}: missing"


@pytest.mark.parametrize(
    ("key", "expected"),
    [
        ("Camera", "endolab, camera, photometry, evidence"),
        ("camera.f", "model, width, height, fx, fy, cx, cy, k"),
        ("photometry.Gamma", "k, gamma, gain, brdf, lights"),
        ("photometry.brdf.albdo", "model, albedo"),
        ("photometry.lights.0.pos", "position, direction, exponent, weight"),
    ],
)
def test_a_key_that_is_none(tmp_path, key, expected):
    sentence = complaint(tmp_path / "c.json", content(**{key: 1.0}))
    assert sentence == f"{named(key)}: unknown key; expected {expected}"


@pytest.mark.parametrize(
    ("key", "misspelt", "named_as"),
    [
        *(("photometry.k", "kk", "photometry.k"), ("photometry.k", "K", "photometry.k")),
        *(("photometry.gamma", "gama", "photometry.gamma"), ("camera.fx", "f_x", "camera.fx")),
        *(("camera.width", "widht", "camera.width"), ("camera", "camrea", "camera")),
        ("photometry.lights.0.position", "postion", "photometry.lights[0].position"),
    ],
)
def test_a_misspelt_key_is_named_beside_the_one_that_is_missing(tmp_path, key, misspelt, named_as):
    whole = content(**{key: ..., f"{key.rpartition('.')[0]}.{misspelt}".lstrip("."): 1.0})
    assert (
        complaint(tmp_path / "c.json", whole) == f'{named_as}: missing; is "{misspelt}" a misspelling of it?'
    )


def test_all_keys_that_are_none_are_named(tmp_path):
    sentence = complaint(tmp_path / "c.json", content(**{"photometry.bias": 1, "photometry.Alpha": 2}))
    assert sentence.startswith("photometry.Alpha: unknown key (as bias); expected k, gamma, ")


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("endolab", 2, "endolab: expected version 1, found 2"),
        ("endolab", "1", 'endolab: expected version 1, found "1"'),
        ("camera", [], "camera: expected an object"),
        ("camera.model", "fisheye", "camera.model: expected one of kannala_brandt, pinhole, scaramuzza"),
        ("camera.model", ["pinhole"], "camera.model: expected one of"),
        (
            *("camera.model", "pinhol"),
            "camera.model: expected one of kannala_brandt, pinhole, scaramuzza, found",
        ),
        ("camera.width", 0, "camera.width: expected a positive number, found 0"),
        ("camera.width", 12.5, "camera.width: expected a whole number of pixels, found 12.5"),
        ("camera.height", -5, "camera.height: expected a positive number, found -5"),
        ("camera.fx", -1, "camera.fx: expected a positive number, found -1"),
        ("camera.fy", 0, "camera.fy: expected a positive number, found 0"),
        ("photometry.k", -0.1, "photometry.k: expected at least 0, found -0.1"),
        ("photometry.gamma", 0, "photometry.gamma: expected a positive number, found 0"),
        ("photometry.gain", 0, "photometry.gain: expected a positive number, found 0"),
        ("photometry.gain", -2, "photometry.gain: expected a positive number, found -2"),
        ("photometry.brdf", None, "photometry.brdf: expected an object"),
        ("photometry.brdf.model", "phong", "photometry.brdf.model: expected one of lambertian, tabulated"),
        ("photometry.brdf.albedo", -0.1, "photometry.brdf.albedo: expected a positive number"),
        ("photometry.brdf.albedo", [0.5, 0.5], "photometry.brdf.albedo: expected 3 finite numbers"),
        ("photometry.brdf.albedo", 1.1, "photometry.brdf: albedo must lie in (0, 1]"),
        ("photometry.brdf.albedo", [0.5, 0.0, 0.5], "photometry.brdf: albedo must lie in (0, 1]"),
        ("photometry.brdf", table([0, 1], ...), "photometry.brdf.value: missing"),
        ("photometry.brdf", table([0, 1], 1), "photometry.brdf.value: expected a list of finite numbers"),
        ("photometry.brdf", table([0, 1], [1, 1, 1]), "photometry.brdf: theta and value must be lists"),
        ("photometry.brdf", table([1, 0], [1, 1]), "photometry.brdf: theta must increase"),
        ("photometry.brdf", table([0, 2], [1, 1]), "photometry.brdf: theta must increase and end at π/2"),
        ("photometry.brdf", table([0, 1], [1, 0]), "photometry.brdf: every value of the BRDF must be"),
        ("photometry.lights", {}, "photometry.lights: expected a list"),
        ("photometry.lights.0", 3, "photometry.lights[0]: expected an object"),
        ("photometry.lights.0.exponent", -1, "photometry.lights[0].exponent: expected at least 0"),
        ("photometry.lights.0.weight", 0, "photometry.lights[0].weight: expected a positive number"),
        ("photometry.lights.0.direction", [0, 0, 0], "photometry.lights[0]: direction must be"),
        ("camera.width", 1e300, "camera.width: "),
        ("endolab", True, "endolab: expected version 1, found true"),
        ("evidence", [1], "evidence: expected an object"),
    ],
)
def test_a_bad_value(tmp_path, key, value, expected):
    assert complaint(tmp_path / "c.json", content(**{key: value})).startswith(expected)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"a": [769.0, 1.0, 0, 0, 0]}, "camera: a[1] must be 0"),
        ({"a": [-769.0, 0, 0, 0, 0]}, "camera: a[0] must be positive"),
        ({"a": [769.0, 0, 0, 0]}, "camera.a: expected 5 finite numbers"),
        ({"c": -1.0}, "camera: cx, cy, c, d, e must be finite and c - d·e positive"),
        ({"row_scale": -1.0}, "camera.row_scale: expected a positive number"),
        ({"fx": 1.0}, "camera.fx: unknown key"),
    ],
)
def test_a_bad_scaramuzza(tmp_path, change, expected):
    whole = el.Calibration(CAMERAS["scaramuzza"], el.Photometry()).to_dict()
    whole["camera"] |= change
    assert complaint(tmp_path / "c.json", whole).startswith(expected)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "not valid JSON: "),
        ('{"endolab": 1,', "not valid JSON: "),
        (EXAMPLE + "}", "not valid JSON: "),
        ("[1]", "the file: expected an object"),
        (b'{"endolab": "\xe9"}', "not UTF-8 text"),
        (b"\x89PNG\r\n\x1a\n\x00", "not UTF-8 text"),
        ('{"endolab": ' + "1" * 5000 + "}", ""),
        ("[" * 100_000, "not valid JSON: "),
    ],
    ids=["empty", "cut off", "too long", "list", "latin", "binary", "many digits", "deep"],
)
def test_not_a_calibration_at_all(tmp_path, text, expected):
    assert complaint(tmp_path / "c.json", text).startswith(expected)


@pytest.mark.parametrize("name", ["none.json", "."])
def test_no_such_file(tmp_path, name):
    with pytest.raises(FileNotFoundError, match="there is no such calibration file") as caught:
        el.Calibration.load(tmp_path / name)
    assert str(caught.value).startswith(str(tmp_path / name))


@pytest.mark.parametrize("target", ["missing/c.json", "file/c.json", "folder"])
def test_where_it_cannot_be_written_nothing_is_left(tmp_path, target):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "folder").mkdir()
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(OSError, match=r"cannot write .*: \w"):
        el.Calibration(CAMERAS["pinhole"], el.Photometry()).save(tmp_path / target)
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("brdf", "evidence", "message"),
    [(el.Glossy(), {}, "Lambertian or tabulated"), (el.Lambertian(), {"sd": float("nan")}, "JSON")],
)
def test_what_a_file_cannot_hold_leaves_the_old_one(tmp_path, brdf, evidence, message):
    path = tmp_path / "c.json"
    path.write_text("old")
    with pytest.raises(ValueError, match=message):
        el.Calibration(CAMERAS["pinhole"], el.Photometry(brdf=brdf), evidence).save(path)
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("c.json", "old")]
