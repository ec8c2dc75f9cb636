"""Compiled loops on several cores: the same results whoever takes part, and who does."""

import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np
import pytest

from endolab.numerics import threads
from endolab.numerics.threads import BAND_ROWS, THREADS_VARIABLE, limit_threads
from tests.tools.loops import blurred, plainly_blurred

SEVERAL = min(2, int(numba.config.NUMBA_NUM_THREADS))


@pytest.fixture
def start(rng):
    return rng.normal(size=(20 * BAND_ROWS + 5, 90))


@pytest.mark.parametrize("wrong", ["0", "two", "²"])
def test_a_number_of_threads_that_is_none_is_said_to_be_so(monkeypatch, wrong, start):
    monkeypatch.setenv(THREADS_VARIABLE, wrong)
    with pytest.raises(ValueError, match="ENDOLAB_THREADS"):
        blurred(start, 7)


def test_limits_hold_inside_and_the_inner_one_is_that_of_its_block(monkeypatch):
    monkeypatch.setenv(THREADS_VARIABLE, str(SEVERAL))
    with limit_threads(1):
        assert threads.threads() == 1
        with limit_threads(None):
            assert threads.threads() == 1
        with limit_threads(SEVERAL + 5):
            assert threads.threads() == SEVERAL
        assert threads.threads() == 1
    assert threads.threads() == SEVERAL


def test_blas_has_one_thread_inside_and_its_own_once_all_are_out():
    """Its threads are the process's: who comes in second must not take one thread for what there was."""

    def now():
        return [pool["num_threads"] for pool in threads._blas().info()]

    before = now()
    second = limit_threads(2)
    with limit_threads(None):
        assert set(now()) == {1}
        second.__enter__()
    second.__exit__(None, None, None)
    assert now() == before


def test_two_threads_of_a_process_at_once_both_get_it_right(start):
    gate = threading.Barrier(2)

    def work(a):
        gate.wait()
        return [blurred(a, 30) for _ in range(10)]

    with ThreadPoolExecutor(2) as pool:
        for a, found in zip(
            (start, -start), pool.map(work, (start, -start)), strict=True
        ):
            for one in found:
                np.testing.assert_allclose(one, plainly_blurred(a, 30), rtol=1e-12)


FORK = """
import os, warnings
import numpy as np
from endolab.numerics import threads
from tests.tools.loops import blurred
warnings.simplefilter("ignore", DeprecationWarning)  # Python's own, of forks beside threads
a = np.random.default_rng(0).normal(size=(325, 90))
before = blurred(a, 7)
with threads._cores:  # as another thread of the parent might
    child = os.fork()
    if child == 0:
        os._exit(0 if np.array_equal(blurred(a, 7), before) else 1)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), np.array_equal(blurred(a, 7), before))
"""


def test_a_forked_child_goes_on_by_itself(monkeypatch):
    for name in (THREADS_VARIABLE, "NUMBA_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    command = [sys.executable, "-W", "error", "-c", FORK]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.stdout.strip() == "0 True", done.stderr
