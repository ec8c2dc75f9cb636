"""The surface that is turned, in JupyterLab on software WebGL: it is drawn, dragged, followed, forgotten."""

import io

import numpy as np
import psutil
import pytest
from matplotlib.image import imread

MAKE = """
import threading
import time
from dataclasses import replace
import numpy as np
import endolab as el

calibration = el.load_calibration("paper", width=320)
scene = el.render(el.SCENES["colon"], calibration.camera, calibration.photometry)
frame, known = el.Frame(scene.image, scene.mask), el.Calibration(scene.camera, scene.photometry)
shown = el.reconstruct(frame, known, solver="facing", channel="green").iterate
shown = replace(shown, log_distance=np.log(scene.distance))
bands = np.round(127 * (1 + np.sin(scene.distance / 3)[..., None] * [1, 0, -1]))
bands = np.nan_to_num(bands).astype(np.uint8)
"""
SHOW = "view = el.show_surface(shown)\nview"
BANDS = "view.show(shown, bands)"
# As the tuner does it, from a thread: the page's answers come in meanwhile.
MANY = """
def follow(count=100):
    for i in range(count):
        number = view.number
        waves = 0.1 * np.sin(i) * np.cos(8 * scene.camera.field.rays[..., 0])
        bent = shown.log_distance + np.log1p(waves)
        view.show(replace(shown, log_distance=bent), bands if i % 2 else None)
        while view.number == number or view.drawn != view.number:
            time.sleep(0.01)
    view.unit = f"mm, {view.number}"
    view.number += 1

threading.Thread(target=follow).start()
"""
CANVAS = ".endolab-surface canvas"
SIZE = ".endolab-size"
DRAWN = f"() => / mm$/.test(document.querySelector('{SIZE}')?.innerText)"


def seen(page):
    """The panel's picture, (h, w, 3)."""
    return imread(io.BytesIO(page.locator(CANVAS).screenshot()))[..., :3]


def covered(picture):
    """Pixels that show something, (h, w)."""
    return picture.min(axis=-1) < 0.9


def apart(one, other):
    """How many pixels differ, as a share of those that show something."""
    return np.mean(np.abs(one - other).max(axis=-1) > 0.02) / np.mean(covered(one))


def moved(one, other):
    """How many pixels show something in one picture alone, as a share."""
    return np.mean(covered(one) != covered(other)) / np.mean(covered(one))


def drag(page, right, down):
    box = page.locator(CANVAS).bounding_box()
    x = box["x"] + box["width"] / 2
    y = box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    for step in range(1, 6):
        page.mouse.move(x + right * step / 5, y + down * step / 5)
    page.mouse.up()
    page.mouse.move(0, 0)
    page.wait_for_timeout(500)


def turn_back(page):
    page.locator(CANVAS).dblclick()
    page.locator(CANVAS).blur()  # who has used a key sees where it went
    page.mouse.move(0, 0)
    page.wait_for_timeout(500)


def run_cell(opened, index):
    """Run one cell to its end."""
    content = "window.jupyterapp.shell.currentWidget.content"
    opened.page.evaluate(f"index => {{ {content}.activeCellIndex = index }}", index)
    opened.command("notebook:run-cell")
    ran = f"index => {content}.widgets[index].model.executionCount !== null"
    opened.page.wait_for_function(ran, arg=index)
    opened.page.wait_for_timeout(500)
    assert opened.state()["complaints"] == []


@pytest.fixture
def opened(open_notebook):
    """A notebook that shows a rendered colon."""
    opened = open_notebook(
        "00_quickstart.ipynb",
        cells=[MAKE, SHOW, BANDS, MANY, "view.close()"],
        height=1600,
    )
    for index in (0, 1):
        run_cell(opened, index)
    opened.page.wait_for_function(DRAWN)
    opened.page.mouse.move(0, 0)  # who points at the panel is told how to turn it
    opened.page.wait_for_timeout(500)
    return opened


def test_a_drag_turns_and_a_double_click_turns_back(opened):
    page = opened.page
    first = seen(page)
    opened.photograph("surface_first")
    assert 0.05 < np.mean(covered(first)) < 0.6
    drag(page, 80, 0)
    aside = seen(page)
    opened.photograph("surface_dragged")
    assert moved(first, aside) > 0.3
    page.locator(CANVAS).hover()
    page.mouse.wheel(0, -300)
    page.wait_for_timeout(500)
    assert np.mean(covered(seen(page))) > 1.3 * np.mean(covered(aside))
    page.locator(CANVAS).focus()
    page.keyboard.press("ArrowRight")
    turn_back(page)
    for _ in range(40):  # a busy machine draws it when it can
        if apart(first, seen(page)) < 0.01:
            break
        page.wait_for_timeout(250)
    assert apart(first, seen(page)) < 0.01
    assert (opened.state()["complaints"], opened.outside) == ([], [])


def test_another_picture_is_seen_from_where_it_was_turned_to(opened):
    page = opened.page
    first = seen(page)
    drag(page, 120, -30)
    turned = seen(page)
    run_cell(opened, 2)
    banded = seen(page)
    opened.photograph("surface_banded")
    assert apart(turned, banded) > 0.5  # other colours …
    assert moved(turned, banded) < 0.1  # … on the same surface, from the same side
    assert moved(first, banded) > 0.3
    turn_back(page)
    assert moved(first, seen(page)) < 0.1


def heap(page):
    """MB of the page's objects, when what is not needed is gone; buffers outside them too."""
    session = page.context.new_cdp_session(page)
    session.send("HeapProfiler.collectGarbage")
    used = session.send("Runtime.getHeapUsage")
    session.detach()
    return (used["usedSize"] + used.get("backingStorageSize", 0)) / 2**20


def renderers():
    """MB of the browser's processes."""
    processes = psutil.Process().children(recursive=True)
    return sum(p.memory_info().rss for p in processes if "chrom" in p.name()) / 2**20


def follow(opened, index):
    """Show a hundred surfaces; how much more memory there is then, MB."""
    page = opened.page
    before = heap(page), renderers()
    run_cell(opened, index)
    page.wait_for_function(
        f"() => / mm, \\d+$/.test(document.querySelector('{SIZE}').innerText)"
    )
    return heap(page) - before[0], renderers() - before[1]


def test_a_hundred_surfaces_take_no_more_memory_than_one(opened):
    run_cell(opened, 2)
    objects, processes = follow(opened, 3)
    assert objects < 10  # a surface has 3 MB
    assert processes < 100
    shown = heap(opened.page)
    run_cell(opened, 4)  # closes it
    opened.page.locator(CANVAS).wait_for(state="detached")
    assert heap(opened.page) < shown - 1
    assert opened.outside == []
