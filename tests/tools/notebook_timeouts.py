"""How long a cell of a notebook may take, by how fast this machine is at the moment.

As a pytest plugin: a cell that ran out of time fails, and so does every cell after it.
"""

from time import perf_counter

import pytest

LIMIT = 60.0  # s, for a cell, where the loop takes so long:
IDLE = 0.1  # s; an idle core of 2024


def cell_limit():
    """Seconds for a cell, by how long a short loop takes: on a slow machine, or beside others."""
    start = perf_counter()
    sum(i * i % 7 for i in range(2_000_000))
    return LIMIT * max(1.0, (perf_counter() - start) / IDLE)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    """Fail a cell that nbval would let pass or xfail: after one that ran out of time nothing is proven."""
    notebook = item.parent
    if not hasattr(notebook, "limit"):
        notebook.limit = cell_limit()
    item.config.option.nbval_cell_timeout = notebook.limit
    yield
    if getattr(notebook, "timed_out", False):
        pytest.fail("this cell, or one before it, ran out of time", pytrace=False)
