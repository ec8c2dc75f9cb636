"""The checks of exercises: right, not yet, or how far off; nbval runs the right answers through them."""

import importlib.util
import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

NOTEBOOKS = Path(__file__).resolve().parents[1] / "notebooks"
IMPORT = re.compile(r"from checks import (\w+) as check")


@pytest.fixture(scope="module")
def checks():
    spec = importlib.util.spec_from_file_location("checks", NOTEBOOKS / "checks.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    "path", sorted(NOTEBOOKS.glob("*.ipynb")), ids=lambda path: path.stem
)
def test_every_check_that_a_notebook_calls_is_there_and_none_more(checks, path):
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    text = "\n".join("".join(cell["source"]) for cell in cells)
    known = vars(getattr(checks, IMPORT.search(text)[1]))
    assert set(re.findall(r"\bcheck\.(\w+)\(", text)) == {
        name for name in known if not name.isupper()
    }


def test_no_answer_yet(checks):
    def unwritten(*_):
        raise NotImplementedError

    for verdict in (
        checks.quickstart.exercise_1(..., 1.0, None),
        checks.endoscope_model.exercise_2(unwritten),
    ):
        assert verdict.right is None
        assert not verdict


def test_a_wrong_answer_is_told_which_way_then_by_how_much_then_a_hint(checks):
    first, second, third = (
        checks.brightness_to_depth.exercise_1(answer) for answer in (-50.0, 50.0, 50.0)
    )
    assert first.right is False
    assert "wrong sign" in first.words
    assert "off by 2" in second.words
    assert "°" in second.words
    assert ["Hint" in one.words for one in (first, second, third)] == [0, 0, 1]
    verdict = checks.geometric_calibration.exercise_2(1.0, 1 / 0.97, 1 / 0.97)
    assert "gain" in verdict.words


@pytest.mark.parametrize("answer", [None, "many", [1, 2], np.nan, lambda: 3])
def test_nonsense_is_no_crash(checks, answer):
    fit = SimpleNamespace(views=range(10), standard_errors={"fx": 0.04})
    for _ in range(3):
        verdict = checks.geometric_calibration.exercise_1(answer, fit)
    assert verdict.right is False
    assert "Hint" in verdict.words


def test_what_a_students_function_raises_is_told(checks):
    def broken(d0, delta):
        raise IndexError("off the grid")

    assert "off the grid" in checks.brightness_to_depth.march(broken).words
