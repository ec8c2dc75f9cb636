"""The discipline of the notebooks: thin, cleared, and closed by an assertion and two exercises."""

import json
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "notebooks").glob("*.ipynb"))


@pytest.fixture(params=NOTEBOOKS, ids=lambda path: path.stem)
def cells(request):
    """Cells of a notebook, each with its source as one text."""
    cells = json.loads(request.param.read_text(encoding="utf-8"))["cells"]
    return [cell | {"text": "".join(cell["source"])} for cell in cells]


def test_it_is_committed_without_what_running_it_leaves(cells):
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert code
    assert not any(cell["outputs"] or cell["execution_count"] for cell in code)


def test_it_opens_by_saying_what_one_will_do_learn_and_need(cells):
    opening = cells[0]["text"].lower()
    assert cells[0]["cell_type"] == "markdown"
    assert all(word in opening for word in ("you will", "learn", "need"))


def test_its_code_is_thin(cells):
    for cell in (cell for cell in cells if cell["cell_type"] == "code"):
        assert len(cell["text"].splitlines()) <= 15, cell["text"]
        assert "class " not in cell["text"]


def test_it_closes_with_an_assertion_and_two_exercises(cells):
    last_code = [cell["text"] for cell in cells if cell["cell_type"] == "code"][-1]
    assert "assert " in last_code
    closing = cells[-1]["text"]
    assert "Exercises" in closing
    assert all(f"**{number}" in closing for number in (1, 2))
