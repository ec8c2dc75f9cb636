"""A surface to turn with the mouse: a grid of points, its picture on it, drawn by the page itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import anywidget
import numpy as np
import traitlets as t

from endolab.io.images import as_png
from endolab.numerics.checks import excerpt, real_array
from endolab.solvers.result import Iterate, Result
from endolab.workbench.plots.scales import brighten, in_colour
from endolab.workbench.tuning.maps import rgba, still_of

HERE = Path(__file__)


def page_script(name: str) -> str:
    """Return what a page runs: the drawing, and one of the scripts on top of it."""
    parts = (
        HERE.with_name(part).read_text(encoding="utf-8") for part in ("board.js", name)
    )
    return "".join(parts)


class SurfaceView(anywidget.AnyWidget):
    """The widget that `show_surface` makes."""

    _esm = page_script("surface_view.js")
    facts: t.Dict[str, Any] = t.Dict().tag(sync=True)
    rays = t.Bytes().tag(sync=True)
    cuts = t.Bytes().tag(sync=True)
    picture = t.Bytes().tag(sync=True)
    far = t.Bytes().tag(sync=True)

    def show(self, shown: Result | Iterate, picture: np.ndarray | None = None) -> None:
        """Show a surface, from where the last one was seen; see `show_surface`."""
        if not isinstance(shown, Result | Iterate):
            raise ValueError(f"a result or an iterate can be shown, got {excerpt(shown)}")
        shape = shown.mask.shape
        if picture is None:
            colours = brighten(shown.problem.shown)
        else:
            if np.asarray(picture).dtype == np.uint8:
                picture = picture / 255
            colours = real_array("picture", picture)
            if colours.shape not in (shape, (*shape, 3)):
                wanted = f"{shape} or {(*shape, 3)}"
                raise ValueError(f"picture must have shape {wanted}, found {colours.shape}")
        self._last = shown
        self._colours = in_colour(colours)
        facts, arrays = still_of(shown.problem, None)
        with self.hold_sync():  # one message
            self.facts = facts
            self.rays = arrays["rays"].astype("f4").tobytes()
            self.cuts = arrays["cuts"].tobytes()
            self.picture = rgba(colours).tobytes()
            self.far = np.where(shown.mask, shown.distance, np.nan).astype("f4").tobytes()

    def _repr_mimebundle_(self, **options: Any) -> Any:
        """Give a still beside the widget where nobody looks: a page will be made of it, or nothing."""
        from endolab.workbench.recording.show import front_end

        bundle = super()._repr_mimebundle_(**options)
        if bundle is not None and self.far and not front_end():
            bundle[0]["image/png"] = self.draw_still()
        return bundle

    def draw_still(self) -> bytes:
        """Draw what is shown as a picture, PNG."""
        from matplotlib.figure import Figure

        from endolab.workbench.plots.surface_view import show_cloud

        figure = Figure(figsize=(6.4, 4.4), layout="constrained")
        axes = figure.subplots()
        unit = self._last.problem.unit
        show_cloud(self._last.points, self._colours, axes, unit=unit, title="", lift=False)
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
    view = SurfaceView()
    view.show(shown, picture)
    return view
