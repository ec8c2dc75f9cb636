"""The tuner in JupyterLab: a slider moves the picture, an error is a line, the page stays alive."""

import re

import pytest

from tests.browser.conftest import READY

PICTURE, STATUS, HANDLE = ".endolab-picture", ".endolab-status", ".endolab-tuner .noUi-handle"
LABEL, CHOOSER, CAPTION = ".endolab-said", ".endolab-choose", ".endolab-caption"
CELL = "import endolab as el\nbox = el.tune(scene='tube', width=160)\nbox"
FINE = f"() => document.querySelector('{STATUS}')?.innerText.includes('fine')"
SHOWN = f"() => document.querySelector('{PICTURE}')?.naturalWidth > 100"


@pytest.fixture
def opened(open_notebook):
    """Notebook 06, cut down to a small tuner, which has given its first answer."""
    opened = open_notebook("06_tuner.ipynb", cells=[CELL], height=1400)
    state = opened.run_all()
    assert state["complaints"] == []
    opened.page.wait_for_function(FINE)
    return opened


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
    changed = f"old => document.querySelector('{PICTURE}').src !== old && ({FINE})()"
    page.wait_for_function(changed, arg=before)
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
    page.wait_for_function(f"() => document.querySelector('{CAPTION}').innerText.startsWith('A: ')")
    page.get_by_role("button", name="show code").click()
    code = "document.querySelector('.endolab-tuner textarea').value"
    page.wait_for_function(f"() => {code}.includes('el.reconstruct')")
    with page.expect_file_chooser() as choosing:
        page.locator(".endolab-tuner .widget-upload").click()
    choosing.value.set_files([{"name": "broken.json", "mimeType": "application/json", "buffer": b"[1]"}])
    page.wait_for_function(f"() => document.querySelector('{STATUS}').innerText.includes('broken.json')")
    opened.photograph("06_tuner_error")
    for index in (0, 1, 2):
        press(page, "ArrowLeft", index)
    page.wait_for_function(FINE)
    assert (opened.state()["complaints"], opened.outside) == ([], [])


def at(page, right, down, panel=1):
    """Page coordinates of a share of a panel's map."""
    box = page.locator(PICTURE).bounding_box()
    spot = page.evaluate("i => JSON.parse(document.querySelector('.endolab-stage').dataset.spots)[i]", panel)
    left, top, right_, bottom = spot
    x, y = left + right * (right_ - left), top + down * (bottom - top)
    return box["x"] + x * box["width"], box["y"] + y * box["height"]


def section_of(page):
    """What the slider of the section says, %."""
    return float(page.locator(".endolab-tuner .widget-readout").last.inner_text())


def section_is(page, percent):
    said = "[...document.querySelectorAll('.endolab-tuner .widget-readout')].at(-1).innerText"
    page.wait_for_function(f"wished => Math.abs(wished - parseFloat({said})) < 1", arg=percent)


def test_the_section_follows_the_pointer(opened):
    page = opened.page
    source = f"() => document.querySelector('{PICTURE}').src"
    page.evaluate(f"""() => {{ window.pictures = 0; new MutationObserver(() => {{ window.pictures += 1; }})
        .observe(document.querySelector('{PICTURE}'), {{attributes: true, attributeFilter: ['src']}}); }}""")
    before, said = page.evaluate(source), page.locator(STATUS).inner_text()
    page.mouse.move(*at(page, 0.9, 0.5))
    page.mouse.down()
    for step in range(1, 41):
        page.mouse.move(*at(page, 0.9 - 0.02 * step, 0.5 + 0.02 * step))
    page.mouse.up()
    section_is(page, 10)
    page.wait_for_function(f"old => ({source})() !== old", arg=before)
    page.wait_for_timeout(1000)
    assert page.evaluate("() => window.pictures") <= 42  # never more than one for each move
    assert page.locator(STATUS).inner_text() == said  # nothing was solved
    page.mouse.move(*at(page, 0.7, 0.5))  # no longer pressed
    box = page.locator(PICTURE).bounding_box()
    page.mouse.click(box["x"] + 0.9 * box["width"], box["y"] + 0.9 * box["height"])  # a curve, no map
    page.wait_for_timeout(500)
    assert section_of(page) == pytest.approx(10, abs=1)
    opened.photograph("06_tuner_dragged")
    page.mouse.click(*at(page, 0.8, 0.5))
    section_is(page, 80)
    assert opened.state()["complaints"] == []


def test_one_cursor_reads_all_maps_and_a_panel_is_chosen_from_a_list(opened):
    page = opened.page
    page.mouse.move(*at(page, 0.5, 0.5))
    page.wait_for_function(f"() => document.querySelectorAll('{LABEL}').length === 4")
    said = page.locator(LABEL).all_inner_texts()
    assert said[1].startswith("d = ")
    assert "grey levels" in said[2]
    page.mouse.move(*at(page, 0.9, 0.3, 0))
    page.wait_for_function(
        f"old => document.querySelectorAll('{LABEL}')[1]?.innerText.startsWith('d = ') && "
        f"document.querySelectorAll('{LABEL}')[1].innerText !== old",
        arg=said[1],
    )
    page.mouse.move(2, 2)
    page.wait_for_function(f"() => document.querySelectorAll('{LABEL}').length === 0")
    before = page.locator(PICTURE).get_attribute("src")
    page.locator(CHOOSER).nth(3).select_option("normals")
    page.wait_for_function(f"old => document.querySelector('{PICTURE}').src !== old", arg=before)
    page.mouse.move(*at(page, 0.5, 0.5, 3))
    page.wait_for_function(f"() => document.querySelectorAll('{LABEL}')[3]?.innerText.startsWith('n = (')")
    assert opened.state()["complaints"] == []


def test_a_stands_beside_b_by_keys_and_is_dropped_again(opened):
    page = opened.page
    caption = f"document.querySelector('{CAPTION}').innerText"
    page.locator(HANDLE).first.focus()
    page.keyboard.press("a")
    page.wait_for_function(f"() => {caption}.startsWith('A: ')")
    for _ in range(20):
        press(page, "ArrowLeft")
    page.wait_for_function(f"() => {caption}.includes('B (now): λ = 0.1 ')")
    assert page.locator(CAPTION).inner_text().startswith("A: λ = 1 ")
    opened.photograph("06_tuner_beside")
    page.keyboard.press("b")
    page.wait_for_function(f"() => {caption}.startsWith('A: ') && !{caption}.includes('B (now)')")
    page.keyboard.press("b")
    page.wait_for_function(f"() => {caption}.startsWith('B (now)')")
    page.keyboard.press("d")
    page.wait_for_function(f"() => {caption}.includes('|')")
    cells = opened.state()["cells"]
    page.keyboard.press("x")  # to the notebook it would mean: cut the cell
    page.wait_for_function(f"() => {caption} === ''")
    assert opened.state()["cells"] == cells
    page.get_by_role("button", name="keep as A").wait_for()
    assert opened.state()["complaints"] == []


def test_a_strip_of_lam_and_a_click_on_one(opened):
    page = opened.page
    page.locator(".endolab-tuner select").filter(has_text="strip of λ").select_option("strip of λ")
    page.wait_for_function(
        "() => JSON.parse(document.querySelector('.endolab-stage').dataset.spots).length === 10"
    )
    opened.photograph("06_tuner_strip")
    page.mouse.click(*at(page, 0.5, 0.5, 3))
    page.wait_for_function(f"() => document.querySelector('{STATUS}').innerText.includes('λ = 3.2 ')")
    page.wait_for_function(FINE)
    assert opened.state()["complaints"] == []


def test_the_pictures_are_there_every_time_the_cell_has_run(open_notebook):
    """Twenty openings while both cores are busy: no slider has to be moved first."""
    busy = "import threading\ndef spin():\n    while True: sum(range(9999))\n"
    busy += "for _ in range(2): threading.Thread(target=spin, daemon=True).start()"
    cell = "import endolab as el\nbox = el.tune(scene='plane', width=64)\nbox"
    opened = open_notebook("06_tuner.ipynb", cells=[busy, *[cell] * 20], height=12000)
    state = opened.run_all()
    assert state["complaints"] == []
    pictures = f"[...document.querySelectorAll('{PICTURE}')]"
    opened.page.wait_for_function(f"() => {pictures}.filter(one => one.naturalWidth > 100).length === 20")


def test_a_restarted_kernel_is_a_line_and_the_cell_runs_again(opened):
    page = opened.page
    lost = page.locator(".endolab-lost")
    assert not lost.is_visible()
    page.evaluate(
        "async () => { await window.jupyterapp.shell.currentWidget.sessionContext.session.kernel.restart() }"
    )
    lost.wait_for(state="visible")
    assert "run the cell again" in lost.inner_text()
    press(page, "ArrowRight")  # nobody listens
    page.mouse.click(*at(page, 0.2, 0.5))
    page.get_by_role("button", name="keep as A").click()
    page.wait_for_timeout(500)
    assert page.locator(".jp-Dialog").count() == 0
    opened.photograph("06_tuner_restarted")
    page.wait_for_function(READY)
    opened.run_all()
    page.locator(".endolab-lost").wait_for(state="hidden")
    page.wait_for_function(FINE)
    for _ in range(20):
        press(page, "ArrowLeft")
    page.wait_for_function(f"() => document.querySelector('{STATUS}').innerText.includes('λ = 0.1 ')")
    assert page.locator(".jp-Dialog").count() == 0
    assert opened.state()["complaints"] == []
