"""Work on several threads: all of it is done, once, and errors come through."""

import numpy as np
import pytest

from endolab.numerics.side_by_side import WORTH_THREADS, by_rows, side_by_side
from endolab.numerics.threads import limit_threads, threads


@pytest.mark.parametrize(
    "shape", [(3, 7), (600, 700), (WORTH_THREADS, 1), (1, WORTH_THREADS)]
)
def test_every_row_is_worked_on_once(shape):
    done = np.zeros(shape)

    def add_one(rows):
        done[rows] += 1

    by_rows(add_one, shape)
    assert np.all(done == 1)


@pytest.mark.parametrize("pixels", [1, WORTH_THREADS])
def test_results_come_in_order_and_errors_too(pixels):
    assert side_by_side(lambda one: 2 * one, range(9), pixels) == list(range(0, 18, 2))
    with pytest.raises(ZeroDivisionError):
        side_by_side(lambda one: 1 / one, [1, 0, 2], pixels)


def test_a_limit_holds_within(all_cores):
    for limit in (1, min(2, threads())):
        with limit_threads(limit):
            found = side_by_side(lambda _: threads(), range(4), WORTH_THREADS)
        assert found == [limit] * 4
