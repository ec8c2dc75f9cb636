"""A pytest plugin: a notebook cell that ran out of time fails, and so does every cell after it."""

import pytest


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    """Fail a cell that nbval would let pass or xfail: the rest of its notebook proves nothing."""
    yield
    if getattr(item.parent, "timed_out", False):
        pytest.fail("this cell, or one before it, ran out of time", pytrace=False)
