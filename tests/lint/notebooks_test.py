"""The discipline of the notebooks: thin, cleared, linked, closed by an assertion and two solved exercises."""

import ast
import json
import re
from pathlib import Path

import pytest

from tests.tools.notebook_solutions import solutions

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
TEXTS = [
    *sorted((ROOT / "notebooks").rglob("*.md")),
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
]
PAGES = [*NOTEBOOKS, *TEXTS]
LINK = re.compile(r"\]\(([^)\s]+)\)")  # its target
# Of an answer, in a cell; of a solution.
CHECK = re.compile(r"^check\.(\w+)\(", re.MULTILINE)
CHECKED = re.compile(r"^assert check\.(\w+)\(", re.MULTILINE)
NO_PROSE = re.compile(
    r"```.*?```|\$\$.*?\$\$|\$[^$]*\$", re.DOTALL
)  # code and formulas


@pytest.fixture(params=NOTEBOOKS, ids=lambda path: path.stem)
def path(request):
    """File of a notebook."""
    return request.param


def cells_of(path):
    """Cells of a notebook, each with its source as one text."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return [cell | {"text": "".join(cell["source"])} for cell in cells]


@pytest.fixture
def cells(path):
    return cells_of(path)


def texts_of(cells, kind):
    return [cell["text"] for cell in cells if cell["cell_type"] == kind]


def code_of(cells):
    return texts_of(cells, "code")


def links_of(path):
    """Targets of the links in a notebook's or a page's text, code left out."""
    if path.suffix == ".ipynb":
        text = "\n\n".join(texts_of(cells_of(path), "markdown"))
    else:
        text = path.read_text(encoding="utf-8")
    return LINK.findall(re.sub(r"```.*?```", "", text, flags=re.DOTALL))


def thick(source):
    """What a notebook's code defines that belongs into the library: classes, and solvers of its own."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ClassDef):
            yield f"class {node.name}"
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            inside = [inner for inner in ast.walk(node) if inner is not node]
            if any(isinstance(inner, ast.Yield | ast.YieldFrom) for inner in inside):
                yield f"generator {getattr(node, 'name', 'lambda')}"
        elif isinstance(node, ast.While):
            yield "a while loop"


def broken(path):
    """Relative links that lead to no file."""
    for link in links_of(path):
        if (
            not re.match(r"[a-z]+:|#", link)
            and not (path.parent / link.partition("#")[0]).exists()
        ):
            yield link


def test_it_is_committed_without_what_running_it_leaves(cells):
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert code
    assert not any(cell["outputs"] or cell["execution_count"] for cell in code)


def test_it_opens_by_saying_what_one_will_do_learn_and_need(cells):
    assert cells[0]["cell_type"] == "markdown"
    assert all(
        f"**{words}**" in cells[0]["text"]
        for words in ("You will", "You will learn", "You need")
    )


def test_it_keeps_to_its_budget(cells):
    assert len(cells) <= 40
    prose = NO_PROSE.sub(" ", "\n\n".join(texts_of(cells, "markdown")))
    assert sum(any(map(str.isalpha, word)) for word in prose.split()) <= 1800
    assert (
        sum(bool(line.strip()) for text in code_of(cells) for line in text.splitlines())
        <= 220
    )
    for text in code_of(cells):
        assert len(text.splitlines()) <= 15, text
        assert max(map(len, text.splitlines())) <= 110, text


def test_it_defines_no_class_and_no_solver(cells):
    assert [found for text in code_of(cells) for found in thick(text)] == []


def test_it_closes_with_an_assertion_and_two_exercises(cells):
    start = next(
        i for i, cell in enumerate(cells) if cell["text"].startswith("## Exercises")
    )
    assert "assert " in code_of(cells[:start])[-1]
    text = "\n".join(texts_of(cells[start:], "markdown"))
    assert all(f"**{number}" in text for number in (1, 2))
    assert len(code_of(cells[start:])) >= 2, "each exercise has a cell to answer in"


def test_every_solution_goes_through_the_check_of_an_answer(cells):
    asked = [CHECK.findall(text) for text in code_of(cells)]
    assert all(len(names) <= 1 for names in asked), "one answer a cell"
    names = [name for one in asked for name in one]
    found = solutions(cells)
    assert len(found) >= 2
    assert [CHECKED.findall(code)[-1:] for code in found] == [[name] for name in names]


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_its_links_lead_somewhere(page):
    assert list(broken(page)) == []


def test_each_notebook_leads_to_the_next_one_and_to_the_library():
    for path, after in zip(NOTEBOOKS, [*NOTEBOOKS[1:], None], strict=True):
        closing = cells_of(path)[-1]["text"].split("**Next:**")
        assert len(closing) == 2, f"{path.name} does not end in **Next:** and a link"
        assert f"({after.name if after else 'README.md'})" in closing[1], path.name
        assert any(link.startswith("../endolab/") for link in links_of(path)), path.name


def test_the_course_plan_lists_every_notebook():
    listed = set(links_of(ROOT / "notebooks" / "README.md"))
    assert {path.name for path in NOTEBOOKS} <= listed
