"""Decks of slides: what of a notebook comes onto them, and what stays with the handout."""

from pathlib import Path

import nbformat
import pytest
from bs4 import BeautifulSoup

from endolab.course.verdict import MISSING
from tests.tools import render_slides as slides
from tests.tools.notebook_solutions import solutions

NOTEBOOKS = sorted((Path(__file__).resolve().parents[2] / "notebooks").glob("*.ipynb"))
SHORT, LONG = "a = 1\nb = 2", "\n".join(f"a = {i}" for i in range(slides.SHORT + 1))


def code(source, *outputs, **metadata):
    cell = nbformat.v4.new_code_cell(source, metadata=metadata)
    cell.outputs = [nbformat.v4.new_output("stream", text=text) for text in outputs]
    return cell


def made(*cells):
    """Sections of a notebook: titles, and the parsed blocks below each."""
    texts = (nbformat.v4.new_markdown_cell(cell) if isinstance(cell, str) else cell for cell in cells)
    found = slides.sections(nbformat.v4.new_notebook(cells=list(texts)), Path())
    return {
        title: [BeautifulSoup(block, "html.parser").contents[0] for block in blocks]
        for title, blocks in found
    }


def in_view(block):
    """Text of a block that is seen at once."""
    for rest in block.find_all("span", class_="rest"):
        rest.extract()
    return block.get_text().strip()


BEGINS = f"{'One ' * 20}end."


@pytest.mark.parametrize(
    ("text", "kept"),
    [
        (f"{BEGINS} Two.", BEGINS),
        (f"({BEGINS} Two.)", ""),
        (f"Short. Then this. {BEGINS} Two.", f"Short. Then this. {BEGINS}"),
        (f"{BEGINS} Two is not. **Three is bold** here. Four.", f"{BEGINS} Three is bold here."),
        (
            f"It is e.g. Gauss-Newton, by Horn et al. {BEGINS} Two.",
            f"It is e.g. Gauss-Newton, by Horn et al. {BEGINS}",
        ),
        (f"{'One ' * 20}$x. Y$ so: $$a . $$ end. Two.", f"{'One ' * 20}$x. Y$ so: $$a . $$ end."),
        (f"{'One ' * 20}`x. Y` end. *Two*.", f"{'One ' * 20}x. Y end."),
    ],
)
def test_a_paragraph_is_there_by_its_beginning_and_what_is_bold(text, kept):
    ((block,),) = made(f"## A\n{text}").values()
    assert " ".join(block.get_text().split()) == text.replace("`", "").replace("*", "")
    assert in_view(block) == kept


def test_a_title_begins_a_slide_and_tasks_are_told_in_full():
    long = f"{BEGINS} Two."
    found = made(
        "# T\nWhat.", f"## A\n{long}\n\n$$x = 1$$\n\n### B\nC:", f"## Exercises\n{long}", long, "## Last\n"
    )
    assert list(found) == ["T", "A", "Exercises"]
    assert [in_view(block)[-4:] for block in found["A"]] == ["end.", "1$$".rjust(4), "B", "C:"]
    assert ["data-leads" in block.attrs for block in found["A"]] == [False, False, True, True]
    assert all(in_view(block) == long for block in found["Exercises"])


def test_code_is_shown_if_it_is_short_and_is_the_idea():
    hidden = {"jupyter": {"source_hidden": True}}
    found = made(
        "## A",
        code(SHORT),
        code(LONG, "out"),
        code(SHORT, "drawn", **hidden),
        code(f"import numpy as np\nimport json\n{SHORT}"),
    )
    short, long, out, drawn = found["A"]
    assert short.details["class"] == ["code", "short"]
    assert short.details.has_attr("open")
    assert not long.details.has_attr("open")
    assert "data-leads" in long.attrs
    assert [out.text, drawn.text] == ["out", "drawn"]


def test_what_a_check_says_of_no_answer_is_left_out():
    cell = code("check.exercise_1(answer)")
    said = {"text/markdown": f"… {MISSING}"}
    cell.outputs = [nbformat.v4.new_output("execute_result", data=said, execution_count=1)]
    (block,) = made("## A", cell)["A"]
    assert "exercise_1" in block.text
    assert "data-leads" not in block.attrs


def test_slide_types_leave_out_and_begin():
    first, second = (code(SHORT, slideshow={"slide_type": kind}) for kind in ("skip", "slide"))
    (block,) = made("## A", first, second)["A"]
    assert "data-starts" in block.attrs


def test_pieces_of_an_output_are_blocks():
    cell = code("")
    data = {"text/html": '<div class="endolab-piece">1</div><div class="endolab-piece">2</div>'}
    cell.outputs = [nbformat.v4.new_output("display_data", data=data)]
    assert [block.text for block in made("## A", cell)["A"]] == ["1", "2"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_deck_keeps_solutions_and_hints_to_itself(path):
    notebook = nbformat.read(path, as_version=4)
    found = slides.sections(notebook, path.parent)
    cells = "".join(cell.source for cell in notebook.cells if cell.cell_type == "code")
    text = BeautifulSoup(slides.deck("a", found, ""), "html.parser").find(id="source").get_text()
    lines = [line for code in solutions(notebook.cells) for line in code.splitlines()]
    lines = [line for line in lines if len(line) > 12 and line.strip() not in cells]
    assert lines
    assert not any(line in text for line in lines)
    assert "Hint 1" not in text
    assert any(title.startswith("Exercises") for title, _ in found)
    assert not any(title.startswith(slides.REFERENCES) for title, _ in found)


def test_a_folder_without_notebooks(tmp_path, capsys):
    assert slides.main([str(tmp_path), str(tmp_path / "slides")]) == 2
    assert capsys.readouterr().err.endswith("there are no notebooks\n")
