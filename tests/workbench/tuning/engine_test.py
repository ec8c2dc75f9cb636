"""The tuner's engine: the latest wish wins, a rough answer comes first, the last is a cold start's."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.workbench.tuning import engine
from endolab.workbench.tuning.engine import Stage, Tuner, sentence_of
from endolab.workbench.tuning.source import Knobs

PAPER = datasets.load_calibration("paper")
SMALL = Knobs(scene="tube", width=160)


@pytest.fixture
def start():
    """Function that starts a tuner; returns it, its answers, and its refusals."""
    started = []

    def start(calibration=PAPER, **given):
        answers = []
        refused = []
        started.append(Tuner(calibration, answers.append, refused.append, **given))
        return started[-1], answers, refused

    yield start
    for tuner in started:
        tuner.close()
    assert not [
        one for one in threading.enumerate() if one.name.startswith("endolab tuner")
    ]


def test_a_first_look_comes_before_the_final_answer_which_is_the_cold_one(start):
    tuner, answers, _ = start()
    tuner.ask(SMALL)
    final = tuner.wait(60)
    assert [one.stage for one in answers] == [Stage.FIRST, Stage.FINAL]
    assert answers[0].result.mask.shape == (60, 80)
    assert answers[-1] is final
    for lam in (0.1, 3.0):  # the first look follows from the answer before, at its size
        tuner.ask(replace(SMALL, lam=lam))
        moved = tuner.wait(60)
        assert answers[-2].result.mask.shape == (120, 160)
        assert moved.followed is answers[-2].result
        assert moved.followed.provenance.preparation.frame == moved.subject.frame.name
        assert np.abs(np.nanmedian(moved.change)) < 1
        cold = tuner.solve_cold(replace(SMALL, lam=lam)).result
        assert np.array_equal(moved.result.distance, cold.distance, equal_nan=True)


def test_of_many_wishes_the_last_is_answered_and_no_other_to_its_end(start):
    tuner, answers, _ = start()
    for lam in np.geomspace(0.01, 1, 30):
        tuner.ask(replace(SMALL, lam=float(lam), width=320, channel="auto", scene="colon"))
        time.sleep(0.01)
    tuner.ask(SMALL)
    assert tuner.wait(60).settings == SMALL
    assert [one.settings for one in answers if one.stage == Stage.FINAL] == [SMALL]


def test_a_stale_solve_is_stopped_within_a_step_or_two(start):
    tuner, answers, _ = start()
    tuner.ask(replace(SMALL, solver="primal_dual", max_iterations=10**6, lam=1e-3))
    until(lambda: any(one.stage != Stage.FIRST for one in answers))  # what it has so far
    started = time.monotonic()
    tuner.ask(replace(SMALL, solver="facing"))
    assert tuner.wait(60).settings.solver == "facing"
    assert time.monotonic() - started < 5


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"scene": "moon"}, "moon"),
        ({"scene": None}, "no frame"),
        ({"lam": -1.0}, "lam"),
        ({"noise": -1.0}, "noise"),
        ({"gamma": 0.0}, "gamma"),
        ({"solver": "magic"}, "magic"),
    ],
)
def test_what_cannot_be_solved_is_one_sentence_and_the_next_wish_is_answered(
    start, changed, words
):
    tuner, _, refused = start()
    tuner.ask(replace(SMALL, **changed))
    with pytest.raises(ValueError, match=words):
        tuner.wait(60)
    assert words in refused[-1]
    tuner.ask(SMALL)
    assert tuner.wait(60).settings == SMALL


def until(condition, seconds=60):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.02)
    assert condition()


def test_trust_is_found_when_it_is_asked_for_and_a_wish_stops_the_search(start):
    tuner, answers, refused = start()
    tuner.ask(SMALL)
    final = tuner.wait(60)
    assert final.uncertainty is None
    tuner.find_uncertainty(final)
    trusted = tuner.wait(60)
    assert trusted.result is final.result
    expected = el.uncertainty_of(
        final.result, final.subject.calibration, draws=trusted.uncertainty.draws
    )
    assert np.array_equal(trusted.uncertainty.sigma, expected.sigma, equal_nan=True)
    count = len(answers)
    tuner.find_uncertainty(final)
    tuner.ask(replace(SMALL, lam=0.5))
    assert tuner.wait(60).uncertainty is None
    assert all(one.uncertainty is None for one in answers[count:])
    assert refused == []


def test_why_there_is_no_first_look_is_said_and_the_answer_comes(start, monkeypatch):
    def reconstruct(frame, calibration, *, width=None, **how):
        if width == 80:
            raise ValueError("too small for it")
        return el.reconstruct(frame, calibration, width=width, **how)

    monkeypatch.setattr(engine, "reconstruct", reconstruct)
    tuner, answers, refused = start()
    tuner.ask(SMALL)
    assert tuner.wait(60).stage == Stage.FINAL
    assert Stage.FIRST not in [answer.stage for answer in answers]
    assert len(refused) == 1
    assert "too small for it" in refused[0]


def test_what_is_compared_is_torn_as_the_answer_is(start):
    tuner, _, _ = start()
    cut = tuner.solve_cold(Knobs(scene="colon", width=160, contours=True))
    assert cut.cut_count > 0
    several = [replace(cut.settings, lam=lam, contours=None) for lam in (0.1, 10.0)]
    found = {}
    tuner.compare(cut, several, found.__setitem__)
    until(lambda: len(found) == 2)
    for number, one in found.items():
        assert one.settings == several[number]
        assert np.array_equal(one.result.problem.cuts, cut.result.problem.cuts)
    assert found[0].data < found[1].data
    assert found[0].roughness > found[1].roughness


def test_a_gain_four_times_as_high_doubles_distances_and_without_one_errors_are_up_to_scale(
    start,
):
    tuner, _, _ = start()
    near, far = (tuner.solve_cold(replace(SMALL, gain=gain)) for gain in (1.0, 4.0))
    assert np.nanmax(np.abs(far.result.distance / near.result.distance - 2)) < 1e-3
    unknown = replace(
        PAPER.resize(160, 120), photometry=replace(PAPER.photometry, gain=None)
    )
    subject = near.subject
    tuner, _, _ = start(unknown, frame=subject.frame, truth=subject.truth)
    blind = tuner.solve_cold(Knobs(scene=None, width=160))
    assert not blind.result.metric
    assert blind.median_error < 3


def test_relief_tells_a_sphere_a_plane_and_a_tube_apart(start):
    tuner, _, _ = start()
    smooth = tuner.solve_cold(replace(SMALL, scene="colon", regulariser="first", lam=1e4))
    plane = tuner.solve_cold(replace(SMALL, scene="plane"))
    tube = tuner.solve_cold(SMALL)
    assert smooth.relief[0] < 5 < min(tube.relief)
    assert plane.relief[1] < 5 < plane.relief[0]


def test_closing_ends_all(start):
    tuner, _, _ = start()
    with pytest.raises(ValueError, match="nothing was asked for"):
        tuner.wait(1)
    tuner.ask(replace(SMALL, width=640))
    with pytest.raises(TimeoutError, match="no answer"):
        tuner.wait(0.001)
    tuner.close()
    tuner.close()
    with pytest.raises(ValueError, match="closed"):
        tuner.ask(SMALL)
    assert sentence_of(ValueError("a\nb")) == "a"
    assert sentence_of(KeyError()) == "KeyError"
