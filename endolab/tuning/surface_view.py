"""A surface to turn with the mouse: a grid of points, its picture on it, drawn by the page itself.

The kernel sends what has changed, as bytes; no request leaves the page. The pose belongs to who turns: a
new surface is seen from where the last one was.
"""

from __future__ import annotations

import io
import threading
import time
from pathlib import Path
from typing import Any

import anywidget
import cv2
import numpy as np
import traitlets as t

from endolab.depth.result import Iterate, Result
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checks import told
from endolab.numerics.derivatives import links
from endolab.reconstruction.mesh import joined_triangles
from endolab.tuning.pictures import jpeg
from endolab.tuning.surface_grid import Shown, box_of, grid_of, keeps, thinned, thinned_links

HEIGHT = 360  # of the panel, px
START = (35.0, 20.0, 1.0, 0.0, 0.0)  # pose: degrees to the left and up, zoom, shifted right and down (panels)
PATIENCE = 0.5  # s; then the next surface is sent though the page has not said that the last is drawn


STYLE = """
.endolab-surface { position: relative; overflow: hidden; color: var(--jp-content-font-color1, #222); }
.endolab-surface canvas { width: 100%; height: 100%; display: block; cursor: grab; touch-action: none; }
.endolab-surface canvas:active { cursor: grabbing; }
.endolab-surface canvas:not(:focus-visible) { outline: none; }
.endolab-surface div, .endolab-surface span { position: absolute; pointer-events: none; white-space: nowrap; }
.endolab-surface span { transform: translate(-50%, -50%); }
.endolab-surface .endolab-size { left: 4px; bottom: 0; }
.endolab-surface .endolab-help { left: 4px; top: 0; }
.endolab-surface:not(:hover) .endolab-help { display: none; }
"""


class SurfaceView(anywidget.AnyWidget):
    """A surface with a picture on it, that is turned with the mouse; `show` shows another one.

    Parameters
    ----------
    height : int
        Of the panel, px; it is as wide as there is room.
    """

    _esm, _css = Path(__file__).with_suffix(".js"), STYLE
    height = t.Int(HEIGHT).tag(sync=True)
    # For each point its ray and its place in the picture, 5 float32; its distance, float32; three uint32
    # points for each triangle; a JPEG. All of them belong to the surface of that number.
    grid = t.Bytes().tag(sync=True)
    far = t.Bytes().tag(sync=True)
    triangles = t.Bytes().tag(sync=True)
    picture = t.Bytes().tag(sync=True)
    box: t.List[float] = t.List().tag(sync=True)
    unit = t.Unicode().tag(sync=True)
    number = t.Int().tag(sync=True)
    # What the page says: which surface it has drawn, whether anybody sees it, where who looks has turned it.
    drawn = t.Int().tag(sync=True)
    visible = t.Bool(True).tag(sync=True)
    pose: t.List[float] = t.List([*START]).tag(sync=True)
    start: t.List[float] = t.List([*START]).tag(sync=True)

    def __init__(self, height: int = HEIGHT) -> None:
        self._showing = threading.RLock()
        self._last: Shown | None = None  # what was given last
        self._waits = False  # it has not been sent
        self._joined = np.zeros((2, 0, 0), dtype=bool)  # what the triangles were made of
        self._sent = 0.0
        super().__init__(height=height)
        self.observe(lambda _: self._flush(), ["drawn", "visible"])

    def show(
        self,
        distance: FloatArray,
        rays: FloatArray,
        picture: np.ndarray,
        *,
        cuts: BoolArray | None = None,
        unit: str = "mm",
        lift: bool = False,
    ) -> None:
        """Show a surface, from where the last one was seen.

        Returns at once. What nobody sees is not sent before it is seen, nor what comes faster than the page
        can draw: then the latest is next.

        Parameters
        ----------
        distance : (H, W) float array
            From the optical centre along the rays, in `unit`; nan where unknown.
        rays : (H, W, 3) float array
            Unit vectors in the camera frame.
        picture : (h, w, 3) or (h, w) array
            What lies on the surface: bytes, or numbers in [0, 1]; larger or smaller than the surface, but of
            its proportions.
        cuts : (2, H, W) bool array, optional
            Steps to the right and lower neighbour over which the surface is torn.
        unit : str
        lift : bool
            Make the dark of the picture brighter, as suits a frame; not a map, whose colours have a meaning.

        Raises
        ------
        ValueError
            In one sentence, if arrays do not fit.
        """
        with self._showing:
            self._last, self._waits = Shown(distance, rays, picture, cuts, unit, lift), True
            self._flush()

    def _flush(self) -> None:
        """Send what was given last, if someone sees it and has drawn the one before."""
        with self._showing:
            busy = self.number != self.drawn and time.monotonic() < self._sent + PATIENCE
            last = self._last
            if last is None or not self._waits or not self.visible or busy or self.comm is None:
                return
            self._waits = False
            rows, columns = thinned(last.distance.shape)
            joined = thinned_links(links(last.known, last.cuts), rows, columns)
            every = np.ix_(rows, columns)
            seen, far = last.known[every], np.where(last.known, last.distance, 0)[every]
            box = box_of((last.rays[every] * far[..., None])[seen]) if seen.any() else [0.0] * 3 + [1.0] * 3
            with self.hold_sync():  # which sends what differs, in one message
                self.grid = grid_of(last.rays, rows, columns)
                if not np.array_equal(joined, self._joined):
                    self.triangles = joined_triangles(far, joined).astype(np.uint32).tobytes()
                    self._joined = joined
                if last.unit != self.unit or not keeps(self.box, box):
                    self.box, self.unit = box, last.unit
                self.far = far.astype(np.float32).tobytes()
                self.picture = jpeg(last.texture)
                self.number += 1
            self._sent = time.monotonic()

    def set_state(self, sync_data: dict[str, Any]) -> None:
        """Hear what the page says, not while a surface is being sent: one could go in two halves."""
        with self._showing:
            super().set_state(sync_data)

    def close(self) -> None:
        """Close the widget; the page and the kernel forget the surface."""
        with self._showing:
            self._last, self._waits = None, False
            with self.hold_sync():  # the page keeps the model of a closed widget …
                self.grid = self.far = self.triangles = self.picture = b""
            self.number = 0  # … and what was true before its last change
            super().close()

    def _repr_mimebundle_(self, **options: Any) -> Any:
        """Give a still beside the widget where nobody looks: a page will be made of it, or nothing."""
        from endolab.recording.viewer import front_end

        bundle = super()._repr_mimebundle_(**options)
        if bundle is not None and self._last is not None and not front_end():
            bundle[0]["image/png"] = self.still()
        return bundle

    def still(self) -> bytes:
        """Draw what was shown last as a picture, from where it is seen first; PNG."""
        from matplotlib.figure import Figure

        from endolab.plots.surface_view import show_cloud

        last = self._last
        if last is None:
            raise ValueError("there is no surface yet: call show")
        every = np.ix_(*thinned(last.distance.shape))
        distance = np.where(last.known, last.distance, np.nan)[every]
        picture = cv2.resize(last.texture, distance.shape[::-1], interpolation=cv2.INTER_AREA)
        figure = Figure(figsize=(6.4, 4.4), layout="constrained")
        show_cloud(
            last.rays[every] * distance[..., None],
            picture / 255,
            figure.subplots(),
            angle=START[0],
            elevation=START[1],
            unit=last.unit,
            title="",
            lift=False,
        )
        content = io.BytesIO()
        figure.savefig(content, format="png", dpi=100)
        return content.getvalue()


def show_surface(shown: Result | Iterate, picture: np.ndarray | None = None) -> SurfaceView:
    """Show a surface in a notebook, to be turned with the mouse.

    For the last line of a cell. Where nobody looks, as when a page is made of the notebook, it is a picture.

    Parameters
    ----------
    shown : Result or Iterate
    picture : (h, w, 3) or (h, w) array, optional
        What lies on it: bytes, or numbers in [0, 1]; by default the frame.

    Raises
    ------
    ValueError
        In one sentence, if these are something else, or the picture has other proportions.
    """
    if not isinstance(shown, Result | Iterate):
        raise ValueError(f"a result or an iterate can be shown, got {told(shown)}")
    problem, view = shown.problem, SurfaceView()
    view.show(
        shown.distance,
        problem.field.rays,
        problem.shown if picture is None else picture,
        cuts=problem.cuts,
        unit=problem.unit,
        lift=picture is None,
    )
    return view
