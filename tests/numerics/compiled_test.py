"""What is compiled is kept for the next run, whatever folders can be written."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "endolab"
RUN = """
import numpy as np
from endolab.numerics import compiled
found = compiled.block_sums(compiled.padded(np.ones((4, 6))))
assert found.sum() == 24
print(compiled.COMPILED["cache"], sum(compiled._block_sums.stats.cache_hits.values()))
"""


@pytest.fixture
def unwritable(tmp_path):
    """A copy of some of endolab beside which nothing can be kept, and a user without a home; runs it."""
    numerics = tmp_path / "endolab" / "numerics"
    numerics.mkdir(parents=True)
    for name in ("__init__.py", "arrays.py", "compiled.py"):
        shutil.copy(PACKAGE / "numerics" / name, numerics)
    for taken in (tmp_path / "endolab/__init__.py", numerics / "__pycache__", tmp_path / "home"):
        taken.touch()  # a file, in which even root can make no folder
    (tmp_path / "temporary").mkdir()
    home = {"HOME": str(tmp_path / "home"), "XDG_CACHE_HOME": str(tmp_path / "home/cache")}
    home |= {"LOCALAPPDATA": home["HOME"], "TMPDIR": str(tmp_path / "temporary")}
    others = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}

    def run():
        how = {"cwd": tmp_path, "env": others | home, "capture_output": True, "text": True, "timeout": 120}
        done = subprocess.run([sys.executable, "-B", "-c", RUN], **how, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout.split()

    return run


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="where temporary files have owners")
def test_loops_are_kept_among_the_temporary_files_if_nowhere_else(unwritable, tmp_path):
    assert unwritable() == ["True", "0"]
    assert unwritable() == ["True", "1"]
    private = tmp_path / "temporary" / f"endolab-{os.getuid()}"
    assert private.stat().st_mode & 0o777 == 0o700
    private.chmod(0o777)  # anybody may have put something there
    assert unwritable() == ["False", "0"]
    private.rename(tmp_path / "elsewhere")
    private.symlink_to(tmp_path / "elsewhere")
    assert unwritable() == ["False", "0"]


def test_loops_are_loaded_without_scipys_blas_and_those_that_need_it_find_it():
    """It takes as long to load as all the rest of Numba that a loop needs."""
    code = (
        "import sys, numba, numpy as np\nfrom endolab.numerics import compiled\n"
        "compiled.block_sums(compiled.padded(np.ones((4, 6))))\n"
        "print('numba.np.arraymath' in sys.modules, 'scipy.linalg' in sys.modules)\n"
        "print(numba.njit(lambda a: a @ a)(2 * np.eye(1))[0, 0])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert (done.stdout, done.stderr) == ("True False\n4.0\n", "")
