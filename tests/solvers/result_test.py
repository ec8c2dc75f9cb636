"""`run` and a solver that does what it is told."""

import numpy as np
import pytest

import endolab as el
from endolab.solvers.energy import energy_terms
from endolab.solvers.problem import Problem
from endolab.synthetic.scenes import Plane

CAMERA = el.Pinhole(8, 6, 6.0, 6.0, 3.5, 2.5)
TRUTH = np.log(Plane(20.0, 10.0).distance(CAMERA.field.rays))
MASK = np.indices((6, 8)).sum(axis=0) > 1
HERE = {"a": np.arange(48.0).reshape(6, 8)}


@pytest.fixture(scope="module")
def problem():
    rendered = el.render(Plane(20.0, 10.0), CAMERA, el.Photometry())
    return Problem(rendered.image, MASK, CAMERA, rendered.photometry, lam=0.0)


class Script:
    """A solver that yields the truth plus each offset, then returns; an exception is raised."""

    def __init__(self, problem, *steps, end=el.Status.CONVERGED):
        self.problem = problem
        self.steps = steps
        self.end = end
        self.closed = False
        self.iterates = []

    def __call__(self):
        previous = None
        try:
            for step in self.steps:
                if isinstance(step, type):
                    raise step
                scalars = {"step": float(len(self.iterates))}
                previous = el.Iterate.of(
                    self.problem, TRUTH + step, previous, maps=HERE, scalars=scalars
                )
                self.iterates.append(previous)
                yield previous
            return self.end
        finally:
            self.closed = True


class Watcher:
    """An observer that notes what it saw, and at one iterate returns or raises something."""

    def __init__(self, at=None, answer=None):
        self.at = at
        self.answer = answer
        self.seen = []
        self.closed = 0

    def __call__(self, iterate):
        self.seen.append(iterate.k)
        if iterate.k != self.at:
            return None
        if isinstance(self.answer, type):
            raise self.answer
        return self.answer

    def close(self):
        self.closed += 1


def test_converged_gives_the_last_iterate(problem):
    script = Script(problem, 0.5, 0.1, 0.3)
    watcher = Watcher()
    result = el.run(script(), [watcher, lambda iterate: False])
    assert result.status is el.Status.CONVERGED
    assert result.iterate is script.iterates[2]
    assert (result.iterations, watcher.seen, watcher.closed) == (2, [0, 1, 2], 1)
    assert result.energy > script.iterates[1].energy


@pytest.mark.parametrize(
    ("status", "options"),
    [
        (el.Status.STALLED, {"end": el.Status.STALLED}),
        (el.Status.MAX_ITERATIONS, {"max_iterations": 2}),
        (el.Status.STOPPED, {"at": 2, "answer": True}),
        (el.Status.STOPPED, {"at": 2, "answer": KeyboardInterrupt}),
        (el.Status.STOPPED, {"then": KeyboardInterrupt}),
        (el.Status.NON_FINITE, {"then": np.where(MASK, np.nan, 0.0)}),
        (el.Status.NON_FINITE, {"then": np.inf}),
    ],
)
def test_any_other_end_gives_the_iterate_of_least_energy(problem, status, options):
    steps = (0.5, 0.1, 0.3, *([options["then"]] if "then" in options else []))
    more = () if "end" in options or "then" in options else (0.0,)
    script = Script(problem, *steps, *more, end=options.get("end", el.Status.CONVERGED))
    first = Watcher(options.get("at"), options.get("answer"))
    second = Watcher()
    with np.errstate(over="ignore", invalid="ignore"):
        solver = script()  # kept, so that it is not closed for want of a name
        result = el.run(solver, [first, second], options.get("max_iterations"))
    assert result.status is status
    assert result.iterate is script.iterates[1]
    assert result.iterations == 2
    assert [row["k"] for row in result.history] == [0, 1, 2]
    assert first.seen == [0, 1, 2]
    assert second.seen == (
        [0, 1] if options.get("answer") is KeyboardInterrupt else [0, 1, 2]
    )
    assert (first.closed, second.closed, script.closed) == (1, 1, True)


@pytest.mark.parametrize(
    ("steps", "at", "answer", "error"),
    [
        ((KeyboardInterrupt,), None, None, KeyboardInterrupt),
        ((0.5, RuntimeError), None, None, RuntimeError),
        ((0.5, 0.1), 1, ZeroDivisionError, ZeroDivisionError),
        ((np.nan,), None, None, ValueError),
        ((), None, None, ValueError),
    ],
)
def test_what_cannot_be_answered_is_raised_and_everyone_is_closed(
    problem, steps, at, answer, error
):
    script = Script(problem, *steps)
    first = Watcher(at, answer)
    second = Watcher()
    solver = script()
    with pytest.raises(error):
        el.run(solver, [first, second])
    assert (first.closed, second.closed, script.closed) == (1, 1, True)


def test_history_tells_each_step(problem):
    script = Script(problem, 0.5, 0.1, 0.3)
    result = el.run(script())
    for row, iterate in zip(result.history, script.iterates, strict=True):
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
