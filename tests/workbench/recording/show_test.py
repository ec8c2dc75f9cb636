"""Showing recordings with a front end and without."""

from importlib import import_module

import pytest

import endolab as el
from tests.tools.problems import coloured_colon


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """A recording."""
    calibration = el.load_calibration("paper", width=64)
    problem, _ = coloured_colon(calibration.camera)
    with el.record(tmp_path_factory.mktemp("embed") / "run.rrd") as recorder:
        recorder(el.Iterate.of(problem, problem.log_d0))
    return recorder.path


def test_without_a_front_end_a_sentence_says_how_to_open_it(path, capsys):
    el.show(path)
    assert capsys.readouterr().out == "`rerun run.rrd` opens the recording.\n"


def test_the_viewer_comes_from_this_machine(path, monkeypatch):
    """With a front end, a widget with the recording is displayed whose program is served locally."""
    shown = []
    monkeypatch.setattr("IPython.display.display", shown.append)
    import_module("ipykernel")
    monkeypatch.setenv("JPY_SESSION_NAME", "a.ipynb")
    monkeypatch.delenv("RERUN_NOTEBOOK_ASSET", raising=False)
    el.show(path, height=300)
    widget, hint = shown[0].children
    assert "localhost" in str(type(widget)._esm) + str(widget._esm)
    assert widget._height == 300
    assert widget._event_queue == [({"type": "rrd"}, [path.read_bytes()])]
    assert "WebGL" in hint.value
