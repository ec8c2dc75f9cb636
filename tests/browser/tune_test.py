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
from tests.browser.conftest import OWN, ROOT, SCREENSHOTS, a_free_port

STATUS, HANDLE = ".endolab-status", ".endolab-tuner .noUi-handle"
SHOWN = """() => [...document.querySelectorAll('.endolab-app img, .endolab-app canvas')]
    .some(one => (one.naturalWidth ?? one.width) > 100)"""
FINE = f"() => document.querySelector('{STATUS}')?.innerText.includes('fine')"
# Its spaces do not break.
CHOSEN = "document.querySelector('.endolab-frames select').selectedOptions[0].text.replaceAll('\\u00a0', ' ')"
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
        command = [sys.executable, "-m", "endolab", "tune", str(frames / what), "--no-browser"]
        command += ["--calibration", str(frames / "sim/endoscope.json"), f"--port={a_free_port()}"]
        how = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True, "cwd": ROOT}
        how["preexec_fn"] = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)  # in the background ignored
        started.append(subprocess.Popen([*command, "--width=160", *options], **how))
        line = started[-1].stdout.readline()
        return started[-1], re.search(r"http://127\.0\.0\.1:\d+/\?token=\w{48}", line)[0]

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
        contexts.append(browser.new_context(viewport={"width": width, "height": height}))
        page = contexts[-1].new_page()
        page.set_default_timeout(90_000)
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


def photograph(page, name):
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=SCREENSHOTS / f"{name}.png")


def chosen(page):
    """The frame that the list of frames shows."""
    return page.evaluate(f"() => {CHOSEN}")


@pytest.mark.parametrize("size", [(1366, 768), (1920, 1080)])
def test_a_frame_is_shown_and_a_slider_moves_it_and_closing_ends_all(start, visit, size):
    process, link = start("sim/frame.png")
    page = visit(link, *size)
    page.wait_for_function(FINE)
    assert "token" not in page.evaluate("location.href")
    assert page.locator(".endolab-frames").count() == 0
    before = page.locator(STATUS).inner_text()
    page.locator(HANDLE).first.focus()
    for _ in range(4):
        page.keyboard.press("ArrowLeft")
    changed = f"old => ({FINE})() && document.querySelector('{STATUS}').innerText !== old"
    page.wait_for_function(changed, arg=before)
    photograph(page, f"tune_{size[0]}x{size[1]}")
    assert page.complaints == []
    page.close()
    assert ended(process) == (0, "ended")


def test_from_frame_to_frame_by_button_key_and_list(start, visit):
    process, link = start("frames")
    page = visit(link)
    said = "document.querySelector('.endolab-frames').innerText"
    assert chosen(page) == "frame_2.png (1 of 3)"
    page.get_by_role("button", name="next").click()
    page.wait_for_function(f"() => {said}.includes('frame_9.png: not a picture that can be read')")
    assert "the frame before is still shown" in page.locator(".endolab-frames").inner_text()
    photograph(page, "tune_folder")
    page.keyboard.press("n")
    page.wait_for_function(f"() => {CHOSEN} === 'frame_10.png (3 of 3)' && !{said}.includes('not a picture')")
    page.wait_for_function(
        "() => document.querySelector('.endolab-tuner').innerText.includes('frame_10.png')"
    )
    page.keyboard.press("n")  # there is none after it
    page.keyboard.press("p")
    page.wait_for_function(f"() => {CHOSEN} === 'frame_9.png (2 of 3)'")
    page.locator(".endolab-frames select").select_option("frame_2.png (1 of 3)")
    page.wait_for_function("() => document.querySelector('.endolab-tuner').innerText.includes('frame_2.png')")
    page.wait_for_function(FINE)
    page.locator(".endolab-tuner input[type=text]").first.fill("p")  # typed, and not pressed
    page.keyboard.press("n")
    page.wait_for_timeout(500)
    assert chosen(page) == "frame_2.png (1 of 3)"
    assert page.complaints == []
    process.send_signal(signal.SIGINT)
    assert ended(process) == (0, "ended")
    page.locator("#lost").wait_for(state="visible")
    assert "start it again" in page.locator("#lost").inner_text()
    photograph(page, "tune_ended")


def test_a_page_that_is_loaded_again_and_a_second_one_show_the_same(start, visit):
    process, link = start("sim/frame.png")
    page = visit(link)
    page.wait_for_function(FINE)
    page.locator(HANDLE).first.focus()
    for _ in range(10):
        page.keyboard.press("ArrowLeft")
    lam = "document.querySelector('.endolab-tuner .widget-readout').innerText"
    told = f"document.querySelector('{STATUS}').innerText.split('λ = ')[1]"
    page.wait_for_function(f"() => ({FINE})() && parseFloat({told}) < 0.4")  # all ten are known
    value = page.evaluate(f"() => {lam}")
    page.reload()
    page.wait_for_function(SHOWN)
    assert page.evaluate(f"() => {lam}") == value
    other = visit(link)
    assert other.evaluate(f"() => {lam}") == value
    with other.expect_file_chooser() as choosing:
        other.locator(".endolab-tuner .widget-upload").first.click()
    choosing.value.set_files([{"name": "broken.json", "mimeType": "application/json", "buffer": b"[1]"}])
    for one in (other, page):  # what one does, both see
        one.wait_for_function(f"() => document.querySelector('{STATUS}').innerText.includes('broken.json')")
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
