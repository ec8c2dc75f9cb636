"""How fast the tuner's picture follows the hand, in a browser: `python -m tests.benchmarks.tuner FRAME ...`

What follows is given to `endolab tune`. Needs Chromium and an idle machine; asserts nothing.
"""

import re
import shutil
import subprocess
import sys
import time
from statistics import median, quantiles
from typing import Any

from playwright.sync_api import Page, sync_playwright

from tests.benchmarks.report import table

# log10 of λ, from one place of the handle to the next: no two are one, as each is to have its picture.
MOVES = [round(-0.9 + 0.1 * number, 1) for number in range(25)]
STEP = 0.05  # s from one to the next: twenty a second
PICTURE = "() => document.querySelector('.endolab-picture')?.naturalWidth > 100"
STATUS = "document.querySelector('.endolab-status')?.innerText"
FINAL = f"() => /converged|settled/.test({STATUS})"
KEPT = f"() => /kept/.test({STATUS})"
# Times of moves and of pictures, ms, and the λ that the line says of a picture.
WATCH = """() => {
    window.moves = []; window.pictures = [];
    document.querySelector('.endolab-picture').addEventListener('load', () => {
        const line = document.querySelector('.endolab-status').innerText;
        window.pictures.push([performance.now(), Number(line.match(/λ ([^ ]+)/)[1])]);
    });
}"""
TURN = """([name, value]) => {
    const handle = document.querySelector(`.endolab-${name} input[type=range]`);
    window.moves.push(performance.now());
    handle.value = value;
    handle.dispatchEvent(new Event('input'));
}"""


def wait(page: Page, condition: str) -> float:
    """Seconds until a condition holds."""
    started = time.perf_counter()
    page.wait_for_function(condition, timeout=60_000, polling="raf")
    return time.perf_counter() - started


def drag(page: Page) -> dict[str, Any]:
    """Drag λ, and say how long after a move its picture or a later one comes, and what comes at rest."""
    page.evaluate(WATCH)
    for place in MOVES:
        page.evaluate(TURN, ["lam", place])
        time.sleep(STEP)
    rests = wait(page, KEPT)
    anew = wait(page, FINAL)
    moves, pictures = page.evaluate("() => [window.moves, window.pictures]")
    delays = []
    for place, move in zip(MOVES, moves, strict=True):
        least = 0.99 * float(f"{10**place:.2g}")
        shown = [at for at, lam in pictures if at > move and lam >= least]
        delays.append(min(shown) - move)
    seen = sum(at < moves[-1] for at, _ in pictures)
    return {
        "pictures a second": f"{1000 * seen / (moves[-1] - moves[0]):.0f}",
        "move to picture, ms": f"{median(delays):.0f} ({quantiles(delays, n=10)[-1]:.0f})",
        "rest to kept, s": f"{rests:.2f}",
        "then anew, s": f"{anew:.2f}",
    }


def measure(link: str) -> dict[str, Any]:
    """Measure one tuner."""
    with sync_playwright() as playwright:
        chromium = shutil.which("chromium")
        browser = playwright.chromium.launch(executable_path=chromium)
        page = browser.new_page(viewport={"width": 1366, "height": 768})
        page.goto(link, wait_until="commit")
        opened = {"page to picture, s": f"{wait(page, PICTURE):.2f}"}
        opened["then answer, s"] = f"{wait(page, FINAL):.2f}"
        time.sleep(3)  # the other λ
        return opened | drag(page)


if __name__ == "__main__":
    command = [sys.executable, "-m", "endolab", "tune", *sys.argv[1:], "--no-browser"]
    tuner = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert tuner.stdout is not None
    found = re.search(r"http://\S+", tuner.stdout.readline())
    assert found is not None
    try:
        row = measure(found[0])
    finally:
        tuner.terminate()
    table("The tuner", row, [list(row.values())])
