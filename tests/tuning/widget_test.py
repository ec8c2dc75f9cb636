"""The tuner's widget without a browser: knobs, picture, status line, export, what cannot be read."""

import gc
import html
import threading
import time
from dataclasses import replace

import cv2
import ipywidgets
import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.io.atomic import as_json
from endolab.io.settings import read_settings
from endolab.tuning.boards import DIFFERENCE
from endolab.tuning.panels import FIRST, FIRST_WITH_TRUTH, PANELS


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
    first, line = box.screen.view.value, box.status.value
    assert decoded(box.screen.view).shape == (548, 1176, 3)
    assert "median error" in line
    assert "fine" in line
    for name, value in (("lam", 0.1), ("xi", "d"), ("noise", 2.0), ("k", 3.0), ("solver", "fast_marching")):
        box.knobs[name].value = value
        assert getattr(box.engine.wait(30).settings, name) == value
        assert box.screen.view.value != first
        first = box.screen.view.value
    assert box.engine.complaint == ""


def test_the_section_moves_without_a_solve(make):
    box = make()
    final = box.engine.wait(30)
    before = box.screen.view.value
    box.knobs["section"].value = 30
    box.knobs["across"].value = "row"
    assert box.screen.view.value != before
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
    before = box.screen.view.value
    box.knobs["channel"].value = "red"
    box.engine.wait(30)
    assert "grey and has no red channel" in box.status.value
    assert box.screen.view.value == before
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


def test_the_pointer_moves_the_section_and_the_cursor_reads_all_maps(make):
    box = make()
    final = box.engine.wait(30)
    view = box.screen.view
    before = view.value
    view.point = [0.301, 0.9, 1, 1, 1.0]
    assert box.knobs["section"].value == 30
    assert view.value != before
    box.knobs["across"].value = "row"
    view.point = [0.301, 1.0, 0, 0, 2.0]
    assert box.knobs["section"].value == 100
    assert box.engine.wait(1) is final
    view.hover = [0.5, 0.25]
    assert len(view.said) == len(view.boxes) == 6
    assert f"d = {final.result.distance[30, 80]:.4g}, true {final.truth[30, 80]:.4g} mm" == view.said[1]
    assert [bool(said) for said in view.said] == [spot is not None for spot in view.spots]
    view.hover = []
    assert view.said == []


def test_a_is_kept_beside_with_the_difference_and_dropped_again(make):
    box = make()
    box.engine.wait(30)
    screen = box.screen
    alone = screen.view.value
    box.keeper.click()
    assert [place.name for place in screen.board.places].count("distance") == 2
    assert DIFFERENCE in [place.name for place in screen.board.places]
    box.knobs["gain"].value = 4.0
    box.engine.wait(30)
    assert screen.view.caption.startswith("A: λ = 1, gain × 1 · median error")
    assert "B (now): λ = 1, gain × 4 · median error" in screen.view.caption
    screen.view.hover = [0.5, 0.5]
    difference = screen.view.said[[place.name for place in screen.board.places].index(DIFFERENCE)]
    assert float(difference.split()[0]) == pytest.approx(100, abs=0.2)  # four times the gain, twice as far
    for key, caption in (("b", "A: "), ("b", "B (now): "), ("b", "A: "), ("d", "A: ")):
        screen.view.key = [key, time.monotonic()]
        assert screen.view.caption.startswith(caption)
    assert "B (now)" in screen.view.caption
    screen.view.key = ["x", time.monotonic()]
    assert (screen.kept, screen.view.caption, box.keeper.description) == (None, "", "keep as A")
    box.knobs["gain"].value = 1.0
    box.engine.wait(30)
    assert screen.view.value == alone


def test_a_strip_shows_several_lam_and_a_click_takes_one_over(make):
    box = make()
    box.engine.wait(30)
    box.strip.value = "λ"
    until(lambda: len(box.screen.board.places) == 10)
    names = [name for name, _ in box.screen.several]
    assert names == ["λ = 0.1", "λ = 0.32", "λ = 1", "λ = 3.2", "λ = 10"]
    taken = box.screen.several[3][1]
    box.screen.view.point = [0.5, 0.5, 3, 1, 1.0]
    final = box.engine.wait(30)
    assert (final.settings.lam, box.knobs["lam"].value, box.screen.several) == (3.2, 3.2, [])
    assert np.array_equal(final.result.distance, taken.result.distance, equal_nan=True)
    box.strip.value = "order"
    until(lambda: box.screen.several and all(one is not None for _, one in box.screen.several))
    box.strip.value = ""
    assert box.screen.board.places[0].name == "frame"
    assert box.engine.complaint == ""


def test_a_page_is_filled_and_gets_its_picture_whenever_it_asks(make):
    box = make()
    box.engine.wait(30)
    sent = []
    box.screen.view.send_state = lambda key=None: sent.append(key or ())
    for room in ([1000, 500, 1, 0.0], [1600, 870, 1, 1.0], [1600, 870, 1, 2.0], [800, 700, 2, 3.0]):
        sent.clear()
        box.screen.view.room = room
        assert "value" in sent[-1]
        height, width = decoded(box.screen.view).shape[:2]
        assert width <= room[0] * room[2]
        assert height <= max(room[1], 260) * room[2]
        assert width > 0.8 * room[0] * room[2] or height > 0.8 * room[1] * room[2]
    before = box.status.value
    box.screen.view.room = [0, 0, 1, 4.0]
    assert "three positive numbers" in box.status.value != before


def test_every_panel_is_chosen_drawn_and_read_without_a_solve(make, seen):
    frame, calibration, truth = seen
    box = make(frame, calibration, truth)
    final = box.engine.wait(60)
    assert list(box.screen.view.panels) == list(FIRST_WITH_TRUTH)
    seen_ones = set()
    for name, panel in PANELS.items():
        box.screen.view.panels = [name, *box.screen.view.panels[1:]]
        if panel.besides:
            until(lambda panel=panel: getattr(box.screen.shown, panel.besides) is not None, 60)
        assert box.screen.board.places[0].name == name
        assert box.screen.shown.result is final.result
        seen_ones.add(box.screen.board.places[0].picture.tobytes())
        if panel.read is not None and name != "another start":
            assert panel.read(box.screen.shown, 60, 80)
    assert len(seen_ones) == len(PANELS)
    assert "panels" not in box.python()
    assert box.engine.complaint == ""
    blind = make(frame, calibration)
    blind.engine.wait(60)
    assert list(blind.screen.view.panels) == list(FIRST)
    assert "error" not in blind.screen.view.choices


def test_a_mask_is_drawn_and_a_length_is_clicked(make, seen, tmp_path):
    frame, calibration, _ = seen
    unknown = replace(calibration, photometry=replace(calibration.photometry, gain=None))
    box = make(frame, unknown)
    assert not box.engine.wait(60).result.metric
    view = box.screen.view

    def press(x, y):
        view.point = [x, y, 0, 1, time.monotonic()]

    box.clicks.kind.value = "knows a distance"
    box.clicks.mm.value = 30.0
    press(0.01, 0.01)
    assert "no surface is seen there" in box.status.value
    assert list(view.marks) == []
    press(0.5, 0.5)
    known = box.engine.wait(60)
    assert known.result.metric
    assert known.settings.known_distance == (30.0, 79.5, 59.5)
    assert np.median(known.result.distance[58:63, 78:83]) == pytest.approx(30, rel=0.01)
    box.clicks.mm.value = 60.0
    assert np.median(box.engine.wait(60).result.distance[58:63, 78:83]) == pytest.approx(60, rel=0.01)
    box.clicks.kind.value = "knows a diameter"
    press(0.3, 0.5)
    press(0.7, 0.5)
    wide = box.engine.wait(60)
    ends = [wide.result.points[60, column] for column in (48, 112)]
    assert np.linalg.norm(ends[0] - ends[1]) == pytest.approx(60, rel=0.1)
    assert len(view.marks) == 2
    box.clicks.kind.value = "draws the mask"
    for x, y in ((0.2, 0.2), (0.8, 0.2), (0.8, 0.8), (0.2, 0.8), (0.2, 0.21)):
        press(x, y)
    masked = box.engine.wait(60)
    rows, columns = np.nonzero(masked.result.mask)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == pytest.approx((24, 96, 32, 128), abs=1.5)
    assert "mask='mask.png'" in box.python()
    box.export(tmp_path / "masked")
    stored = el.read_frame(tmp_path / "masked" / "mask.png").image
    assert np.array_equal(stored.max(axis=-1) > 0.5, masked.subject.frame.mask)
    box.clicks.forget.click()
    assert np.array_equal(box.engine.wait(60).subject.frame.mask, frame.mask)
    assert not box.engine.wait(1).result.metric
    box.knobs["scene"].value = "plane"
    press(0.5, 0.5)
    assert "that is for a frame of your own" in box.status.value


def test_what_was_exported_is_reconstructed_and_set_again(make, seen, tmp_path):
    frame, calibration, _ = seen
    box = make(frame, calibration)
    for name, value in (
        ("lam", 0.3),
        ("k", 2.8),
        ("albedo", "0.7, 0.4, 0.3"),
        ("xi", "d"),
        ("smooth", "1.5"),
    ):
        box.knobs[name].value = value
    wished = box.settings()
    shown = box.engine.wait(60).result
    box.export(tmp_path / "out")
    written = read_settings(tmp_path / "out" / "settings.json")
    again = el.reconstruct(frame, written.believed(calibration), **written.keywords)
    assert np.array_equal(again.distance, shown.distance, equal_nan=True)
    other = make(frame, calibration)
    other.take({"settings.json": (tmp_path / "out" / "settings.json").read_bytes()})
    assert other.settings() == wished
    for content, words in (
        (b'{"endolab_settings": 1, "lam": "auto"}', "no knob for lam = auto"),
        (b'{"endolab_settings": 1, "threshold": 0.1}', "no knob for threshold"),
        (b'{"endolab_settings": 2}', "expected version 1, found 2"),
    ):
        other._guarded(lambda content=content: other.take({"a.json": content}))()
        assert words in other.status.value
    assert other.settings() == wished


def test_the_surface_to_turn_follows_and_carries_a_map(make):
    box = make()
    box.engine.wait(30)
    assert box._turned.layout.display == "none"
    assert box.surface.number == 0
    box.turning.value = "frame"
    until(lambda: box.surface.number == 1)
    box.surface.drawn = 1
    picture = box.surface.picture
    box.turning.value = "normals"
    until(lambda: box.surface.picture != picture)
    box.surface.drawn = box.surface.number
    before = box.surface.far
    box.knobs["gain"].value = 3.0
    box.engine.wait(30)
    until(lambda: (box.surface.set_state({"drawn": box.surface.number}), box.surface.far != before)[1])
    box.turning.value = "σ"
    until(lambda: box.screen.shown.trust is not None, 60)
    box.turning.value = "off"
    assert box._turned.layout.display == "none"
    assert box.engine.complaint == ""


def test_another_frame_leaves_the_knobs_and_forgets_mask_and_length(make, seen):
    frame, calibration, truth = seen
    box = make(frame, calibration)
    box.knobs["lam"].value, box.knobs["k"].value = 0.1, 3.0
    box.engine.wait(60)
    box.clicks.kind.value = "knows a distance"
    box.screen.view.point = [0.5, 0.5, 0, 1, 1.0]
    assert box.engine.wait(60).settings.known_distance
    other = replace(frame, name="other.png")
    box.look_at(other, truth=truth)
    final = box.engine.wait(60)
    assert final.subject.frame is other
    assert (final.settings.lam, final.settings.k, final.settings.known_distance) == (0.1, 3.0, None)
    assert final.median_error is not None
    with pytest.raises(ValueError, match="but the calibration is for"):
        box.look_at(other, datasets.load_calibration("paper"))
    assert box.engine.wait(1) is final


def test_lines_that_cannot_be_read_are_a_sentence(make):
    box = make()
    box.engine.wait(30)
    for name, text, words in (
        ("max_iterations", "3.5", "iterations: expected a whole number, found 3.5"),
        ("max_iterations", "x", "iterations: expected a number, found 'x'"),
        ("albedo", "1, 2", "albedo: expected 3 numbers with commas between, found '1, 2'"),
        ("smooth", "-1", "smooth"),
    ):
        box.knobs[name].value = text
        until(lambda words=words: words in html.unescape(box.status.value))
        box.knobs[name].value = ""
    box.knobs["max_iterations"].value = "2"
    assert box.engine.wait(30).result.status is el.Status.MAX_ITERATIONS
    assert "2 iterations of 2 at most, max iterations" in box.status.value


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
    assert (
        names
        == "board.png cloud.ply depth.npz overview.png recording.rrd report.json result.py settings.json"
    )
    shown = box.screen.shown.result
    with np.load(tmp_path / "out" / "depth.npz") as stored:
        assert np.array_equal(stored["distance"], shown.distance.astype(np.float32), equal_nan=True)
    recorded = el.read_recording(tmp_path / "out" / "recording.rrd")
    assert recorded.table()["energy"].tolist() == [row["energy"] for row in shown.history]
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


def test_a_mask_is_dropped_beside_its_frame_or_for_the_one_that_is_there(make, seen):
    frame, calibration, _ = seen
    box = make()
    mask = np.zeros((120, 160, 3))
    mask[30:90, 40:120] = 1
    given = {"a.png": png(frame.image), "e.json": as_json(calibration.to_dict())}
    box.take(given | {"a_mask.png": png(mask)})
    assert box.engine.wait(30).subject.frame.mask.sum() == 60 * 80
    box.take(given)
    assert box.engine.wait(30).subject.frame.mask.all()
    box.take({"mask.png": png(mask)})
    masked = box.engine.wait(30)
    assert masked.subject.frame.mask.sum() == 60 * 80
    box.clicks.forget.click()
    assert box.engine.wait(30).subject.frame.mask.all()
    before = box.engine.wait(1)
    for files, words in (
        ({"mask.png": png(mask[1:])}, "the mask is 160x119 px, the frame 160x120 px"),
        ({"mask.png": b"no"}, "mask.png: not a picture"),
        ({"mask.png": b"", "b-mask.png": b""}, "expected one mask at most, found 2"),
    ):
        box._guarded(lambda files=files: box.take(files))()
        assert words in box.status.value
    assert box.engine.wait(1) is before
    scene = make()
    scene.engine.wait(30)
    scene._guarded(lambda: scene.take({"mask.png": png(mask)}))()
    assert "no frame that this could be the mask of" in scene.status.value


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
    for point in ([0.5], ["a", "b", "c", 1, 1], [float("nan"), 0.0, 0, 1, 0.0]):
        box.screen.view.point = point
        assert "a point of a map is five numbers" in box.status.value
    box.screen.view.point = [7.0, -7.0, 0, 1, 1.0]
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
    before = box.screen.view.value
    box.knobs["lam"].value = 0.01
    box._guarded(lambda: box.take({"a.json": b"{"}))()
    box.engine.wait(30)
    assert box.screen.view.value != before
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
