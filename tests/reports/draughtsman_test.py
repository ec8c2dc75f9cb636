"""Another process draws the same page, and one that cannot is not missed."""

import io
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

import endolab as el
from endolab.plots.contents import page_of
from endolab.reports import draughtsman as module
from endolab.reports.draughtsman import Draughtsman, drawn


@pytest.fixture(scope="module")
def page():
    camera = el.Pinhole(40, 30, 20.0, 20.0, 19.5, 14.5)
    rendered = el.render(el.SCENES["curved"], camera, el.Photometry(brdf=el.Lambertian(0.5)))
    calibration = el.Calibration(camera, rendered.photometry)
    return page_of(el.reconstruct(el.Frame(rendered.image, rendered.mask), calibration, solver="facing"))


@pytest.fixture
def another(monkeypatch):
    """A draughtsman as there is one where Matplotlib has not been loaded."""
    with monkeypatch.context() as meanwhile:
        meanwhile.delitem(sys.modules, "matplotlib", raising=False)
        made = Draughtsman()
    with made:
        yield made


def pixels(png):
    return np.asarray(Image.open(io.BytesIO(png)))


def test_another_process_draws_what_this_one_would(another, page, monkeypatch):
    here = drawn(page)
    monkeypatch.setattr(module, "drawn", lambda page: pytest.fail("drawn here"))
    assert np.array_equal(pixels(another.draw(page)), pixels(here))


def test_what_draws_loads_neither_numba_nor_pyplot_nor_anything_when_a_page_has_come(page, tmp_path):
    """Each takes as long as a part of the drawing, for which everybody waits."""
    (tmp_path / "page").write_bytes(pickle.dumps(page))
    code = (
        "import pickle, sys\nfrom endolab.reports import draughtsman\ndraughtsman.load()\n"
        "before = {*sys.modules}\npage = pickle.load(open(sys.argv[1], 'rb'))\ndraughtsman.drawn(page)\n"
        "print({'numba', 'matplotlib.pyplot'} & {*sys.modules}, {'cv2', 'matplotlib'} <= before,"
        " sorted(name for name in {*sys.modules} - before if name.startswith('endolab')))"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "page")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert (done.stdout, done.stderr) == ("set() True []\n", "")


def test_a_page_is_drawn_though_the_other_process_has_ended(another, page):
    another._process.kill()
    another._process.wait()
    assert pixels(another.draw(page)).shape == (900, 1600, 3)


def test_where_matplotlib_is_loaded_there_is_no_other_process(page):
    with Draughtsman() as draughtsman:
        assert draughtsman._process is None
        assert pixels(draughtsman.draw(page)).shape == (900, 1600, 3)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="where a process that has ended can be told")
def test_it_is_ended_though_it_never_drew(another):
    process = another._process
    another.__exit__()
    assert process.poll() is not None
