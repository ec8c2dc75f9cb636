"""The tuner's engine: the newest wish wins, and what is held makes the same bits again."""

import time
from dataclasses import replace

import numpy as np
import pytest

from endolab.workbench.tuning.engine import AnswerKind, Engine
from endolab.workbench.tuning.source import Knobs, Source

FIRST = Knobs(scene=0, width=160, channel="green", contours=False)


@pytest.fixture
def start(seen):
    """Function that starts an engine on the tube; returns it and its answers."""
    started = []

    def start(wish=FIRST):
        frame, calibration, truth = seen
        answers = []
        source = Source(calibration, frame, truth)
        started.append(Engine(source, answers.append))
        started[-1].ask(wish)
        started[-1].wait(60)
        del answers[:-1]  # what was shown on the way to the first one
        return started[-1], answers

    yield start
    for engine in started:
        engine.close()


def apart(one, other):
    return np.nanmean(np.abs(one.result.distance / other.result.distance - 1))


def test_errors_are_those_of_the_truth(start, seen):
    _, [answer] = start()
    error = 100 * np.abs(answer.result.distance / seen[2] - 1)
    assert answer.errors == pytest.approx((np.nanmean(error), np.nanmedian(error)))
    assert 1 < answer.errors[0] < 2  # %, of a tube


@pytest.mark.parametrize(
    "turned",
    [
        {"lam": 0.15},
        {"regulariser": "first"},
        {"gamma": 2.0},
        {"k": 2.0},
        {"gain": 2.0},
    ],
    ids=str,
)
def test_a_kept_answer_depends_on_what_is_held_alone(start, turned):
    """It was of what was tried before: an export could not give it again."""
    engine, answers = start()
    wish = replace(FIRST, **turned)
    engine.ask(wish)
    engine.wait(60)
    look, by_hand = answers[1:]
    assert [look.kind, by_hand.kind] == [AnswerKind.LOOK, AnswerKind.FINAL]
    assert apart(look, by_hand) < 0.8 * apart(answers[0], by_hand)
    assert by_hand.still is answers[0].still
    engine.ask(replace(FIRST, lam=7.0))
    engine.wait(60)
    engine.ask(wish)  # comes back at once
    engine.wait(60)
    assert answers[-1] is by_hand


def test_while_the_hand_moves_looks_follow_and_the_newest_wish_wins(start):
    engine, answers = start()
    lams = [float(lam) for lam in np.geomspace(0.9, 0.02, 12)]
    for lam in lams:
        engine.ask(replace(FIRST, lam=lam))
        time.sleep(0.04)
    engine.wait(60)
    looks = [one for one in answers if one.kind is AnswerKind.LOOK]
    assert len(looks) >= 3
    assert {one.settings.lam for one in looks} <= set(lams)
    assert answers[-1].is_final
    assert answers[-1].settings.lam == lams[-1]
    assert apart(looks[-1], answers[-1]) < 0.8 * apart(answers[0], answers[-1])


def test_the_curve_is_of_one_solver_and_goes_on_until_too_little_is_explained(start):
    engine, answers = start()
    curve = engine.curve_of(answers[0])
    assert len(curve) >= 5
    assert {one.settings.solver for one in curve} == {"gauss_newton"}
    _, at_least = engine.best_lam(answers[0])
    assert at_least == (curve[-1].explained >= 0.99)
    assert not at_least or 3.2 * curve[-1].settings.lam > 100
    engine.ask(replace(FIRST, regulariser="first"))
    engine.wait(60)
    other = engine.curve_of(answers[-1])
    assert {one.settings.regulariser for one in other} == {"first"}
