"""The explained contrast falls as λ grows; the λ that it suggests is the largest that explains enough."""

import numpy as np
import pytest

import endolab as el
from tests.tools.problems import Shot

LAMS = (0.1, 1.0, 10.0, 100.0)


@pytest.fixture(scope="module")
def explained():
    shot = Shot("colon", el.load_calibration("paper", width=160))
    how = {"channel": "grey", "contours": False}
    return [el.explained_contrast(shot.reconstruct(lam=lam, **how)) for lam in LAMS]


def test_it_falls_as_lam_grows(explained):
    assert explained[0] > 0.99
    assert np.all(np.diff(explained) < 0)


def test_the_suggested_lam_lies_between_what_does_and_what_does_not_explain_enough():
    lam, at_least = el.suggest_lam([10, 0.1, 1], [0.9, 1.0, 0.995])
    assert lam == pytest.approx(10 ** (0.005 / 0.095))
    assert not at_least
    assert el.suggest_lam(LAMS, [0.999] * 4) == (pytest.approx(100), True)
    assert el.suggest_lam(LAMS, [0.98, 0.9, 0.8, 0.7]) == (None, False)
    assert el.suggest_lam([], []) == (None, False)
