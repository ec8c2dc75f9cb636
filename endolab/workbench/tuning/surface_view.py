"""A surface to turn with the mouse: a grid of points, its picture on it, drawn by the page itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import anywidget
import numpy as np
import traitlets as t

from endolab.io.images import as_png
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import excerpt, real_array
from endolab.solvers.result import Iterate, Result
from endolab.workbench.plots.scales import brighten, in_colour
from endolab.workbench.tuning.maps import as_buffers, rgba, still_of

HERE = Path(__file__)


def page_script(name: str) -> str:
    """Return what a page runs: the drawing, and one of the scripts on top of it."""
    parts = (
        HERE.with_name(part).read_text(encoding="utf-8") for part in ("board.js", name)
    )
    return "".join(parts)


class SurfaceView(anywidget.AnyWidget):
    """The widget that `show_surface` makes of a surface and of its colours, (H, W, 3)."""

    _esm = page_script("surface_view.js")
    facts: t.Dict[str, Any] = t.Dict().tag(sync=True)

    def __init__(self, shown: Result | Iterate, colours: FloatArray) -> None:
        self._shown = shown
        self._colours = colours
        facts, arrays = still_of(shown.problem, None)
        arrays |= {"picture": rgba(colours), "far": shown.distance}
        names, buffers = as_buffers(arrays)
        super().__init__(facts=facts | dict(zip(dict(names), buffers, strict=True)))

    def _repr_mimebundle_(self, **options: Any) -> Any:
        """Give a still beside the widget where nobody looks: a page will be made of it, or nothing."""
        from endolab.workbench.recording.viewer import front_end

        bundle = super()._repr_mimebundle_(**options)
        if bundle is not None and not front_end():
            bundle[0]["image/png"] = self.draw_still()
        return bundle

    def draw_still(self) -> bytes:
        """Draw what is shown as a picture, PNG."""
        from matplotlib.figure import Figure

        from endolab.workbench.plots.surface_view import show_cloud

        figure = Figure(figsize=(6.4, 4.4), layout="constrained")
        axes = figure.subplots()
        unit = self._shown.problem.unit
        show_cloud(self._shown.points, self._colours, axes, unit=unit, title="", lift=False)
        return as_png(figure)


def show_surface(shown: Result | Iterate, picture: np.ndarray | None = None) -> SurfaceView:
    """Show a surface in a notebook, to be turned with the mouse.

    For the last line of a cell. Where nobody looks, as when a page is made of the notebook, it is a picture.

    Parameters
    ----------
    shown : Result or Iterate
    picture : (H, W, 3) or (H, W) array, optional
        What lies on it, pixel by pixel: bytes, or numbers in [0, 1]; by default the frame.

    Returns
    -------
    SurfaceView
        The widget, which is shown already.

    Raises
    ------
    ValueError
        In one sentence, if these are something else.
    """
    if not isinstance(shown, Result | Iterate):
        raise ValueError(f"a result or an iterate can be shown, got {excerpt(shown)}")
    shape = shown.mask.shape
    if picture is None:
        return SurfaceView(shown, in_colour(brighten(shown.problem.shown)))
    if np.asarray(picture).dtype == np.uint8:
        picture = picture / 255
    colours = real_array("picture", picture)
    if colours.shape not in (shape, (*shape, 3)):
        wanted = f"{shape} or {(*shape, 3)}"
        raise ValueError(f"picture must have shape {wanted}, found {colours.shape}")
    return SurfaceView(shown, in_colour(colours))
