"""The explained contrast falls as λ grows; the λ that it suggests is the largest that explains enough."""

import numpy as np
import pytest

import endolab as el
from endolab.metrics.contrast import explained_share, noise_left
from tests.tools.cases import drawn
from tests.tools.problems import at_truth

LAMS = (0.1, 1.0, 10.0, 100.0)


def explained_by(lams, **noise):
    """What a colon's surfaces explain."""
    colon = drawn("colon", "paper", 160, **noise)
    how = {"channel": "grey", "contours": False}
    return [el.explained_contrast(colon.solve(lam=lam, **how)) for lam in lams]


def test_it_falls_as_lam_grows():
    explained = explained_by(LAMS)
    assert explained[0] > 0.99
    assert np.all(np.diff(explained) < 0)


@pytest.mark.parametrize("noise", [0.0, 1.0, 8.0])
def test_noise_counts_as_explained(noise):
    """The true surface explains all, and one that is bright alike everywhere nothing, whatever the noise."""
    problem, truth = at_truth("curved", noise=noise, bits=8)
    truth = el.Result(el.Iterate.of(problem, truth), el.Status.CONVERGED, [], 0.0)
    assert el.explained_contrast(truth) == pytest.approx(1, abs=0.003)
    assert el.explained_contrast(truth) <= 1
    flat = np.where(problem.mask, 0.5 - problem.image, np.nan)
    assert explained_share(problem, flat, noise_left(truth)[0]) == pytest.approx(0)


def test_a_lam_is_suggested_in_noise():
    lams = LAMS[:3]
    lam, at_least = el.suggest_lam(lams, explained_by(lams, noise=8, bits=8))
    assert 0.1 < lam < 10
    assert not at_least


def test_the_suggested_lam_lies_between_what_does_and_what_does_not_explain_enough():
    lam, at_least = el.suggest_lam([10, 0.1, 1], [0.9, 1.0, 0.995])
    assert lam == pytest.approx(10 ** (0.005 / 0.095))
    assert not at_least
    assert el.suggest_lam(LAMS, [0.999] * 4) == (pytest.approx(100), True)
    assert el.suggest_lam(LAMS, [0.98, 0.9, 0.8, 0.7]) == (None, False)
    assert el.suggest_lam([], []) == (None, False)
