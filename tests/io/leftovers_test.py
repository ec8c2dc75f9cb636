"""Temporary names: what killed runs left is cleared, what live ones have is not."""

import os
import re
import subprocess
import sys
import threading
import time
from pathlib import Path

import psutil
import pytest

from endolab.io import leftovers
from endolab.io.atomic import staged_file, staged_folder, write_atomically
from endolab.io.leftovers import TEMPORARY, clear_leftovers, is_temporary, temporary_name

ROOT = Path(__file__).resolve().parents[2]
HOLD = """if True:
    import time
    from endolab.io.atomic import staged_file, staged_folder
    with staged_folder("out") as folder, staged_file("out/a.bin") as file:
        (folder / "half").write_text("1")
        file.write_text("1")
        print("there", flush=True)
        time.sleep(60)
"""


@pytest.fixture
def held(tmp_path):
    """A process that is writing into the folder `out`, until it is killed."""
    command = [sys.executable, "-c", HOLD]
    where = {"cwd": tmp_path, "env": os.environ | {"PYTHONPATH": str(ROOT)}, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **where) as process:
        assert process.stdout.readline() == "there\n"
        yield process
        process.kill()


def names(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.skipif(os.name != "posix", reason="a zombie is of POSIX")
def test_a_live_run_keeps_its_files_and_a_killed_one_does_not(held, tmp_path):
    out = tmp_path / "out"
    before = names(out)
    assert len(before) == 2
    assert all(TEMPORARY.fullmatch(name) for name in before)
    with staged_folder(out) as folder:
        (folder / "b").write_text("1")
    assert names(out) == sorted([*before, ".endolab.json", "b"])
    held.kill()  # and nobody waits for it
    while psutil.Process(held.pid).status() != psutil.STATUS_ZOMBIE:
        time.sleep(0.01)
    with staged_folder(out) as folder:
        (folder / "b").write_text("2")
    assert names(out) == [".endolab.json", "b"]


def test_a_single_file_clears_its_folder_too(held, tmp_path):
    held.kill()
    held.wait()
    write_atomically(tmp_path / "out" / "c", b"1")
    assert names(tmp_path / "out") == ["c"]


def test_threads_leave_each_other_alone(tmp_path):
    inside, go = threading.Event(), threading.Event()

    def work():
        with staged_folder(tmp_path) as folder, staged_file(tmp_path / "b") as file:
            inside.set()
            go.wait(30)
            (folder / "a").write_text("1")
            file.write_text("1")

    thread = threading.Thread(target=work)
    thread.start()
    inside.wait(30)
    with staged_folder(tmp_path) as folder:
        (folder / "c").write_text("1")
    go.set()
    thread.join()
    assert names(tmp_path) == [".endolab.json", "a", "b", "c"]


@pytest.mark.parametrize(("days", "left"), [(0, True), (6, True), (8, False)])
def test_what_another_computer_has_is_left_for_a_week(tmp_path, monkeypatch, days, left):
    with monkeypatch.context() as other:
        other.setattr(leftovers, "_computer", lambda: "0123abcd")
        path = tmp_path / temporary_name(".png")
    path.mkdir()
    then = time.time() - days * 24 * 3600
    os.utime(path, (then, then))
    clear_leftovers(tmp_path)
    assert path.exists() is left


def test_only_such_names_are_cleared(tmp_path):
    killed = temporary_name().replace(f"-{os.getpid()}-", "-999999999-")
    mine = [".endolab.json", ".endolab-notes", ".endolab-x", "endolab-1", f"{killed}x", killed[1:]]
    for name in mine:
        (tmp_path / name).write_text("mine")
    (tmp_path / killed).mkdir()
    (tmp_path / killed / "half").write_text("1")
    clear_leftovers(tmp_path)
    assert names(tmp_path) == sorted(mine)
    clear_leftovers(tmp_path / "nowhere")


def test_a_name_tells_whose_it_is():
    name = temporary_name(".png")
    assert is_temporary(Path("out", name))
    assert re.search(rf"-{os.getpid()}-\w{{8}}\.png$", name)
    assert len({temporary_name() for _ in range(100)}) == 100
