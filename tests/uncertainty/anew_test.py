from dataclasses import replace

import numpy as np
import pytest

from endolab.depth.gauss_newton import gauss_newton
from endolab.reconstruction.contours import torn_at_contours
from endolab.uncertainty.anew import LONGEST, Anew
from tests.tools.problems import problem_of


def settled(problem, start=None):
    """Log d once there is nothing left to do, 0 outside the mask."""
    *_, last = gauss_newton(problem, start=start, tolerance=1e-4, max_iterations=100)
    return np.where(problem.mask, last.log_distance, 0.0)


def answer(steps):
    """What a generator returns."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


def alike(a, b):
    return np.corrcoef(a.ravel(), b.ravel())[0, 1]


@pytest.fixture(scope="module")
def colon():
    problem, _ = problem_of("colon", 100)
    return problem, settled(problem)


def test_another_lam_moves_it_as_a_whole_run_does(colon):
    problem, v = colon
    found = answer(Anew(problem, v).with_lam(4.0))
    there = settled(replace(problem, lam=4 * problem.lam), v) - v
    assert np.std(there) > 0.005
    assert alike(found, there) > 0.9
    assert np.std(found) == pytest.approx(np.std(there), rel=0.3)
    assert np.all(found[~problem.mask] == 0)


def test_a_torn_surface_moves_as_a_whole_run_does(colon):
    problem, v = colon
    cuts = torn_at_contours(problem).cuts
    found = answer(Anew(problem, v).with_cuts(cuts))
    there = settled(replace(problem, cuts=cuts), v) - v
    assert np.std(there) > 0.02
    assert alike(found, np.clip(there, -LONGEST, LONGEST)) > 0.8


def test_what_is_left_to_do_is_no_answer(colon):
    """A map that is not there yet moves on its own; that is not λ's doing."""
    problem, v = colon
    bumpy = v + 0.05 * problem.mask * np.sin(np.arange(v.shape[1]) / 4)
    rough, smooth = Anew(problem, bumpy), Anew(problem, v)
    assert not answer(rough.with_lam(1.0)).any()
    assert alike(answer(rough.with_lam(4.0)), answer(smooth.with_lam(4.0))) > 0.8


def test_no_lam_has_no_other_and_the_largest_no_larger(colon):
    problem, v = colon
    assert not answer(Anew(replace(problem, lam=0.0), v).with_lam(10.0)).any()
    assert not answer(Anew(replace(problem, lam=1e12), v).with_lam(10.0)).any()


def test_what_goes_too_far_is_cut_short(colon):
    problem, v = colon
    far = answer(Anew(problem, v).with_lam(1e9))
    assert np.abs(far).max() <= LONGEST
