"""The Rerun viewer in the notebook, in a browser on software WebGL: it draws, from this machine alone."""

import io

import numpy as np
from matplotlib.image import imread

SOLVE = """
import endolab as el

calibration = el.load_calibration("paper", width=64)
scene = el.render(el.SCENES["colon"], calibration.camera, calibration.photometry)
frame, known = el.Frame(scene.image, scene.mask), el.Calibration(scene.camera, scene.photometry)
"""
FILE = 'el.reconstruct(frame, known, observers=[el.record("run.rrd")])\nel.show("run.rrd", height=500)'


def colours(opened):
    """Number of colours in the viewer's picture; 0 before there is one."""
    canvas = opened.page.locator("canvas")
    if not canvas.count():
        return 0
    picture = imread(io.BytesIO(canvas.first.screenshot()))
    return len(
        np.unique(np.round(255 * picture.reshape(-1, picture.shape[-1])), axis=0)
    )


def drawn(opened, seconds=30):
    """Whether the viewer draws a run before time is up; software takes its time."""
    for _ in range(2 * seconds):
        if colours(opened) > 1000:
            return True
        opened.page.wait_for_timeout(500)
    return False


def test_the_viewer_draws_a_run(open_notebook):
    opened = open_notebook("00_quickstart.ipynb", cells=[SOLVE, FILE], height=1600)
    state = opened.run_all()
    assert (state["complaints"], state["waiting"]) == ([], 0)
    seen = drawn(opened)
    opened.photograph("viewer_show")
    assert seen
    assert opened.outside == []
