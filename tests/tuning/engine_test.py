"""The tuner's engine: the latest wish wins, nothing stale comes last, errors are sentences."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.reconstruction.problem_setup import make_problem
from endolab.tuning import engine as tuning
from endolab.tuning.boards import of_one
from endolab.tuning.engine import Tuner, sentence_of
from endolab.tuning.panels import FIRST, View
from endolab.tuning.sentences import summary
from endolab.tuning.source import Settings, Source

PAPER = datasets.load_calibration("paper")
SMALL = Settings(scene="tube", width=160)


@pytest.fixture
def start():
    """Function that starts a tuner on the paper's endoscope; all are closed at the end."""
    made = []

    def start(on_outcome=None, **options):
        made.append(Tuner(options.pop("calibration", PAPER), on_outcome, **options))
        return made[-1]

    yield start
    for tuner in made:
        tuner.close()


def answer(tuner, settings, seconds=30):
    tuner.ask(settings)
    return tuner.wait(seconds)


class Slow:
    """A solver of 40 steps of 5 ms, which counts how often it ran to its end and what it was given."""

    def __init__(self):
        self.ended, self.begun, self.starts = 0, [], []

    def __call__(self, frame, calibration, *, observers=(), start=None, max_iterations=None, lam=1.0, **_):
        if lam == 13:
            raise ArithmeticError("thirteen\nand a traceback")
        self.begun.append(lam)
        self.starts.append(None if start is None else start.problem.lam)
        problem = replace(make_problem(frame, calibration), lam=lam)

        def iterates():
            iterate = el.Iterate.of(problem, problem.log_facing)
            for _ in range(40):
                yield iterate
                time.sleep(0.005)
                iterate = el.Iterate.of(problem, problem.log_facing, iterate)
            self.ended += 1
            return el.Status.CONVERGED

        return el.run(iterates(), observers, max_iterations)


def test_a_coarse_answer_comes_before_the_fine_one_and_both_are_near_the_truth(start):
    told = []
    tuner = start(told.append)
    serial = tuner.ask(Settings(scene="tube"))
    final = tuner.wait(60)
    told = [one for one in told if one.stage != "refining"]  # of a slow machine
    assert [(one.stage, one.serial) for one in told] == [("coarse", serial), ("fine", serial)]
    assert told[-1] is final
    assert [one.result.mask.shape for one in told] == [(120, 160), (240, 320)]
    assert final.median_error < 0.5
    assert told[0].median_error < 1.5


def test_a_coarse_answer_starts_from_the_last_on_the_same_grid_and_a_fine_one_from_nothing(start):
    solver = Slow()
    tuner = start(solve=solver)
    for lam, width, k in ((1.0, 160, 2.5), (2.0, 160, 3.0), (3.0, 200, 3.0)):
        answer(tuner, replace(SMALL, lam=lam, width=width, k=k))
    assert (solver.begun, solver.starts) == ([1, 1, 2, 2, 3, 3], [None, None, 1, None, None, None])


def test_after_a_change_of_lam_the_first_answer_follows_and_the_last_depends_on_nothing_before(start):
    told = []
    tuner = start(told.append)
    for lam in (1.0, 0.3, 3.0):
        wish = replace(SMALL, lam=lam, channel="auto")
        last = answer(tuner, wish)
        cold = tuner.cold(wish).result
        assert np.array_equal(last.result.distance, cold.distance, equal_nan=True)
        quick = next(one for one in told if one.serial == last.serial)
        if lam == 1.0:
            assert (last.followed, quick.result.mask.shape) == (None, (60, 80))
        else:
            assert last.followed is quick.result
            assert quick.result.mask.shape == (120, 160)
            assert quick.result.problem.lam == lam
            assert quick.result.energy < 1.05 * last.result.energy


def test_the_path_of_an_answer_is_kept_and_bounded(start, monkeypatch):
    tuner = start(solve=Slow())
    whole = answer(tuner, SMALL).path
    assert [one.k for one in whole] == list(range(40))
    monkeypatch.setattr(tuning, "REMEMBERED", 10 * whole[0].log_distance.nbytes)
    thinned = [one.k for one in answer(tuner, replace(SMALL, lam=2.0)).path]
    assert 5 <= len(thinned) <= 10
    assert len(set(np.diff(thinned))) == 1


def test_after_a_burst_only_the_last_wish_is_answered_in_full(start):
    told, solver = [], Slow()
    tuner = start(told.append, solve=solver)
    for i in range(50):
        last = tuner.ask(replace(SMALL, lam=1.0 + i))
        time.sleep(0.004)
    final = tuner.wait(30)
    assert (final.serial, final.settings.lam) == (last, 50)
    time.sleep(0.1)
    assert told[-1] is final
    assert [one.serial for one in told if one.stage == "fine" and one.error is None] == [last]
    assert [one.serial for one in told] == sorted(one.serial for one in told)
    assert solver.ended == 1  # the coarse ones stop early, and every other fine one was cancelled


def test_a_long_solve_shows_what_it_has_so_far(start, monkeypatch):
    monkeypatch.setattr(tuning, "PATIENCE", 0.05)
    told = []
    tuner = start(told.append, solve=Slow())
    final = answer(tuner, SMALL)
    stages = [one.stage for one in told]
    between = told[1:-1]
    assert (stages[0], stages[-1]) == ("coarse", "fine")
    assert {one.stage for one in between} == {"refining"}
    assert 1 <= len(between) <= 20
    steps = [one.result.iterations for one in between]
    assert steps == sorted(steps)
    assert all(len(one.result.history) == one.result.iterations + 1 for one in between)
    assert all(one.median_error is not None for one in between)
    assert told[-1] is final


def staged_solve(frame, calibration, *, observers=(), max_iterations=None, **_):
    """A run whose first stage, on a grid of half the size, takes its time."""
    small = calibration.camera.width // 2, calibration.camera.height // 2
    halved = replace(calibration, camera=calibration.camera.resize(*small))
    coarse, fine = make_problem(frame.resize(*small, 2.2), halved), make_problem(frame, calibration)

    def iterates():
        for number in (1, 2):
            iterate = replace(el.Iterate.of(coarse, coarse.log_facing), stage="bounced light", round=number)
            for _ in range(3 if max_iterations else 40):
                yield iterate
                time.sleep(0.005)
                iterate = replace(iterate, k=iterate.k + 1)
        yield el.Iterate.of(fine, fine.log_facing)
        return el.Status.CONVERGED

    return el.run(iterates(), observers)


def test_what_is_told_of_a_stage_on_the_way_is_of_that_stage_alone(start, monkeypatch):
    monkeypatch.setattr(tuning, "PATIENCE", 0.05)
    told = []
    tuner = start(told.append, solve=staged_solve)
    final = answer(tuner, SMALL)
    between = [one for one in told if one.stage == "refining"]
    assert {one.label for one in between} >= {"bounced light, round 1", "bounced light, round 2"}
    for one in between:
        assert [entry["k"] for entry in one.result.history] == list(range(one.result.iterate.k + 1))
        on_the_way = one.label.startswith("bounced light")  # the answer's own iterates may be told, too
        assert one.result.mask.shape == ((60, 80) if on_the_way else (120, 160))
        assert one.median_error is not None  # the truth is of the whole grid
        assert f"Gauss-Newton, {one.label} · " in summary(one)
        shapes = {of_one(each, FIRST, View(), 3).picture.shape for each in (one, final)}
        assert shapes == {(548, 1176, 3)}
    assert final.label == "fine"


def test_a_wish_stops_a_stage_on_the_way(start):
    solver = Slow()

    def solve(frame, calibration, *, lam=1.0, observers=(), **options):
        if lam == 1:
            return staged_solve(frame, calibration, observers=observers, **options)
        return solver(frame, calibration, lam=lam, observers=observers, **options)

    told = []
    tuner = start(told.append, solve=solve)
    tuner.ask(replace(SMALL, lam=1.0))
    time.sleep(0.1)
    assert answer(tuner, replace(SMALL, lam=2.0), 10).settings.lam == 2
    assert not [one for one in told if one.settings.lam == 1 and one.stage == "fine"]


def test_a_wish_stops_the_solve_in_flight_at_its_next_iterate(start):
    begun, stopped = threading.Event(), threading.Event()

    def endless(frame, calibration, *, observers=(), lam=1.0, **_):
        problem = make_problem(frame, calibration)
        if lam == 2:
            return el.run(iter_once(problem), observers)
        begun.set()
        try:
            start = el.Iterate.of(problem, problem.log_facing)
            for _ in range(5000):  # 10 s at most
                time.sleep(0.002)
                if any(observer(start) for observer in observers):
                    break
        finally:
            stopped.set()
        return el.run(iter_once(problem))

    def iter_once(problem):
        yield el.Iterate.of(problem, problem.log_facing)
        return el.Status.CONVERGED

    tuner = start(solve=endless)
    tuner.ask(replace(SMALL, lam=1.0))
    assert begun.wait(10)
    tuner.ask(replace(SMALL, lam=2.0))
    assert stopped.wait(5)
    assert tuner.wait(10).settings.lam == 2


def test_an_error_is_one_line_and_the_next_wish_works(start):
    tuner = start(solve=Slow())
    failed = answer(tuner, replace(SMALL, lam=13), 10)
    assert (failed.error, failed.result, failed.median_error) == ("thirteen", None, None)
    assert answer(tuner, SMALL, 10).error is None


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (Settings(scene="moon"), "unknown scene 'moon'; choose plane"),
        (Settings(scene=None), "there is no frame to look at"),
        (replace(SMALL, lam=-1), "lam must lie in [0, 1e+12], got -1"),
        (replace(SMALL, epsilon=0), "epsilon must lie in [1e-12, 1e+06], got 0"),
        (replace(SMALL, noise=-1), "noise must be finite"),
        (replace(SMALL, gamma=0.0), "gamma must be positive"),
        (replace(SMALL, solver="magic"), "unknown solver 'magic'"),
        (replace(SMALL, width=0), "width must be at least 1 px, got 0"),
    ],
)
def test_what_cannot_be_solved_is_said(start, settings, words):
    tuner = start()
    assert words in answer(tuner, settings, 10).error


def test_a_watcher_that_fails_stops_nothing(start):
    def fail(outcome):
        raise OSError("no screen")

    tuner = start(fail)
    tuner.ask(SMALL)
    assert (tuner.wait(30).error, tuner.complaint) == (None, "no screen")


def test_close_ends_the_thread_and_the_solve(start):
    before, solver = threading.active_count(), Slow()
    tuner = start(solve=solver)
    assert threading.active_count() == before + 2
    tuner.ask(SMALL)
    for _ in range(1000):  # 10 s at most
        if solver.begun:
            break
        time.sleep(0.01)
    assert solver.begun
    tuner.close()
    tuner.close()
    assert threading.active_count() == before
    assert solver.ended == 0
    with pytest.raises(ValueError, match="closed"):
        tuner.ask(SMALL)
    with pytest.raises(TimeoutError, match="closed"):
        tuner.wait(1)


def test_waiting_ends(start):
    tuner = start(solve=Slow())
    with pytest.raises(ValueError, match="nothing was asked for"):
        tuner.wait(1)
    tuner.ask(SMALL)
    with pytest.raises(TimeoutError, match="no answer in 0"):
        tuner.wait(0.001)


def until(condition, seconds=60):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.02)
    assert condition()


def test_trust_is_found_when_somebody_looks_and_told_as_the_last_answer_once_more(start):
    told = []
    tuner = start(told.append)
    fine = answer(tuner, SMALL)
    time.sleep(2 * tuning.REST)
    assert told[-1] is fine
    assert fine.trust is None
    tuner.look_at("trust")
    until(lambda: told[-1].trust is not None)
    assert (told[-1].result, told[-1].serial) == (fine.result, fine.serial)
    assert told[-1].trust.draws == tuning.DRAWS
    expected = el.trust_of(fine.result, fine.subject.calibration, draws=tuning.DRAWS)
    assert np.array_equal(told[-1].trust.sigma, expected.sigma, equal_nan=True)
    assert tuner.wait(1) is told[-1]
    tuner.look_at()
    count = len(told)
    assert answer(tuner, replace(SMALL, lam=0.5)).trust is None
    time.sleep(2 * tuning.REST)
    assert all(outcome.trust is None for outcome in told[count:])


@pytest.mark.parametrize("early", [True, False])
def test_a_wish_stops_the_search_for_trust_and_is_answered_first(start, monkeypatch, early):
    """Early there is nothing to tell, and it ends like an interrupt."""
    told, stopped, begun = [], [], threading.Event()

    def slow(result, known, *, draws, observers):
        if result.problem.lam == 1.0:
            begun.set()
            stopped.append(any(observer(None) for observer in observers))
            until(lambda: any(observer(None) for observer in observers))
            stopped.append(True)
            if early:
                raise KeyboardInterrupt
        return f"trust of λ = {result.problem.lam:g}"

    monkeypatch.setattr(tuning, "trust_of", slow)
    tuner = start(told.append)
    tuner.look_at("trust")
    answer(tuner, SMALL)
    assert begun.wait(30)
    tuner.ask(replace(SMALL, lam=0.5))
    until(lambda: told[-1].trust is not None)
    assert stopped == [False, True]
    assert told[-1].trust == "trust of λ = 0.5"
    assert [outcome.trust for outcome in told if outcome.settings.lam == 1.0 and outcome.trust] == []
    kinds = [outcome.stage for outcome in told if outcome.serial == 2]
    assert (kinds[0], kinds[-2:]) == ("coarse", ["fine", "fine"])


@pytest.mark.parametrize(("besides", "words"), [("trust", "minimises no energy")])
def test_why_there_is_no_trust_is_one_sentence_once(start, besides, words):
    told = []
    tuner = start(told.append)
    tuner.look_at(besides)
    answer(tuner, replace(SMALL, solver="fast_marching"))
    until(lambda: told[-1].untold is not None)
    assert words in told[-1].untold
    assert words in summary(told[-1])
    count = len(told)
    time.sleep(2 * tuning.REST)
    assert len(told) == count
    assert answer(tuner, SMALL).untold is None


def test_a_failing_watcher_does_not_end_the_search_and_closing_does(start):
    def fail(outcome):
        raise ZeroDivisionError("no picture")

    tuner = start(fail)
    tuner.look_at("trust")
    answer(tuner, SMALL)
    until(lambda: tuner.wait(1).trust is not None)
    assert tuner.complaint == "no picture"
    tuner.close()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("endolab tuner")]


def frame_of(width=200):
    small = PAPER.resize(width, 150)
    view = el.render(el.SCENES["tube"], small.camera, small.photometry, noise=1, bits=8)
    return el.Frame(view.image, view.mask), el.Calibration(view.camera, view.photometry), view.distance


KNOBS = [
    Settings(scene="tube", width=160, noise=2.0, lam=0.3),
    Settings(scene="plane", width=160, k=2.0, gamma=2.0, gain=1.5, xi="d", regulariser="first"),
    Settings(scene="colon", width=128, channel="red", solver="fast_marching", epsilon=1e-2),
    Settings(scene=None, width=160),
    Settings(scene=None, width=400, k=2.2, gain=0.5),
]


@pytest.mark.parametrize("settings", KNOBS)
def test_the_code_makes_the_same_result(start, settings):
    frame, calibration, _ = frame_of()
    known = PAPER if settings.scene else calibration
    code = settings.code(known)
    assert len(code.splitlines()) <= 3
    names = {"el": el, "replace": replace, "calibration": known, "frame": frame}
    exec(code, names)
    tuner = start(calibration=known, frame=None if settings.scene else frame)
    cold = tuner.cold(settings).result
    assert np.array_equal(names["result"].distance, cold.distance, equal_nan=True)
    tuner.ask(settings)  # and so does a wish
    assert np.array_equal(tuner.wait(30).result.distance, cold.distance, equal_nan=True)


def test_a_gain_four_times_as_high_doubles_distances_and_without_one_errors_are_up_to_scale(start):
    tuner = start()
    near, far = (tuner.cold(replace(SMALL, gain=gain)).result.distance for gain in (1.0, 4.0))
    assert np.nanmax(np.abs(far / near - 2)) < 1e-3
    frame, calibration, truth = frame_of()
    unknown = replace(calibration, photometry=replace(calibration.photometry, gain=None))
    tuner = start(calibration=unknown, frame=frame, truth=truth)
    outcome = tuner.cold(Settings(scene=None, width=160))
    assert not outcome.result.metric
    assert outcome.median_error < 3
    assert tuner.cold(Settings(scene=None, width=160, gain=4)).median_error == outcome.median_error


def test_noise_does_not_meet_the_surface_again_and_memory_is_bounded():
    source = Source(PAPER)
    views = [source.subject(replace(SMALL, noise=noise)) for noise in (0.0, 1.0)]
    assert views[0].truth is not views[1].truth
    assert np.array_equal(views[0].truth, views[1].truth, equal_nan=True)
    assert views[0].calibration.camera is views[1].calibration.camera
    difference = (views[1].frame.image - views[0].frame.image)[views[0].frame.mask]
    assert 0.8 < 255 * difference.std() < 1.05
    for noise in range(40):
        source.coarse(Settings(scene="plane", width=80, noise=noise / 10))
    assert len(source._memory) <= 12


def test_frame_truth_and_calibration_must_fit(start):
    frame, calibration, truth = frame_of()
    tuner = start(calibration=calibration)
    with pytest.raises(ValueError, match="200x150 px, but the calibration is for 1440x1080 px"):
        tuner.use(PAPER, frame)
    with pytest.raises(ValueError, match="truth has shape"):
        tuner.use(calibration, frame, truth[1:])
    with pytest.raises(ValueError, match="there is no frame"):
        tuner.use(calibration, None, truth)
    tuner.use(calibration, frame, truth)
    assert answer(tuner, Settings(scene=None, width=160)).median_error < 5


def test_a_sentence_is_one_line():
    assert sentence_of(ValueError("a\nb")) == "a"
    assert sentence_of(KeyError()) == "KeyError"
