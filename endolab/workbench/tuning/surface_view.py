"""A surface to turn with the mouse: a grid of points, its picture on it, drawn by the page itself."""

from __future__ import annotations

import json

import numpy as np
from IPython.display import HTML

from endolab.numerics.checks import excerpt, real_array
from endolab.solvers.result import Iterate, Result
from endolab.workbench.plots.scales import brighten
from endolab.workbench.tuning.maps import as_texts, rgba, still_of
from endolab.workbench.tuning.script import page_script

MOST = 240  # rows or columns that are shown
PAGE = """<div class="endolab-surface" style="position: relative; height: 360px; overflow: hidden;
color: var(--jp-content-font-color1, #222)"></div>
<script>(() => {{ {script}
show_surface(document.currentScript.previousElementSibling, {content}); }})();</script>"""


def show_surface(shown: Result | Iterate, picture: np.ndarray | None = None) -> HTML:
    """Show a surface in a notebook, and in a page that is made of it, to be turned with the mouse.

    For the last line of a cell.

    Parameters
    ----------
    shown : Result or Iterate
    picture : (H, W, 3) or (H, W) array, optional
        What lies on it, pixel by pixel: bytes, or numbers in [0, 1]; by default the frame.

    Returns
    -------
    IPython.display.HTML

    Raises
    ------
    ValueError
        In one sentence, if these are something else.
    """
    if not isinstance(shown, Result | Iterate):
        raise ValueError(f"a result or an iterate can be shown, got {excerpt(shown)}")
    problem = shown.problem
    shape = shown.mask.shape
    if picture is None:
        picture = brighten(problem.shown)
    elif np.asarray(picture).dtype == np.uint8:
        picture = picture / 255
    colours = real_array("picture", picture)
    if colours.shape not in (shape, (*shape, 3)):
        wanted = f"{shape} or {(*shape, 3)}"
        raise ValueError(f"picture must have shape {wanted}, found {colours.shape}")
    _, maps = still_of(problem, None)
    rows, columns = (np.arange(0, size, -(-max(shape) // MOST)) for size in shape)
    few = np.ix_(rows, columns)
    maps = {
        "rays": maps["rays"][few],
        "cuts": np.bitwise_or.reduceat(
            np.bitwise_or.reduceat(maps["cuts"], rows, axis=0), columns, axis=1
        ),
        "picture": rgba(colours)[few],
        "far": np.where(shown.mask, shown.distance, np.nan)[few],
    }
    content = {
        "width": columns.size,
        "height": rows.size,
        "unit": problem.unit,
        "maps": as_texts(maps),
    }
    return HTML(
        PAGE.format(script=page_script("surface_view"), content=json.dumps(content))
    )
