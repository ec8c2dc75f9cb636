"""A surface to turn with the mouse: a grid of points, its picture on it, drawn by the page itself.

The kernel sends what has changed, as bytes; no request leaves the page. The pose belongs to who turns: a
new surface is seen from where the last one was.
"""

from __future__ import annotations

import io
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import anywidget
import cv2
import numpy as np
import traitlets as t

from endolab.numerics.arrays import BoolArray, FloatArray, IndexArray
from endolab.numerics.checks import excerpt
from endolab.numerics.derivatives import links
from endolab.reconstruction.mesh import join_triangles
from endolab.solvers.result import Iterate, Result
from endolab.workbench.plots.scales import brighten
from endolab.workbench.tuning.pictures import Picture, grey_or_colour, jpeg


@dataclass(frozen=True)
class Panel3D:
    """What a panel shows of a surface, chosen by what a screen can show and a browser draws at once."""

    height: int = 360  # px
    # Pose at first: degrees to the left and up, zoom, shifted right and down (panels).
    start: tuple[float, ...] = (35.0, 20.0, 1.0, 0.0, 0.0)
    # s; then the next surface is sent though the page has not said that the last is drawn.
    answer_timeout: float = 0.5
    columns: int = 320  # of points, at most
    rows: int = 240
    texture_columns: int = 640  # of the picture on it, px, at most
    # % of the points lie beyond each face of the box: spikes must not make the rest small.
    outlying: float = 1.0
    # The box stays if the new one's faces are off by less than this share of its diagonal.
    box_margin: float = 0.1


PANEL = Panel3D()
Given = tuple[FloatArray, FloatArray, np.ndarray, BoolArray | None, str, bool]


class SurfaceView(anywidget.AnyWidget):
    """A surface with a picture on it, that is turned with the mouse; `show` shows another one.

    Parameters
    ----------
    height : int
        Of the panel, px, or 0 for as high as there is room; it is as wide as there is room.
    """

    _esm = Path(__file__).with_suffix(".js")
    _css = Path(__file__).with_suffix(".css")
    height = t.Int(PANEL.height).tag(sync=True)
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
    pose: t.List[float] = t.List([*PANEL.start]).tag(sync=True)
    start: t.List[float] = t.List([*PANEL.start]).tag(sync=True)

    def __init__(self, height: int = PANEL.height) -> None:
        self._showing = threading.RLock()
        self._last: Given | None = None  # what was given last
        self._waits = False  # it has not been sent
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
            Steps to the right and lower neighbour over which the surface is cut.
        unit : str
        lift : bool
            Make the dark of the picture brighter, as suits a frame; not a map, whose colours have a meaning.

        Raises
        ------
        ValueError
            If the picture has other proportions than the surface.
        """
        (height, width), (tall, wide) = distance.shape, picture.shape[:2]
        if abs(tall * width - wide * height) > max(
            height, width, tall, wide
        ):  # shrunk to whole pixels
            raise ValueError(
                f"picture of {wide}x{tall} px has not the proportions of {width}x{height} px"
            )
        with self._showing:
            self._last = (distance, rays, picture, cuts, unit, lift)
            self._waits = True
            self._flush()

    def _flush(self) -> None:
        """Send what was given last, if someone sees it and has drawn the one before."""
        with self._showing:
            busy = (
                self.number != self.drawn
                and time.monotonic() < self._sent + PANEL.answer_timeout
            )
            if (
                self._last is None
                or not self._waits
                or not self.visible
                or busy
                or self.comm is None
            ):
                return
            self._waits = False
            distance, rays, picture, cuts, unit, lift = self._last
            known = np.isfinite(distance) & (distance > 0)
            rows, columns = thin_indices(distance.shape)
            joined = thin_links(links(known, cuts), rows, columns)
            every = np.ix_(rows, columns)
            far = np.where(known, distance, 0)[every]
            points = (rays[every] * far[..., None])[known[every]]
            with self.hold_sync():  # which sends what differs, in one message
                self.grid = grid_of(rays, rows, columns)
                self.triangles = join_triangles(far, joined).astype(np.uint32).tobytes()
                box = box_of(points) if len(points) else [0.0] * 3 + [1.0] * 3
                if unit != self.unit or not fits_box(self.box, box):
                    self.box = box
                    self.unit = unit
                self.far = far.astype(np.float32).tobytes()
                self.picture = jpeg(as_texture(picture, lift))
                self.number += 1
            self._sent = time.monotonic()

    def set_state(self, sync_data: dict[str, Any]) -> None:
        """Hear what the page says, not while a surface is being sent: one could go in two halves."""
        with self._showing:
            super().set_state(sync_data)

    def close(self) -> None:
        """Close the widget; the page and the kernel forget the surface."""
        with self._showing:
            self._last = None
            self._waits = False
            with self.hold_sync():  # the page keeps the model of a closed widget …
                self.grid = self.far = self.triangles = self.picture = b""
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
        """Draw what was shown last as a picture, from where it is seen first; PNG."""
        from matplotlib.figure import Figure

        from endolab.workbench.plots.surface_view import show_cloud

        if self._last is None:
            raise ValueError("there is no surface yet: call show")
        distance, rays, picture, _, unit, lift = self._last
        every = np.ix_(*thin_indices(distance.shape))
        points = rays[every] * np.where(distance > 0, distance, np.nan)[every][..., None]
        colours = (
            cv2.resize(
                as_texture(picture, lift), points.shape[1::-1], interpolation=cv2.INTER_AREA
            )
            / 255
        )
        figure = Figure(figsize=(6.4, 4.4), layout="constrained")
        options: dict[str, Any] = {
            "angle": PANEL.start[0],
            "elevation": PANEL.start[1],
            "title": "",
            "lift": False,
        }
        show_cloud(points, colours, figure.subplots(), unit=unit, **options)
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

    Returns
    -------
    SurfaceView
        The widget, which is shown already.

    Raises
    ------
    ValueError
        In one sentence, if these are something else, or the picture has other proportions.
    """
    if not isinstance(shown, Result | Iterate):
        raise ValueError(f"a result or an iterate can be shown, got {excerpt(shown)}")
    shape = np.shape(shown.problem.shown if picture is None else picture)
    if len(shape) not in (2, 3) or shape[2:] not in ((), (3,)):
        raise ValueError(f"picture must have shape (h, w, 3) or (h, w), found {shape}")
    view = SurfaceView()
    show_on(
        view, shown, shown.problem.shown if picture is None else picture, picture is None
    )
    return view


def show_on(
    view: SurfaceView, shown: Result | Iterate, picture: np.ndarray, lift: bool
) -> None:
    """Show a result, with a picture on it, in a view that is there."""
    known = shown.problem
    view.show(
        shown.distance,
        known.field.rays,
        picture,
        cuts=known.cuts,
        unit=known.unit,
        lift=lift,
    )


def as_texture(picture: np.ndarray, lift: bool) -> Picture:
    """A picture as it is seen, (h, w, 3)."""
    less = PANEL.texture_columns / picture.shape[1]
    if less < 1:
        picture = cv2.resize(picture, None, fx=less, fy=less, interpolation=cv2.INTER_AREA)
    if picture.dtype == np.uint8:
        picture = picture / 255
    return grey_or_colour(brighten(picture) if lift else picture)


def thin_indices(shape: tuple[int, ...]) -> tuple[IndexArray, IndexArray]:
    """Rows and columns of a picture of that shape that have a point: evenly, the outermost ones too."""
    less = max(1.0, shape[0] / PANEL.rows, shape[1] / PANEL.columns)
    first, second = (
        np.linspace(0, n - 1, max(1, int(n / less))).round().astype(np.int32) for n in shape
    )
    return first, second


def thin_links(joined: BoolArray, rows: IndexArray, columns: IndexArray) -> BoolArray:
    """Steps between the points that are left, (2, h, w): those on whose way no step is missing."""
    right = np.logical_and.reduceat(joined[0][rows], columns, axis=1)
    below = np.logical_and.reduceat(joined[1][:, columns], rows, axis=0)
    right[:, -1] = False
    below[-1] = False
    return np.stack([right, below])


def grid_of(rays: FloatArray, rows: IndexArray, columns: IndexArray) -> bytes:
    """Of each point its ray, and its place in the picture, to the right and down, in [0, 1]."""
    grid = np.empty((len(rows), len(columns), 5), np.float32)
    grid[..., :3] = np.nan_to_num(rays[np.ix_(rows, columns)])
    grid[..., 3] = (columns + 0.5) / rays.shape[1]
    grid[..., 4] = ((rows + 0.5) / rays.shape[0])[:, None]
    return grid.tobytes()


def box_of(points: FloatArray) -> list[float]:
    """Least and greatest x, y, z of points (n, 3), but for a few that lie far out."""
    return [
        float(value)
        for value in np.percentile(
            points, [PANEL.outlying, 100 - PANEL.outlying], axis=0
        ).ravel()
    ]


def fits_box(box: list[float], new: list[float]) -> bool:
    """Whether another surface can be seen in the box of the one before."""
    size = np.linalg.norm(np.subtract(new[3:], new[:3]))
    return bool(box) and bool(np.abs(np.subtract(box, new)).max() < PANEL.box_margin * size)
