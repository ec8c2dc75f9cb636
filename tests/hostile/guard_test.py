"""The guard sees what it must see: each kind of harm, planted, and a case without one."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import psutil
import pytest

from tests.hostile import judge, worker
from tests.hostile.case import Case
from tests.hostile.guard import Guard

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="it looks into /proc")


def say(text, status=2):
    sys.stderr.write(text)
    return status


def refuse():
    raise ValueError("frame.png: expected a picture, found none")


def leave(path, content="x"):
    Path(path).parent.mkdir(exist_ok=True, parents=True)
    Path(path).write_text(content)
    return 0


def native(text):
    os.write(2, text)
    return 0


def hog():
    taken = np.ones(900 * 2**17)
    return 0 if taken.size else 1


CHILDREN, OPEN, END = [], [], threading.Event()


def leak_thread():
    threading.Thread(target=END.wait, name="planted", daemon=True).start()
    return 0


def leak_process():
    CHILDREN.append(subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]))
    return 0


def leak_file():
    OPEN.append(Path("given.txt").open())  # noqa: SIM115
    return 0


def temporary():
    import tempfile

    Path(tempfile.mkdtemp()).joinpath("x").touch()
    return 0


def unmeant():
    try:
        int("x")
    except ValueError as error:
        print(f"endolab: {error} of frame.png", file=sys.stderr)
    return 2


PLANTED = {
    "traceback": (lambda: 1 / 0, "exit status 1"),
    "two lines": (lambda: say("endolab: frame.png: cannot be read\nmore\n"), "2 lines on stderr"),
    "no sentence": (lambda: say("frame.png\n"), "no sentence"),
    "nothing said": (lambda: 2, "0 lines on stderr"),
    "too long": (lambda: say(f"endolab: {'long ' * 200}\n"), "a sentence of"),
    "escape codes": (lambda: say("endolab: \x1b[31mframe.png\x1b[0m is red\n"), "unprintable"),
    "words of Python": (
        lambda: say("endolab: frame.png: [Errno 28] No space left on device\n"),
        "words for programmers",
    ),
    "an error that nobody meant": (unmeant, "was not meant"),
    "a warning": (lambda: say("RuntimeWarning: overflow\n", 0), "something on stderr"),
    "a library's line": (lambda: native(b"libpng warning: gAMA: duplicate\n"), "something on stderr"),
    "exit status": (lambda: 3, "exit status 3"),
    "not a number": (lambda: print("distance: nan") or 0, "a number that is none"),
    "a file left over": (lambda: leave("more.npz"), "left over: more.npz"),
    "a hidden file": (lambda: leave("out/.endolab-x/depth.npz"), "left over: out/.endolab-x"),
    "a file changed": (lambda: leave("given.txt", "y"), "changed: given.txt"),
    "a file gone": (lambda: Path("given.txt").unlink() or 0, "gone: given.txt"),
    "half a result": (lambda: leave("out/depth.npz"), "broken: out/depth.npz"),
    "cut JSON": (lambda: leave("out/report.json", '{"a": NaN}'), "broken: out/report.json"),
    "no result": (lambda: 0, "missing: out"),
    "a temporary file": (temporary, "temporary file left"),
    "a thread": (leak_thread, "thread left: planted"),
    "a process": (leak_process, "process left"),
    "an open file": (leak_file, "1 open files left"),
    "much memory": (hog, "it took"),
}


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run something as a case in this process."""
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(worker.tempfile, "tempdir", str(tmp_path / "temporary"))
    there = worker.Worker.__new__(worker.Worker)
    there.place, there.temporary = tmp_path, tmp_path / "temporary"
    there.caught = [os.open(tmp_path / name, os.O_RDWR | os.O_CREAT | os.O_APPEND) for name in ("o", "e")]
    (tmp_path / "case").mkdir()
    (tmp_path / "case/given.txt").write_text("x")
    monkeypatch.chdir(tmp_path / "case")

    def run(function, **expected):
        os.chdir(tmp_path / "case")
        return there.run(Case("planted", function, **expected))["wrong"]

    END.clear()
    yield run
    END.set()
    for descriptor in there.caught:
        os.close(descriptor)
    for child in CHILDREN:
        child.kill()
        child.wait()
    for stream in OPEN:
        stream.close()
    CHILDREN.clear(), OPEN.clear()


@pytest.mark.parametrize("name", PLANTED)
def test_what_is_planted_is_found(run, name):
    function, found = PLANTED[name]
    wrong = run(function, new=("out",), names=("frame.png",))
    assert any(found in sentence for sentence in wrong), wrong


def test_what_is_as_it_must_be_survives(run):
    assert (
        run(lambda: say("endolab: frame.png: expected a picture, found none\n"), names=("frame.png",)) == []
    )
    assert run(lambda: leave("out/report.json", "{}"), new=("out",)) == []
    assert (
        run(lambda: leave("rows.csv", "a,b\n1,2\n") or say("endolab: the second row\n"), kept=("rows.csv",))
        == []
    )
    assert run(lambda: leave("given.txt", "y") or 0, kept=("given.txt",), any=("given.txt",)) == []
    assert run(lambda: leave("given.txt", "z") or 0, kept=("given.txt",), safe=("given.txt",)) != []
    assert run(lambda: 0, status=2) == ["exit status 0, where 2 was expected: ''"]


def test_an_error_is_meant_if_endolab_raised_it(monkeypatch):
    from endolab.io.images import read_image

    for function, meant in (
        (lambda: read_image("nothing.png"), True),
        (refuse, False),
        (lambda: int("x"), False),
    ):
        with pytest.raises((OSError, ValueError)) as caught:
            function()
        assert (judge.raised_on_purpose(caught.value) == "") == meant


def test_what_hangs_or_dies_is_a_case_that_was_not_survived():
    """A worker that is ready, and then hangs in its first case and dies in its next."""
    program = (
        "print('{}', flush=True); word = input(); print('\"told\"', flush=True); 'die' in word or input()"
    )
    with Guard(limit=0.5, program=("-c", program)) as guard:
        guard.start()
        first = guard._worker.pid
        outcome = guard.run("hang", 0)
        assert (outcome.told, outcome.wrong) == ("told", ("no end after 0.5 s",))
        assert not psutil.pid_exists(first)
        guard.limit = 60
        (wrong,) = guard.run("die", 1).wrong
        assert wrong.startswith("the process died (0)")
    assert not guard.place.exists()
