"""The tuner and the surface in JupyterLab: a slider moves the picture, keys are its own, a page lives on."""

import pytest

from tests.browser.conftest import FINAL, READY, SAID

MAKE = (
    "import endolab as el\nbox = el.tune(scene='tube', width=160)\nbox.engine.wait(60)"
)
CELLS = [f"{MAKE}\nel.show_surface(box.answer.result)", "box"]


@pytest.fixture
def opened(open_notebook):
    """Notebook 06, cut down to a small tuner and its surface."""
    opened = open_notebook("06_tuner.ipynb", cells=CELLS, width=1366, height=1600)
    assert opened.run_all()["complaints"] == []
    opened.page.wait_for_function(FINAL)
    yield opened
    assert opened.state()["complaints"] == []
    assert opened.outside == []


def says(page, words):
    page.wait_for_function(f"words => ({FINAL})() && {SAID}.includes(words)", arg=words)


def test_a_slider_moves_the_picture_and_the_notebook_does_not_hear_its_keys(opened):
    page = opened.page
    cells = opened.state()["cells"]
    handle = page.locator(".endolab-lam input[type=range]")
    handle.focus()
    for _ in range(4):
        page.keyboard.press("ArrowLeft")
    says(page, "λ 0.4 ")
    number = page.locator(".endolab-lam input").first
    number.fill("25")
    number.press("Enter")
    says(page, "λ 25 ")
    handle.focus()
    page.keyboard.press("Control+z")  # not in the text field
    says(page, "λ 0.4 ")
    for key in "av":  # to the notebook they would mean: add a cell, paste one
        page.keyboard.press(key)
    page.get_by_role("button", name="drop A").wait_for()
    page.get_by_role("button", name="from outside").wait_for()
    assert opened.state()["cells"] == cells
    assert page.locator(".endolab-surface canvas").is_visible()
    opened.photograph("06_tuner")


def test_a_restarted_kernel_is_a_line_and_the_cell_runs_again(opened):
    page = opened.page
    lost = page.locator(".endolab-lost")
    session = "window.jupyterapp.shell.currentWidget.sessionContext.session"
    page.evaluate(f"async () => {{ await {session}.kernel.restart() }}")
    lost.wait_for(state="visible")
    page.get_by_role("button", name="keep as A").click()
    assert page.locator(".jp-Dialog").count() == 0
    page.wait_for_function(READY)
    opened.run_all()
    page.wait_for_function(FINAL)
    lost.wait_for(state="hidden")
