"""A JupyterLab on a copy of the notebooks, a Chromium, and a notebook open in it."""

import contextlib
import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest

import endolab as el
from endolab import datasets
from endolab.solvers.solvers import SOLVERS
from tests.conftest import missing_system

ROOT = Path(__file__).resolve().parents[2]
SCREENSHOTS = Path(
    os.environ.get("ENDOLAB_SCREENSHOTS") or ROOT / "build" / "screenshots"
)
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-sync",
]
FLAGS += ["--disable-background-networking", "--disable-component-update"]
CURRENT = "window.jupyterapp?.shell?.currentWidget"
# Rerun's viewer asks whether there is a newer one; refused, it goes on.
NEWER = "https://api.github.com/repos/rerun-io/rerun/releases/latest"
# Rerun serves its viewer under the name localhost.
OWN = ("http://127.0.0.1:", "http://localhost:", "data:", "blob:")
READY = f"() => {CURRENT}?.sessionContext?.session?.kernel?.status === 'idle'"
# Cells still to run, and what went wrong: in a cell's output, or behind a slider, in the slider's own output.
STATE = """() => {
    const cells = window.jupyterapp.shell.currentWidget.content.widgets.filter(c => c.model.type === 'code');
    const outputs = cells.flatMap(c => c.model.outputs.toJSON());
    const shown = document.querySelectorAll('[data-mime-type$=".stderr"], [data-mime-type$=".error"]');
    return {
        waiting: cells.filter(c => c.model.executionCount === null).length,
        cells: cells.length,
        complaints: outputs.filter(o => o.output_type === 'error' || o.name === 'stderr')
            .map(o => o.evalue || o.text.toString()).concat([...shown].map(e => e.innerText)),
        pictures: outputs.filter(o => o.data && o.data['image/png']).length,
    };
}"""
# What the tuner's page knows, whether an answer has come and its curve, and its line.
KNOWN = "document.querySelector('.endolab-tuner')?.endolab"
FINAL = f"() => {KNOWN}?.arrays?.distance && !{KNOWN}.moving && {KNOWN}.curve?.lams"
SAID = "document.querySelector('.endolab-line').innerText"
# Nothing but these cells.
CELLS = """cells => {
    const model = window.jupyterapp.shell.currentWidget.content.model;
    model.sharedModel.transact(() => {
        model.sharedModel.deleteCellRange(0, model.sharedModel.cells.length);
        cells.forEach((source, i) => model.sharedModel.insertCell(i, {cell_type: 'code', source}));
    });
}"""
# Opened as with a double click on its name; closed without a question whether to save it.
OPEN = """async path => { await window.jupyterapp.commands.execute('docmanager:open', {path}) }"""
CLOSE = """async () => {
    const widget = window.jupyterapp.shell.currentWidget;
    await widget.sessionContext.shutdown();
    widget.context.model.dirty = false;
    widget.dispose();
}"""


class OpenNotebook:
    """A notebook that is open in JupyterLab, with an idle kernel, in a page cut off from the world.

    `outside` lists the addresses other than this machine's that the page asked for, and was not given; of
    the viewer, which may be open in another tab, whether there is a newer one is not counted.
    """

    def __init__(self, page, outside, name, cells=None, width=1400, height=9000):
        self.page = page
        self.outside = outside
        outside.clear()
        page.set_viewport_size({"width": width, "height": height})  # all cells at once
        page.evaluate(OPEN, f"notebooks/{name}")
        page.wait_for_function(READY)
        if cells:
            page.evaluate(CELLS, cells)

    def command(self, name):
        """Execute one of JupyterLab's commands, without waiting for its end."""
        self.page.evaluate("name => { window.jupyterapp.commands.execute(name) }", name)

    def state(self):
        """Numbers of ``cells``, those ``waiting``, ``pictures``, and a list of ``complaints``."""
        return self.page.evaluate(STATE)

    def run_all(self, seconds=150):
        """Run all cells; return the state at their end, at the first complaint, or when time is up."""
        self.command("notebook:run-all-cells")
        for _ in range(int(seconds / 0.25)):
            state = self.state()
            if not state["waiting"] or state["complaints"]:
                break
            self.page.wait_for_timeout(250)
        return state

    def photograph(self, name):
        """Keep a screenshot as build/screenshots/<name>.png; ENDOLAB_SCREENSHOTS names another folder."""
        photograph(self.page, name)

    def close(self):
        """Close the notebook and its kernel."""
        self.page.evaluate(CLOSE)


def photograph(page, name):
    """Keep a screenshot of a page among SCREENSHOTS."""
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=SCREENSHOTS / f"{name}.png")


def a_free_port():
    """A port that nobody listens to."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


@pytest.fixture(scope="package")
def compiled():
    """Every solver's kernels in the cache: a page that waits for a cell does not wait for a compiler."""
    camera = datasets.load_calibration("paper", width=32).camera
    scene = el.render(el.SCENES["colon"], camera, el.Photometry())
    frame = el.Frame(scene.image, scene.mask)
    calibration = el.Calibration(camera, scene.photometry)
    for solver in SOLVERS:
        el.reconstruct(frame, calibration, solver=solver)


@pytest.fixture(scope="package")
def lab(tmp_path_factory, compiled):
    """Address of a JupyterLab on a copy of the notebooks, started as ``make lab`` does."""
    root = tmp_path_factory.mktemp("lab")
    shutil.copytree(
        ROOT / "notebooks", root / "notebooks", ignore=shutil.ignore_patterns(".*")
    )
    environment = {
        key: value for key, value in os.environ.items() if key != "MPLBACKEND"
    }
    environment |= {"PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}
    command = [
        sys.executable,
        "-m",
        "endolab",
        "lab",
        f"--notebooks={root / 'notebooks'}",
    ]
    port = a_free_port()
    command += [
        f"--port={port}",
        "--",
        "--no-browser",
        "--expose-app-in-browser",
    ]
    command += ["--IdentityProvider.token="]
    log = root / "log.txt"
    with open(log, "w") as stream:
        server = subprocess.Popen(
            command, env=environment, stdout=stream, stderr=subprocess.STDOUT
        )
    address = f"http://127.0.0.1:{port}"
    for _ in range(600):
        with contextlib.suppress(OSError):
            urllib.request.urlopen(f"{address}/lab", timeout=10).close()
            break
        assert server.poll() is None, log.read_text()
        time.sleep(0.1)
    yield address
    server.terminate()
    server.wait(20)


@pytest.fixture(scope="package")
def browser():
    """Chromium, the system's own; Playwright's stays away from the network."""
    names = ("chromium", "chromium-browser", "google-chrome")
    program = next(filter(None, map(shutil.which, names)), None)
    if program is None:
        missing_system(
            "The notebooks are not opened in a browser: there is no Chromium on this machine."
        )
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=program, args=FLAGS)
        yield chromium
        chromium.close()


@pytest.fixture(scope="package")
def lab_page(lab, browser):
    """A page with JupyterLab and no notebook, and the list of addresses that were refused."""
    outside = []

    def refuse(route):
        if route.request.url != NEWER:
            outside.append(route.request.url)
        route.abort()

    page = browser.new_page()
    page.set_default_timeout(90_000)  # another worker may want both cores
    page.route(lambda url: not url.startswith(OWN), refuse)
    page.goto(f"{lab}/lab?reset")
    page.wait_for_function("() => window.jupyterapp?.shell?.layoutModified")
    page.evaluate("async () => { await window.jupyterapp.restored }")
    yield page, outside
    page.close()


@pytest.fixture
def open_notebook(lab_page):
    """Function that opens a notebook by its file's name (see `OpenNotebook`), maybe with other cells."""
    opened = []

    def open_it(name, **how):
        opened.append(OpenNotebook(*lab_page, name, **how))
        return opened[-1]

    yield open_it
    for notebook in opened:
        notebook.close()
