"""Files and folders that are whole or not there."""

import itertools
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from endolab.io import atomic
from endolab.io.atomic import (
    check_new,
    read_bytes,
    read_json,
    stage_file,
    stage_folder,
    write_atomically,
)


def texts(folder):
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_text() for path in files}


def write(folder, *names, error=None, **how):
    with stage_folder(folder, **how) as staging:
        for name in names:
            (staging / name).write_text("new")
        if error is not None:
            raise error


@pytest.fixture
def old(tmp_path):
    """A folder that is there."""
    (tmp_path / "old").mkdir()
    for name in ("a", "mine", "report.json"):
        (tmp_path / "old" / name).write_text("old")
    return tmp_path / "old"


def test_a_folder_is_replaced_by_the_names_of_its_files_and_only_if_asked(
    tmp_path, old
):
    write(tmp_path / "new" / "deep", "a", "b")
    assert texts(tmp_path / "new") == {"deep/a": "new", "deep/b": "new"}
    with pytest.raises(FileExistsError, match="overwrite"):
        write(old, "b")
    write(old, "a", "b", overwrite=True)
    assert texts(old) == {"a": "new", "b": "new", "mine": "old", "report.json": "old"}
    (tmp_path / "empty").mkdir()
    write(tmp_path / "empty", "a")
    assert {path.name for path in tmp_path.iterdir()} == {"new", "old", "empty"}


def test_the_report_moves_last(old):
    (old / "z").mkdir()  # so that it cannot be replaced
    with pytest.raises(OSError, match="old: "):
        write(old, "a", "report.json", "z", overwrite=True)
    assert texts(old)["report.json"] == "old"


@pytest.mark.parametrize("error", [ValueError(), OSError("no"), KeyboardInterrupt()])
def test_a_failure_leaves_nothing_and_what_was_there(tmp_path, old, error):
    before = texts(tmp_path)
    for folder in (old, tmp_path / "new" / "deep"):
        with pytest.raises(type(error)):
            write(folder, "a", "b", error=error, overwrite=True)
    assert texts(tmp_path) == before
    assert [path.name for path in tmp_path.iterdir()] == ["old"]


@pytest.mark.parametrize("name", ["new", "old"])
def test_what_was_there_outlives_a_kill(tmp_path, old, name):
    before = texts(old)
    code = f"""
import os
from endolab.io.atomic import stage_folder
with stage_folder({name!r}, overwrite=True) as folder:
    (folder / 'a').write_text('half')
    os.kill(os.getpid(), 9)"""
    words = [sys.executable, "-c", code]
    done = subprocess.run(words, cwd=tmp_path, timeout=60, check=False)
    assert done.returncode == -signal.SIGKILL
    assert before.items() <= texts(old).items()
    write(tmp_path / name, "a", overwrite=name == "old")
    assert (tmp_path / name / "a").read_text() == "new"


def test_a_file_is_replaced_whole_and_only_if_asked(tmp_path):
    path = tmp_path / "a.pdf"
    for content in ("1", "2"):
        with stage_file(path) as temporary:
            temporary.write_text(content)
        assert texts(tmp_path) == {"a.pdf": content}
    with pytest.raises(ZeroDivisionError), stage_file(path) as temporary:
        temporary.write_text(str(1 / 0))
    with pytest.raises(FileExistsError, match="overwrite"):
        check_new(path)
    assert texts(tmp_path) == {"a.pdf": "2"}


# What cannot be done is said in one sentence that names the file --------------------------


@pytest.mark.parametrize("name", ["file/x", "nowhere/x", "folder", "n" * 300, ""])
def test_a_place_that_cannot_be_written_or_read_is_named(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    Path("folder").mkdir()
    Path("file").write_text("mine")
    works = [lambda: write_atomically(name, b"new"), lambda: read_bytes(name)]
    if name in ("file/x", "n" * 300):
        works.append(lambda: write(name, "a"))
    for work in works:
        with pytest.raises(OSError, match=r"^[^\[\n]+$") as caught:
            work()
        assert name in str(caught.value)
        assert ".endolab" not in str(caught.value)
    assert {path.name for path in tmp_path.iterdir()} == {"file", "folder"}
    assert Path("file").read_text() == "mine"


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-32"])
def test_json_is_read_whatever_its_byte_order_mark(encoding, tmp_path):
    (tmp_path / "a.json").write_text('{"from": "Gießen"}', encoding=encoding)
    assert read_json(tmp_path / "a.json", "file") == {"from": "Gießen"}


def test_an_interrupt_at_whatever_line_leaves_a_whole_file_and_nothing_else(tmp_path):
    """One that came while a temporary folder was made or removed left it there."""
    target = tmp_path / "file"

    def interrupt_at(number):
        lines = itertools.count()

        def trace(frame, event, arg):
            is_own = frame.f_code.co_filename == atomic.__file__
            if is_own and event == "line" and next(lines) == number:
                raise KeyboardInterrupt
            return trace

        return trace

    interrupted = 0
    for number in range(1000):
        target.write_bytes(b"before")
        before = sys.gettrace()
        sys.settrace(interrupt_at(number))
        try:
            write_atomically(target, b"after")
        except KeyboardInterrupt:
            interrupted += 1
        finally:
            sys.settrace(before)
        assert target.read_bytes() in (b"before", b"after")
        assert [path.name for path in tmp_path.iterdir()] == ["file"], number
        if interrupted <= number:
            break
    assert 10 < interrupted < 1000
