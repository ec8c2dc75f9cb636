"""Files and folders that are whole or not there."""

import json
import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from endolab.io.atomic import (
    read_bytes,
    read_json,
    stage_file,
    stage_folder,
    write_atomically,
)

ROOT = Path(__file__).resolve().parents[2]
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT)}


def texts(folder):
    return {
        str(path.relative_to(folder)): path.read_text()
        for path in folder.rglob("*")
        if path.is_file()
    }


def write(folder, *names, content="new", error=None, **how):
    with stage_folder(folder, **how) as staging:
        for name in names:
            (staging / name).write_text(content)
        if error is not None:
            raise error


@pytest.fixture
def own(tmp_path):
    """A folder that endolab has written."""
    write(tmp_path / "own", "a", "report.json", content='{"endolab": 1}')
    return tmp_path / "own"


def test_files_move_in_when_the_block_succeeds_the_report_last(tmp_path, own):
    (own / "report.json").unlink()
    (own / "report.json").mkdir()  # so that it cannot be replaced
    with pytest.raises(OSError, match=r"report\.json: it is a folder"):
        write(own, "a", "report.json", overwrite=True)
    assert texts(own) == {"a": '{"endolab": 1}'}
    write(tmp_path / "new" / "deep", "a", "b")
    assert texts(tmp_path / "new") == {"deep/a": "new", "deep/b": "new"}


@pytest.mark.parametrize("error", [ValueError(), OSError("no"), KeyboardInterrupt()])
def test_a_failure_leaves_nothing_and_what_was_there(tmp_path, own, error):
    before = texts(tmp_path)
    for folder in (own, tmp_path / "new" / "deep"):
        with pytest.raises(type(error)):
            write(folder, "a", "b", error=error)
    assert texts(tmp_path) == before
    assert [path.name for path in tmp_path.iterdir()] == ["own"]


@pytest.mark.parametrize(
    "report", [None, "[]", '{"endolab": ', '{"status": "CONVERGED"}']
)
def test_a_folder_of_others_needs_overwrite(tmp_path, report):
    (tmp_path / "notes.txt").write_text("mine")
    if report is not None:
        (tmp_path / "report.json").write_text(report)
    before = texts(tmp_path)
    with pytest.raises(FileExistsError, match="overwrite"), stage_folder(tmp_path):
        pytest.fail("the block must not run")
    assert texts(tmp_path) == before
    write(tmp_path, "a", "report.json", content='{"endolab": 1}', overwrite=True)
    write(tmp_path, "a")  # it is endolab's now
    (tmp_path / "report.json").unlink()
    assert texts(tmp_path) == {"a": "new", "notes.txt": "mine"}


def test_what_an_earlier_run_wrote_goes_with_its_report_and_nothing_else(own):
    report = {"report.json": '{"endolab": 1}'}
    for name in (
        "notes.txt",
        "mesh.ply",
    ):  # called as a file of endolab's, which it is not
        (own / name).write_text("mine")
    write(own, "b")  # brings no report, so it adds to what there is
    assert {*texts(own)} == {"a", "b", "notes.txt", "mesh.ply", *report}
    write(own, "c", *report, content='{"endolab": 1}')
    assert {*texts(own)} == {"b", "c", "notes.txt", "mesh.ply", *report}
    with pytest.raises(ValueError, match="no"):
        write(own, "d", *report, content='{"endolab": 1}', error=ValueError("no"))
    assert "c" in texts(own)
    # Which is read.
    write(own, "d", *report, content='{"endolab": 1}', inputs=[own / "c", own])
    assert {*texts(own)} == {"b", "c", "d", "notes.txt", "mesh.ply", *report}


@pytest.mark.parametrize(
    "listed", ["a", 3, ["../mine", "..", ".", "", "*", "**", None, [1]], {"mine": 1}]
)
def test_a_report_that_lists_anything_else_takes_nothing_away(tmp_path, listed):
    out = tmp_path / "out"
    for name in ("mine", "x/depth.npz", "out/mine", "out/deep/er/depth.npz"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("mine")
    kept = {*texts(tmp_path)}
    (out / "report.json").write_text(json.dumps({"endolab": 1, "files": listed}))
    write(out, "b", "report.json", content='{"endolab": 1}')
    assert {*texts(tmp_path)} == {*kept, "out/b", "out/report.json"}


def test_a_folder_where_a_run_was_killed_counts_as_empty(tmp_path):
    code = "import os, sys; from endolab.io.atomic import stage_folder\n"
    code += "with stage_folder('out') as folder:\n"
    code += "    (folder / 'a').write_text('half'); os.kill(os.getpid(), 9)"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=ENVIRONMENT, timeout=60
    )
    assert done.returncode == -signal.SIGKILL
    assert not list((tmp_path / "out").glob("[!.]*"))
    write(tmp_path / "out", "a")
    assert (tmp_path / "out/a").read_text() == "new"


def test_what_is_read_is_never_replaced(own):
    for overwrite in (False, True):
        for given in (own / "a", own / ".." / own.name / "a"):
            with pytest.raises(
                FileExistsError, match="own/a is read by this very call"
            ):
                write(
                    own,
                    "a",
                    overwrite=overwrite,
                    inputs=["paper", None, given, "x" * 300],
                )
        with pytest.raises(FileExistsError, match="own/a is read by this very call"):
            stage_file(own / "a", overwrite=overwrite, inputs=[own / "a"]).__enter__()
    write(own, "b", inputs=[own / "a"])


def test_a_file_is_replaced_whole_and_only_if_asked(tmp_path):
    path = tmp_path / "a.pdf"
    for content in ("1", "2"):
        with stage_file(path) as temporary:
            assert temporary.suffix == ".pdf"
            temporary.write_text(content)
        assert texts(tmp_path) == {"a.pdf": content}
    with suppress(ValueError), stage_file(path) as temporary:
        temporary.write_text("half")
        raise ValueError
    with (
        pytest.raises(FileExistsError, match="overwrite"),
        stage_file(path, overwrite=False),
    ):
        pytest.fail("the block must not run")
    assert texts(tmp_path) == {"a.pdf": "2"}


def test_an_error_names_the_file_that_it_is_about_and_no_temporary_one(tmp_path):
    with (
        pytest.raises(OSError, match=rf"^{tmp_path}/no: No such file"),
        stage_folder(tmp_path / "new"),
    ):
        (tmp_path / "no").read_bytes()
    refused = pytest.raises(OSError, match=rf"^{tmp_path}/new/no/a: No such")
    with refused, stage_folder(tmp_path / "new") as staging:
        (staging / "no/a").write_text("")


# What cannot be done is said in one sentence that names the file --------------------------
ODD = ["file/x", "nowhere/x", "folder", "n" * 300, "pipe", "", "a\0b"]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("mine")
    os.mkfifo(tmp_path / "pipe")
    return tmp_path


@pytest.mark.skipif(os.name != "posix", reason="pipes and names of POSIX")
@pytest.mark.parametrize("name", ODD)
def test_a_file_that_cannot_be_written_or_read_is_named(here, name):
    before = sorted(here.rglob("*"))
    for work in (
        lambda: write_atomically(name, b"new"),
        lambda: read_bytes(name, "frame"),
    ):
        with pytest.raises((OSError, ValueError), match=r"^[^\[\n]+$") as caught:
            work()
        assert name.replace("\0", "\\x00") in str(caught.value)
        assert getattr(caught.value, "errno", None) is None
    assert sorted(here.rglob("*")) == before
    assert (here / "file").read_text() == "mine"


@pytest.mark.parametrize("target", ["file", "file/x/y", "new/" + 300 * "n"])
def test_a_folder_that_cannot_be_made(here, target):
    before = sorted(here.rglob("*"))
    with (
        pytest.raises(OSError, match=r"^[^\n]*(file|new)[^\n]*: \w"),
        stage_folder(target),
    ):
        pytest.fail("the block must not run")
    assert sorted(here.rglob("*")) == before


@pytest.mark.parametrize(
    "content", [b"\xff", b"[" * 100_000, b'{"a": ', b"x" * 10_000_001]
)
def test_json_that_cannot_be_read_is_one_sentence(tmp_path, content):
    (tmp_path / "a.json").write_bytes(content)
    with pytest.raises(ValueError, match=r"^[^\n]*a\.json: [^\n]*$"):
        read_json(tmp_path / "a.json", "calibration file")
    (tmp_path / "a.json").write_text(json.dumps({"a": [1]}))
    assert read_json(tmp_path / "a.json", "calibration file") == {"a": [1]}


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-32"])
def test_json_is_read_whatever_its_byte_order_mark(encoding, tmp_path):
    (tmp_path / "a.json").write_text('{"from": "Gießen"}', encoding=encoding)
    assert read_json(tmp_path / "a.json", "file") == {"from": "Gießen"}
