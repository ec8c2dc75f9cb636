"""A notebook opened in JupyterLab in a real browser, run to its end, without an error or a warning."""


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
    assert opened.outside == []
