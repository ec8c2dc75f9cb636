"""From a slider to a picture in headless Chromium: `python -m tests.benchmarks.tuner [MOVES [ACTIONS]]`.

Not a test: it asserts nothing and depends on the machine. JupyterLab runs on a notebook in a
temporary folder; a real frame is looked at if there is one (`ENDOLAB_DATA`), besides a rendered colon.
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
SCENE = "import endolab as el\nbox = el.tune(scene='colon', width=320)\nbox"
REAL = """import endolab as el
from endolab import datasets
one = datasets.read_c3vd(datasets.data_folder() / "c3vd_trans_t1_a", 1)
box = el.tune(one.frame, one.calibration, width={width})
box.knobs["channel"].value = "{channel}"
box"""
PANELS = ("model - frame", "normals", "contours")  # shown in turn while λ moves
FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"]
READY = "() => window.jupyterapp?.shell?.currentWidget?.sessionContext?.session?.kernel?.status === 'idle'"
# Notes, for each new picture, when it was decoded and drawn and what the status line said of it.
WATCH = """() => {
    const box = document.querySelector('.endolab-tuner'), image = box.querySelector('.endolab-picture');
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
def lab(cell: str) -> Iterator[tuple[str, int]]:
    """Give the address of a JupyterLab on a notebook of one cell, and its process id."""
    with tempfile.TemporaryDirectory() as folder, socket.socket() as free:
        kernel = {"display_name": "endolab", "language": "python", "name": "endolab"}
        book = nbformat.v4.new_notebook(
            cells=[nbformat.v4.new_code_cell(cell)], metadata={"kernelspec": kernel}
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


def act(page: Any, rng: random.Random) -> None:
    """Do one thing at random: a slider, a choice, a panel, a button, a key, a click or a look at the maps."""
    tuner = page.locator(".endolab-tuner")
    kind = rng.choice(("slider", "slider", "choice", "panel", "button", "key", "click", "hover"))
    if kind == "slider":
        handles = tuner.locator(".noUi-handle")
        handles.nth(rng.randrange(handles.count())).focus()
        for _ in range(rng.randint(1, 4)):
            page.keyboard.press(rng.choice(["ArrowLeft", "ArrowRight"]))
    elif kind in ("choice", "panel"):
        chosen = tuner.locator(".endolab-choose" if kind == "panel" else ".widget-dropdown select")
        if chosen.count():
            one = chosen.nth(rng.randrange(chosen.count()))
            count = one.evaluate("select => select.options.length")
            one.select_option(index=rng.randrange(count))
    elif kind == "button":
        name = rng.choice(["keep as A", "drop A", "show code", "forget mask and length"])
        found = tuner.get_by_role("button", name=name)
        if found.count():
            found.first.click()
    elif kind == "key":
        tuner.locator(".noUi-handle").first.focus()
        page.keyboard.press(rng.choice("abdx"))
    else:
        box = tuner.locator(".endolab-picture").bounding_box()
        where = box["x"] + rng.random() * box["width"], box["y"] + rng.random() * box["height"]
        (page.mouse.click if kind == "click" else page.mouse.move)(*where)


def actions(page: Any, count: int, kernel: psutil.Process) -> list[str]:
    """Do so many things at random, two a second; return what came of it."""
    rng, memory, started = random.Random(1), [], time.monotonic()
    page.set_default_timeout(20_000)
    for i in range(count):
        act(page, rng)
        if i % (count // 5 or 1) == count // 5 // 2:
            memory.append(kernel.memory_info().rss / 1e6)
        page.wait_for_timeout(max(0, 1e3 * (started + 0.5 * (i + 1) - time.monotonic())))
    page.wait_for_timeout(5000)
    memory.append(kernel.memory_info().rss / 1e6)
    bad = page.locator('[data-mime-type$=".stderr"], [data-mime-type$=".error"]').count()
    line = page.locator(".endolab-status").inner_text()
    flat = " ".join(f"{one:.0f}" for one in memory)
    return [str(count), f"{time.monotonic() - started:.0f}", str(bad), flat, line]


def main(arguments: list[str]) -> None:
    """Print the tables."""
    count, random_actions = (int(value) for value in (*arguments, *("30", "500")[len(arguments) :]))
    from playwright.sync_api import sync_playwright

    subjects = {"colon 320, green": SCENE}
    if os.environ.get("ENDOLAB_DATA"):
        for width, channel in ((320, "green"), (320, "auto"), (480, "auto")):
            subjects[f"C3VD {width}, {channel}"] = REAL.format(width=width, channel=channel)
    program = shutil.which("chromium") or shutil.which("google-chrome")
    for name, cell in subjects.items():
        with lab(cell) as (address, server), sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=program, args=FLAGS)
            page = browser.new_page(viewport={"width": 1500, "height": 1200})
            page.goto(f"{address}/lab/workspaces/bench/tree/bench.ipynb?reset")
            page.wait_for_function(READY, timeout=90_000)
            page.evaluate("() => { window.jupyterapp.commands.execute('notebook:run-all-cells') }")
            page.wait_for_function(FINE, timeout=90_000)
            page.wait_for_timeout(1000)
            page.evaluate(WATCH)
            head = ("picture", "median", "95th pc", "solve", "draw + encode", "decode + paint")
            for panel in PANELS:
                page.locator(".endolab-choose").nth(2).select_option(panel)
                page.wait_for_timeout(500)
                rows = moves(page, max(count // len(PANELS), 1))
                table(f"{name}, {panel}: moves of λ, ms from key to pixels", head, rows)
            if random_actions and name in ("C3VD 320, auto", list(subjects)[-1]) and "480" not in name:
                head = ("actions", "s", "errors", "kernel MB", "status")
                children = psutil.Process(server).children(recursive=True)
                kernel = next(one for one in children if "ipykernel_launcher" in " ".join(one.cmdline()))
                table(f"{name}: anything at random", head, [actions(page, random_actions, kernel)])
            browser.close()


if __name__ == "__main__":
    main(sys.argv[1:])
