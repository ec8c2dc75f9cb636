"""What every test can ask for: a random generator, the published frames, Open3D."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest

os.environ["MPLBACKEND"] = "Agg"  # no windows
if "PYTEST_XDIST_WORKER" in os.environ:  # there are as many of these as cores
    os.environ.setdefault("ENDOLAB_THREADS", "1")
# As the command line has it; Rerun reads it once.
os.environ.setdefault("RUST_LOG", "warn,re_log_encoding=off,re_sdk=off")
# a test may be the first to open a video, which counts.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
# The one variable by which a Rerun viewer sends no usage data.
os.environ.setdefault("CI", "1")

# Programs that tests start and interrupt would ignore what nohup, or a shell's &, has this one ignore.
for _number, _usual in (
    (signal.SIGINT, signal.default_int_handler),
    (signal.SIGHUP, signal.SIG_DFL),
):
    if signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, _usual)

ROOT = Path(__file__).resolve().parent.parent
os.environ["PYTHONPATH"] = str(ROOT)  # of programs that tests start
os.environ.setdefault("ENDOLAB_DATA", str(ROOT.parent / "shared/data"))
# Folders: what opens a browser, kills, fills a disk, measures; what goes through no reconstruction; what only
# reads the code.
MARKS = {
    "slow": ("browser", "hostile", "benchmarks", "research"),
    "quick": ("numerics", "model", "frames", "synthetic", "solvers", "metrics", "io"),
    "lint": ("lint",),
}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark tests by their folders: `make test` leaves to `make test-slow` and `make lint` what is theirs."""
    for item in items:
        for mark, folders in MARKS.items():
            if item.path.relative_to(ROOT).parts[1] in folders:
                item.add_marker(mark)


def missing_system(sentence):
    """Skip a test whose system library is missing, or fail it where ENDOLAB_REQUIRE_SYSTEM is set."""
    if os.environ.get("ENDOLAB_REQUIRE_SYSTEM"):
        pytest.fail(sentence, pytrace=False)
    pytest.skip(sentence)


@pytest.fixture
def rng():
    """Give random numbers that are the same in every run."""
    return np.random.default_rng(0)


@pytest.fixture
def all_cores(monkeypatch):
    """Let compiled loops have as many threads as there are cores."""
    monkeypatch.delenv("ENDOLAB_THREADS", raising=False)


@pytest.fixture(scope="session")
def data():
    """Give the folder of published frames."""
    from endolab.io.datasets.sample import data_folder

    folder = data_folder()
    if folder is None:
        pytest.skip("the published frames are not here; ENDOLAB_DATA can name a folder")
    return folder


@pytest.fixture(scope="session")
def open3d():
    """Give Open3D, which imports only where libusb is installed."""
    try:
        import open3d
    except (ImportError, OSError) as error:
        missing_system(
            f"Open3D does not import ({error}); on Debian install libusb-1.0-0"
        )
    return open3d
