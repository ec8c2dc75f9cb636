"""A surface to turn with the mouse: a grid of points, its picture on it, drawn by the page itself.

The kernel sends what has changed, as bytes; no request leaves the page. The pose belongs to who turns: a
new surface is seen from where the last one was.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import anywidget
import numpy as np
import traitlets as t
from skimage.measure import block_reduce

from endolab.io.images import as_png
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import excerpt, real_array
from endolab.numerics.stencils import links
from endolab.reconstruction.mesh import join_triangles
from endolab.solvers.problem import Problem
from endolab.solvers.result import Iterate, Result
from endolab.workbench.plots.scales import brighten
from endolab.workbench.tuning.pictures import Picture, grey_or_colour, jpeg, remember


@dataclass(frozen=True)
class Panel3D:
    """What a panel shows of a surface, chosen by what a screen can show and a browser draws at once."""

    # s; then the next surface is sent though the page has not said that the last is drawn.
    answer_timeout: float = 0.5
    most: int = 320  # points in a row or a column, ...
    most_moving: int = 160  # ... and of surfaces that follow one another quickly
    # Of such surfaces: how often as long as the page took for the last one, before the next is sent. A page
    # that draws without a graphics card would have no time for anything else.
    pause: float = 2.0
    # % of the points lie beyond each face of the box: spikes must not make the rest small.
    outlying: float = 1.0
    # The box stays if the new one's faces are off by less than this share of its size.
    box_margin: float = 0.1


PANEL = Panel3D()


@remember
def _bright_colours(frame: FloatArray) -> Picture:
    """A frame as it lies on a surface."""
    return grey_or_colour(brighten(frame))


_jpeg = remember(jpeg)


class SurfaceView(anywidget.AnyWidget):
    """A surface with a picture on it, that is turned with the mouse; `show` shows another one."""

    _esm = Path(__file__).with_suffix(".js")
    _css = Path(__file__).with_suffix(".css")
    # For each point, row by row, its ray, three float32, and its distance, float32; three uint32 points for
    # each triangle; a JPEG. All of them belong to the surface of that number.
    columns = t.Int().tag(sync=True)
    rays = t.Bytes().tag(sync=True)
    far = t.Bytes().tag(sync=True)
    triangles = t.Bytes().tag(sync=True)
    picture = t.Bytes().tag(sync=True)
    box: t.List[float] = t.List().tag(sync=True)
    unit = t.Unicode().tag(sync=True)
    number = t.Int().tag(sync=True)
    # What the page says: which surface it has drawn, whether anybody sees it, where who looks has turned it,
    # unless it is as at first.
    drawn = t.Int().tag(sync=True)
    visible = t.Bool(True).tag(sync=True)
    pose: t.List[float] = t.List().tag(sync=True)
    marker: t.List[float] = t.List().tag(
        sync=True
    )  # a point that is pointed at, x, y, z, or nothing

    def __init__(self) -> None:
        self._showing = threading.RLock()
        self._last: Result | Iterate | None = None  # what was given last, ...
        self._picture: Picture  # ... and what lies on it
        self._most = PANEL.most
        self._joined: list[Any] = []  # what the triangles that were sent last are of
        self._waits = False  # it has not been sent
        self._sent = 0.0
        self._took = 0.0  # s, the page for the last one
        self._later: threading.Timer | None = None
        super().__init__()
        self.observe(self._hear, "drawn")
        self.observe(lambda _: self._flush(), "visible")

    def show(
        self,
        shown: Result | Iterate,
        picture: np.ndarray | None = None,
        moving: bool = False,
    ) -> None:
        """Show a surface, from where the last one was seen.

        Returns at once. What nobody sees is not sent before it is seen, nor what comes faster than the page
        can draw: then the latest is next.

        Parameters
        ----------
        shown : Result or Iterate
        picture : (H, W, 3) or (H, W) array, optional
            What lies on the surface, pixel by pixel: bytes, or numbers in [0, 1]; by default the frame, with
            its dark made brighter.
        moving : bool
            Whether others follow at once: then fewer points are sent.

        Raises
        ------
        ValueError
            In one sentence, if these are something else.
        """
        if not isinstance(shown, Result | Iterate):
            raise ValueError(f"a result or an iterate can be shown, got {excerpt(shown)}")
        if picture is None:
            colours = _bright_colours(shown.problem.shown)
        else:
            if np.asarray(picture).dtype == np.uint8:
                picture = picture / 255
            given = real_array("picture", picture)
            shape = shown.mask.shape
            if given.shape not in (shape, (*shape, 3)):
                found = f"found {given.shape}"
                raise ValueError(
                    f"picture must have shape {shape} or {(*shape, 3)}, {found}"
                )
            colours = grey_or_colour(given)
        with self._showing:
            self._last = shown
            self._most = PANEL.most_moving if moving else PANEL.most
            self._picture = colours
            self._waits = True
            self._flush()

    def _hear(self, change: dict[str, Any]) -> None:
        """Hear that the page has drawn a surface; one that nobody looked at may take minutes."""
        with self._showing:
            if change["new"] == self.number:
                took = time.monotonic() - self._sent
                self._took = min(took, PANEL.answer_timeout)
            self._flush()

    def _flush_in(self, seconds: float) -> None:
        """Send later what was given last, unless that is about to happen anyway."""
        if self._later is not None:
            return

        def flush() -> None:
            self._later = None
            self._flush()

        self._later = threading.Timer(seconds, flush)
        self._later.daemon = True
        self._later.start()

    @property
    def _follows(self) -> bool:
        """Whether what is to be shown is one of many."""
        return self._most == PANEL.most_moving

    def _flush(self) -> None:
        """Send what was given last, if someone sees it and has drawn the one before."""
        with self._showing:
            passed = time.monotonic() - self._sent
            free = self.number == self.drawn or passed > PANEL.answer_timeout
            pause = PANEL.pause * self._took - passed
            if self._waits and self._follows and pause > 0:
                self._flush_in(pause)
                return
            shown = self._last
            if not (self._waits and self.visible and free and shown and self.comm):
                return
            self._waits = False
            step = -(-max(shown.mask.shape) // self._most)
            some = np.s_[::step, ::step]
            far = np.where(shown.mask, shown.distance, 0)[some]
            rays = np.nan_to_num(shown.problem.field.rays[some])
            points = (rays * far[..., None])[far > 0]
            unit = shown.problem.unit
            with self.hold_sync():  # which sends what differs, in one message
                self._send_grid(shown.problem, step, rays, far)
                box = box_of(points)
                if unit != self.unit or not fits_box(self.box, box):
                    self.box = box
                self.unit = unit
                self.far = far.astype(np.float32).tobytes()
                self.picture = _jpeg(self._picture)
                self.number += 1
            self._sent = time.monotonic()

    def _send_grid(
        self, problem: Problem, step: int, rays: FloatArray, far: FloatArray
    ) -> None:
        """Send rays and triangles, unless those of the surface before will do."""
        grid = [problem.mask, problem.cuts, problem.field, step]
        is_known = all(a is b for a, b in zip(grid, self._joined, strict=False))
        if self._follows and self._joined and is_known:
            return
        self._joined = grid
        # A step is cut if one is on its way, or beside it.
        cuts = problem.cuts
        cuts = cuts if cuts is None else block_reduce(cuts, (1, step, step), np.max)
        joined = links(problem.mask[::step, ::step], cuts)
        self.columns = far.shape[1]
        self.rays = rays.astype(np.float32).tobytes()
        self.triangles = join_triangles(far, joined).astype(np.uint32).tobytes()

    def set_state(self, sync_data: dict[str, Any]) -> None:
        """Hear what the page says, not while a surface is being sent: one could go in two halves."""
        with self._showing:
            super().set_state(sync_data)

    def close(self) -> None:
        """Close the widget; the page and the kernel forget the surface."""
        with self._showing:
            self._last = None
            self._joined = []
            self._waits = False
            with self.hold_sync():  # the page keeps the model of a closed widget …
                self.rays = self.far = self.triangles = self.picture = b""
            self.number = 0  # … and what was true before its last change
            super().close()

    def _repr_mimebundle_(self, **options: Any) -> Any:
        """Give a still beside the widget where nobody looks: a page will be made of it, or nothing."""
        from endolab.workbench.recording.viewer import front_end

        bundle = super()._repr_mimebundle_(**options)
        if bundle is not None and self._last is not None and not front_end():
            bundle[0]["image/png"] = self.draw_still()
        return bundle

    def draw_still(self) -> bytes:
        """Draw what was shown last as a picture, PNG."""
        from matplotlib.figure import Figure

        from endolab.workbench.plots.surface_view import show_cloud

        if self._last is None:
            raise ValueError("there is no surface yet: call show")
        figure = Figure(figsize=(6.4, 4.4), layout="constrained")
        show_cloud(
            self._last.points,
            self._picture / 255,
            figure.subplots(),
            unit=self._last.problem.unit,
            title="",
            lift=False,
        )
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


def box_of(points: FloatArray) -> list[float]:
    """Least and greatest x, y, z of points (n, 3), but for a few that lie far out."""
    ends = np.percentile(points, [PANEL.outlying, 100 - PANEL.outlying], axis=0)
    box: list[float] = ends.ravel().tolist()
    return box


def fits_box(box: list[float], new: list[float]) -> bool:
    """Whether another surface can be seen in the box of the one before."""
    off = np.abs(np.subtract(box, new)).max() if box else np.inf
    return bool(off < PANEL.box_margin * np.ptp(new))
