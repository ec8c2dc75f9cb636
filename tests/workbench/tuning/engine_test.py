"""The tuner's engine: the newest wish wins, and what is held makes the same bits again."""

import time
from dataclasses import replace

import numpy as np
import pytest

from endolab.workbench.tuning.engine import Engine
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


def test_while_the_hand_moves_looks_follow_and_the_newest_wish_wins(start):
    engine, answers = start()
    lams = [float(lam) for lam in np.geomspace(0.9, 0.02, 12)]
    for lam in lams:
        engine.ask(replace(FIRST, lam=lam))
        time.sleep(0.04)
    engine.wait(60)
    looks = [one for one in answers if one.kind == "look"]
    assert len(looks) >= 3
    assert {one.settings.lam for one in looks} <= set(lams)
    assert answers[-1].is_final
    assert answers[-1].settings.lam == lams[-1]
    assert apart(looks[-1], answers[-1]) < 0.8 * apart(answers[0], answers[-1])
    engine.ask(FIRST)  # comes back at once
    engine.wait(60)
    assert answers[-1] is answers[0]


@pytest.mark.parametrize("lam", [0.01, 100.0])
def test_the_curve_goes_on_to_both_sides_until_99_percent_is_crossed(start, lam):
    """Of a λ that was too large, no λ explained so much."""
    engine, [answer] = start(replace(FIRST, lam=lam))
    curve = engine.curve_of(answer)
    assert len(curve) >= 3
    assert curve[0].explained >= 0.99
    is_more = curve[-1].explained >= 0.99
    assert not is_more or 3.2 * curve[-1].settings.lam > 100
