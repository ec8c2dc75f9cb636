"""The Rerun viewer in the notebook, in a browser on software WebGL: it draws, from this machine alone."""

import io

import numpy as np
import pytest
from matplotlib.image import imread

from browser.conftest import NEWER

SOLVE = """
import endolab as el
from endolab import datasets
from endolab.recording import record
from endolab.embed import show

calibration = datasets.calibration("paper", width=64)
scene = el.render(el.SCENES["colon"], calibration.camera, calibration.photometry)
frame, known = el.Frame(scene.image, scene.mask), el.Calibration(scene.camera, scene.photometry)
"""
FILE = 'el.reconstruct(frame, known, observers=[record("run.rrd")])\nshow("run.rrd", height=500)'
LIVE = "el.reconstruct(frame, known, observers=[record(live=True)]).status"


def colours(opened):
    """Number of colours in the viewer's picture; 0 before there is one."""
    canvas = opened.page.locator("canvas")
    if not canvas.count():
        return 0
    picture = imread(io.BytesIO(canvas.first.screenshot(timeout=60_000)))
    return len(np.unique(np.round(255 * picture.reshape(-1, picture.shape[-1])), axis=0))


@pytest.mark.parametrize(("name", "code"), [("show", FILE), ("live", LIVE)], ids=["show", "live"])
def test_the_viewer_draws_a_run(open_notebook, name, code):
    opened = open_notebook("00_quickstart.ipynb", height=1600)
    opened.page.evaluate(
        """cells => { const model = window.jupyterapp.shell.currentWidget.content.model;
        model.sharedModel.transact(() => {
            model.sharedModel.deleteCellRange(0, model.sharedModel.cells.length);
            cells.forEach((source, i) => model.sharedModel.insertCell(i, {cell_type: 'code', source}));
        }); }""",
        [SOLVE, code],
    )
    opened.page.route("http://localhost:*/**", lambda route: route.continue_())  # this machine too
    state = opened.run_all()
    assert state["complaints"] == []
    assert state["waiting"] == 0
    most = 0
    for _ in range(60):  # software takes its time
        most = max(most, colours(opened))
        if most > 1000:
            break
        opened.page.wait_for_timeout(500)
    opened.photograph(f"viewer_{name}")
    assert most > 1000
    assert set(opened.outside) <= {NEWER}
