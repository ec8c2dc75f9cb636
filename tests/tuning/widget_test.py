"""The tuner's widget without a browser: knobs, picture, status line, export, what cannot be read."""

import gc
import threading
import time
from dataclasses import replace
from types import SimpleNamespace

import cv2
import ipywidgets
import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.io.atomic import as_json
from endolab.plots.scales import DECIDERS
from endolab.trust.choice_of_lam import LamCurve
from endolab.tuning.engine import Tuner
from endolab.tuning.panels import BESIDES, Cut, contrast, limits_of, outcome_board, spots, summary
from endolab.tuning.pictures import (
    COLOURS,
    EDGE,
    HEIGHT,
    LEFT_OUT,
    TITLE,
    WIDTH,
    board,
    coloured,
    curve_panel,
    grey_or_colour,
    map_panel,
    panel,
    ticks,
)
from endolab.tuning.source import Settings


@pytest.fixture
def make():
    """Function that makes a tuner of few pixels; all are closed at the end."""
    made = []

    def make(*given, **options):
        made.append(el.tune(*given, **{"scene": "tube", "width": 160} | options))
        return made[-1]

    yield make
    for box in made:
        box.close()


@pytest.fixture(scope="module")
def seen():
    """A frame of a tube, its calibration and its true distance."""
    small = datasets.load_calibration("paper").resize(160, 120)
    view = el.render(el.SCENES["tube"], small.camera, small.photometry, noise=1, bits=8)
    return el.Frame(view.image, view.mask), el.Calibration(view.camera, view.photometry), view.distance


def decoded(image):
    return cv2.imdecode(np.frombuffer(image.value, np.uint8), cv2.IMREAD_COLOR)


def until(condition, seconds=20):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.02)
    assert condition()


def test_a_moved_knob_changes_the_picture_and_the_line(make):
    box = make()
    box.engine.wait(30)
    first, line = box.pair.picture.value, box.status.value
    assert decoded(box.pair.picture).shape == (548, 1176, 3)
    assert "median error" in line
    assert "fine" in line
    for name, value in (("lam", 0.1), ("xi", "d"), ("noise", 2.0), ("k", 3.0), ("solver", "fast_marching")):
        box.knobs[name].value = value
        assert getattr(box.engine.wait(30).settings, name) == value
        assert box.pair.picture.value != first
        first = box.pair.picture.value
    assert box.engine.complaint == ""


def test_the_section_moves_without_a_solve(make):
    box = make()
    final = box.engine.wait(30)
    before = box.pair.picture.value
    box.knobs["section"].value = 30
    box.knobs["across"].value = "row"
    assert box.pair.picture.value != before
    assert box.engine.wait(1) is final


def test_sliders_at_their_ends_say_a_sentence_at_most(make):
    box = make()
    for name in ("lam", "epsilon", "noise", "k", "gamma", "gain", "section"):
        for end in ("min", "max"):
            knob = box.knobs[name]
            before, limit = knob.value, getattr(knob, end)
            knob.value = 10.0**limit if name in ("lam", "epsilon", "gain") else limit
            outcome = box.engine.wait(30)
            assert outcome.error is None or "\n" not in outcome.error
            knob.value = before
    assert (box.engine.wait(30).error, box.engine.complaint) == (None, "")


def test_an_error_is_a_line_and_the_picture_stays(make, seen):
    frame, calibration, _ = seen
    box = make(el.Frame(frame.image[..., 1], frame.mask), calibration)
    box.engine.wait(30)
    before = box.pair.picture.value
    box.knobs["channel"].value = "red"
    box.engine.wait(30)
    assert "grey and has no red channel" in box.status.value
    assert box.pair.picture.value == before
    box.knobs["channel"].value = ""
    box.engine.wait(30)
    assert "energy" in box.status.value


def test_a_frame_with_truth_shows_its_error(make, seen):
    frame, calibration, truth = seen
    box = make(frame, calibration, truth)
    assert box.settings().scene is None
    assert box.engine.wait(30).median_error < 5
    assert box.knobs["noise"].disabled
    box.knobs["scene"].value = "plane"
    assert box.engine.wait(30).settings.scene == "plane"
    assert not box.knobs["noise"].disabled


def test_a_is_kept_beside_with_the_same_colours_and_dropped_again(make):
    box = make()
    box.engine.wait(30)
    pair = box.pair
    box.keeper.click()
    kept = pair.picture_kept.value
    assert kept == pair.picture.value
    assert decoded(pair.picture).shape == (822, 784, 3)
    box.knobs["gain"].value = 3.0
    outcome = box.engine.wait(30)
    assert pair.picture_kept.value == kept
    assert pair.picture.value != kept
    assert pair.limits(outcome) == limits_of(pair.kept)
    assert limits_of(outcome) != pair.limits(outcome)
    assert pair.children[0].layout.display is None
    assert pair.children[0].layout.flex == pair.children[1].layout.flex
    assert pair.picture_kept.caption.startswith("A: λ = 1, gain × 1 · median error")
    assert pair.picture.caption.startswith("B (now): λ = 1, gain × 3 · median error")
    box.keeper.click()
    assert (pair.kept, pair.children[0].layout.display) == (None, "none")
    assert (pair.picture.caption, decoded(pair.picture).shape) == ("", (548, 1176, 3))
    assert box.keeper.description == "keep as A"


def test_a_without_a_truth_has_the_same_axes_of_the_section(outcome):
    blind = replace(outcome, subject=replace(outcome.subject, truth=None))
    iterate = blind.result.iterate
    twice = replace(iterate, log_distance=iterate.log_distance + 0.7)
    other = replace(blind, result=replace(blind.result, iterate=twice))
    shown = (blind, None), (other, None), (other, limits_of(blind))
    panels = [outcome_board(one, Cut(), limits)[274:, 392:784] for one, limits in shown]
    numbers = [panel[-38:-12].astype(int) for panel in panels]  # below the axis
    assert (numbers[0] != numbers[1]).any()
    assert (numbers[0] == numbers[2]).all()


def test_what_differs_is_said_and_one_iteration_is_not_many(outcome):
    one, other = Settings(scene=None, k=None, solver="primal_dual"), Settings(scene=None, k=3.0)
    assert contrast(one, other) == "λ = 1, k = as calibrated, solver = primal-dual"
    assert contrast(other, one) == "λ = 1, k = 3, solver = Gauss-Newton"
    assert summary(outcome).count(f"{outcome.result.iterations} iterations") == 1
    once = replace(outcome, result=replace(outcome.result, history=[{"k": 1}]))
    assert "1 iteration ·" in summary(once)


def test_the_pointer_moves_the_section(make):
    box = make()
    final = box.engine.wait(30)
    before = box.pair.picture.value
    box.pair.picture.point = [0.301, 0.9, 1.0]
    assert box.knobs["section"].value == 30
    assert box.pair.picture.value != before
    box.knobs["across"].value = "row"
    box.keep()
    kept = box.pair.picture_kept.value
    box.pair.picture_kept.point = [0.301, 1.0, 2.0]
    assert box.knobs["section"].value == 100
    assert box.pair.picture_kept.value != kept
    assert box.engine.wait(1) is final


@pytest.mark.parametrize("columns", [3, 2])
@pytest.mark.parametrize("shape", [(120, 160), (100, 300), (300, 100)])
def test_spots_are_where_the_maps_are(outcome, columns, shape):
    result = outcome.result
    mask = np.zeros(shape, bool)
    like = SimpleNamespace(result=SimpleNamespace(mask=mask))
    for at, (left, top, right, bottom) in enumerate(spots(like, columns)):
        rows = -(-6 // columns)
        panels = [panel("")] * 6
        panels[at] = map_panel("", np.zeros((*shape, 3), np.uint8))
        black = board([panels[first : first + columns] for first in range(0, 6, columns)]).max(axis=-1) == 0
        height, width = black.shape
        ys, xs = np.nonzero(black)
        assert (height, width) == (274 * rows, 392 * columns)
        assert [left * width, right * width] == pytest.approx([xs.min(), xs.max() + 1])
        assert [top * height, bottom * height] == pytest.approx([ys.min(), ys.max() + 1])
    assert spots(outcome, columns)[0][2] == pytest.approx(328 / (392 * columns))
    assert result.mask.shape == (120, 160)


def test_the_code_is_shown_and_runs(make):
    box = make()
    box.knobs["lam"].value = 0.5
    box.show_code()
    assert box.code.layout.display is None
    names = {}
    exec(box.code.value, names)
    cold = box.engine.cold(box.settings()).result
    assert np.array_equal(names["result"].distance, cold.distance, equal_nan=True)
    box.show_code()
    assert box.code.layout.display == "none"


def test_export_writes_everything_or_nothing(make, tmp_path):
    box = make()
    box.export(tmp_path / "out")
    names = " ".join(sorted(path.name for path in (tmp_path / "out").glob("[!.]*")))
    assert names == "board.png cloud.ply depth.npz overview.png recording.rrd report.json result.py"
    with np.load(tmp_path / "out" / "depth.npz") as stored:
        cold = box.engine.cold(box.settings()).result
        assert np.allclose(stored["distance"], cold.distance, equal_nan=True, rtol=1e-6)
    (tmp_path / "file").write_text("here")
    box.folder.value = str(tmp_path / "file" / "out")
    box._export_aside()
    until(lambda: "cannot write to the folder" in box.status.value)
    box.knobs["lam"].value = 2.0
    box.engine.wait(30)
    assert "energy" in box.status.value


def png(picture):
    return cv2.imencode(".png", np.round(255 * picture[..., ::-1]).astype(np.uint8))[1].tobytes()


def test_a_dropped_frame_and_calibration_are_looked_at(make, seen):
    frame, calibration, _ = seen
    box = make()
    box.take({"mine.png": png(frame.image), "endoscope.json": as_json(calibration.to_dict())})
    assert box.engine.wait(30).subject.frame.name == "mine.png"
    assert "truth unknown" in box.status.value
    assert 'el.read_frame("mine.png"' in box.python().replace("'", '"')
    box.take({"endoscope.json": as_json(calibration.to_dict())})
    assert box.engine.wait(30).settings.scene == "colon"


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ({"a.png": b"not a picture"}, "a.png: not a picture that can be read"),
        ({"a.json": b"{"}, "a.json"),
        ({"a.json": b'{"endolab": 2}'}, "expected version 1, found 2"),
        ({"a.png": png(np.ones((4, 5, 3)))}, "a.png is 5x4 px, but the calibration is for 1440x1080 px"),
        ({"../a.png": b""}, "../a.png: not a picture that can be read"),
        ({300 * "a" + ".json": b"\xff"}, "a.json: not UTF-8 text"),
        ({"a\0b": b"", "e.json": b"[]"}, "e.json: the file: expected an object"),
        ({"a.png": b"", "b.png": b""}, "expected one picture at most, found 2: a.png, b.png"),
        ({"a.json": b"", "b.JSON": b""}, "expected one calibration at most, found 2: a.json, b.JSON"),
    ],
)
def test_what_cannot_be_read_is_said_and_changes_nothing(make, files, words):
    box = make()
    before = box.engine.wait(30)
    box._guarded(lambda: box.take({name: memoryview(content) for name, content in files.items()}))()
    assert words in box.status.value
    assert "/tmp" not in box.status.value
    assert box.engine.wait(1) is before


@pytest.mark.parametrize(
    "name", ["../../x.png", "a/b.png", "", ".", "..", "a\0b.png", 'a"b\n.png', "<b>x</b>"]
)
def test_a_frame_may_have_any_name(make, seen, name):
    frame, calibration, _ = seen
    box = make()
    box.take({name: png(frame.image), "endoscope.json": as_json(calibration.to_dict())})
    assert box.engine.wait(30).subject.frame.name == name
    assert box.engine.complaint == ""
    compile(box.python(), "shown", "exec")
    assert "<b>" not in box.status.value


def test_spoiled_pictures_are_a_line_and_the_next_wish_is_answered(make, seen):
    frame, calibration, _ = seen
    box = make()
    known = as_json(calibration.to_dict())
    chance = np.random.default_rng(0)
    for _ in range(30):
        content = bytearray(png(frame.image))
        for place in chance.integers(len(content), size=chance.choice([1, 5, 50])):
            content[place] = chance.integers(256)
        files = {"endoscope.json": known, "a.png": bytes(content[: chance.choice([None, len(content) // 2])])}
        box._guarded(lambda files=files: box.take(files))()
        outcome = box.engine.wait(30)
        assert outcome.error is None or "\n" not in outcome.error
    for light in ({"gain": 1e-300}, {"gain": 1e300}, {"k": 1e9}, {"gamma": 1e-9}):
        odd = calibration.to_dict()
        odd["photometry"] |= light
        box._guarded(lambda odd=odd: box.take({"a.json": as_json(odd)}))()
        box.engine.wait(30)
        assert "<" not in box.status.value.split(">", 1)[1].removesuffix("</span>")
    box.take({"endoscope.json": known})
    assert box.engine.wait(30).error is None
    assert box.engine.complaint == ""


def test_a_point_that_is_none_and_a_folder_that_cannot_be_are_a_line(make):
    box = make()
    box.engine.wait(30)
    for point in ([0.5], ["a", "b", "c"], [float("nan"), 0.0, 0.0]):
        box.pair.picture.point = point
        assert "a point of a map is three numbers" in box.status.value
    box.pair.picture.point = [7.0, -7.0, 1.0]
    assert box.knobs["section"].value == 100
    for folder in ("", "a\0b", 300 * "a"):
        box.folder.value, before = folder, box.status.value
        box._guarded(box._export_aside)()
        until(lambda before=before: box.status.value != before and "exporting" not in box.status.value)
        assert "C0392B" in box.status.value
        assert "Errno" not in box.status.value


def test_a_solve_under_way_does_not_wipe_off_what_a_button_said(make):
    box = make()
    box.engine.wait(30)
    before = box.pair.picture.value
    box.knobs["lam"].value = 0.01
    box._guarded(lambda: box.take({"a.json": b"{"}))()
    box.engine.wait(30)
    assert box.pair.picture.value != before
    assert "a.json" in box.status.value
    box.knobs["lam"].value = 1.0
    box.engine.wait(30)
    assert "energy" in box.status.value


def test_wrong_arguments_are_refused_and_close_ends_the_thread(make, seen):
    threads = threading.active_count()
    with pytest.raises(ValueError, match="unknown scene 'moon'"):
        el.tune(scene="moon")
    with pytest.raises(ValueError, match="but the calibration is for 1440x1080"):
        el.tune(seen[0])
    for wrong in (
        {"frame": "a.png"},
        {"calibration": "paper"},
        {"width": 0},
        {"width": "x"},
        {"scene": None},
    ):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            el.tune(**wrong)
    for truth in (-seen[2], 0 * seen[2], np.full(seen[2].shape, "far")):
        with pytest.raises(ValueError, match="truth must be positive and finite, or nan"):
            el.tune(*seen[:2], truth=truth)
    assert threading.active_count() == threads
    box = make()
    assert threading.active_count() == threads + 2
    box.close()
    assert threading.active_count() == threads


def test_tuners_that_are_closed_are_forgotten():
    """Jupyter keeps all widgets that are not closed; the first few load what stays."""
    counts = []
    for _ in range(5):
        box = el.tune(scene="plane", width=16)
        box.engine.wait(30)
        box.close()
        del box
        gc.collect()
        counts.append((threading.active_count(), len(ipywidgets.widgets.widget._instances)))
    assert counts[-1] == counts[2]


@pytest.fixture(scope="module")
def outcome():
    engine = Tuner(datasets.load_calibration("simple", 160))
    yield engine.cold(Settings(scene="tube", width=160))
    engine.close()


@pytest.fixture(scope="module")
def trusted(outcome):
    """The same, and how far it can be trusted, and what other λ would leave."""
    lam, alike = np.array([0.1, 1.0, 10.0]), np.array([-0.2, 0.1, 0.2])
    curve = LamCurve(0.5, lam, lam, lam, alike, np.zeros(3))
    return replace(outcome, trust=el.trust_of(outcome.result, draws=4), curve=curve)


def third_of(outcome, third, limits=None):
    """The third panel of a board."""
    picture = outcome_board(outcome, Cut(), limits, third=third)
    return picture[: picture.shape[0] // 2, 2 * picture.shape[1] // 3 :]


def test_the_third_view_shows_what_was_chosen(trusted):
    views = [third_of(trusted, third) for third in BESIDES]
    assert all((one != other).any() for i, one in enumerate(views) for other in views[:i])
    _, sigma, decided, weights = views
    mask, inner = trusted.result.mask, np.s_[TITLE : TITLE + HEIGHT, EDGE : EDGE + WIDTH]
    percent = np.where(mask, 100 * trusted.trust.sigma / trusted.result.distance, np.nan)
    most = next(limit for limit in (2, 5, 10, 20, 50, 100) if limit >= np.nanpercentile(percent, 98))
    large = cv2.resize(coloured(percent, (0, most), "magma"), (WIDTH, HEIGHT), interpolation=cv2.INTER_LINEAR)
    assert np.array_equal(sigma[inner], large)
    for k, colour in enumerate(DECIDERS.values(), 1):
        share = np.mean((decided[inner] == colour).all(axis=-1))
        assert share == pytest.approx(np.mean(trusted.trust.decided_by == k), abs=0.15)
    assert (weights == COLOURS["now"]).all(axis=-1).any()


def test_the_marker_follows_the_slider(trusted):
    def marker(lam):
        picture = third_of(replace(trusted, settings=replace(trusted.settings, lam=lam)), "λ")
        return np.flatnonzero((picture == COLOURS["now"]).all(axis=-1).sum(axis=0) > 100).mean()

    assert marker(0.2) < marker(1.0) < marker(5.0)
    middle = (marker(0.1) + marker(10.0)) / 2
    assert marker(1.0) == pytest.approx(middle, abs=1.5)


def test_what_is_not_known_yet_or_never_is_grey_and_a_lends_its_colours(trusted, outcome):
    known = third_of(trusted, "normals")
    for third in ("σ", "who decided", "λ"):
        waiting, never = third_of(outcome, third), third_of(replace(outcome, untold="no energy"), third)
        assert (waiting[100, 100] == LEFT_OUT).all()
        assert (waiting != never).any()
        assert known.shape == waiting.shape
    trust = replace(trusted.trust, sigma=5 * trusted.trust.sigma)
    other = replace(trusted, trust=trust)
    alone, beside = third_of(other, "σ"), third_of(other, "σ", limits_of(trusted))
    bar = np.s_[TITLE:, EDGE + WIDTH :]
    assert np.array_equal(beside[bar], third_of(trusted, "σ")[bar])
    assert (alone[bar] != beside[bar]).any()


def test_a_third_view_is_chosen_without_a_solve(make):
    box = make()
    final = box.engine.wait(30)
    before = box.pair.picture.value
    box.knobs["third"].value = "σ"
    until(lambda: box.pair.shown.trust is not None, 60)
    assert box.pair.shown.result is final.result
    assert box.pair.picture.value != before
    assert "third" not in box.python()
    box.knobs["third"].value = "normals"
    assert box.pair.picture.value == before
    assert box.engine.complaint == ""


def test_a_board_shows_what_is_known_and_a_cut_stays_in_the_picture(outcome):
    whole = outcome_board(outcome, Cut())
    assert whole.shape == (548, 1176, 3)
    blind = outcome_board(replace(outcome, subject=replace(outcome.subject, truth=None)), Cut(0.0, True))
    assert blind.shape == whole.shape
    assert (blind != whole).any()
    assert [Cut(share).index((3, 4)) for share in (0, 0.5, 1)] == [0, 2, 3]
    assert [Cut(share, True).index((3, 4)) for share in (0, 0.5, 1)] == [0, 1, 2]


def test_colours_span_their_limits_and_leave_out_what_is_unknown():
    values = np.array([[0.0, 1.0, 5.0, np.nan]])
    assert coloured(values, (0, 1)).tolist()[0] == [[68, 1, 84], [253, 231, 37], [253, 231, 37], [184] * 3]
    middle = coloured(np.zeros((1, 1)), (-1, 1), "diverging")[0, 0]
    assert middle.min() > 250
    assert grey_or_colour(np.array([[0.5, np.nan]])).tolist()[0] == [[128] * 3, [184] * 3]


@pytest.mark.parametrize(("low", "high"), [(0, 1), (-3.2, 170), (1e-5, 2e-5), (2, 2)])
def test_ticks_are_round_and_within(low, high):
    marks = ticks(low, high)
    assert 1 <= len(marks) <= 8
    assert all(low - 1e-12 <= mark <= high + 1e-12 for mark in marks)


def test_a_panel_takes_any_shape_and_a_curve_of_one_point_is_a_dot():
    shapes = {map_panel("", np.zeros((h, w, 3), np.uint8)).shape for h, w in ((1, 1), (900, 3), (480, 640))}
    assert len(shapes) == 1
    curves = [("data", np.zeros(1), np.ones(1))], [("data", np.zeros(1), np.full(1, np.nan))]
    drawn, blank = (curve_panel("", each, "x", "y", y_limits=(0, 2)) for each in curves)
    assert (drawn != blank).any()
