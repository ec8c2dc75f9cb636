"""Where the time of a command goes: the parts make up the whole."""

import subprocess
import sys
import time

import pytest

from endolab.cli.stopwatch import Stopwatch


def test_stages_make_up_the_time_that_passed(monkeypatch):
    now = iter([2.0, 2.5, 4.0, 4.25])
    monkeypatch.setattr(time, "perf_counter", lambda: next(now))
    clock = Stopwatch(1.0)
    for stage in ("starting", "reading", "preparing", "starting"):
        clock.lap(stage)
    assert clock.stages == {"starting": 1.25, "reading": 0.5, "preparing": 1.5}
    clock.share("preparing", [("solution", 0.5), ("contours", 0.25), ("solution", 0.25)])
    assert clock.stages["preparing"] == 0.5
    assert (clock.stages["solution"], clock.stages["contours"]) == (0.75, 0.25)
    assert clock.total == pytest.approx(4.25 - 1.0, rel=1e-12)


@pytest.mark.skipif(sys.platform != "linux", reason="where the system knows when a process began")
def test_a_process_began_when_it_was_started():
    """Though it has waited since; to a tenth of a second."""
    code = "import time; first = time.time(); time.sleep(0.5); "
    code += "from endolab.cli.stopwatch import process_began as began; "
    code += "print(time.time() - time.perf_counter() + began(), first)"
    before = time.time()
    how = {"capture_output": True, "text": True, "check": True, "timeout": 60}
    began, first = map(float, subprocess.run([sys.executable, "-c", code], **how).stdout.split())
    assert before - 0.1 < began < first + 0.1
