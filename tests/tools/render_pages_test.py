"""Pages of notebooks: folded solutions, positions of a slider, links, and a cell that fails."""

import nbformat
import pytest
from bs4 import BeautifulSoup

from tests.tools import render_pages as pages

EXERCISE = """See [the next](02_b.ipynb).

<details><summary>Hint 1</summary>

Think.
</details>

<details><summary>Solution</summary>

```python
answer = 42
```
</details>
"""
SLIDER = "from ipywidgets import interact\n@interact(a=(0, 8))\ndef show(a=4):\n    print(f'a is {a}')"


@pytest.fixture
def notebooks(tmp_path):
    """Folder of a notebook with an exercise, a slider and a cell whose code is hidden."""
    folder = tmp_path / "notebooks"
    folder.mkdir()
    hidden = nbformat.v4.new_code_cell("print(6 * 7)", metadata={"jupyter": {"source_hidden": True}})
    cells = [hidden, nbformat.v4.new_code_cell(SLIDER), nbformat.v4.new_markdown_cell(EXERCISE)]
    nbformat.write(nbformat.v4.new_notebook(cells=cells), folder / "01_a.ipynb")
    (folder / "README.md").write_text("[one](01_a.ipynb)")
    (folder / "ANSWERS.md").write_text("42")
    return folder


@pytest.fixture
def no_reference(monkeypatch):
    """Leave the reference out: pdoc's affair, and ten seconds."""
    monkeypatch.setattr(pages, "write_reference", lambda _: None)


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
@pytest.mark.usefixtures("no_reference")
@pytest.mark.parametrize("solutions", [False, True])
def test_a_page_folds_what_is_not_asked_for_and_has_positions_of_a_slider(notebooks, tmp_path, solutions):
    pages.render_pages(notebooks, tmp_path / "html", solutions=solutions)
    assert (tmp_path / "html" / "ANSWERS.html").exists() == solutions
    assert 'href="01_a.html"' in (tmp_path / "html" / "index.html").read_text(encoding="utf-8")
    page = BeautifulSoup((tmp_path / "html" / "01_a.html").read_text(encoding="utf-8"), "html.parser").main
    hidden, hint, solution = page.find_all("details")
    assert "6 * 7" in hidden.text or "6" in hidden.text
    assert "Think." in hint.text
    assert "answer = 42" in solution.text
    assert [fold.has_attr("open") for fold in (hidden, hint, solution)] == [False, False, solutions]
    labels = [one.text for one in page.select(".endolab-chosen label")]
    assert labels == ["0", "2", "4", "6", "8"]
    assert page.select("input[checked] + label")[0].text == "4"
    assert "a is 8" in page.text


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
@pytest.mark.usefixtures("no_reference")
def test_a_cell_that_fails_and_an_empty_folder_are_told_and_leave_no_pages(notebooks, tmp_path):
    path = notebooks / "01_a.ipynb"
    nbformat.write(nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("1 / 0")]), path)
    with pytest.raises(ValueError, match=r"01_a\.ipynb.*ZeroDivisionError"):
        pages.render_pages(notebooks, tmp_path / "html")
    path.unlink()
    with pytest.raises(ValueError, match="no notebooks"):
        pages.render_pages(notebooks, tmp_path / "html")
    assert not (tmp_path / "html").exists()
