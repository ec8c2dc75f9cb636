"""The modules of the page: they do what node asks of them, and each can be read."""

import shutil
import subprocess
from pathlib import Path

import pytest

from endolab.workbench.tuning import script
from tests.conftest import missing_system

TESTS = Path(__file__).with_name("page").glob("*.test.js")


@pytest.mark.parametrize("test", sorted(TESTS), ids=lambda path: path.stem)
def test_stores_and_scales(test):
    node = shutil.which("node")
    if node is None:
        missing_system("The page's modules are not tested: on Debian install nodejs")
    run = subprocess.run([node, "--test", str(test)], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr


def test_no_module_is_long_and_no_line_wide():
    for module in script.HERE.glob("*.js"):
        lines = module.read_text(encoding="utf-8").splitlines()
        assert len(lines) <= 200, module.name
        assert max(map(len, lines)) <= 100, module.name
