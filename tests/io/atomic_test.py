"""Files and folders that are whole or not there."""

import errno
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from endolab.io.atomic import staged_folder, write_atomically

ROOT = Path(__file__).resolve().parents[2]


def contents(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def test_a_staged_folder_moves_in_when_the_block_succeeds(tmp_path):
    target = tmp_path / "new" / "deep"
    with staged_folder(target) as folder:
        (folder / "a.txt").write_text("1")
        assert contents(target) != ["a.txt"]
    assert contents(tmp_path) == ["new", "new/deep", "new/deep/a.txt"]


def half_written(folder, error=None):
    for name in ("a.txt", "b.txt"):
        (folder / name).write_text("1")
    if error is not None:
        raise error


@pytest.mark.parametrize("error", [ValueError, OSError, KeyboardInterrupt])
def test_a_staged_folder_leaves_nothing_of_a_failure(tmp_path, error):
    with pytest.raises(error), staged_folder(tmp_path / "new" / "deep") as folder:
        half_written(folder, error)
    assert contents(tmp_path) == []
    (tmp_path / "b.txt").mkdir()  # a name taken by a folder leaves the others unwritten
    with pytest.raises(OSError, match=r"b\.txt"), staged_folder(tmp_path) as folder:
        half_written(folder)
    assert contents(tmp_path) == ["b.txt"]


@pytest.mark.parametrize("fails", [True, False])
def test_a_staged_folder_keeps_what_was_there(tmp_path, fails):
    (tmp_path / "old.txt").write_text("old")
    (tmp_path / "a.txt").write_text("old")
    try:
        with staged_folder(tmp_path) as folder:
            (folder / "a.txt").write_text("new")
            if fails:
                raise ValueError
    except ValueError:
        assert fails
    assert contents(tmp_path) == ["a.txt", "old.txt"]
    assert (tmp_path / "old.txt").read_text() == "old"
    assert (tmp_path / "a.txt").read_text() == ("old" if fails else "new")


@pytest.mark.parametrize("target", ["file", "file/x", "file/x/y", "new/" + 300 * "n"])
def test_a_folder_that_cannot_be_made(tmp_path, target):
    (tmp_path / "file").write_text("mine")
    refused = pytest.raises(OSError, match=r"cannot write to the folder .*: \w")
    with refused, staged_folder(tmp_path / target):
        pytest.fail("the block must not run")
    assert contents(tmp_path) == ["file"]


def test_a_file_is_replaced_whole(tmp_path):
    path = tmp_path / "a.bin"
    for content in (b"first", b"2"):
        write_atomically(path, content)
        assert path.read_bytes() == content
    assert contents(tmp_path) == ["a.bin"]
    assert path.stat().st_mode & 0o777 == 0o644


@pytest.mark.parametrize("there", [True, False])
def test_a_full_disk_leaves_the_old_file(tmp_path, monkeypatch, there):
    path = tmp_path / "a.bin"
    if there:
        path.write_bytes(b"old")

    def full(self, content):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match=r"cannot write .*a\.bin: No space left on device"):
        write_atomically(path, b"new")
    assert contents(tmp_path) == (["a.bin"] if there else [])
    assert not there or path.read_bytes() == b"old"


@pytest.mark.parametrize("limit", [1_000, 30_000])
def test_the_system_refuses_to_write_on(tmp_path, limit):
    """A limit on the size of files: `simulate` ends with one sentence and leaves nothing."""

    def limited():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    command = [sys.executable, "-m", "endolab", "simulate", "curved", "--width", "80", "--out", "new"]
    how = {
        "cwd": tmp_path,
        "env": os.environ | {"PYTHONPATH": str(ROOT)},
        "capture_output": True,
        "text": True,
    }
    done = subprocess.run(command, preexec_fn=limited, timeout=60, **how)
    assert done.returncode == 2
    assert done.stderr.startswith("endolab: cannot write ")
    assert done.stderr.endswith(": File too large\n")
    assert done.stderr.count("\n") == 1
    assert contents(tmp_path) == []
