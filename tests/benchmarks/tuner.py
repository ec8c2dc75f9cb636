"""From a key to a picture in headless Chromium: `python -m tests.benchmarks.tuner [MOVES [ACTIONS]]`.

Not a test: it asserts nothing and depends on the machine. `endolab tune` looks at a real frame
(of `ENDOLAB_DATA`), and at a rendered colon.
"""

import random
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from endolab import datasets
from tests.benchmarks.report import table

FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-sync",
]
SIZE = {"width": 1366, "height": 768}
# Notes, for each new picture, when it was drawn and what the status line said of it.
WATCH = """() => {
    const image = document.querySelector('.endolab-picture');
    window.seen = [];
    new MutationObserver(async () => {
        const said = document.querySelector('.endolab-status').innerText;
        await image.decode().catch(() => null);
        requestAnimationFrame(() => window.seen.push({at: performance.now(), said}));
    }).observe(image, {attributes: true, attributeFilter: ['src']});
    document.addEventListener('keydown', () => { window.pressed = performance.now() }, true);
}"""
FINAL = "() => document.querySelector('.endolab-status')?.innerText.includes('converged')"
CAME = "() => window.seen.some(one => one.at > window.pressed && one.said.includes('converged'))"
KNOB = '.endolab-knob:has-text("%s") select'


@contextmanager
def tuner(browser: Any, frame: str) -> Iterator[Any]:
    """Give the page of a tuner."""
    command = [
        sys.executable,
        "-m",
        "endolab",
        "tune",
        frame,
        "--calibration",
        "c3vd",
        "--no-browser",
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            page = browser.new_page(viewport=SIZE)
            page.goto(re.search(r"http\S+", process.stdout.readline())[0])
            page.wait_for_function(FINAL, timeout=120_000)
            page.evaluate(WATCH)
            yield page
        finally:
            process.terminate()


def moves(page: Any, count: int) -> list[list[str]]:
    """Move λ by a step, wait for the final picture; return the rows of the table."""
    rng = random.Random(0)
    samples = {"first": [], "final": []}
    for _ in range(count):
        page.locator("input[type=range]").first.focus()
        page.evaluate("() => { window.seen = []; }")
        page.keyboard.press(rng.choice(["ArrowLeft", "ArrowRight"]))
        page.wait_for_function(CAME, timeout=60_000)
        page.wait_for_timeout(150)
        after = page.evaluate("() => window.seen.map(one => one.at - window.pressed)")
        samples["first"].append(after[0])
        samples["final"].append(after[-1])
    return [
        [name, f"{np.median(one):.0f}", f"{np.percentile(one, 95):.0f}"]
        for name, one in samples.items()
    ]


def act(page: Any, rng: random.Random) -> None:
    """Do one thing at random: a slider, a choice, a panel, a key or a click."""
    kind = rng.choice(("slider", "choice", "key", "click"))
    if kind == "slider":
        page.locator("input[type=range]").first.focus()
        page.keyboard.press(rng.choice(["ArrowLeft", "ArrowRight"]))
    elif kind == "choice":
        chosen = page.locator(".endolab-knobs select:visible, .endolab-choose").all()
        one = rng.choice(chosen)
        one.select_option(
            index=rng.randrange(one.evaluate("select => select.options.length"))
        )
    elif kind == "key":
        page.keyboard.press(rng.choice([*"abcdrux", "Control+z"]))
    else:
        page.mouse.click(
            rng.random() * SIZE["width"], 120 + rng.random() * (SIZE["height"] - 120)
        )


def main(arguments: list[str]) -> None:
    """Print the tables."""
    count, actions = (
        int(value) for value in (*arguments, *("20", "300")[len(arguments) :])
    )
    from playwright.sync_api import sync_playwright

    frame = str(datasets.data_folder() / "c3vd_trans_t1_a" / "0001_color.png")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=FLAGS
        )
        with tuner(browser, frame) as page:
            errors = []
            rng = random.Random(1)
            page.on("pageerror", lambda error: errors.append(str(error)))
            heads = ["picture", "median", "95th pc"]
            for scene, channel in (
                ("0001_color.png", "auto"),
                ("0001_color.png", ""),
                ("colon", ""),
            ):
                page.locator(KNOB % "frame or scene").select_option(scene)
                page.locator(KNOB % "channel").select_option(channel or "green or grey")
                page.wait_for_timeout(4000)
                table(
                    f"{scene} {channel}: ms from key to pixels", heads, moves(page, count)
                )
            for _ in range(actions):
                act(page, rng)
                page.wait_for_timeout(200)
            page.wait_for_timeout(5000)
            print(f"{actions} actions at random, {len(errors)} errors:", *errors)
            print(page.locator(".endolab-status").inner_text())


if __name__ == "__main__":
    main(sys.argv[1:])
