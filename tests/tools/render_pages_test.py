"""Pages of notebooks: a cell that fails. What they show is seen to in `tests/browser/pages_test.py`."""

import nbformat
import pytest

from tests.tools import render_pages as pages


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_a_cell_that_fails_and_an_empty_folder_are_told_and_leave_no_pages(tmp_path):
    folder = tmp_path / "notebooks"
    path = tmp_path / "notebooks/01_a.ipynb"
    folder.mkdir()
    nbformat.write(
        nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("1 / 0")]), path
    )
    with pytest.raises(ValueError, match=r"01_a\.ipynb.*ZeroDivisionError"):
        pages.render_pages(folder, tmp_path / "html")
    path.unlink()
    with pytest.raises(ValueError, match="no notebooks"):
        pages.render_pages(folder, tmp_path / "html")
    assert not (tmp_path / "html").exists()
