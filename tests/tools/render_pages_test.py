"""Pages of notebooks: a cell that fails. What they show is seen to in `tests/browser/pages_test.py`."""

import nbformat
import pytest
from nbclient.exceptions import CellExecutionError

from tests.tools.render_pages import render_pages


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_a_cell_that_fails_leaves_no_pages(tmp_path):
    cell = nbformat.v4.new_code_cell("1 / 0")
    nbformat.write(nbformat.v4.new_notebook(cells=[cell]), tmp_path / "01_a.ipynb")
    with pytest.raises(CellExecutionError, match="ZeroDivisionError"):
        render_pages(tmp_path, tmp_path / "html")
    assert not (tmp_path / "html").exists()
