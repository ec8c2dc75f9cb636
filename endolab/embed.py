"""Recordings on screen: the Rerun viewer below a notebook's cell, beside it, or else a picture.

The viewer in the notebook is a web page that needs WebGL. Its program is served by this machine,
so it needs no network.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import rerun as rr

from endolab.files import PathLike
from endolab.recordings import Recording, read_recording
from endolab.viewer import start_server, start_viewer

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from endolab.recording import Comparison, Recorder

HEIGHT = 640  # px
# Told to kernels by those who show what they say: Jupyter's server, VS Code, Colab.
FRONT_ENDS = ("JPY_SESSION_NAME", "VSCODE_PID", "COLAB_RELEASE_TAG")


def front_end() -> bool:
    """Whether someone looks at this notebook; a test or a script that runs one shows no widgets."""
    if "ipykernel" not in sys.modules:
        return False
    return any(os.environ.get(name) for name in FRONT_ENDS)


def show(recording: PathLike | Recorder | Comparison, *, native: bool = False, height: int = HEIGHT) -> None:
    """Show a recording: below the cell, or in the native viewer.

    Where neither works there is a picture of the run's end instead, and a sentence that says why.

    Parameters
    ----------
    recording : path, or closed Recorder or Comparison
        The ``.rrd`` file.
    native : bool
        Open the native viewer, beside the notebook.
    height : int
        Of the viewer below the cell, px.

    Raises
    ------
    FileNotFoundError, ValueError
        In one sentence, if there is no such recording or it cannot be read.
    """
    path = recording if isinstance(recording, str | os.PathLike) else recording.path
    if path is None:
        raise ValueError("that run went to a viewer, not to a file: there is nothing to show")
    if height < 100:
        raise ValueError(f"height must be at least 100 px, got {height}")
    kept = read_recording(path)
    if native:
        try:
            start_viewer(kept.path)
            return
        except OSError as error:
            why = str(error)
            why = "The native viewer needs a screen, and there is none" if "screen" in why else why
    elif front_end():
        _embed(kept.path, height)
        return
    else:
        why = "Nobody is there to show the viewer to"
    print(f"{why}: here is how the run ended. Elsewhere, `rerun {kept.path.name}` opens the recording.")
    if kept.runs:
        _display(picture_of(kept))


def _display(figure: Figure) -> None:
    from IPython.display import Image, display

    content = io.BytesIO()
    figure.savefig(content, format="png")
    if "ipykernel" in sys.modules:
        display(Image(content.getvalue()))


def _notebook() -> Any:
    """Rerun's module for notebooks, with its program served by this machine."""
    os.environ.setdefault("RERUN_NOTEBOOK_ASSET", "serve-local")
    with contextlib.redirect_stdout(io.StringIO()):  # it tells of every step
        import rerun_notebook  # type: ignore[import-untyped]
    return rerun_notebook


def _embed(path: Path, height: int) -> None:
    from IPython.display import display
    from ipywidgets import HTML, VBox

    viewer = _notebook().Viewer(width="auto", height=height)
    viewer.send_rrd(path.read_bytes())  # waits until the page is ready
    hint = HTML(
        "<small>Empty? The viewer needs a browser with WebGL 2, and a kernel on this machine; "
        f"<code>show(…, native=True)</code> or <code>rerun {path.name}</code> opens it outside.</small>"
    )
    display(VBox([viewer, hint]))


def follow(stream: rr.RecordingStream, height: int = HEIGHT) -> None:
    """Show a viewer below the cell that follows what is logged to a stream, while the cell runs.

    Raises
    ------
    OSError
        If nobody looks at the notebook, or the server does not start.
    """
    if not front_end():
        raise OSError("a viewer that follows a run needs JupyterLab; record to a file instead")
    from IPython.display import display

    address = start_server()
    stream.connect_grpc(address)
    # The page fetches the run from the server: messages through the kernel, which is busy with the
    # run, would arrive when the cell has ended.
    display(_notebook().Viewer(width="auto", height=height, url=address))


def picture_of(recording: Recording) -> Figure:
    """Draw how a recording's runs ended: distance, normals, and the way of the energy.

    Parameters
    ----------
    recording : Recording

    Returns
    -------
    Figure
        A row per run; not one of pyplot's, so there is nothing to close.
    """
    from matplotlib.figure import Figure

    from endolab import plots

    runs = recording.runs
    if not runs:
        raise ValueError(f"{recording.path} holds no reconstruction")
    figure = Figure(figsize=(13, 3.6 * len(runs)), dpi=100, layout="constrained")
    ends = [run.depth() for run in runs.values()]
    seen = np.concatenate([end[np.isfinite(end)] for end in ends])
    low, high = np.percentile(seen, [1, 99]) if seen.size else (0.0, 1.0)
    axes = figure.subplots(len(runs), 3, squeeze=False)
    for (depth, facing, energy), (name, run), end in zip(axes, runs.items(), ends, strict=True):
        last = f"iteration {run.pictured[-1]}"
        title = f"{name.replace('_', ' ')}, {last}" if name else f"Distance, {last}"
        plots.show_depth(end, depth, unit=run.unit, limits=(float(low), float(high)), title=title)
        plots.show_normals(run.normals(), facing)
        table = run.table()
        terms = [n for n in ("energy", "data", "regulariser") if n in (table.dtype.names or ())]
        history = [{"k": row["iteration"], **{n: row[n] for n in terms}} for row in table]
        plots.show_history(history, energy)
    return figure
