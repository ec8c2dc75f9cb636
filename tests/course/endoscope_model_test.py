"""Checks of notebook 01: the right answer passes, and each slip gets its own sentence."""

import numpy as np
import pytest

from endolab.course import endoscope_model as check


def rms(weight):
    return np.array([np.sqrt(np.mean(off**2)) for off in check._errors(weight)])


def slope(weight, power=1):
    return np.polyfit(np.log(check.HEIGHTS), power * np.log(rms(weight)), 1)[0]


def signed(weight):
    means = [np.mean(off) for off in check._errors(weight)]
    return np.polyfit(np.log(check.HEIGHTS), np.log(np.abs(means)), 1)[0]


def unwritten(*_):
    raise NotImplementedError


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (lambda w: -slope(w), "negative"),
        (lambda w: 1 / slope(w), "Turn it round"),
        (lambda w: slope(1), "same for all"),
        (signed, "cancel"),
        (lambda w: slope(w, 2), "mean square"),
        (lambda w: np.polyfit(check.HEIGHTS, np.log(rms(w)), 1)[0], "logarithmic"),
        (lambda w: np.nan, "no number"),
        (lambda w: slope(w) - 0.3, "exponent 1.5"),
    ],
)
def test_a_slip_in_the_slope_is_named(answer, said):
    found = check.exercise_1(answer)
    assert found.right is False
    assert said in found.said


def test_the_slope_measured_passes():
    assert check.exercise_1(slope)
    assert slope(1) == pytest.approx(-2, abs=0.05)
    assert slope(2) == pytest.approx(-1, abs=0.05)


def twin(power, sign=1, of_plane=True):
    def brdf(brdf, cosine, k, gamma, other_k, other_gamma):
        factor = other_gamma / gamma
        fall_off = factor * (k + power) - (other_k + power) if of_plane else sign * (k - other_k)
        return 0.7 * brdf**factor * cosine**fall_off

    return brdf


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (twin(0), "which power"),
        (twin(1), "what of 1/d²"),
        (twin(2), "cos θ of the surface"),
        (twin(3, of_plane=False), "Right for another k"),
        (lambda b, c, k, g, k2, g2: b ** (g2 / g) * c ** ((g2 / g - 1) * (k + 3)), "changes as well"),
        (lambda b, c, k, g, k2, g2: b ** (g2 / g) * c ** (3 * g2 / g - 3), "each for itself"),
        (twin(3, sign=-1, of_plane=False), "changed places"),
        (lambda b, c, k, g, k2, g2: b**2, "stay as it is"),
        (lambda b, c, k, g, k2, g2: b[:3], "one for each cosine"),
        (lambda b, c, k, g, k2, g2: b, "still differ"),
    ],
)
def test_a_slip_in_the_brdf_is_named(answer, said):
    found = check.exercise_2(answer)
    assert found.right is False
    assert said in found.said


def test_the_brdf_passes_whatever_its_factor():
    assert check.exercise_2(twin(3))


@pytest.mark.parametrize("exercise", [check.exercise_1, check.exercise_2])
@pytest.mark.parametrize("answer", [..., unwritten])
def test_no_answer_is_neither_right_nor_wrong(exercise, answer):
    assert exercise(answer).right is None
