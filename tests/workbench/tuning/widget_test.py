"""The tuner's widget without a browser: one answer is shown, written and exported, whatever is done."""

import threading
from dataclasses import replace

import cv2
import numpy as np
import pytest

import endolab as el
from endolab.io.images import write_image
from endolab.io.settings import read_settings
from endolab.workbench.tuning.panels import USUAL_PANELS
from endolab.workbench.tuning.source import Knobs
from endolab.workbench.tuning.widget import TunerBox


@pytest.fixture
def make():
    """Function that makes a tuner of few pixels; all are closed at the end."""
    made = []

    def make(*given, **options):
        made.append(el.tune(*given, **{"scene": "tube", "width": 160} | options))
        made[-1].engine.wait(60)
        return made[-1]

    yield make
    for box in made:
        box.close()


def turn(box, **knobs):
    """Turn knobs, and wait for the last answer."""
    box.knobs = box.knobs | knobs
    return box.engine.wait(60)


def click(box, number, right=0.5, down=0.5):
    """Press in the middle of a panel, or at shares of its map."""
    place = box.board.places[number]
    left, top, to, bottom = place.spot or place.box
    box.press(left + right * (to - left), top + down * (bottom - top))


def is_one(box):
    """Whether board, code, knobs, line and surface are of the one answer."""
    answer = box.answer
    distance = answer.result.distance
    names = {}
    exec(box.code, names)
    assert np.array_equal(names["result"].distance, distance, equal_nan=True)
    assert box.settings() == answer.settings
    named = f"λ {answer.settings.lam:.3g} · " in box.line["text"]
    assert named == answer.uses_lam
    assert all(place.answer is answer for place in box.board.places)
    box.surface.drawn = box.surface.number  # as the page says
    far = np.frombuffer(box.surface.far, np.float32).reshape(distance.shape)
    mask = answer.result.mask
    assert np.allclose(far[mask], distance[mask], rtol=1e-6)


def test_all_that_is_shown_is_of_one_answer_after_every_kind_of_change(make):
    box = make()
    for knobs in (
        {"lam": 0.1, "noise": 2.0},
        {"xi": "d", "regulariser": "first", "smooth": 1.5},
        {"k": 3.0, "gamma": 2.0, "gain": 2.0, "albedo": [0.7, 0.4, 0.3]},
        {"scene": "plane", "channel": "red", "solver": "fast_marching"},
        {"contours": True, "highlights": "keep", "width": 320},
    ):
        answer = turn(box, **knobs)
        assert box.answer is answer
        is_one(box)
    before = box.visited[-2]
    box.undo()
    assert box.engine.wait(60).settings == before
    is_one(box)
    box.reset()
    assert box.engine.wait(60).settings == Knobs(scene="tube", width=160)
    is_one(box)


def test_a_if_it_is_shown_is_what_is_exported(make, tmp_path):
    box = make()
    kept = box.answer
    box.keep()
    assert box.shows == "A beside B"
    now = turn(box, lam=10.0, regulariser="first")
    assert [place.answer for place in box.board.places[:3]] == [kept, now, now]
    box.blink()
    box.blink()
    assert (box.shows, box.answer) == ("A", kept)
    is_one(box)
    box.export(tmp_path / "out")
    board = cv2.imread(str(tmp_path / "out/board.png"))[..., ::-1]
    assert np.array_equal(board, box.board.picture)
    with np.load(tmp_path / "out/depth.npz") as stored:
        expected = kept.result.distance.astype(np.float32)
        assert np.array_equal(stored["distance"], expected, equal_nan=True)
    written = read_settings(tmp_path / "out/settings.json")
    assert (written.keywords["lam"], written.keywords["regulariser"]) == (1.0, "auto")
    assert (tmp_path / "out/result.py").read_text() == box.code
    energies = el.read_recording(tmp_path / "out/recording.rrd").table()["energy"]
    assert energies.tolist() == [row["energy"] for row in kept.result.history]
    box.blink()
    assert (box.shows, box.answer) == ("B", now)
    is_one(box)
    again = turn(box, lam=1.0, regulariser="auto")  # as A is
    assert (box.shows, box.now, again.result) == ("B", again, kept.result)
    box.drop()
    assert (box.kept, box.shows) == (None, "")


def test_an_export_is_done_whatever_is_asked_for_before_it_begins_and_told_if_it_fails(
    make, tmp_path
):
    box = make()
    gate = threading.Event()
    first = box.answer
    (tmp_path / "file").write_text("here")
    box.engine.do(lambda is_stale: gate.wait(60))
    box.export_aside(str(tmp_path / "out"))
    box.export_aside(str(tmp_path / "file"))
    lines = []
    box.observe(lambda change: lines.append(change["new"]), "line")
    box.knobs = box.knobs | {"lam": 3.0}
    gate.set()
    assert box.engine.wait(60).settings.lam == 3.0
    with np.load(tmp_path / "out/depth.npz") as stored:
        expected = first.result.distance.astype(np.float32)
        assert np.array_equal(stored["distance"], expected, equal_nan=True)
    wrong = [line["text"] for line in lines if line.get("wrong")]
    assert len(wrong) == 1
    assert wrong[0].startswith("the export into")
    assert any("exported into" in line["text"] for line in lines)
    assert (tmp_path / "file").read_text() == "here"


def test_five_lam_stand_in_columns_on_the_curve_and_one_is_taken_over(make, until):
    box = make()
    now = box.answer
    box.compare("lam")
    box.engine.wait(60)
    until(lambda: len(box.board.places) == 15)
    assert box.line["text"].startswith("5 of 5")
    assert box.answer is now
    assert sorted({one.settings.lam for one in box.tried}) == [
        0.1,
        0.32,
        1.0,
        3.2,
        10.0,
    ]
    click(box, 3)
    taken = box.engine.wait(60)
    assert (taken.settings.lam, box.knobs["lam"], box.compared) == (3.2, 3.2, "")
    until(lambda: len(taken.variants) == 4)
    is_one(box)
    chart = box.board.places[USUAL_PANELS.index("λ curve")]
    brings = [dot.brings and dot.brings.lam for dot in chart.panel.dots]
    box.press(*chart.dots[brings.index(1.0)])
    assert box.engine.wait(60).result is now.result  # without a solve
    is_one(box)
    box.compare("regulariser")
    box.engine.wait(60)
    until(lambda: len(box.board.places) == 6)
    assert set(box.answer.variants) >= {"first", "second"}
    box.compare("")
    is_one(box)


def test_the_section_follows_the_pointer_and_the_cursor_reads_all_maps(make):
    box = make()
    answer = box.answer
    before = box.picture
    click(box, 1, right=0.301)
    assert box.knobs["section"] == pytest.approx(30, abs=1)
    assert box.picture != before
    assert box.engine.wait(1) is answer
    box.hover = [0.5, 0.25]
    assert box.cursor_texts[1] == f"{answer.result.distance[30, 80]:.4g} mm"
    assert "grey levels" in box.cursor_texts[2]
    assert box.cursor_texts[3] == "column 80, row 30"
    assert box.surface.marker == pytest.approx(answer.result.points[30, 80])
    assert len(box.cursor_marks[3]) == 2
    box.hover = []
    assert box.cursor_texts == []


def test_what_cannot_be_read_or_solved_is_a_line_and_the_answer_stays(
    make, seen, until
):
    frame, calibration, _ = seen
    box = make(el.Frame(frame.image[..., 1], frame.mask), calibration)
    settings = box.answer.settings
    wrong = {
        "max_iterations": 3.5,
        "albedo": [1, 2],
        "smooth": "much",
        "channel": "red",
    }
    for name, value in wrong.items():
        before = box.knobs[name]
        box.knobs = box.knobs | {name: value}
        until(lambda: box.line.get("wrong"))
        assert box.answer.settings == settings
        turn(box, **{name: before})
        assert not box.line.get("wrong")


def test_from_frame_to_frame_and_one_that_cannot_be_read_is_passed_by(seen, tmp_path):
    frame, calibration, truth = seen
    paths = [tmp_path / f"f{number}.png" for number in range(3)]
    for path in (paths[0], paths[2]):
        write_image(path, frame.image)
    paths[1].write_bytes(b"no picture")
    named = replace(frame, name="f0.png")
    box = TunerBox(named, calibration, truth, width=160, pictures=paths)
    assert box.engine.wait(60).median_error < 5
    box.step(1)
    assert "f1.png" in box.line["text"]
    assert box.knobs["scene"] == 0
    turn(box, lam=0.5)
    other = turn(box, scene=2)
    assert (other.subject.frame.name, other.settings.lam) == ("f2.png", 0.5)
    assert other.median_error is None
    assert "read_frame('f2.png'" in box.code
    box.step(1)  # there is none after it
    assert box.knobs["scene"] == 2
    turn(box, scene="plane")
    box.undo()
    assert box.engine.wait(60).settings.scene is None
    assert box.knobs["scene"] == 2
    box.close()


def test_no_wish_is_dropped_by_what_is_done_with_the_answer_before(make):
    """Knobs then said what nobody had solved, until another was turned."""
    box = make()
    box.knobs = box.knobs | {"lam": 3.0}
    for act in (lambda: box.compare("lam"), box.find_uncertainty):
        with pytest.raises(ValueError, match="still to come"):
            act()
    assert box.engine.wait(60).settings.lam == 3.0
    is_one(box)


def test_what_is_kept_while_a_solve_goes_on_is_its_answer(make):
    box = make()
    box.knobs = box.knobs | {"lam": 3.0}
    box.keep()
    assert box.kept is None
    final = box.engine.wait(60)
    assert (box.kept, box.shows) == (final, "A beside B")


def test_the_iterates_of_the_last_run_can_be_looked_at_and_no_other_is_exported(
    make, seen, tmp_path
):
    box = make(*seen)
    answer = box.answer
    assert box.path == len(answer.path) > 2
    box.iterate(1)
    assert (box.path_place, box.board.places[1].answer.stage) == (1, "iterate")
    assert "iteration" in box.line["text"]
    assert "median error" in box.line["text"]
    box.export(tmp_path / "out")
    with np.load(tmp_path / "out/depth.npz") as stored:
        expected = answer.result.distance.astype(np.float32)
        assert np.array_equal(stored["distance"], expected, equal_nan=True)
    box.iterate(box.path)
    assert all(place.answer is answer for place in box.board.places)
    for _ in range(2):  # the page's slider goes to the same place twice
        box.set_state({"scrub": 1})
        assert box.path_place == 1
        box.iterate(box.path)


def test_what_was_refused_stays_to_be_read_when_more_is_known_of_the_answer(
    make, until
):
    """A sentence about a broken frame was gone as soon as the next λ had been solved."""
    box = make()
    answer = box.answer
    until(lambda: len(answer.variants) == 4)
    box.engine.refuse("it cannot be read")
    box.engine.tell(answer)
    assert box.line == {"text": "it cannot be read", "wrong": True}


def test_three_hundred_things_done_at_random_leave_one_answer(make, rng):
    box = make(width=64)
    lists = [
        spec for spec in box.specs if "options" in spec and spec["name"] != "width"
    ]
    ranges = [spec for spec in box.specs if "range" in spec]
    actions = [
        box.blink,
        box.reset,
        box.undo,
        box.drop,
        lambda: box.compare(""),
        lambda: box.show("A beside B"),
        lambda: setattr(
            box, "window", np.sort(rng.random((2, 2)), axis=0).ravel().tolist()
        ),
        lambda: box.preset(rng.choice(box.presets)),
        lambda: box.press(*rng.random(2)),
    ]
    needs_final = [
        box.keep,
        lambda: box.answer.uses_lam and box.compare("lam"),
        lambda: box.path and box.iterate(rng.integers(1, box.path + 1)),
    ]
    for _ in range(300):
        kind = rng.integers(3)
        if kind == 0:
            spec = ranges[rng.integers(len(ranges))]
            value = rng.uniform(*spec["range"][:2])
            box.knobs = box.knobs | {
                spec["name"]: 10**value if "log" in spec else value
            }
        elif kind == 1:
            spec = lists[rng.integers(len(lists))]
            value = spec["options"][rng.integers(len(spec["options"]))]
            value = value[1] if isinstance(value, list | tuple) else value
            box.knobs = box.knobs | {spec["name"]: value}
        elif (
            box.answer.stage == "final" and not box.engine.waits and rng.random() < 0.3
        ):
            needs_final[rng.integers(3)]()
        else:
            actions[rng.integers(len(actions))]()
        assert "Error" not in box.line.get("text", "")
    box.drop()
    box.reset()
    box.engine.wait(60)
    is_one(box)
