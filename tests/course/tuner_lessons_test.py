"""Exercises of notebook 06: right answers pass, and each mistake is told from the others."""

import numpy as np
import pytest

import endolab as el
from endolab.course import tuner_lessons as check
from endolab.tuning.engine import Tuner
from endolab.tuning.source import Settings


@pytest.fixture(scope="module")
def engine():
    """A tuner that is asked nothing."""
    engine = Tuner(el.load_calibration("paper"))
    yield engine
    engine.close()


@pytest.fixture(scope="module")
def answer(engine):
    """The best gain as the tuner itself finds it, and what is left."""

    def error(gain):
        return engine.cold(Settings(scene="tube", gamma=2.0, gain=gain)).median_error

    found = {gain: error(gain) for gain in (1.1, 1.12, 1.13, 1.14, 1.16)}
    gain = min(found, key=found.get)
    return gain, found[gain]


def test_the_best_gain_is_right(engine, answer):
    gain, left = answer
    assert check.exercise_1(gain, left, "shape", engine)
    assert check.exercise_1(gain, ..., "shape", engine).right is None


@pytest.mark.parametrize(
    ("mistake", "said"),
    [
        (lambda gain, left: (1 / gain, left, "shape"), "already too near"),
        (lambda gain, left: (gain**0.5, left, "shape"), "by its root"),
        (lambda gain, left: (gain**2, left, "shape"), "square of the best"),
        (lambda gain, left: (1.03, left, "shape"), "higher gain"),
        (lambda gain, left: (1.2, left, "shape"), "lower gain"),
        (lambda gain, left: (gain, left / 100, "shape"), "in per cent"),
        (lambda gain, left: (gain, 3 * left, "shape"), "status line"),
        (lambda gain, left: (gain, left, "scale"), "takes out"),
        (lambda gain, left: (gain, left, "γ"), '"scale" or "shape"'),
    ],
)
def test_a_wrong_gain_is_told_by_what_it_is(engine, answer, mistake, said):
    told = check.exercise_1(*mistake(*answer), engine)
    assert told.right is False
    assert said in told.said


def test_the_largest_lam_that_is_small_enough_is_right(engine):
    assert check.exercise_2(0.01, "slope", engine)
    assert check.exercise_2(..., "slope", engine).right is None


@pytest.mark.parametrize(
    ("lam", "charged", "said"),
    [
        (1.0, "slope", "is *order* at first?"),
        (1e-3, "slope", "need not fall"),
        (0.0, "slope", "positive"),
        (0.01, "bend", "next to no bends"),
        (0.01, "noise", '"slope" or "bend"'),
    ],
)
def test_a_wrong_lam_is_told_by_what_it_does(engine, lam, charged, said):
    told = check.exercise_2(lam, charged, engine)
    assert told.right is False
    assert said in told.said


def test_a_gain_only_multiplies_distances_by_its_root(engine):
    once, more = (engine.cold(Settings(scene="tube", gain=gain)).result.distance for gain in (1.0, 1.21))
    assert np.allclose(more, 1.1 * once, rtol=1e-6, equal_nan=True)
