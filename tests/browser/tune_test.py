"""The tuner as an app: a first picture, from frame to frame, reloaded, left, interrupted; nothing stays."""

import re
import signal
import subprocess
import sys
import time
from functools import partial

import numpy as np
import psutil
import pytest

from endolab.cli import main as cli
from endolab.io.images import read_image, write_image
from tests.browser.conftest import OWN, ROOT, a_free_port, photograph

STATUS = ".endolab-status"
HANDLE = ".endolab-tuner input[type=range]"
SHOWN = "() => document.querySelector('.endolab-picture')?.naturalWidth > 100"
SAID = f"document.querySelector('{STATUS}').innerText"
FINAL = (
    f"() => document.querySelector('{STATUS}')?.innerText.match(/converged|settled/)"
)
WINDOW = "Number(document.querySelector('.endolab-stage').dataset.window)"
FRAMES = '.endolab-knob:has-text("frame or scene") select'
END = 30  # s until all must have ended, on a machine with much to do; 3 s pass after the last page


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    """A folder with an endoscope and a folder of three frames, the second of which is none."""
    folder = tmp_path_factory.mktemp("tune")
    options = ["--calibration", "simple", "--width", "160", "--out"]
    assert cli.main(["simulate", "tube", *options, str(folder / "sim")]) == 0
    (folder / "frames").mkdir()
    frame = read_image(folder / "sim/frame.png")
    write_image(folder / "frames/frame_2.png", frame)
    (folder / "frames/frame_9.png").write_bytes(b"no picture")
    write_image(folder / "frames/frame_10.png", np.flip(frame, axis=1))
    return folder


@pytest.fixture
def start(frames, compiled):
    """Function that starts the app; returns its process and its link."""
    started = []

    def start(what, *options):
        command = [sys.executable, "-m", "endolab", "tune", str(frames / what)]
        command += ["--no-browser", f"--port={a_free_port()}", "--width=160", *options]
        command += ["--calibration", str(frames / "sim/endoscope.json")]
        how = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        # In the background ignored.
        how["preexec_fn"] = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
        started.append(subprocess.Popen(command, cwd=ROOT, **how))
        line = started[-1].stdout.readline()
        return started[-1], re.search(r"http://127\.0\.0\.1:\d+/\w{48}/", line)[0]

    yield start
    for process in started:
        if process.poll() is None:
            process.kill()
        process.stdout.close()
        process.wait(10)


@pytest.fixture
def visit(browser):
    """Function that opens a link in a page of its own, which may reach nothing but this machine."""
    contexts = []

    def visit(link, width=1366, height=768):
        contexts.append(
            browser.new_context(viewport={"width": width, "height": height})
        )
        page = contexts[-1].new_page()
        page.set_default_timeout(60_000)
        page.complaints = []
        page.route(lambda url: not url.startswith(OWN), lambda route: route.abort())
        page.on("requestfailed", lambda request: page.complaints.append(request.url))
        page.on("pageerror", lambda error: page.complaints.append(str(error)))
        page.goto(link)
        page.wait_for_function(SHOWN)
        return page

    yield visit
    for context in contexts:
        context.close()


def ended(process):
    """Wait for the end of a process and of all that it had started; its status and what it printed last."""
    children = psutil.Process(process.pid).children(recursive=True)
    process.wait(END)
    _, alive = psutil.wait_procs(children, timeout=END)
    assert alive == []
    return process.returncode, process.stdout.read().splitlines()[-1]


@pytest.mark.parametrize("size", [(1366, 768), (1920, 1080)])
def test_all_fits_into_the_page_and_a_slider_moves_it_and_closing_ends_all(
    start, visit, size
):
    process, link = start("sim/frame.png")
    page = visit(link, *size)
    page.wait_for_function(FINAL)
    for _ in range(2):
        scrolled = "[document.documentElement.scrollWidth, document.documentElement.scrollHeight]"
        page.wait_for_function(
            f"size => {scrolled}.join() === size", arg=f"{size[0]},{size[1]}"
        )
        box = page.locator(".endolab-picture").bounding_box()
        assert box["width"] > 0.97 * size[0]
        assert box["y"] + box["height"] > 0.97 * size[1]
        page.get_by_role("button", name="advanced").click()
        page.wait_for_timeout(500)
    for knob in page.locator(".endolab-knob").all():
        assert len(knob.get_attribute("title")) > 20, knob.inner_text()
    before = page.locator(STATUS).inner_text()
    page.locator(HANDLE).first.focus()
    for _ in range(4):
        page.keyboard.press("ArrowLeft")
    page.wait_for_function(
        f"old => ({FINAL})() && {SAID} !== old && {SAID}.includes('λ 0.4 ')", arg=before
    )
    photograph(page, f"tune_{size[0]}x{size[1]}")
    assert page.complaints == []
    page.close()
    assert ended(process) == (0, "ended")


def test_maps_zoom_by_the_wheel_and_the_path_is_gone_through_and_keys_are_listed(
    start, visit
):
    _, link = start("sim/frame.png")
    page = visit(link)
    page.wait_for_function(FINAL)
    x, y = 200, 300  # on the first map
    label = page.locator(".endolab-said")
    page.mouse.move(x, y)
    label.first.wait_for()
    before = label.nth(1).inner_text()
    page.mouse.wheel(0, -600)
    page.wait_for_function(f"() => {WINDOW} < 0.5")
    page.mouse.move(x + 1, y)
    page.wait_for_timeout(300)
    assert label.nth(1).inner_text()[:2] == before[:2]  # the same place of the wall
    page.mouse.dblclick(x, y)
    page.wait_for_function(f"() => {WINDOW} === 1")
    page.keyboard.press("?")
    page.get_by_text("3D from the camera").wait_for()
    page.keyboard.press("Escape")
    page.keyboard.press("v")
    page.get_by_role("button", name="from outside").wait_for()
    page.get_by_label("iterate").fill("1")
    page.wait_for_function(f"() => {SAID}.includes('iteration')")
    page.get_by_title("All options at once.").select_option("paper")
    page.wait_for_function(f"() => {SAID}.includes('second order')")
    photograph(page, "tune_paper")
    assert page.complaints == []


def test_from_frame_to_frame_by_key_and_list_and_typed_letters_are_no_keys(
    start, visit
):
    process, link = start("frames")
    page = visit(link)
    page.wait_for_function(FINAL)
    page.keyboard.press("n")  # wherever the focus is
    page.wait_for_function(f"() => {SAID}.includes('frame_9.png: not a whole picture')")
    assert "the frame before is still shown" in page.locator(STATUS).inner_text()
    frames = page.locator(FRAMES)
    frames.select_option("frame_10.png")
    code = "document.querySelector('.endolab-tuner textarea').value"
    page.wait_for_function(f"() => ({FINAL})() && {code}.includes('frame_10.png')")
    page.get_by_role("button", name="advanced").click()
    smooth = page.locator(".endolab-smooth input").first
    smooth.click()
    page.keyboard.press("a")
    assert smooth.input_value() == "a"
    smooth.fill("")
    page.get_by_role("button", name="advanced").click()
    frames.select_option("tube")
    page.wait_for_function(f"() => {SAID}.includes('median error')")
    page.keyboard.press("Control+z")
    page.wait_for_function(f"() => ({FINAL})() && !{SAID}.includes('median error')")
    photograph(page, "tune_folder")
    assert page.complaints == []
    process.send_signal(signal.SIGINT)
    assert ended(process) == (0, "ended")
    page.locator("#lost").wait_for(state="visible")


def test_a_page_that_is_loaded_again_and_a_second_one_show_the_same(start, visit):
    process, link = start("sim/frame.png")
    page = visit(link)
    page.wait_for_function(FINAL)
    page.locator(HANDLE).first.focus()
    for _ in range(5):
        page.keyboard.press("ArrowLeft")
    page.wait_for_function(f"() => ({FINAL})() && {SAID}.includes('λ 0.32 ')")
    page.reload()
    page.wait_for_function(SHOWN)
    other = visit(link)
    other.keyboard.press("a")
    for one in (page, other):  # what one does, both see
        one.get_by_role("button", name="drop A").wait_for()
        assert "λ 0.32 " in one.locator(STATUS).inner_text()
    page.close()
    time.sleep(5)
    assert process.poll() is None  # there is the other
    other.close()
    assert ended(process) == (0, "ended")


def test_a_process_that_is_told_to_end_does_so_in_a_solve(start, visit):
    process, link = start("sim/frame.png")
    visit(link)
    process.terminate()
    assert ended(process) == (0, "ended")
