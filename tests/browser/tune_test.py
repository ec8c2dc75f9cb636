"""The tuner as an app: a first picture, from frame to frame, reloaded, left, interrupted; nothing stays."""

import re
import signal
import subprocess
import sys
from functools import partial

import numpy as np
import psutil
import pytest

from endolab.cli import main as cli
from endolab.io.images import read_image, write_image
from endolab.io.surfaces import read_depth
from tests.browser.conftest import (
    FINAL,
    KNOWN,
    OWN,
    ROOT,
    SAID,
    a_free_port,
    photograph,
)

TURN = """([name, value]) => {
    const handle = document.querySelector(`.endolab-${name} input[type=range]`);
    handle.value = value;
    handle.dispatchEvent(new Event('input'));
}"""
COUNT = """() => {
    window.painted = 0;
    const count = () => { window.painted += 1; };
    document.querySelector('.endolab-tuner').addEventListener('painted', count);
}"""
# Pairs of visible parts, none inside the other, that overlap by more than two pixels.
OVERLAPS = """() => {
    const names = '.endolab-tuner button, .endolab-knob, .endolab-status, .endolab-cell';
    const parts = [...document.querySelectorAll(names)]
        .filter((one) => one.offsetParent && !one.closest('.endolab-3d'));
    const boxes = parts.map((one) => one.getBoundingClientRect());
    return parts.flatMap((one, i) => parts.slice(i + 1)
        .map((other, j) => [one, other, boxes[i], boxes[i + 1 + j]]))
        .filter(([one, other, a, b]) => !one.contains(other) && !other.contains(one)
            && Math.min(a.right, b.right) - Math.max(a.left, b.left) > 2
            && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 2)
        .map(([one, other]) => `${one.className || one.innerText} / ${other.className || other.innerText}`);
}"""
# Keeps the first answer that it is asked about; whether that is on the screen, in the same colours.
IS_FIRST = """() => {
    const { arrays, asked, held } = document.querySelector('.endolab-tuner').endolab;
    const { distance, cuts } = arrays, colours = held.distance;
    window.first ??= { distance, cuts, colours };
    const same = (one, other) => one.every((value, i) => Object.is(value, other[i]));
    return asked.lam === 1 && same(distance, first.distance) && same(cuts, first.cuts)
        && same(colours, first.colours);
}"""
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
        if "--calibration" not in options:
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
        size = {"width": width, "height": height}
        contexts.append(browser.new_context(viewport=size, bypass_csp=True))
        page = contexts[-1].new_page()
        page.set_default_timeout(60_000)
        page.complaints = []
        page.route(lambda url: not url.startswith(OWN), lambda route: route.abort())
        page.on("requestfailed", lambda request: page.complaints.append(request.url))
        page.on("pageerror", lambda error: page.complaints.append(str(error)))
        page.goto(link)
        page.wait_for_function(FINAL)
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


def test_the_hand_moves_the_picture_and_nothing_moves_that_is_held(start, visit):
    """λ and γ are dragged: limits, contours and the place of the panels stay, and nothing overlaps."""
    process, link = start("sim/frame.png")
    page = visit(link)
    first = page.evaluate(f"() => {KNOWN}.held.distance")
    place = "document.querySelector('.endolab-stage').getBoundingClientRect().top"
    top = page.evaluate(f"() => {place}")
    page.evaluate(f"() => {{ window.before = {KNOWN}.arrays.distance.slice() }}")
    page.evaluate(COUNT)
    for name, places in (
        ("lam", np.linspace(0, -2, 12)),
        ("gamma", np.linspace(2.2, 1.7, 12)),
    ):
        for value in places:
            page.evaluate(TURN, [name, float(value)])
            page.wait_for_timeout(60)
    page.wait_for_function(FINAL)
    page.wait_for_function(f"() => {KNOWN}.asked.gamma === 1.7")
    assert page.evaluate("() => window.painted") > 4
    assert page.evaluate(f"() => {KNOWN}.held.distance") == first
    changed = "some((far, i) => Math.abs(far / window.before[i] - 1) > 0.05)"
    assert page.evaluate(f"() => {KNOWN}.arrays.distance.{changed}")
    assert page.evaluate(f"() => {place}") == top
    assert page.locator(".endolab-badge").inner_text() == "held"
    page.keyboard.press("Enter")
    page.wait_for_function(f"() => {SAID}.includes('asked anew')")
    for size in ((900, 700), (1366, 768), (1920, 1080)):
        page.set_viewport_size({"width": size[0], "height": size[1]})
        page.wait_for_timeout(300)
        assert page.evaluate(OVERLAPS) == []
        assert page.evaluate("document.documentElement.scrollWidth") <= size[0]
        photograph(page, f"tune_{size[0]}x{size[1]}")
    page.reload()
    page.wait_for_function(FINAL)
    assert page.evaluate(f"() => {KNOWN}.asked.gamma") == 1.7
    assert page.complaints == []
    page.close()
    assert ended(process) == (0, "ended")


def test_one_cursor_reads_all_maps_and_a_click_lays_the_section_and_a_is_compared(
    start, visit
):
    _, link = start("sim/frame.png")
    page = visit(link)
    box = page.locator(".endolab-body").nth(1).bounding_box()
    x, y = box["x"] + 0.3 * box["width"], box["y"] + 0.5 * box["height"]
    page.mouse.move(x, y)
    labels = page.locator(".endolab-said:visible")
    assert labels.count() == 3
    assert labels.nth(1).inner_text().endswith(" mm")
    titles = page.locator(".endolab-head span")
    before = titles.nth(3).inner_text()
    page.mouse.click(x, y)
    assert titles.nth(3).inner_text() != before
    page.mouse.wheel(0, -400)
    page.keyboard.press("a")
    page.get_by_role("button", name="drop A").wait_for()
    page.evaluate(TURN, ["lam", -1])
    page.wait_for_function(f"() => {KNOWN}.asked.lam === 0.1")
    assert "A: λ 1" in titles.nth(2).inner_text()
    page.keyboard.press("u")
    page.wait_for_function(f"() => {KNOWN}.asked.lam === 1")
    page.get_by_label("preset").select_option("fastest")
    page.wait_for_function(f"() => {KNOWN}.asked.solver === 'fast_marching'")
    page.keyboard.press("r")
    page.wait_for_function(f"() => {KNOWN}.asked.solver === 'gauss_newton'")
    page.get_by_label("panel").nth(2).select_option("contours")
    page.wait_for_function(f"() => {KNOWN}.arrays.contours")
    page.keyboard.press("?")
    page.get_by_text("3D from the camera").wait_for()
    page.emulate_media(color_scheme="dark")
    photograph(page, "tune_dark")
    assert page.complaints == []


def test_a_lamp_is_moved_by_hand_where_distances_are_mm(start, visit, frames, tmp_path):
    options = ["--calibration", "simple", "--width", "160", "--out"]
    assert (
        cli.main(["simulate", "tube", "--lamp", "4,0", *options, f"{frames}/lit"]) == 0
    )
    _, link = start("lit/frame.png")
    page = visit(link)
    far = f"() => {KNOWN}.arrays.distance.map((one) => Number.isFinite(one) ? one : 0)"
    assert page.evaluate(IS_FIRST)
    first = np.array(page.evaluate(far))
    x, y = (page.locator(f".endolab-lamp_{axis} input").first for axis in "xy")
    assert not x.is_visible()
    page.get_by_role("button", name="more ...").click()
    assert y.is_visible()
    assert y.is_enabled()
    x.fill("4")
    x.press("Enter")
    page.wait_for_function(f"() => ({FINAL})() && {KNOWN}.asked.lamp_x === 4")
    followed = np.array(page.evaluate(far))
    out = tmp_path / "out"
    command = f"reconstruct {frames}/lit/frame.png --calibration {frames}/sim/endoscope.json --lamp 4,0"
    assert cli.main([*command.split(), "--out", str(out)]) == 0
    wanted = np.nan_to_num(read_depth(out / "depth.npz")["distance"]).ravel()
    assert "(4, 0, 0)" in (out / "report.json").read_text()
    left = np.abs(followed - wanted).mean()  # as contours stay
    assert left < 0.5 * np.abs(first - wanted).mean()
    page.keyboard.press("Enter")
    page.wait_for_function(f"() => {SAID}.includes('asked anew')")
    assert np.array_equal(page.evaluate(far), wanted)
    page.keyboard.press("r")
    page.wait_for_function(IS_FIRST)
    _, link = start("lit/frame.png", "--calibration", "simple")  # of unknown gain
    page = visit(link)
    page.get_by_role("button", name="more ...").click()
    assert page.locator(".endolab-lamp_x input").first.is_disabled()


def test_from_frame_to_frame_by_key_and_list_and_typed_letters_are_no_keys(
    start, visit
):
    process, link = start("frames")
    page = visit(link)
    page.keyboard.press("n")  # wherever the focus is, and past what is no picture
    page.wait_for_function(f"() => ({FINAL})() && {KNOWN}.asked.scene === 2")
    page.locator(FRAMES).select_option("frame_9.png")
    page.wait_for_function(f"() => {SAID}.includes('frame_9.png: not a whole picture')")
    assert "the frame before is still shown" in page.evaluate(SAID)
    page.get_by_role("button", name="more ...").click()
    smooth = page.locator(".endolab-smooth input").first
    smooth.click()
    page.keyboard.press("a")
    assert smooth.input_value() == "a"
    assert page.complaints == []
    process.send_signal(signal.SIGINT)
    assert ended(process) == (0, "ended")
    page.locator(".endolab-lost").wait_for(state="visible")
