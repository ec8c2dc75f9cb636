"""Files and folders that are whole or not there."""

import errno
import os
import resource
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from endolab.batch.sweep import read_table
from endolab.datasets.endomapper import read_xml
from endolab.datasets.folders import open_dataset
from endolab.datasets.known_endoscopes import load_calibration
from endolab.io import atomic
from endolab.io.atomic import as_path, read_bytes, read_json, staged_file, staged_folder, write_atomically
from endolab.io.descriptions import Calibration, read_camera, read_target
from endolab.io.images import read_image
from endolab.io.surfaces import read_depth
from endolab.io.video import open_frames

ROOT = Path(__file__).resolve().parents[2]
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT)}


def contents(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def test_a_staged_folder_moves_in_when_the_block_succeeds(tmp_path):
    target = tmp_path / "new" / "deep"
    with staged_folder(target) as folder:
        (folder / "a.txt").write_text("1")
        assert contents(target) != ["a.txt"]
    assert contents(tmp_path) == ["new", "new/deep", "new/deep/.endolab.json", "new/deep/a.txt"]


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
        with staged_folder(tmp_path, overwrite=True) as folder:
            (folder / "a.txt").write_text("new")
            if fails:
                raise ValueError
    except ValueError:
        assert fails
    assert contents(tmp_path) == [".endolab.json"] * (not fails) + ["a.txt", "old.txt"]
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


@pytest.mark.skipif(os.name != "posix", reason="modes are of POSIX")
@pytest.mark.parametrize(("umask", "file", "folder"), [(0o022, 0o644, 0o755), (0o077, 0o600, 0o700)])
def test_files_obey_the_umask_and_replaced_ones_keep_their_mode(tmp_path, umask, file, folder):
    code = f"""if True:
        import os
        from endolab.io.atomic import staged_folder, write_atomically
        os.umask({umask})
        for content in (b"1", b"2"):
            write_atomically("single", content)
            with staged_folder("new") as folder:
                for name in "ab":
                    write_atomically(folder / name, content)
            for name in ("single", "new/a"):
                if content == b"1":
                    os.chmod(name, 0o640)
    """
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=ENVIRONMENT, check=True, timeout=60)
    found = {name: (tmp_path / name).stat().st_mode & 0o777 for name in contents(tmp_path)}
    kept = dict.fromkeys(("single", "new/a"), 0o640)
    assert found == {"new": folder, "new/.endolab.json": file, "new/b": file} | kept


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
    how = {"cwd": tmp_path, "env": ENVIRONMENT, "capture_output": True, "text": True}
    done = subprocess.run(command, preexec_fn=limited, timeout=60, **how)
    assert done.returncode == 2
    assert done.stderr.startswith("endolab: cannot write ")
    assert done.stderr.endswith(": File too large\n")
    assert done.stderr.count("\n") == 1
    assert contents(tmp_path) == []


# What cannot be done is said in one sentence that names the file --------------------------
ODD = {
    "file/x": r"^cannot write file/x: Not a directory$",
    "nowhere/x": r"^cannot write nowhere/x: No such file or directory$",
    "folder": r"^cannot write folder: it is a folder$",
    "n" * 300: r"^cannot write n+: File name too long$",
    "pipe": r"^cannot write pipe: it is no plain file$",
    "": r"^no file or folder can be called ''$",
    "a\0b": r"^no file or folder can be called 'a\\x00b'$",
    "\ud800": r"^no file or folder can be called '\\ud800'$",
}


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("mine")
    os.mkfifo(tmp_path / "pipe")
    return tmp_path


@pytest.mark.skipif(os.name != "posix", reason="sentences of POSIX")
@pytest.mark.parametrize("name", ODD)
def test_a_file_that_cannot_be_written_is_named(here, name):
    before = contents(here)
    with pytest.raises((OSError, ValueError), match=ODD[name]):
        write_atomically(name, b"new")
    assert contents(here) == before
    assert (here / "file").read_text() == "mine"


@pytest.mark.skipif(os.name != "posix", reason="sentences of POSIX")
@pytest.mark.parametrize("name", ODD)
def test_a_file_that_cannot_be_read_is_named(here, name):
    with pytest.raises((OSError, ValueError), match=r"^[^\[\n]+$") as caught:
        read_bytes(name, "frame")
    assert repr(name) in str(caught.value) or str(caught.value).startswith(f"{name}: ")
    if name in ("file/x", "nowhere/x", "folder"):
        assert "there is no such frame" in str(caught.value)


READERS = [
    *(read_image, read_depth, open_frames, read_target, read_camera, Calibration.load),
    *(load_calibration, open_dataset, read_table, lambda path: read_xml(path, "rig")),
]


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize("name", ["n" * 300 + ".json", "file/x.json", "", "a\0b.json", "\ud800.json"])
def test_every_reader_says_in_one_sentence_what_it_cannot_read(here, read, name):
    with pytest.raises((OSError, ValueError), match=r"^[^\[\n]+$") as caught:
        read(name)
    said = str(caught.value)
    assert name[:200] in said or repr(name)[:200] in said
    assert getattr(caught.value, "errno", None) is None


def test_a_file_that_may_not_be_read_is_named(tmp_path, monkeypatch):
    (tmp_path / "a.json").write_text("{}")

    def refuse(self):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(self))

    monkeypatch.setattr(Path, "read_bytes", refuse)
    with pytest.raises(OSError, match=r"a\.json: cannot be read: Permission denied$"):
        read_json(tmp_path / "a.json", "calibration file")


def test_a_path_may_be_anything_that_the_system_takes():
    for name in ("a", "ä", os.fsdecode(b"\xff") if os.name == "posix" else "b", Path("c")):
        assert as_path(name) == Path(name)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda folder, temporary: (folder / "no").read_bytes(), r"^{}/no: No such file"),
        (
            lambda folder, temporary: (temporary / "no/a").write_text(""),
            r"^cannot write {}/new/no/a: No such",
        ),
    ],
)
def test_an_error_names_the_file_that_it_is_about(tmp_path, wrong, said):
    with pytest.raises(OSError, match=said.format(tmp_path)), staged_folder(tmp_path / "new") as temporary:
        wrong(tmp_path, temporary)
    assert contents(tmp_path) == []


def test_no_sentence_knows_of_the_temporary_file(tmp_path):
    path = tmp_path / "b.pdf"
    with pytest.raises(OSError, match=rf"^cannot write {path}: No space left"), staged_file(path):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with pytest.raises(ValueError, match=rf"^{path}: no$"), staged_file(path) as temporary:
        raise ValueError(f"{temporary}: no")
    assert contents(tmp_path) == []


# Nothing of others is replaced unasked -----------------------------------------------------
def write(folder, names="ab", content="new", **how):
    with staged_folder(folder, **how) as staging:
        for name in names:
            (staging / name).write_text(content)


def texts(folder):
    return {path.name: path.read_text() for path in folder.glob("[!.]*")}


def test_what_was_written_here_may_be_written_again(tmp_path):
    for content in ("1", "2", "2", "3"):
        write(tmp_path / "out", content=content)
    write(tmp_path / "out", "c")
    assert texts(tmp_path / "out") == {"a": "3", "b": "3", "c": "new"}
    shutil.copytree(tmp_path / "out", tmp_path / "copy")
    write(tmp_path / "copy")


@pytest.mark.parametrize("before", [["mine"], ["ours", "mine"], ["ours", "manifest"]])
def test_what_another_wrote_stops_it_before_the_work_and_before_anything_is_moved(tmp_path, before):
    for who in before:
        if who == "ours":
            write(tmp_path, content="old")
        elif who == "mine":
            (tmp_path / "b").write_text("mine")
        else:
            (tmp_path / ".endolab.json").write_text('{"files": [')
    there = texts(tmp_path)
    refused = r"b is there already and endolab did not write it; .* or replace it with overwrite=True"
    with pytest.raises(FileExistsError, match=refused), staged_folder(tmp_path, "b"):
        pytest.fail("the block must not run")
    with pytest.raises(FileExistsError, match=r"is there already and endolab did not write it"):
        write(tmp_path)
    assert texts(tmp_path) == there
    write(tmp_path, overwrite=True)
    write(tmp_path)
    assert texts(tmp_path) == {"a": "new", "b": "new"}


@pytest.mark.skipif(os.name != "posix", reason="links need rights elsewhere")
def test_a_link_is_of_another(tmp_path):
    write(tmp_path / "out")
    (tmp_path / "out/a").rename(tmp_path / "kept")
    (tmp_path / "out/a").symlink_to(tmp_path / "kept")
    with pytest.raises(FileExistsError, match="out/a is there already"):
        write(tmp_path / "out")
    write(tmp_path / "out", content="other", overwrite=True)  # the link is replaced, not what it leads to
    assert ((tmp_path / "kept").read_text(), texts(tmp_path / "out")["a"]) == ("new", "other")


@pytest.mark.parametrize("links", [True, False])
def test_a_file_that_comes_in_between_is_not_lost(tmp_path, monkeypatch, links):
    """As of a second run, or of the user: between the last look and the move."""
    write(tmp_path, content="old")
    real = atomic._move_in

    def late(files, *others):
        (tmp_path / "c").write_text("mine")
        real(files, *others)

    def refuse(*paths):
        raise PermissionError(errno.EPERM, "no links here")

    monkeypatch.setattr(atomic, "_move_in", late)
    if not links:
        monkeypatch.setattr(os, "link", refuse)
    with pytest.raises(OSError, match=rf"^cannot write {tmp_path}/c: "):
        write(tmp_path, "abcd")
    assert texts(tmp_path) == {"a": "old", "b": "old", "c": "mine"}
    monkeypatch.setattr(atomic, "_move_in", real)
    write(tmp_path)
    assert texts(tmp_path) == {"a": "new", "b": "new", "c": "mine"}
    assert contents(tmp_path) == [".endolab.json", "a", "b", "c"]


@pytest.mark.parametrize("failure", [OSError(errno.EACCES, "Permission denied"), KeyboardInterrupt()])
def test_a_move_that_fails_half_way_is_taken_back(tmp_path, monkeypatch, failure):
    write(tmp_path, content="old")
    real = Path.replace

    def replace(self, place):
        if place == tmp_path / "b":
            monkeypatch.setattr(Path, "replace", real)
            raise failure
        return real(self, place)

    monkeypatch.setattr(Path, "replace", replace)
    with pytest.raises((OSError, KeyboardInterrupt)):
        write(tmp_path, "abc")
    assert texts(tmp_path) == {"a": "old", "b": "old"}
    write(tmp_path)


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_a_run_that_is_killed_while_it_moves_leaves_what_may_be_written_again(tmp_path):
    write(tmp_path / "out", content="old")
    code = """if True:
        import os, signal
        from endolab.io import atomic
        def killed(path, place):
            if place.name == "b":
                os.kill(os.getpid(), signal.SIGKILL)
            path.replace(place)
        atomic._replace = killed
        with atomic.staged_folder("out") as folder:
            for name in "abc":
                (folder / name).write_text("half")
    """
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=ENVIRONMENT, timeout=60)
    assert done.returncode == -signal.SIGKILL
    assert texts(tmp_path / "out") == {"a": "half", "b": "old"}
    write(tmp_path / "out", "abc")
    assert texts(tmp_path / "out") == dict.fromkeys("abc", "new")
    assert contents(tmp_path / "out") == [".endolab.json", "a", "b", "c"]


def test_one_of_two_runs_at_once_wins_whole(tmp_path):
    """However they meet, what is left is of one of them, and endolab's own."""
    names = [f"{number:02d}" for number in range(20)]
    threads = [threading.Thread(target=write, args=(tmp_path, names, str(who))) for who in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(set(texts(tmp_path).values())) == 1
    assert contents(tmp_path) == [".endolab.json", *names]
    write(tmp_path, names)


def test_what_is_read_is_never_replaced(tmp_path):
    write(tmp_path)
    for overwrite in (False, True):
        for given in (tmp_path / "a", tmp_path / ".." / tmp_path.name / "a"):
            with pytest.raises(FileExistsError, match=r"/a is read by this very call"):
                write(tmp_path, overwrite=overwrite, inputs=["paper", given, "x" * 300])
        with pytest.raises(FileExistsError, match=r"/a is read by this very call"):
            staged_file(tmp_path / "a", overwrite=overwrite, inputs=[tmp_path / "a"]).__enter__()
    write(tmp_path, "b", inputs=[tmp_path / "a"])


def test_a_file_elsewhere_belongs_to_the_folder(tmp_path):
    elsewhere = {"c": tmp_path / "cal.json"}
    for content in ("1", "2"):
        write(tmp_path / "report", "ac", content, elsewhere=elsewhere)
        assert (tmp_path / "cal.json").read_text() == content
        assert texts(tmp_path / "report") == {"a": content}
    (tmp_path / "cal.json").write_text("mine")
    with pytest.raises(FileExistsError, match=r"cal\.json is there already"):
        write(tmp_path / "report", "ac", "3", elsewhere=elsewhere)
    assert texts(tmp_path / "report") == {"a": "2"}


def test_a_single_file_is_not_replaced_by_another_content_unasked(tmp_path):
    def put(content, **how):
        with staged_file(tmp_path / "a.pdf", **how) as temporary:
            assert temporary.suffix == ".pdf"
            temporary.write_text(content)

    put("1", overwrite=False)
    put("1", overwrite=False)  # the same
    with pytest.raises(FileExistsError, match=r"a\.pdf is there already; .* replace it with overwrite=True"):
        put("2", overwrite=False)
    assert texts(tmp_path) == {"a.pdf": "1"}
    put("2", overwrite=True)
    put("3")
    assert texts(tmp_path) == {"a.pdf": "3"}
    assert contents(tmp_path) == ["a.pdf"]
