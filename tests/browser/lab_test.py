"""Every notebook opened in JupyterLab in a real browser, run to its end, without an error or a warning."""

import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest
from conftest import missing_system

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-sync",
    "--disable-background-networking",
    "--disable-component-update",
]

# The state of a notebook: cells still to run, and what went wrong in those that have.
STATE = """() => {
    const cells = window.jupyterapp.shell.currentWidget.content.widgets.filter(c => c.model.type === 'code');
    const outputs = cells.flatMap(c => c.model.outputs.toJSON());
    return {
        waiting: cells.filter(c => c.model.executionCount === null).length,
        cells: cells.length,
        complaints: outputs.filter(o => o.output_type === 'error' || o.name === 'stderr')
            .map(o => o.evalue || o.text.toString()),
        pictures: outputs.filter(o => o.data && o.data['image/png']).length,
    };
}"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """Address of a JupyterLab on a copy of the notebooks."""
    folder = tmp_path_factory.mktemp("lab") / "notebooks"
    shutil.copytree(ROOT / "notebooks", folder)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    options = ["--no-browser", "--expose-app-in-browser", f"--port={port}", "--ServerApp.port_retries=0"]
    options += ["--IdentityProvider.token=", "--allow-root", f"--notebook-dir={folder}"]
    environment = {key: value for key, value in os.environ.items() if key != "MPLBACKEND"}
    environment |= {"PYTHONPATH": str(ROOT)}
    server = subprocess.Popen(
        [sys.executable, "-m", "jupyterlab", *options],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    address = f"http://127.0.0.1:{port}"
    for _ in range(240):
        try:
            urllib.request.urlopen(f"{address}/api", timeout=5).close()
            break
        except OSError:
            time.sleep(0.25)
    yield address
    server.terminate()
    server.wait(20)


@pytest.fixture(scope="module")
def browser():
    """Chromium, the system's own; Playwright's stays away from the network."""
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        missing_system("The notebooks are not opened in a browser: there is no Chromium on this machine.")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=program, args=FLAGS)
        yield chromium
        chromium.close()


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_in_the_browser(lab, browser, notebook, tmp_path):
    page = browser.new_page(viewport={"width": 1400, "height": 9000})  # all of it at once
    page.goto(f"{lab}/lab/workspaces/{notebook.stem}/tree/{notebook.name}?reset")
    page.wait_for_function(
        "() => window.jupyterapp?.shell?.currentWidget?.sessionContext?.isReady", timeout=60_000
    )
    page.wait_for_function(
        "() => window.jupyterapp.shell.currentWidget.sessionContext.session?.kernel?.status === 'idle'",
        timeout=60_000,
    )
    assert page.locator(".jp-Dialog").count() == 0, "a dialog blocks the page"
    page.evaluate("() => { window.jupyterapp.commands.execute('notebook:run-all-cells') }")
    state = {"waiting": 1, "complaints": []}
    for _ in range(180):
        state = page.evaluate(STATE)
        if not state["waiting"] or state["complaints"]:
            break
        page.wait_for_timeout(500)
    page.screenshot(path=Path(os.environ.get("ENDOLAB_SCREENSHOTS", tmp_path)) / f"{notebook.stem}.png")
    assert state["complaints"] == []
    # What goes wrong behind a slider is shown in the slider's own output, not in the cell's.
    complaints = page.locator('[data-mime-type$=".stderr"], [data-mime-type$=".error"]')
    assert complaints.all_inner_texts() == []
    assert state["waiting"] == 0, f"{state['waiting']} of {state['cells']} cells did not end"
    assert state["pictures"] > 0
    page.close()
