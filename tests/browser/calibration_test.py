"""The calibration's board in JupyterLab: a bar shows its frame, two clicks leave it out, sheets turn."""

import pytest

BARS, PICTURE, STATUS = ".endolab-bars [data-index]", ".endolab-calibration img", ".endolab-status"
CELLS = [
    "import endolab as el\nfrom tests.tools.simulated_session import simulated\n"
    "session, frames, _ = simulated()\nbox = el.tune_calibration(session, frames=frames)\nbox",
]
SOURCE = f"() => document.querySelector('{PICTURE}').src"
SAYS = f"words => document.querySelector('{STATUS}').innerText.includes(words)"


@pytest.fixture
def opened(open_notebook):
    """A notebook with a board of 22 frames, of which two show nothing."""
    opened = open_notebook("02_geometric_calibration.ipynb", cells=CELLS, height=1000)
    assert opened.run_all()["complaints"] == []
    opened.page.wait_for_function(
        "() => document.querySelectorAll('.endolab-bars [data-index]').length === 22"
    )
    return opened


def test_a_bar_shows_its_frame_and_two_clicks_leave_it_out(opened):
    page = opened.page
    before = page.evaluate(SOURCE)
    page.locator(BARS).nth(7).click()
    page.wait_for_function(f"old => ({SOURCE})() !== old", arg=before)
    assert page.locator(".endolab-calibration select").nth(2).evaluate("e => e.selectedIndex") == 7
    page.locator(BARS).nth(7).dblclick()
    page.wait_for_function(SAYS, arg="without frame_7: fx")
    page.wait_for_function("() => document.querySelectorAll('.endolab-out').length === 3")
    opened.photograph("calibration_left_out")
    page.locator(".endolab-bars").focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press(" ")
    page.wait_for_function(SAYS, arg="without frame_7, frame_8: fx")
    page.get_by_role("button", name="take all back").click()
    page.wait_for_function(SAYS, arg="with all frames")
    assert (opened.state()["complaints"], opened.outside) == ([], [])


def test_sheets_turn_under_the_mouse_and_a_click_chooses_one(opened):
    page = opened.page
    canvas = page.locator(".endolab-space canvas")
    box, shown = canvas.bounding_box(), "() => document.querySelector('.endolab-space canvas').toDataURL()"
    before, frame = page.evaluate(shown), page.evaluate(SOURCE)
    page.mouse.move(box["x"] + 200, box["y"] + 150)
    page.mouse.down()
    page.mouse.move(box["x"] + 260, box["y"] + 120, steps=5)
    page.mouse.up()
    assert page.evaluate(shown) != before
    assert page.evaluate(SOURCE) == frame  # a drag chooses nothing
    for x in range(30, int(box["width"]) - 30, 25):  # somewhere there is a sheet
        page.mouse.click(box["x"] + x, box["y"] + box["height"] / 2)
        page.wait_for_timeout(150)
        if page.evaluate(SOURCE) != frame:
            break
    assert page.evaluate(SOURCE) != frame
    opened.photograph("calibration_turned")
    assert opened.state()["complaints"] == []


def test_what_is_left_out_has_its_picture(opened):
    page = opened.page
    page.locator(".endolab-calibration select").first.select_option("light: grey levels")
    page.wait_for_function(
        "() => document.querySelector('.endolab-title').textContent.includes('grey levels')"
    )
    pictures = page.locator(PICTURE)
    page.wait_for_function(
        f"() => [...document.querySelectorAll('{PICTURE}')].every(one => one.naturalWidth)"
    )
    assert [pictures.nth(i).is_visible() for i in range(2)] == [True, True]
    opened.photograph("calibration_light")
