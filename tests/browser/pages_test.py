"""Pages of notebooks in a browser: folds, a surface, a recording beside them."""

import nbformat
import pytest

from tests.browser.conftest import photograph
from tests.tools import render_pages as pages

EXERCISE = """$x^2$: why?

<details><summary>Hint 1</summary>

Think.
</details>

<details><summary>Solution</summary>

```python
answer = 42
```

Therefore.
</details>

**Next:** more.
"""


SURFACE = """import tempfile
from pathlib import Path
import endolab as el
calibration = el.load_calibration("paper", width=64)
scene = el.render(el.SCENES["plane"], calibration.camera, calibration.photometry)
known = el.Calibration(scene.camera, scene.photometry)
recorder = el.record(Path(tempfile.mkdtemp()) / "run.rrd")
frame = el.Frame(scene.image, scene.mask)
el.show_surface(el.reconstruct(frame, known, channel="green", observers=[recorder]))
"""


@pytest.fixture
def notebooks(tmp_path):
    """Folder of a notebook with an exercise, a surface, and a cell whose code is hidden."""
    folder = tmp_path / "notebooks"
    folder.mkdir()
    hidden = nbformat.v4.new_code_cell(
        "print(6 * 7)", metadata={"jupyter": {"source_hidden": True}}
    )
    surface = nbformat.v4.new_code_cell(SURFACE)
    cells = [hidden, surface, nbformat.v4.new_markdown_cell(EXERCISE)]
    nbformat.write(nbformat.v4.new_notebook(cells=cells), folder / "01_a.ipynb")
    (folder / "README.md").write_text("[one](01_a.ipynb)")
    return folder


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
@pytest.mark.usefixtures("compiled")
@pytest.mark.parametrize("solutions", [False, True], ids=["folded", "open"])
def test_a_solution_is_in_view_where_it_was_asked_for(
    browser, notebooks, tmp_path, monkeypatch, solutions
):
    pytest.importorskip("dash")  # the formulas' script
    # pdoc's affair and the tuner's, and half a minute.
    monkeypatch.setattr(pages, "write_beside", lambda _: None)
    pages.render_pages(notebooks, tmp_path / "html", solutions)
    assert (tmp_path / "html" / "run.rrd").is_file()
    page = browser.new_page()
    outside = []
    page.on("request", lambda request: outside.append(request.url))
    page.goto((tmp_path / "html" / "01_a.html").as_uri())
    page.locator("mjx-container").wait_for()
    solution = [page.get_by_text("answer"), page.get_by_text("Therefore.")]
    code = page.locator(".endolab-code pre")
    hint = page.get_by_text("Think.")
    assert [part.is_visible() for part in [*solution, code, hint]] == [
        solutions,
        solutions,
        False,
        False,
    ]
    assert page.get_by_text(
        "42", exact=True
    ).first.is_visible()  # what the hidden code printed
    assert page.get_by_text("Next:").is_visible()
    page.get_by_text("Code", exact=True).click()
    assert code.is_visible()
    if not solutions:
        page.get_by_text("Solution", exact=True).click()
    assert all(part.is_visible() for part in solution)
    assert page.locator(".endolab-surface canvas").is_visible()
    assert all(url.startswith(("file:", "data:", "blob:")) for url in outside)
    photograph(page, f"pages-{'open' if solutions else 'folded'}")
    page.close()
