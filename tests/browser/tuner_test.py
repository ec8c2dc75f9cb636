"""The tuner in JupyterLab: a slider moves the picture, an error is a line, the page stays alive."""

import json
import re

import pytest

PICTURE, STATUS, HANDLE = ".endolab-tuner img", ".endolab-status", ".endolab-tuner .noUi-handle"
CELLS = ["from endolab.widgets import tuner\nbox = tuner(scene='tube', width=160)\nbox"]


@pytest.fixture
def opened(open_notebook, lab):
    """Notebook 06, cut down to a small tuner, which has given its first answer."""
    opened = open_notebook("06_tuner.ipynb", height=1400)
    opened.page.evaluate(
        """cells => { const model = window.jupyterapp.shell.currentWidget.content.model;
        model.sharedModel.transact(() => {
            model.sharedModel.deleteCellRange(0, model.sharedModel.cells.length);
            cells.forEach((source, i) => model.sharedModel.insertCell(i, {cell_type: 'code', source}));
        }); }""",
        CELLS,
    )
    state = opened.run_all()
    assert state["complaints"] == []
    opened.page.wait_for_function(FINE, timeout=60_000)
    return opened


FINE = f"() => document.querySelector('{STATUS}')?.innerText.includes('fine')"


def lam_of(page):
    """What the status line says of λ, or None."""
    said = re.search(r"λ = ([\d.e+-]+)", page.locator(STATUS).inner_text())
    return said and float(said[1])


def press(page, key, index=0):
    handle = page.locator(HANDLE).nth(index)
    handle.focus()
    page.keyboard.press(key)


def test_a_slider_changes_the_picture(opened):
    page = opened.page
    before, lam = page.locator(PICTURE).first.get_attribute("src"), lam_of(page)
    for _ in range(8):
        press(page, "ArrowLeft")
    page.wait_for_function(
        f"old => document.querySelector('{PICTURE}').src !== old && ({FINE})()", arg=before, timeout=20_000
    )
    page.wait_for_timeout(1500)
    assert page.locator(PICTURE).first.get_attribute("src") != before
    assert lam_of(page) == pytest.approx(lam * 10**-0.4, rel=0.02)
    assert "fine" in page.locator(STATUS).inner_text()
    opened.photograph("06_tuner_moved")
    assert opened.state()["complaints"] == []


def test_ends_errors_and_a_kept_result_leave_the_page_alive(opened):
    page = opened.page
    for index in range(6):
        for key in ("Home", "End"):
            press(page, key, index)
            page.wait_for_timeout(150)
    page.get_by_role("button", name="keep as A").click()
    page.wait_for_function(f"() => document.querySelectorAll('{PICTURE}').length === 2")
    page.get_by_role("button", name="show code").click()
    page.wait_for_function(
        "() => document.querySelector('.endolab-tuner textarea').value.includes('el.reconstruct')"
    )
    with page.expect_file_chooser() as choosing:
        page.locator(".endolab-tuner .widget-upload").click()
    choosing.value.set_files(
        [{"name": "broken.json", "mimeType": "application/json", "buffer": json.dumps([1]).encode()}]
    )
    page.wait_for_function(
        f"() => document.querySelector('{STATUS}').innerText.includes('broken.json')", timeout=20_000
    )
    opened.photograph("06_tuner_error")
    for index in (0, 1, 2):
        press(page, "ArrowLeft", index)
    page.wait_for_function(FINE, timeout=60_000)
    assert opened.state()["complaints"] == []
    assert opened.outside == []
