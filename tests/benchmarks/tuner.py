"""How fast the tuner's picture follows the hand, in a browser: `python -m tests.benchmarks.tuner FRAME ...`

What follows is given to `endolab tune`. Needs Chromium and an idle machine; asserts nothing.
"""

import re
import shutil
import subprocess
import sys
import time
from statistics import median, quantiles

from playwright.sync_api import sync_playwright

STEP = 0.055  # s from one move to the next: eighteen a second
RESTS = 0.5  # s, until a picture has come for sure
OTHERS = 4  # s in which the other λ of the curve are solved
# Places of the handles, from one move to the next.
MOVES = {
    "lam": [round(-0.9 + 0.1 * number, 1) for number in range(25)],
    "gamma": [round(1.6 + 0.05 * number, 2) for number in range(25)],
    "lamp_x": [round(0.25 + 0.25 * number, 2) for number in range(25)],
}
HELD = "document.querySelector('.endolab-tuner')?.endolab"
FIRST = f"() => {HELD}?.arrays?.picture"
SURFACE = f"() => {HELD}?.arrays?.distance"
FINAL = f"() => {HELD}?.moving === false && {HELD}?.curve?.lams?.length > 2"
WATCH = """(name) => {
    const root = document.querySelector('.endolab-tuner');
    const pictures = window.pictures = [];
    window.moves = [];
    root.addEventListener('painted', ({detail}) => {
        pictures.push([performance.now(), detail.asked[name] ?? 0]);
    });
}"""
TURN = """([name, value]) => {
    const handle = document.querySelector(`.endolab-${name} input[type=range]`);
    window.moves.push(performance.now());
    handle.value = value;
    handle.dispatchEvent(new Event('input'));
}"""


def wait(page, condition):
    """Seconds until a condition holds."""
    started = time.perf_counter()
    page.wait_for_function(condition, timeout=60_000, polling="raf")
    return time.perf_counter() - started


def drag(page, name):
    """Drag a knob, and say how long after a move its picture or a later one is painted."""
    page.evaluate(WATCH, name)
    for place in MOVES[name]:
        page.evaluate(TURN, [name, place])
        time.sleep(STEP)
    time.sleep(RESTS)
    wait(page, FINAL)
    moves, pictures = page.evaluate("() => [window.moves, window.pictures]")
    seen = sum(at < moves[-1] for at, _ in pictures)
    rate = 1000 * seen / (moves[-1] - moves[0])
    delays = []
    for place, move in zip(MOVES[name], moves, strict=True):
        wanted = float(f"{10**place:.2g}") if name == "lam" else place
        shown = [at for at, value in pictures if at > move and value >= 0.999 * wanted]
        delays.append(min(shown) - move)
    late = quantiles(delays, n=10)[-1]
    return f"{median(delays):.0f} ms, 90 % {late:.0f} ms, {rate:.1f} pictures a second"


def measure(link):
    """Measure one tuner."""
    with sync_playwright() as playwright:
        chromium = shutil.which("chromium")
        browser = playwright.chromium.launch(executable_path=chromium)
        size = {"width": 1366, "height": 768}
        page = browser.new_page(viewport=size, bypass_csp=True)
        page.goto(link, wait_until="commit")
        row = {"frame, s": f"{wait(page, FIRST):.2f}"}
        row["then surface, s"] = f"{wait(page, SURFACE):.2f}"
        for name in MOVES:
            wait(page, FINAL)
            time.sleep(OTHERS)
            row[name] = drag(page, name)
        return row


if __name__ == "__main__":
    command = [sys.executable, "-m", "endolab", "tune", *sys.argv[1:], "--no-browser"]
    tuner = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    link = re.search(r"http://\S+", tuner.stdout.readline())[0]
    try:
        for what, value in measure(link).items():
            print(f"{what:16} {value}")
    finally:
        tuner.terminate()
