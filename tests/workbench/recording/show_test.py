"""Showing recordings where there is no front end, no screen, or no recording."""

import sys

import pytest

import endolab as el
from endolab.workbench.recording import show as embed
from tests.tools.problems import coloured_colon


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """A recording of two runs."""
    calibration = el.load_calibration("paper", width=64)
    problem, _ = coloured_colon(calibration.camera)
    start = el.Iterate.of(problem, problem.log_d0)
    with el.record(tmp_path_factory.mktemp("embed") / "both.rrd") as both:
        both.run("facing")(start)
        newton = both.run("gauss_newton")
        newton(start)
        newton(el.Iterate.of(problem, problem.log_d0 + 0.1, start))
    return both.path


def test_without_a_front_end_there_is_a_sentence_and_a_picture(
    path, capsys, monkeypatch
):
    for variable in ("JPY_SESSION_NAME", "VSCODE_PID", "COLAB_RELEASE_TAG"):
        monkeypatch.delenv(variable, raising=False)
    shown = []
    monkeypatch.setitem(sys.modules, "ipykernel", sys)
    monkeypatch.setattr("IPython.display.display", shown.append)
    embed.show(path)
    output = capsys.readouterr().out
    assert output.startswith("Nobody is there to show the viewer to")
    assert "`rerun both.rrd`" in output
    assert output.count("\n") == 1
    assert shown[0].data.startswith(b"\x89PNG")


def test_the_picture_has_the_end_of_each_run_in_the_same_colours(path):
    figure = embed.picture_of(el.read_recording(path))
    titles = [axes.get_title() for axes in figure.axes]
    assert "facing, iteration 0" in titles
    assert "gauss newton, iteration 1" in titles
    left, right = (axes.images[0] for axes in figure.axes[::3][:2])
    assert left.get_clim() == right.get_clim()
    figure.canvas.draw()


def test_the_viewer_comes_from_this_machine(path, monkeypatch):
    """With a front end, a widget with the recording is displayed whose program is served locally."""
    shown = []
    monkeypatch.setattr("IPython.display.display", shown.append)
    monkeypatch.setattr(embed, "front_end", lambda: True)
    monkeypatch.delenv("RERUN_NOTEBOOK_ASSET", raising=False)
    embed.show(path, height=300)
    widget, hint = shown[0].children
    assert "localhost" in str(type(widget)._esm) + str(widget._esm)
    assert widget._height == 300
    assert widget._event_queue == [({"type": "rrd"}, [path.read_bytes()])]
    assert "WebGL" in hint.value
