"""The tuner and the surface in JupyterLab: a slider moves the picture, keys are its own, a page lives on."""

from tests.browser.conftest import FINAL, READY, SAID

MAKE = (
    "import endolab as el\nbox = el.tune(scene='tube', width=160)\nbox.engine.wait(60)"
)
CELLS = [f"{MAKE}\nel.show_surface(box.answer.result)", "box"]


def says(page, words):
    page.wait_for_function(f"words => ({FINAL})() && {SAID}.includes(words)", arg=words)


def test_a_slider_moves_the_picture_keys_are_its_own_and_a_kernel_is_restarted(
    open_notebook,
):
    opened = open_notebook("06_tuner.ipynb", cells=CELLS, width=1366, height=1600)
    page = opened.page
    assert opened.run_all()["complaints"] == []
    page.wait_for_function(FINAL)
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
    assert opened.state()["cells"] == len(CELLS)
    assert page.locator(".endolab-surface canvas").is_visible()
    opened.photograph("06_tuner")

    lost = page.locator(".endolab-lost")
    session = "window.jupyterapp.shell.currentWidget.sessionContext.session"
    page.evaluate(f"async () => {{ await {session}.kernel.restart() }}")
    lost.wait_for(state="visible")
    page.get_by_role("button", name="drop A").click()
    assert page.locator(".jp-Dialog").count() == 0
    page.wait_for_function(READY)
    opened.run_all()
    page.wait_for_function(FINAL)
    lost.wait_for(state="hidden")
    assert opened.state()["complaints"] == []
    assert opened.outside == []
