"""What is printed: in any encoding, complaints in one line, and no harm where nobody reads it."""

import errno
import io
import os
import subprocess
import sys
from contextlib import redirect_stdout

import numpy as np
import pytest

from endolab.cli import main as cli
from endolab.cli.streams import LONGEST, in_one_line, patient_streams

DEPTH = np.full((12, 16), 50.0)
EVALUATE = ["evaluate", "depth.npz", "depth.npz"]


@pytest.fixture
def run(tmp_path):
    """Run the command line in a process of its own: code, stdout, stderr; `closed`: nobody reads stdout."""
    normals = np.tile([0.0, 0.0, -1.0], (12, 16, 1))
    np.savez(tmp_path / "depth.npz", distance=DEPTH, z=DEPTH, normals=normals)

    def call(*arguments, stdout=subprocess.PIPE, closed=False, **environment):
        command = [sys.executable, "-W", "error", "-m", "endolab", *arguments]
        how = {"cwd": tmp_path, "env": os.environ | environment, "stderr": subprocess.PIPE}
        with subprocess.Popen(command, stdout=stdout, **how) as process:
            if closed:
                process.stdout.close()
                process.stdout = None
            out, error = process.communicate(timeout=120)
        return process.returncode, (out or b"").decode(errors="replace"), error.decode()

    return call


@pytest.mark.parametrize(
    ("arguments", "unbuffered"), [(EVALUATE, ""), (EVALUATE, "1"), (["sweep", "--help"], "")]
)
def test_nobody_needs_to_read_what_is_printed(run, arguments, unbuffered):
    """As after ``| head -1``."""
    assert run(*arguments, closed=True, PYTHONUNBUFFERED=unbuffered) == (0, "", "")


@pytest.mark.parametrize(("encoding", "degree"), [("ascii", "\\xb0"), ("latin-1", "\ufffd"), ("utf-8", "°")])
def test_what_an_encoding_lacks_is_spelt_out(run, encoding, degree):
    code, out, error = run(*EVALUATE, PYTHONIOENCODING=encoding)
    assert (code, error) == (0, "")
    assert f"median 0{degree}" in out


@pytest.mark.skipif(sys.platform != "linux", reason="a disk that is full, whoever writes to it")
def test_a_full_disk_is_said(run):
    with open("/dev/full", "w") as full:
        code, _, error = run(*EVALUATE, stdout=full)
    assert (code, error) == (2, "endolab: cannot print what was found: No space left on device\n")


def test_there_need_be_no_stdout(monkeypatch, tmp_path):
    np.savez(tmp_path / "depth.npz", distance=DEPTH, z=DEPTH)
    depth = str(tmp_path / "depth.npz")
    monkeypatch.setattr(sys, "stdout", None)
    assert cli.main(["evaluate", depth, depth]) == 0


def test_a_complaint_is_one_short_line():
    assert in_one_line(ValueError("a\nb\0c\udcff °λ")) == "a\\nb\\x00c\\udcff °λ"
    assert in_one_line(MemoryError()) == "out of memory"
    long = in_one_line(f"{'x' * 1_000_000}: there is no such file")
    assert len(long) < LONGEST + 10
    assert long.endswith("x: there is no such file")
    assert in_one_line(OSError(errno.ENAMETOOLONG, "File name too long", "x")) == "x: File name too long"
    assert in_one_line(OSError(errno.ENOENT, "No such file")) == "the current folder: No such file"
    assert in_one_line(OSError("a sentence")) == "a sentence"


def test_an_argument_of_a_megabyte_is_answered_in_a_line(capsys):
    for option in ("--lam", "--solver", "--albedo", "--mask", "--none"):
        arguments = [
            "reconstruct",
            "none.png",
            "--calibration",
            "paper",
            "--out",
            "o",
            f"{option}={'7' * 10**6}x",
        ]
        try:
            code = cli.main(arguments)
        except SystemExit as exit:
            code = exit.code
        error = capsys.readouterr().err
        assert code == 2
        assert error.startswith("endolab: ")
        assert (error.count("\n"), len(error) < LONGEST + 100) == (1, True)


def test_a_stream_that_fails_otherwise_is_a_sentence():
    class Broken(io.StringIO):
        def write(self, text):
            raise OSError(errno.EIO, "Input/output error")

        def fileno(self):
            return descriptor

    descriptor = os.open(os.devnull, os.O_WRONLY)
    try:
        why = "cannot print what was found: Input/output error"
        with redirect_stdout(Broken()), pytest.raises(OSError, match=why), patient_streams():
            print("found")
    finally:
        os.close(descriptor)
