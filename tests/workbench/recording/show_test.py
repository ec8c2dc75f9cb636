"""Showing recordings where there is no front end, no screen, or no recording."""

import io
import subprocess
import sys

import matplotlib.image
import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.workbench.recording import show as embed
from endolab.workbench.recording import viewer
from endolab.workbench.recording.recorder import Comparison


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """A recording of two runs."""
    calibration = datasets.load_calibration("paper", width=64)
    scene = el.render(el.SCENES["colon"], calibration.camera, calibration.photometry)
    frame = el.Frame(scene.image, scene.mask)
    known = el.Calibration(scene.camera, scene.photometry)
    with Comparison(tmp_path_factory.mktemp("embed") / "both.rrd") as both:
        el.reconstruct(frame, known, solver="facing", observers=[both.run("facing")])
        el.reconstruct(
            frame,
            known,
            channel="grey",
            max_iterations=3,
            observers=[both.run("gauss_newton")],
        )
    return both.path


@pytest.fixture
def nobody(monkeypatch):
    """Take away every sign of a front end and of a screen."""
    for variable in (
        *("JPY_SESSION_NAME", "VSCODE_PID", "COLAB_RELEASE_TAG"),
        *("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"),
    ):
        monkeypatch.delenv(variable, raising=False)


def test_without_a_front_end_there_is_a_sentence_and_a_picture(
    path, nobody, capsys, monkeypatch
):
    shown = []
    monkeypatch.setattr(embed, "_display", shown.append)
    embed.show(path)
    output = capsys.readouterr().out
    assert output.startswith(
        "Nobody is there to show the viewer to: here is how the run ended."
    )
    assert "`rerun both.rrd`" in output
    assert output.count("\n") == 1
    (figure,) = shown
    figure.savefig(content := io.BytesIO(), format="png")
    content.seek(0)
    picture = matplotlib.image.imread(content)
    assert picture.shape[:2] == (720, 1300)
    assert len(np.unique(picture.reshape(-1, picture.shape[-1]), axis=0)) > 500


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is always a screen")
def test_without_a_screen_the_native_viewer_gives_way_to_a_picture(
    path, nobody, capsys, monkeypatch
):
    shown = []
    monkeypatch.setattr(embed, "_display", shown.append)
    monkeypatch.setattr(viewer, "VIEWER_PORT", 9877)
    embed.show(path, native=True)
    assert capsys.readouterr().out.startswith(
        "The native viewer needs a screen, and there is none: here is"
    )
    assert len(shown) == 1


def test_the_picture_has_a_row_per_run_on_one_scale(path):
    figure = embed.picture_of(el.read_recording(path))
    titles = [axes.get_title() for axes in figure.axes]
    assert "facing, iteration 0" in titles
    assert "gauss newton, iteration 3" in titles
    limits = [
        axes.images[0].get_clim() for axes in figure.axes if "iteration" in axes.get_title()
    ]
    assert limits[0] == limits[1]


def test_a_closed_recorder_can_be_shown(tmp_path, path, nobody, monkeypatch):
    monkeypatch.setattr(embed, "_display", lambda figure: None)
    recorder = el.record(tmp_path / "run.rrd")
    with pytest.raises(FileNotFoundError, match="there is no recording"):
        embed.show(recorder)  # nothing was written yet
    recorder.close()
    (tmp_path / "run.rrd").write_bytes(path.read_bytes())
    embed.show(recorder)


def test_the_viewer_comes_from_this_machine(path, monkeypatch):
    """With a front end, a widget with the recording is displayed whose program is served locally."""
    code = f"""
import IPython.display
from endolab.workbench.recording import show as embed
shown = []
IPython.display.display = shown.append
embed.front_end = lambda: True
embed.show({str(path)!r}, height=300)
widget, hint = shown[0].children
assert "localhost" in str(type(widget)._esm) or "localhost" in str(widget._esm), widget._esm
assert widget._height == 300
(event, buffers), = widget._event_queue
assert event == {{"type": "rrd"}} and buffers == [open({str(path)!r}, "rb").read()]
assert "WebGL" in hint.value
"""
    monkeypatch.delenv("RERUN_NOTEBOOK_ASSET", raising=False)
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
