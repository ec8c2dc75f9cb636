"""A notebook opened in JupyterLab in a real browser, run to its end, without an error or a warning."""

from tests.browser.conftest import CURRENT, NEWER
from tests.tools.foreign_notebooks import TAKEN, foreign_notebooks


def test_a_notebook_runs_in_the_browser(open_notebook):
    opened = open_notebook("00_quickstart.ipynb")
    assert opened.page.locator(".jp-Dialog").count() == 0, "a dialog blocks the page"
    state = opened.run_all()
    opened.photograph("00_quickstart")
    assert state["complaints"] == []
    assert state["waiting"] == 0, (
        f"{state['waiting']} of {state['cells']} cells did not end"
    )
    assert state["pictures"] > 0
    assert set(opened.outside) <= {NEWER}


def test_a_foreign_notebooks_scripts_do_not_run_when_it_is_opened(open_notebook):
    """Whatever it is called and whatever its cells are; that of a cell which is run does, and is seen to."""
    for name, content in foreign_notebooks().items():
        opened = open_notebook(name)
        outputs = sum(len(cell.get("outputs", ())) for cell in content["cells"])
        rendered = (
            f"n => {CURRENT}.node.querySelectorAll('.jp-OutputArea-output').length >= n"
        )
        opened.page.wait_for_function(rendered, arg=outputs)
        opened.page.wait_for_load_state("networkidle")
        assert opened.page.evaluate("() => window.takenOver ?? 0") == 0, name
        assert set(opened.outside) <= {NEWER}
    cell = f"from IPython.display import HTML\nHTML({f'<script>{TAKEN}</script>'!r})"
    opened = open_notebook("00_quickstart.ipynb", cells=[cell])
    opened.run_all()
    opened.page.wait_for_function("() => window.takenOver === 1")
    opened.page.evaluate("() => { delete window.takenOver }")
