"""From a slider to a picture in headless Chromium: `python -m tests.benchmarks.tuner [MOVES [RANDOM_MOVES]]`.

Not a test: it asserts nothing and depends on the machine. JupyterLab runs on a notebook in a
temporary folder.
"""

import os
import random
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import nbformat
import numpy as np
import psutil

from tests.benchmarks.report import table

ROOT = Path(__file__).resolve().parents[2]
CELL = "import endolab as el\nbox = el.tune(scene='colon', width=320)\nbox"
FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"]
READY = "() => window.jupyterapp?.shell?.currentWidget?.sessionContext?.session?.kernel?.status === 'idle'"
# Notes, for each new picture, when it was decoded and drawn and what the status line said of it.
WATCH = """() => {
    const box = document.querySelector('.endolab-tuner'), image = box.querySelector('.endolab-now img');
    window.seen = [];
    new MutationObserver(async () => {
        const said = box.querySelector('.endolab-status').innerText, arrived = performance.now();
        await image.decode().catch(() => null);
        requestAnimationFrame(() => window.seen.push({at: performance.now(), arrived, said}));
    }).observe(image, {attributes: true, attributeFilter: ['src']});
    document.addEventListener('keydown', () => { window.pressed = performance.now() }, true);
}"""
FINE = "() => document.querySelector('.endolab-status')?.innerText.includes('fine')"
FINAL = "() => window.seen.some(one => one.at > window.pressed && one.said.includes('fine'))"


@contextmanager
def lab() -> Iterator[tuple[str, int]]:
    """Give the address of a JupyterLab and its process id."""
    with tempfile.TemporaryDirectory() as folder, socket.socket() as free:
        kernel = {"display_name": "endolab", "language": "python", "name": "endolab"}
        book = nbformat.v4.new_notebook(
            cells=[nbformat.v4.new_code_cell(CELL)], metadata={"kernelspec": kernel}
        )
        nbformat.write(book, Path(folder) / "bench.ipynb")
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
        free.close()
        options = ["--no-browser", "--expose-app-in-browser", f"--port={port}", "--allow-root"]
        options += ["--IdentityProvider.token=", f"--notebook-dir={folder}"]
        server = subprocess.Popen(
            [sys.executable, "-m", "jupyterlab", *options],
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            **dict.fromkeys(("stdout", "stderr"), subprocess.DEVNULL),
        )
        try:
            for _ in range(240):
                try:
                    urllib.request.urlopen(f"http://127.0.0.1:{port}/api", timeout=5).close()
                    break
                except OSError:
                    time.sleep(0.25)
            yield f"http://127.0.0.1:{port}", server.pid
        finally:
            server.terminate()
            server.wait(20)


def said(one: dict[str, Any], what: str) -> float:
    """A number of ms in a status line."""
    found = re.search(rf"{what} in (\d+) ms", one["said"])
    return float(found[1]) if found else float("nan")


def moves(page: Any, count: int) -> list[list[str]]:
    """Move λ by a step, wait for the final picture; return the rows of the table."""
    handle = page.locator(".endolab-tuner .noUi-handle").first
    handle.focus()
    rng, samples = random.Random(0), {"first": [], "final": []}
    for _ in range(count):
        page.evaluate("() => { window.seen = []; }")
        page.keyboard.press(rng.choice(["ArrowLeft", "ArrowRight"]))
        page.wait_for_function(FINAL, timeout=60_000)
        page.wait_for_timeout(150)
        pressed = page.evaluate("() => window.pressed")
        seen = [one | {"after": one["at"] - pressed} for one in page.evaluate("() => window.seen")]
        samples["first"].append(seen[0])
        samples["final"].append(seen[-1])
    rows = []
    for name, ones in samples.items():
        after = np.array([one["after"] for one in ones])
        solve, draw = (np.array([said(one, what) for one in ones]) for what in ("solved", "drawn"))
        paint = np.array([one["at"] - one["arrived"] for one in ones])
        parts = [np.median(after), np.percentile(after, 95), *(np.nanmedian(x) for x in (solve, draw, paint))]
        rows.append([name, *(f"{part:.0f}" for part in parts)])
    return rows


def burst(page: Any, count: int, kernel: psutil.Process) -> list[str]:
    """Move sliders at random for a minute; return what came of it."""
    handles = page.locator(".endolab-tuner .noUi-handle")
    rng, memory, started = random.Random(1), [], time.monotonic()
    for i in range(count):
        handles.nth(rng.randrange(6)).focus()
        for _ in range(rng.randint(1, 4)):
            page.keyboard.press(rng.choice(["ArrowLeft", "ArrowRight"]))
        if i % (count // 4 or 1) == 0:
            memory.append(kernel.memory_info().rss / 1e6)
        page.wait_for_timeout(max(0, 1e3 * (started + 60 * (i + 1) / count - time.monotonic())))
    page.wait_for_function(FINE, timeout=90_000)
    page.wait_for_timeout(3000)
    memory.append(kernel.memory_info().rss / 1e6)
    # The reading beside the first slider is λ, and the status line says what the picture shows.
    line = page.locator(".endolab-status").inner_text()
    wished = float(page.locator(".endolab-tuner .widget-readout").first.inner_text())
    shown = float(re.search(r"λ = ([\d.e+-]+)", line)[1])
    bad = page.locator('[data-mime-type$=".stderr"], [data-mime-type$=".error"]').count()
    fresh = "yes" if abs(shown / wished - 1) < 0.07 else f"NO: {wished} wished, {shown} shown"
    flat = " ".join(f"{one:.0f}" for one in memory)
    return [str(count), f"{time.monotonic() - started:.0f}", str(bad), fresh, flat, line]


def main(arguments: list[str]) -> None:
    """Print the tables."""
    count, random_moves = (int(value) for value in (*arguments, *("50", "200")[len(arguments) :]))
    from playwright.sync_api import sync_playwright

    program = shutil.which("chromium") or shutil.which("google-chrome")
    with lab() as (address, server), sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=FLAGS)
        page = browser.new_page(viewport={"width": 1500, "height": 1200})
        page.goto(f"{address}/lab/workspaces/bench/tree/bench.ipynb?reset")
        page.wait_for_function(READY, timeout=90_000)
        page.evaluate("() => { window.jupyterapp.commands.execute('notebook:run-all-cells') }")
        page.wait_for_function(FINE, timeout=90_000)
        page.wait_for_timeout(1000)
        page.evaluate(WATCH)
        head = ("picture", "median", "95th pc", "solve", "draw + encode", "decode + paint")
        table(f"{count} moves of λ, colon 320x240, ms from key to pixels", head, moves(page, count))
        head = ("moves", "s", "errors", "last one shown", "kernel MB", "status")
        children = psutil.Process(server).children(recursive=True)
        kernel = next(one for one in children if "ipykernel_launcher" in " ".join(one.cmdline()))
        table("Random moves of six sliders", head, [burst(page, random_moves, kernel)])
        browser.close()


if __name__ == "__main__":
    main(sys.argv[1:])
