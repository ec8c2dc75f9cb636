"""Recordings on screen: the Rerun viewer below a notebook's cell.

The viewer in the notebook is a web page that needs WebGL. Its program is served by this machine,
so it needs no network.
"""

import contextlib
import io
import os
import sys

from endolab.io.atomic import PathLike
from endolab.numerics.checks import check_int
from endolab.workbench.recording.reader import read_recording
from endolab.workbench.recording.recorder import Recorder


def show(recording: PathLike | Recorder, *, height: int = 640) -> None:
    """Show a recording below the cell.

    Where nobody looks, as when a page is made of the notebook, a sentence says how to open it.

    Parameters
    ----------
    recording : path, or closed Recorder
        The ``.rrd`` file.
    height : int
        Of the viewer below the cell, px.

    Raises
    ------
    FileNotFoundError, ValueError
        In one sentence, if there is no such recording or it cannot be read.
    """
    check_int("height", height, 100)
    kept = read_recording(recording.path if isinstance(recording, Recorder) else recording)
    # Told to kernels by those who show what they say: Jupyter's server, VS Code, Colab.
    seen = any(map(os.environ.get, ("JPY_SESSION_NAME", "VSCODE_PID", "COLAB_RELEASE_TAG")))
    if not (seen and "ipykernel" in sys.modules):
        print(f"`rerun {kept.path.name}` opens the recording.")
        return
    from IPython.display import display
    from ipywidgets import HTML, VBox

    os.environ.setdefault("RERUN_NOTEBOOK_ASSET", "serve-local")
    with contextlib.redirect_stdout(io.StringIO()):  # it tells of every step
        from rerun_notebook import Viewer  # type: ignore[import-untyped]
    viewer = Viewer(width="auto", height=height)
    viewer.send_rrd(kept.path.read_bytes())  # waits until the page is ready
    needs = "The viewer needs a browser with WebGL 2, and a kernel on this machine"
    other = f"<code>rerun {kept.path.name}</code> opens it outside"
    hint = HTML(f"<small>Empty? {needs}; {other}.</small>")
    display(VBox([viewer, hint]))
