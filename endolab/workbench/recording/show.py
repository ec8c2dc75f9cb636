"""Recordings on screen: the Rerun viewer below a notebook's cell, or else a picture.

The viewer in the notebook is a web page that needs WebGL. Its program is served by this machine,
so it needs no network.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from endolab.io.atomic import PathLike
from endolab.io.images import as_png
from endolab.numerics.checks import check_int
from endolab.workbench.recording.reader import Recording, read_recording
from endolab.workbench.recording.viewer import front_end, notebook_viewer

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from endolab.workbench.recording.recorder import Recorder


def show(recording: PathLike | Recorder, *, height: int = 640) -> None:
    """Show a recording below the cell.

    Where nobody looks there is a picture of the run's end instead, and a sentence that says why.

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
    path = recording if isinstance(recording, str | os.PathLike) else recording.path
    check_int("height", height, 100)
    kept = read_recording(path)
    if front_end():
        _embed(kept.path, height)
        return
    why = "Nobody is there to show the viewer to"
    opens = f"`rerun {kept.path.name}` opens the recording"
    print(f"{why}. Elsewhere, {opens}; it ended like this.")
    if "ipykernel" in sys.modules and kept.runs:
        from IPython.display import Image, display

        display(Image(as_png(picture_of(kept))))


def _embed(path: Path, height: int) -> None:
    from IPython.display import display
    from ipywidgets import HTML, VBox

    viewer = notebook_viewer().Viewer(width="auto", height=height)
    viewer.send_rrd(path.read_bytes())  # waits until the page is ready
    needs = "The viewer needs a browser with WebGL 2, and a kernel on this machine"
    other = f"<code>rerun {path.name}</code> opens it outside"
    hint = HTML(f"<small>Empty? {needs}; {other}.</small>")
    display(VBox([viewer, hint]))


def picture_of(recording: Recording) -> Figure:
    """Draw how a recording's runs ended; a row for each: distance, normals, and the way of its energy."""
    from endolab.workbench import plots

    runs = recording.runs
    limits = plots.common_limits([run.depth() for run in runs.values()])
    with plots.style.page(16, 4.6 * len(runs)) as figure:
        rows = figure.subplots(len(runs), 3, squeeze=False)
        for (depth, facing, energy), (name, run) in zip(rows, runs.items(), strict=True):
            words = name.replace("_", " ") or "Distance"
            title = f"{words}, iteration {run.pictured[-1]}"
            plots.show_depth(run.depth(), depth, unit=run.unit, limits=limits, title=title)
            plots.show_normals(run.normals(), facing)
            plots.show_history(run.history, energy)
    return figure
