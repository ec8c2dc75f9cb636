"""`run`, with a solver that follows a script."""

from unittest.mock import Mock

import numpy as np
import pytest

import endolab as el
from endolab.solvers.energy import energy_terms
from endolab.solvers.problem import Problem
from endolab.solvers.result import limit_steps
from endolab.synthetic.scenes import Plane

CAMERA = el.Pinhole(8, 6, 6.0, 6.0, 3.5, 2.5)
TRUTH = np.log(Plane(20.0, 10.0).distance(CAMERA.field.rays))
MASK = np.indices((6, 8)).sum(axis=0) > 1


@pytest.fixture(scope="module")
def problem():
    rendered = el.render(Plane(20.0, 10.0), CAMERA, el.Photometry())
    return Problem(rendered.image, MASK, CAMERA, rendered.photometry, lam=0.0)


def script(problem, made, *steps):
    """A solver that yields the truth plus each offset; it returns a status, and raises an exception."""
    previous = None
    try:
        for step in steps:
            if isinstance(step, el.Status):
                return step
            if isinstance(step, type):
                raise step
            v = TRUTH + step
            scalars = {"step": float(len(made))}
            previous = el.Iterate.of(problem, v, previous, scalars=scalars)
            made.append(previous)
            yield previous
        return el.Status.CONVERGED
    finally:
        made.append("closed")


def watcher(*answers):
    """An observer that answers so, or raises an exception."""
    return Mock(side_effect=answers or None, return_value=None)


def seen_by(observer):
    return [call.args[0].k for call in observer.call_args_list]


def test_converged_gives_the_last_iterate(problem):
    made = []
    first = watcher()
    result = el.run(script(problem, made, 0.5, 0.1, 0.3), [first, lambda _: False])
    assert result.status is el.Status.CONVERGED
    assert result.iterate is made[2]
    assert (result.iterations, first.close.call_count) == (2, 1)
    assert seen_by(first) == [0, 1, 2]
    assert result.energy > made[1].energy


@pytest.mark.parametrize(
    ("status", "then", "answer", "limit"),
    [
        (el.Status.STALLED, el.Status.STALLED, None, None),
        (el.Status.MAX_ITERATIONS, 0.0, None, 2),
        (el.Status.STOPPED, 0.0, True, None),
        (el.Status.STOPPED, 0.0, KeyboardInterrupt, None),
        (el.Status.STOPPED, KeyboardInterrupt, None, None),
        (el.Status.NON_FINITE, np.where(MASK, np.nan, 0.0), None, None),
        (el.Status.NON_FINITE, np.inf, None, None),
    ],
)
def test_any_other_end_gives_the_iterate_of_least_energy(
    problem, status, then, answer, limit
):
    made = []
    first, second = watcher(None, None, answer), watcher()
    # Kept, so that it is not closed for want of a name.
    solver = script(problem, made, 0.5, 0.1, 0.3, then)
    with np.errstate(over="ignore", invalid="ignore"):
        result = el.run(limit_steps(solver, limit), [first, second])
    assert result.status is status
    assert result.iterate is made[1]
    assert [row["k"] for row in result.history] == [0, 1, 2]
    assert seen_by(first) == [0, 1, 2]
    assert seen_by(second) == [0, 1, 2][: 2 if answer is KeyboardInterrupt else 3]
    assert (
        first.close.call_count == second.close.call_count == made.count("closed") == 1
    )


@pytest.mark.parametrize(
    ("steps", "answers", "error"),
    [
        ((KeyboardInterrupt,), (), KeyboardInterrupt),
        ((0.5, RuntimeError), (), RuntimeError),
        ((0.5, 0.1), (None, ZeroDivisionError), ZeroDivisionError),
        ((np.nan,), (), ValueError),
        ((), (), ValueError),
    ],
)
def test_what_cannot_be_answered_is_raised_and_everyone_is_closed(
    problem, steps, answers, error
):
    made = []
    first, second = watcher(*answers), watcher()
    solver = script(problem, made, *steps)
    with pytest.raises(error):
        el.run(solver, [first, second])
    assert (
        first.close.call_count == second.close.call_count == made.count("closed") == 1
    )


def test_history_tells_each_step(problem):
    made = []
    result = el.run(script(problem, made, 0.5, 0.1, 0.3))
    for row, iterate in zip(result.history, made[:3], strict=True):
        terms = energy_terms(problem, iterate.log_distance)
        assert {key: row[key] for key in terms} == terms
        assert row["energy"] == sum(terms.values()) == iterate.energy
        assert row["step"] == row["k"] == iterate.k
    assert np.isnan(result.history[0]["change"])
    assert [row["change"] for row in result.history[1:]] == pytest.approx([0.4, 0.2])
    seconds = [row["seconds"] for row in result.history]
    assert 0 < seconds[0] < seconds[1] < seconds[2] <= result.seconds


def test_an_iterate_is_read_only_and_nan_outside_the_mask(problem):
    values = TRUTH.copy()
    iterate = el.Iterate.of(problem, values)
    values[:] = 0.0
    np.testing.assert_array_equal(iterate.log_distance, np.where(MASK, TRUTH, np.nan))
    with pytest.raises(ValueError, match="read-only"):
        iterate.log_distance[3, 3] = 1.0
    with pytest.raises(AttributeError):
        iterate.k = 3
