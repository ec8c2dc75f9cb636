"""The tuner in JupyterLab: a slider moves the picture, panels are chosen, the page stays alive."""

import pytest

from tests.browser.conftest import READY

PICTURE = ".endolab-picture"
STATUS = ".endolab-status"
HANDLE = ".endolab-tuner input[type=range]"
LABEL = ".endolab-said"
CHOOSER = ".endolab-choose"
CELL = "import endolab as el\nbox = el.tune(scene='tube', width=160)\nbox"
SAID = f"document.querySelector('{STATUS}').innerText"
FINAL = (
    f"() => document.querySelector('{STATUS}')?.innerText.match(/converged|settled/)"
)
CELLS = "JSON.parse(document.querySelector('.endolab-stage').dataset.cells)"


@pytest.fixture
def opened(open_notebook):
    """Notebook 06, cut down to a small tuner, which has given its first answer."""
    opened = open_notebook("06_tuner.ipynb", cells=[CELL], width=1366, height=768)
    state = opened.run_all()
    assert state["complaints"] == []
    opened.page.wait_for_function(FINAL)
    yield opened
    assert opened.state()["complaints"] == []
    assert opened.outside == []


def press(page, key, times=1):
    page.locator(HANDLE).first.focus()
    for _ in range(times):
        page.keyboard.press(key)


def says(page, words):
    page.wait_for_function(f"words => ({FINAL})() && {SAID}.includes(words)", arg=words)


def at(page, right, down, panel=1):
    """Page coordinates of a share of a panel's map."""
    box = page.locator(PICTURE).bounding_box()
    cell = page.evaluate(f"() => {CELLS}")[panel]
    left, top, to, bottom = cell["spot"] or cell["box"]
    x = left + right * (to - left)
    y = top + down * (bottom - top)
    return box["x"] + x * box["width"], box["y"] + y * box["height"]


def test_a_slider_moves_by_tenths_of_a_decade_and_a_number_can_be_typed(opened):
    page = opened.page
    before = page.locator(PICTURE).get_attribute("src")
    press(page, "ArrowLeft", 4)
    says(page, "λ 0.4 ")
    assert page.locator(PICTURE).get_attribute("src") != before
    number = page.locator(".endolab-lam input").first
    number.fill("25")
    number.press("Enter")
    says(page, "λ 25 ")
    press(page, "Control+z")  # not in the text field
    says(page, "λ 0.4 ")
    opened.photograph("06_tuner")


def test_the_section_follows_the_pointer_and_one_cursor_reads_all_maps(opened):
    page = opened.page
    page.mouse.move(*at(page, 0.9, 0.5))
    # Of three maps, and of the section.
    page.wait_for_function(f"() => document.querySelectorAll('{LABEL}').length === 4")
    assert page.locator(LABEL).nth(3).inner_text().startswith("column ")
    assert page.locator(".endolab-marker").is_visible()
    assert page.locator(LABEL).nth(1).inner_text().endswith(" mm")
    before = page.locator(PICTURE).get_attribute("src")
    status = page.locator(STATUS).inner_text()
    page.mouse.down()
    for step in range(1, 21):
        page.mouse.move(*at(page, 0.9 - 0.04 * step, 0.5))
    page.mouse.up()
    page.wait_for_function(
        f"old => document.querySelector('{PICTURE}').src !== old", arg=before
    )
    page.wait_for_timeout(500)
    section = "document.querySelector('.endolab-section input').value"
    assert float(page.evaluate(section)) == pytest.approx(10, abs=1)
    assert page.locator(STATUS).inner_text() == status  # nothing was solved
    page.mouse.move(2, 2)
    page.wait_for_function(f"() => document.querySelectorAll('{LABEL}').length === 0")


def test_a_stands_beside_b_by_keys_and_the_notebook_does_not_hear_them(opened):
    page = opened.page
    cells = opened.state()["cells"]
    page.keyboard.press("a")
    page.get_by_role("button", name="drop A").wait_for()
    press(page, "ArrowLeft", 10)
    says(page, "A beside B: λ 0.1 ")
    opened.photograph("06_tuner_beside")
    for key, words in (
        ("b", "B: λ 0.1 "),
        ("b", "A: λ 1 "),
        ("d", "A beside B: λ 0.1 "),
    ):
        page.keyboard.press(key)
        says(page, words)
    page.keyboard.press("x")  # to the notebook it would mean: cut the cell
    page.get_by_role("button", name="keep as A").wait_for()
    assert opened.state()["cells"] == cells


def test_the_pictures_are_there_every_time_the_cell_has_run(open_notebook):
    """Ten openings while both cores are busy: no slider has to be moved first."""
    busy = "import threading\ndef spin():\n    while True: sum(range(9999))\n"
    busy += "for _ in range(2): threading.Thread(target=spin, daemon=True).start()"
    cell = "import endolab as el\nbox = el.tune(scene='plane', width=64)\nbox"
    opened = open_notebook("06_tuner.ipynb", cells=[busy, *[cell] * 10], height=20000)
    assert opened.run_all()["complaints"] == []
    pictures = f"[...document.querySelectorAll('{PICTURE}')]"
    opened.page.wait_for_function(
        f"() => {pictures}.filter(one => one.naturalWidth > 100).length === 10"
    )


def test_a_restarted_kernel_is_a_line_and_the_cell_runs_again(opened):
    page = opened.page
    lost = opened.page.locator(".endolab-lost")
    session = "window.jupyterapp.shell.currentWidget.sessionContext.session"
    page.evaluate(f"async () => {{ await {session}.kernel.restart() }}")
    lost.wait_for(state="visible")
    press(page, "ArrowRight")  # nobody listens
    page.get_by_role("button", name="keep as A").click()
    assert page.locator(".jp-Dialog").count() == 0
    page.wait_for_function(READY)
    opened.run_all()
    lost.wait_for(state="hidden")
    page.wait_for_function(FINAL)
    press(page, "ArrowLeft", 10)
    says(page, "λ 0.1 ")
