"""The tuner's widget without a page: what is sent, kept and written."""

import contextlib
import json
import runpy
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

import endolab as el
from endolab.cli import main as cli
from endolab.io.images import write_image
from endolab.io.settings import SolvingSettings, read_settings
from endolab.io.surfaces import read_depth
from endolab.reconstruction.settings import option_types
from endolab.solvers.problem import NONE
from endolab.workbench.tuning.maps import rgba, still_of
from endolab.workbench.tuning.messages import MESSAGES
from endolab.workbench.tuning.source import Knobs, Source
from endolab.workbench.tuning.widget import KNOBS, TunerBox

SAID = {row["name"]: row.get("fields") for row in MESSAGES["says"]}
GREEN = {"channel": "green", "contours": False}


@pytest.fixture
def tune(seen):
    """Function that makes a tuner whose page paints at once; returns it and the messages."""
    made = []

    def tune(*given, **options):
        box = TunerBox(*(given or seen[:2]), **({"width": 160} | options))
        made.append(box)
        messages = []

        def send(message, buffers=()):
            for name, value in message.items():
                for one in value if name == "chips" else [value]:
                    assert SAID[name] is None or {*one} <= {*SAID[name]}
            messages.append((message, buffers))
            box._free.set()

        box.send = send
        box.turn(GREEN)
        box.engine.wait(60)
        return box, messages

    yield tune
    for box in made:
        box.close()


def turn(box, **values):
    """Turn knobs as the page does, which says all of them."""
    box.follow(json.loads(json.dumps(vars(box.knobs) | values)))
    box.engine.wait(60)


def test_what_code_turns_the_page_is_told_before_its_answer(tune):
    box, messages = tune()
    messages.clear()
    box.turn({"lam": 0.1})
    box.engine.wait(60)
    (first, _), *later = messages
    assert first["knobs"]["lam"] == 0.1
    assert [one["asked"] for one, _ in later if "asked" in one][-1] == first["knobs"]
    assert sum("knobs" in one for one, _ in messages) == 1


def test_each_map_that_a_panel_can_show_is_numbers_or_a_picture_of_the_frames_size(
    tune,
):
    box, messages = tune()
    box._hear(box, {"do": "panels", "given": [list(box.facts["panels"])]}, [])
    box._hear(box, {"do": "sigma", "given": []}, [])
    box.engine.wait(120)
    arrays = {}
    for message, buffers in messages:
        for (name, kind), content in zip(
            message.get("names", []), buffers, strict=True
        ):
            arrays[name] = np.frombuffer(content, "f4" if kind == "f4" else "u1")
    size = box.answer.result.mask.size
    for name in ("distance", "model - frame", "spread over λ", "bounced light", "σ"):
        assert arrays[name].size == size
        assert np.isfinite(arrays[name]).any()
    for name in ("normals", "contours", "what determined each pixel", "picture"):
        assert arrays[name].size == 4 * size
    shown = box.answer.result.distance.ravel().astype("f4")
    assert np.array_equal(arrays["distance"], shown, equal_nan=True)


def test_all_that_is_left_out_is_hatched_on_the_frame(seen):
    """Rectangles were; what lies outside a mask, and highlights that are ignored, were not."""
    problem = el.reconstruct(*seen[:2], solver="facing").problem
    evidence = np.zeros(problem.mask.shape, np.int8)
    evidence[40:60, 60:80] = NONE
    mask = problem.mask & (np.arange(160) > 40)
    given = replace(problem, mask=mask, evidence=evidence)
    changed = still_of(given, None)[1]["picture"] != rgba(given.shown)
    hatched = changed.any(axis=-1)
    for left_out in (~mask, evidence == NONE):
        assert 0.1 < hatched[left_out].mean() < 0.3
    assert not hatched[mask & (evidence != NONE)].any()


@pytest.mark.parametrize(
    ("what", "turned"),
    [
        ("file", {}),
        ("file", {"lam": 0.2, "k": 2.2, "regulariser": "first"}),
        ("scene", {"noise": 2.0, "gain": 1.5}),
        ("nominal", {"fov": 100, "median_distance": 40.0}),
        ("nominal", {"left_out": [[0.5, 0.0, 0.7, 0.4]]}),
    ],
    ids=["anew", "held", "scene", "fov and length", "rectangle"],
)
def test_what_is_exported_is_what_is_shown_to_the_bit(
    tune, seen, tmp_path, what, turned
):
    frame, calibration, _ = seen
    write_image(tmp_path / "f.png", frame.image)
    if what == "file":
        box, _ = tune(frame, calibration, pictures=[tmp_path / "f.png"])
    elif what == "scene":
        box, _ = tune(None, el.load_calibration("paper"), scene="tube")
    else:
        box, _ = tune(frame, el.nominal_calibration(frame, 140))
    if turned:
        turn(box, **turned)
    out = box.export(tmp_path / "out", board=b"png")
    shown = np.where(box.answer.result.mask, box.answer.result.distance, np.nan)
    assert np.isnan(shown[20, 100]) == ("left_out" in turned)
    by_code = runpy.run_path(str(out / "result.py"))["result"]
    assert np.array_equal(by_code.distance, shown, equal_nan=True)
    picture = "f.png" if what == "file" else "frame.png"
    command = f"reconstruct {out}/{picture} --calibration {out}/endoscope.json"
    command += f" --settings {out}/settings.json"
    assert cli.main([*command.split(), "--out", str(tmp_path / "again")]) == 0
    again = read_depth(tmp_path / "again/depth.npz")["distance"]
    assert np.array_equal(again, shown.astype("f4"), equal_nan=True)
    recorded = el.read_recording(out / "recording.rrd")
    assert list(recorded.runs) == [""]
    names = {path.name for path in out.iterdir()}
    assert {"board.png", "depth.npz", "overview.png", "report.json"} <= names
    assert "found.npz" in names


def test_what_cannot_be_drawn_costs_no_export(tune, tmp_path, monkeypatch):
    box, messages = tune()
    monkeypatch.delattr("endolab.workbench.reports.result.overview")
    monkeypatch.delattr("endolab.workbench.recording.recorder.paint")
    box._hear(box, {"do": "export", "given": [str(tmp_path / "out"), ""]}, [])
    box.engine.wait(60)
    message, _ = messages[-1]
    assert message["tone"] == "endolab-wrong"
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"depth.npz", "report.json", "result.py"} <= names
    warnings = json.loads((tmp_path / "out/report.json").read_text())["warnings"]
    for lost in ("overview.png", "recording.rrd"):
        assert lost not in names
        assert lost in message["line"]
        assert lost in " ".join(warnings)


def test_an_export_answers_for_its_picture_alone_and_options_win(
    tune, seen, tmp_path, monkeypatch, capsys
):
    """It answered for the exported picture, whatever picture it was given."""
    monkeypatch.chdir(tmp_path)
    frame, calibration, _ = seen
    Path("film").mkdir()
    write_image("f.png", frame.image)
    write_image("film/0.png", np.flip(frame.image, axis=1))
    write_image("m.png", np.arange(160) < np.full((120, 1), 80))
    box, _ = tune(frame, calibration, pictures=[Path("f.png")], width=80)
    turn(box, lam=0.2, k=2.2, median_distance=40.0)
    box.export("o", board=b"png")
    saved = read_settings("o/settings.json")
    narrow = {"width": 64, "channel": "red", "contours": True, "smooth": 1.0}
    narrow |= {"highlights": "ignore"}
    beside = {"mask": "m.png", "calibration": "simple", "albedo": 0.4}
    for picture, options, anew in (
        ("f.png", {"lam": 0.5, "xi": "d", "median_distance": 30.0}, ""),
        ("f.png", narrow, "is width, channel, contours, highlights, smooth\n"),
        ("f.png", beside, "is mask, camera, wall\n"),
        ("film/0.png", {}, "is picture"),
        ("film", {}, "in each frame"),
    ):
        typed = {"calibration": "o/endoscope.json", "settings": "o/settings.json"}
        typed |= {"out": "again"} | options
        words = [f"--{name.replace('_', '-')}={one}" for name, one in typed.items()]
        words = ["reconstruct", picture, *words]
        assert cli.main([one.replace("=True", "=yes") for one in words]) == 0
        printed = capsys.readouterr().out
        assert ("found anew" in printed) == (anew != "")
        assert anew in printed
        [path] = Path("again").rglob("depth.npz")
        albedo = {name: options.pop(name) for name in ["albedo"] if name in options}
        mask = options.pop("mask", saved.mask if picture == "f.png" else None)
        known = el.load_calibration(options.pop("calibration", "o/endoscope.json"))
        known = SolvingSettings({}, saved.photometry | albedo).apply(known)
        shown = el.read_frame(
            "film/0.png" if "film" in picture else picture, None, mask
        )
        solve = partial(el.reconstruct, shown)
        if not anew:
            solve = partial(el.solve_found, el.load_found(saved.found))
        expected = solve(known, **saved.keywords | options).distance
        again = read_depth(path)["distance"]
        np.testing.assert_array_equal(again, expected.astype("f4"))
        shutil.rmtree("again")


def test_a_page_without_python_holds_all_lams(tune, tmp_path):
    box, _ = tune()
    page = box.export_html(tmp_path / "tuner.html").read_text()
    assert page.count('"regulariser": "first"') == 21
    assert "http" not in page.replace("http://www.w3.org", "")
    assert len(page) < 7e6 * (160 / 320) ** 2  # bytes


@pytest.mark.parametrize(
    ("action", "word"),
    [
        ({"do": "turn", "given": [{"known_distance": "near"}]}, "known_distance"),
        ({"do": "turn", "given": [{"lam": -1}]}, "lam"),
        ({"do": "destroy", "given": []}, "destroy"),
        ({"do": "export", "given": [__file__, ""]}, "under another name"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line_and_the_next_is_done(
    tune, action, word
):
    box, messages = tune()
    box._hear(box, action, [])
    box.engine.wait(60)
    wrong = [m for m, _ in messages if m.get("tone") == "endolab-wrong"]
    assert word in wrong[-1]["line"]
    assert "\n" not in wrong[-1]["line"]
    turn(box, known_distance=None, lam=0.3)
    assert box.answer.settings.lam == 0.3


def test_truth_is_of_the_frame(seen):
    frame, calibration, truth = seen
    with pytest.raises(ValueError, match="truth"):
        TunerBox(frame, calibration, truth[:-1])
    with pytest.raises(ValueError, match="truth"):
        TunerBox(frame, calibration, replace(frame).image[..., 0] * -1.0)


def test_the_field_of_view_of_a_nominal_camera_turns_and_no_others(tune, seen):
    frame = seen[0]
    box, _ = tune(frame, el.nominal_calibration(frame, 140))
    before = box.answer.result
    turn(box, fov=100)
    mask = before.problem.mask
    angles = [
        np.arccos(one.problem.field.cos_alpha[mask])
        for one in (before, box.answer.result)
    ]
    np.testing.assert_allclose(angles[1], angles[0] * 100 / 140, atol=1e-6)
    known, _ = tune()
    assert "fov" not in [spec["name"] for spec in known.facts["specs"]]


def test_a_frame_that_nobody_calibrated_is_of_a_nominal_endoscope(seen):
    """Whatever its shape, as in the app."""
    frame = el.Frame(seen[0].image[:60], seen[0].mask[:60])
    with contextlib.closing(el.tune(frame, width=64)) as box:
        box.engine.wait(60)
        assert "camera" in box.answer.result.report.nominal


def test_each_size_of_picture_has_a_nominal_camera(seen, tmp_path):
    """A size that was not among the few that were looked at first was refused."""
    paths = [tmp_path / "wide.png", tmp_path / "tall.png"]
    for path, columns in zip(paths, (160, 90), strict=True):
        write_image(path, seen[0].image[:, :columns])
    frame = el.read_frame(paths[0])
    source = Source(el.nominal_calibration(frame), frame, None, paths)
    camera = source.subject(Knobs(scene=1)).calibration.camera
    assert (camera.width, camera.height) == (90, 120)


def test_controls_offer_what_settings_take():
    for spec in KNOBS:
        kind = option_types().get(spec["name"])
        parts = [one for part in (kind, *get_args(kind)) for one in get_args(part)]
        offered = [
            one if isinstance(one, str) else one[1] for one in spec.get("options", ())
        ]
        assert {part for part in parts if isinstance(part, str)} <= {*offered}
