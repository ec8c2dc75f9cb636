"""Compiled loops on several cores: the same results whoever takes part, and who does."""

import math
import os
import subprocess
import sys
import threading

import joblib
import numba
import numpy as np
import pytest

from endolab.numerics import threads
from endolab.numerics.threads import ENOUGH, ROWS, VARIABLE, band_rows, bands, limited_threads
from tests.tools.loops import blurred, plainly_blurred

SEVERAL = min(2, int(numba.config.NUMBA_NUM_THREADS))


@pytest.fixture
def start(rng):
    shape = 20 * ROWS + 5, 90
    assert shape[0] * shape[1] > ENOUGH
    return rng.normal(size=shape)


def solved(start, rounds=7):
    a = start.copy()
    assert blurred(a, np.zeros(a.shape), rounds) == rounds
    return a


@pytest.fixture
def asked(monkeypatch):
    """How many threads each parallel call took."""
    counts = []
    real = blurred.parallel

    def counted(*args):
        counts.append(numba.get_num_threads())
        return real(*args)

    monkeypatch.setattr(blurred, "parallel", counted)
    monkeypatch.delenv(VARIABLE, raising=False)
    return counts


def said(code, **environment):
    """What a fresh Python prints."""
    plain = {name: value for name, value in os.environ.items() if name not in (VARIABLE, "NUMBA_NUM_THREADS")}
    command = [sys.executable, "-W", "error", "-c", f"from endolab.numerics import threads\n{code}"]
    how = {"capture_output": True, "text": True, "timeout": 120, "env": plain | environment}
    done = subprocess.run(command, **how)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.parametrize("rows", [1, ROWS - 1, ROWS, ROWS + 1, 5 * ROWS + 3])
def test_bands_are_all_rows_once(rows):
    found = [i for band in range(bands(rows)) for i in range(*band_rows(band, 3, 3 + rows))]
    assert found == list(range(3, 3 + rows))


def test_results_are_the_same_bit_for_bit_on_any_number_of_threads(start, asked):
    assert SEVERAL > 1, "this machine has one core, and the test says nothing"
    with limited_threads(1):
        alone = solved(start)
    assert asked == []
    with limited_threads(SEVERAL):
        together = solved(start)
    assert asked == [SEVERAL]
    np.testing.assert_array_equal(alone, together)
    np.testing.assert_allclose(alone, plainly_blurred(start, 7), rtol=1e-12)


def test_small_maps_wake_no_other_core(start, asked):
    solved(start[:, : ENOUGH // start.shape[0]])
    assert asked == []
    solved(start)
    assert asked == [threads.threads()] or threads.threads() == 1


@pytest.mark.parametrize("wrong", ["0", "-1", "two", "1.5", " 2", "²", "1e1"])
def test_a_number_of_threads_that_is_none_is_said_to_be_so(monkeypatch, wrong, start):
    monkeypatch.setenv(VARIABLE, wrong)
    with pytest.raises(ValueError, match=r"^ENDOLAB_THREADS must be a positive number of threads, found '"):
        solved(start)


def test_the_variable_says_how_many_up_to_what_numba_has(monkeypatch):
    most = int(numba.config.NUMBA_NUM_THREADS)
    monkeypatch.delenv(VARIABLE, raising=False)
    assert threads.threads() == min(threads.cores(), most)
    monkeypatch.setattr(threads, "cores", lambda: 1)
    assert threads.threads() == 1
    for told, taken in (("", 1), ("1", 1), (str(most), most), (str(most + 1), most), ("9" * 30, most)):
        monkeypatch.setenv(VARIABLE, told)
        assert threads.threads() == taken


def test_limits_hold_inside_and_the_inner_one_is_that_of_its_block(monkeypatch):
    monkeypatch.setenv(VARIABLE, str(SEVERAL))
    with limited_threads(1):
        assert threads.threads() == 1
        with limited_threads(None):
            assert threads.threads() == 1
        with limited_threads(SEVERAL + 5):
            assert threads.threads() == SEVERAL
        assert threads.threads() == 1
    with pytest.raises(RuntimeError), limited_threads(1):
        raise RuntimeError
    assert threads.threads() == SEVERAL


@pytest.mark.parametrize("wrong", [0, -2, 1.0, True, "2"])
def test_a_limit_that_is_no_number_of_threads_is_named(wrong):
    with pytest.raises(ValueError, match="threads must be a whole number of at least 1, got"):
        limited_threads(wrong).__enter__()
    assert threads.threads() >= 1


def test_a_limit_is_that_of_its_own_thread(monkeypatch):
    monkeypatch.setenv(VARIABLE, str(SEVERAL))
    found = []
    with limited_threads(1):
        other = threading.Thread(target=lambda: found.append(threads.threads()))
        other.start()
        other.join()
    assert found == [SEVERAL]


def test_two_threads_of_a_process_at_once_both_get_it_right(start, rng):
    other = rng.normal(size=start.shape)
    expected = [solved(one, 30) for one in (start, other)]
    right, gate = [], threading.Barrier(2)

    def work(one, wanted):
        gate.wait()
        right.extend(np.array_equal(solved(one, 30), wanted) for _ in range(10))

    both = [threading.Thread(target=work, args=given) for given in zip((start, other), expected, strict=True)]
    for one in both:
        one.start()
    for one in both:
        one.join()
    assert right == [True] * 20


def test_who_finds_the_cores_taken_goes_on_by_itself(start, asked):
    with threads._cores:
        busy = solved(start)
    assert asked == []
    np.testing.assert_array_equal(busy, solved(start))
    assert len(asked) == (1 if threads.threads() > 1 else 0)


def test_the_cores_are_free_again_after_an_error(start, asked, monkeypatch):
    def broken(*_):
        raise RuntimeError("broken")

    monkeypatch.setattr(blurred, "parallel", broken)
    with limited_threads(SEVERAL), pytest.raises(RuntimeError, match="broken"):
        solved(start)
    assert not threads._cores.locked()


FORK = """
import os, warnings
import numpy as np
from tests.tools.loops import blurred
warnings.simplefilter("ignore", DeprecationWarning)  # Python's own, of forks beside threads
a = np.random.default_rng(0).normal(size=(325, 90))
def solved():
    one = a.copy()
    blurred(one, np.zeros(one.shape), 7)
    return one
before = solved()
with threads._cores:  # as another thread of the parent might
    child = os.fork()
    if child == 0:
        os._exit(0 if np.array_equal(solved(), before) else 1)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), np.array_equal(solved(), before))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
def test_a_forked_child_goes_on_by_itself():
    assert said(FORK) == "0 True"


def test_a_worker_of_joblib_takes_its_share():
    joint = threads.cores()
    found = joblib.Parallel(2, backend="loky")(joblib.delayed(threads.threads)() for _ in range(2))
    assert found == [max(joint // 2, 1)] * 2


@pytest.mark.parametrize(
    ("written", "found"),
    [
        (["150000 100000\n"], 2),
        (["50000 100000\n"], 1),
        (["max 100000\n"], math.inf),
        (["300000\n", "100000\n"], 3),
        (["-1\n", "100000\n"], math.inf),
        (["100000\n"], math.inf),
        ([], math.inf),
    ],
)
def test_a_containers_share_of_the_cores_is_read(tmp_path, monkeypatch, written, found):
    paths = [tmp_path / str(k) for k in range(max(1, len(written)))]
    for path, text in zip(paths, written, strict=False):
        path.write_text(text)
    monkeypatch.setattr(threads, "SHARES", ([tmp_path / "none"], paths))
    assert threads._share() == found
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(8), raising=False)
    monkeypatch.delenv("LOKY_MAX_CPU_COUNT", raising=False)
    assert threads.cores.__wrapped__() == min(found, 8)
    monkeypatch.setenv("LOKY_MAX_CPU_COUNT", "1")
    assert threads.cores.__wrapped__() == 1


def test_cores_are_those_that_joblib_finds():
    assert threads.cores() == joblib.cpu_count()


def test_no_more_are_asked_for_than_numba_was_given():
    assert said("print(threads.threads())", NUMBA_NUM_THREADS="1") == "1"
    assert said("print(threads.threads())", NUMBA_NUM_THREADS="1", ENDOLAB_THREADS="2") == "1"


def test_what_threads_another_package_has_loaded_does_not_matter():
    """Open3D brings a TBB that is too old for Numba, which would warn of it."""
    pytest.importorskip("open3d")
    code = (
        "import open3d, warnings; warnings.simplefilter('error'); import numpy as np, numba\n"
        "from endolab.depth.multigrid import dot\n"
        "assert dot(np.ones((400, 400)), np.ones((400, 400))) == 160000\n"
        "print(numba.threading_layer())"
    )
    env = {**os.environ, "ENDOLAB_THREADS": "2"}
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env, timeout=120)
    assert (ran.returncode, ran.stdout.split()[-1:]) == (0, ["omp"]), ran.stderr
