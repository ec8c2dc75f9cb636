"""Figures: a frame, its depth, normals and surface, errors and energies.

Every function but `overview` draws into the axes ``ax`` it is given, or into new ones, under
``title``, and returns the axes. Colours are safe for colour-blind readers, axes carry units, and
what is left out (nan) is neutral grey.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar  # type: ignore[import-untyped]

from endolab.depth.energy import model_image
from endolab.iteration import Iterate, Result
from endolab.operators import FloatArray
from endolab.rays import RayField

LEFT_OUT = (0.72, 0.72, 0.72)
BACKDROP = (0.09, 0.10, 0.12)
# Okabe and Ito's colours; the truth is black, as a reference should be.
LINES = {"truth": "black", "start": "#56B4E9", "estimate": "#D55E00"}
OTHERS = ("#009E73", "#CC79A7", "#E69F00", "#0072B2")
VIEW_WIDTH = 320  # columns of a surface that `show_cloud` draws; more cost time and show no more
JUMP = 1.25  # neighbours whose distances differ by more are not joined
FARTHEST = 8.0  # median distances that the view reaches
LAMP = np.array([-0.35, 0.35, 0.87])  # over the left shoulder of the viewer


def _axes(ax: Axes | None) -> Axes:
    return plt.subplots(layout="constrained")[1] if ax is None else ax


def _draw(picture: FloatArray, ax: Axes | None, title: str, **how: object) -> tuple[Axes, ScalarMappable]:
    """Show a map on pixel axes."""
    ax = _axes(ax)
    ax.set_facecolor(LEFT_OUT)
    shown = ax.imshow(picture, interpolation="nearest", **how)  # type: ignore[arg-type]
    ax.set(title=title, xlabel="column u [px]", ylabel="row v [px]")
    ax.locator_params(nbins=3)
    return ax, shown


def _bar(ax: Axes, shown: ScalarMappable, label: str, extend: str) -> None:
    # An inset is as high as the picture; a bar beside the axes is as high as their slot.
    bar = ax.figure.colorbar(shown, cax=ax.inset_axes((1.03, 0, 0.045, 1)), label=label, extend=extend)
    bar.ax.locator_params(nbins=5)


def _diverging(values: FloatArray, ax: Axes | None, title: str, label: str, limit: float | None) -> Axes:
    """Show signed values, white at 0, with a colour bar."""
    if limit is None:
        seen = np.abs(values[np.isfinite(values)])
        limit = float(np.percentile(seen, 98)) if seen.size else 1.0
    limit = limit if limit > 0 else 1.0
    ax, shown = _draw(values, ax, title, cmap="RdBu_r", vmin=-limit, vmax=limit)
    _bar(ax, shown, label, "both")
    return ax


def show_picture(picture: FloatArray, ax: Axes | None = None, title: str = "Frame") -> Axes:
    """Show a frame.

    Parameters
    ----------
    picture : (H, W) or (H, W, 3) float array
        Stored values in [0, 1]; values outside are clipped.
    """
    return _draw(np.clip(picture, 0, 1), ax, title, cmap="gray", vmin=0, vmax=1)[0]


def show_depth(
    distance: FloatArray,
    ax: Axes | None = None,
    *,
    unit: str = "mm",
    limits: tuple[float, float] | None = None,
    title: str = "Distance",
) -> Axes:
    """Show distances with a colour bar.

    Parameters
    ----------
    distance : (H, W) float array
        In `unit`; nan where unknown.
    unit : str
        Of the distances.
    limits : two floats, optional
        Ends of the colour bar; the 1st and 99th percentile by default.
    """
    seen = distance[np.isfinite(distance)]
    if limits is None:
        limits = (float(np.percentile(seen, 1)), float(np.percentile(seen, 99))) if seen.size else (0.0, 1.0)
    ax, shown = _draw(distance, ax, title, cmap="viridis", vmin=limits[0], vmax=limits[1])
    below, above = bool((seen < limits[0]).any()), bool((seen > limits[1]).any())
    extend = {(True, True): "both", (True, False): "min", (False, True): "max"}.get((below, above), "neither")
    _bar(ax, shown, f"distance from the camera [{unit}]", extend)
    return ax


def show_normals(normals: FloatArray, ax: Axes | None = None, title: str = "Normals") -> Axes:
    """Show normals as colours, (n + 1)/2.

    Parameters
    ----------
    normals : (H, W, 3) float array
        Unit normals, x right, y down, z forward; nan where unknown.
    """
    known = np.isfinite(normals).all(axis=-1, keepdims=True)
    return _draw(np.where(known, np.clip((normals + 1) / 2, 0, 1), LEFT_OUT), ax, title)[0]


def show_error(
    estimate: FloatArray,
    truth: FloatArray,
    ax: Axes | None = None,
    *,
    relative: bool = True,
    unit: str = "mm",
    limit: float | None = None,
    title: str = "Error",
) -> Axes:
    """Show estimate - truth: red is too far, blue too near.

    Parameters
    ----------
    estimate, truth : (H, W) float array
        Distances in one unit; nan where unknown.
    relative : bool
        In per cent of the truth, else in `unit`.
    unit : str
        Of the distances.
    limit : float, optional
        End of the colour bar; the 98th percentile of the absolute error by default.
    """
    error = estimate - truth
    if relative:
        return _diverging(100 * error / truth, ax, title, "error of the distance [%]", limit)
    return _diverging(error, ax, title, f"error of the distance [{unit}]", limit)


def show_section(
    distances: Mapping[str, FloatArray],
    field: RayField,
    ax: Axes | None = None,
    *,
    row: int | None = None,
    column: int | None = None,
    unit: str = "mm",
    title: str | None = None,
) -> Axes:
    """Show where a row or column of the picture cuts surfaces, seen from the side.

    Parameters
    ----------
    distances : mapping of str to (H, W) float array
        The surfaces by name; "truth", "start" and "estimate" have colours of their own.
    field : RayField
        Of the camera.
    row, column : int, optional
        Which; the middle column by default.
    unit : str
        Of the distances.
    """
    if row is not None and column is not None:
        raise ValueError("choose a row or a column, not both")
    if row is None and column is None:
        column = field.shape[1] // 2
    ax = _axes(ax)
    across, name = (1, f"column {column}") if row is None else (0, f"row {row}")
    others = iter(OTHERS * len(distances))
    for label, distance in distances.items():
        surface = distance[..., None] * field.rays
        points = surface[:, column] if row is None else surface[row]
        colour = LINES[label] if label in LINES else next(others)
        ax.plot(points[:, 2], points[:, across], color=colour, lw=1.8, label=label)
    ax.plot(0, 0, marker=">", color="black", ms=7, ls="none")
    ax.annotate("camera", (0, 0), xytext=(-4, 8), textcoords="offset points")
    ax.set(title=f"Section along {name}" if title is None else title, xlabel=f"z [{unit}]")
    ax.set_ylabel(f"{'xy'[across]} [{unit}]")
    ax.set_aspect("equal", adjustable="datalim")
    if across == 1 and not ax.yaxis_inverted():
        ax.invert_yaxis()  # as in the picture, y points down
    ax.grid(alpha=0.3)
    ax.legend(frameon=False, loc="best")
    return ax


def show_history(
    history: Sequence[Mapping[str, float]], ax: Axes | None = None, title: str = "Energy"
) -> Axes:
    """Show energy and terms against the iteration, on a logarithmic axis.

    Parameters
    ----------
    history : sequence of mappings
        `Result.history`: k, energy and its terms.
    """
    ax = _axes(ax)
    k = [entry["k"] for entry in history]
    for name, colour, style in (
        ("energy", "black", "-"),
        ("data", "#0072B2", "--"),
        ("regulariser", "#D55E00", ":"),
    ):
        values = np.array([entry.get(name, np.nan) for entry in history], dtype=float)
        # A term of exactly 0 (λ = 0, say) has no place on a logarithmic axis.
        if np.any(values > 0):
            ax.plot(k, np.where(values > 0, values, np.nan), style, color=colour, lw=2, label=name)
    ax.set(title=title, xlabel="iteration", ylabel="energy [1]", yscale="log")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.grid(alpha=0.3)
    ax.legend(frameon=False)
    return ax


def show_cloud(
    points: FloatArray,
    colours: FloatArray,
    ax: Axes | None = None,
    *,
    angle: float = 30.0,
    elevation: float = 20.0,
    unit: str = "mm",
    title: str = "Surface from the side",
) -> Axes:
    """Show a surface from beside the camera, in its picture's colours and with relief.

    Parameters
    ----------
    points : (H, W, 3) float array
        Surface points in the camera frame; nan where unknown.
    colours : (H, W, 3) or (H, W) float array
        Of the points, in [0, 1].
    angle, elevation : float
        How far the viewer stands to the left of the optical axis and above it, degrees.
    unit : str
        Of the points.

    Notes
    -----
    A parallel projection. What the viewer would see from behind is not drawn, so that a tube
    lies open, and neither are jumps in depth.
    """
    ax = _axes(ax)
    step = -(-points.shape[1] // VIEW_WIDTH)
    points, colours = points[::step, ::step], np.clip(colours[::step, ::step], 0, 1)
    yaw, pitch = np.deg2rad(angle), np.deg2rad(elevation)
    turn = np.array([[np.cos(yaw), 0, -np.sin(yaw)], [0, 1, 0], [np.sin(yaw), 0, np.cos(yaw)]])
    nod = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    to_viewer = nod @ turn  # right, down, away

    def corners(a: FloatArray) -> FloatArray:
        return np.stack([a[:-1, :-1], a[:-1, 1:], a[1:, 1:], a[1:, :-1]], axis=2)

    patch = corners(points @ to_viewer.T)
    distance = corners(np.linalg.norm(points, axis=-1))
    # Rows and columns turn clockwise around a patch for the camera; so they must for the viewer.
    normal = np.cross(patch[:, :, 2] - patch[:, :, 0], patch[:, :, 3] - patch[:, :, 1])
    with np.errstate(invalid="ignore", divide="ignore"):
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        kept = (normal[..., 2] > 0) & (distance.max(axis=-1) < JUMP * distance.min(axis=-1))
    patch, normal = patch[kept], normal[kept]
    colour = colours[:-1, :-1][kept]
    colour = np.repeat(colour[:, None], 3, axis=-1) if colour.ndim == 1 else colour
    if len(patch):
        # The far end of a lumen is dark in any frame: lift it, or relief drowns.
        colour = (colour / max(np.percentile(colour, 99), 1e-6)).clip(0, 1) ** 0.6
        colour *= 0.4 + 0.6 * np.clip(normal @ LAMP, 0, 1)[:, None]
        order = np.argsort(-patch[..., 2].mean(axis=-1))
        faces, flat = colour[order], patch[order, :, :2]
        patches = PolyCollection(flat, facecolors=faces, edgecolors=faces, linewidths=0.4, rasterized=True)
        ax.add_collection(patches, autolim=False)
        # A plane that runs to the horizon must not make what is near small.
        away = distance[kept].max(axis=-1)
        near = patch[away <= FARTHEST * np.median(away), :, :2].reshape(-1, 2)
        low, high = np.minimum(near.min(axis=0), 0), np.maximum(near.max(axis=0), 0)
        ax.update_datalim([low, (high[0], high[1] + 0.12 * (high - low)[1])])  # the bar's place
        ax.autoscale_view()
        _scale_bar(ax, high[0] - low[0], unit)
    ax.invert_yaxis()
    ax.plot(0, 0, marker="o", color="white", ms=5)
    ax.annotate("camera", (0, 0), xytext=(0, 7), textcoords="offset points", color="white", ha="center")
    ax.set(title=title, xticks=[], yticks=[], facecolor=BACKDROP)
    ax.set_aspect("equal", adjustable="datalim")
    return ax


def _scale_bar(ax: Axes, width: float, unit: str) -> None:
    """Draw a bar of a round length, about a quarter of the width, in the lower left corner."""
    power = 10 ** np.floor(np.log10(width / 4))
    length = max(power * factor for factor in (1, 2, 5) if power * factor <= width / 4)
    bar = AnchoredSizeBar(
        ax.transData, length, f"{length:g} {unit}", "lower left", frameon=False, color="white", pad=0.8, sep=4
    )
    ax.add_artist(bar)


def overview(
    shown: Result | Iterate, picture: FloatArray | None = None, truth: FloatArray | None = None
) -> Figure:
    """Draw everything about a result on one page.

    Parameters
    ----------
    shown : Result or Iterate
    picture : (H, W) or (H, W, 3) float array, optional
        The frame as it looked; the problem's own by default.
    truth : (H, W) float array, optional
        True distance, mm. Where the result has no unit, the truth takes the result's scale.

    Returns
    -------
    Figure
        1600 x 900 px when saved; not one of pyplot's, so there is nothing to close.
    """
    iterate = shown.iterate if isinstance(shown, Result) else shown
    problem, unit = iterate.problem, iterate.problem.unit
    if picture is None:
        picture = problem.image if problem.picture is None else problem.picture
    start = np.exp(np.where(problem.mask, problem.log_facing, np.nan))
    curves = {"start": start, "estimate": iterate.distance}
    if truth is not None:
        scale = 1.0 if problem.metric else np.nanmedian((iterate.distance / truth)[problem.mask])
        curves = {"truth": np.where(problem.mask, scale * truth, np.nan), **curves}

    style: Any = {"font.size": 13, "axes.titlesize": 15, "axes.titleweight": "bold", "legend.fontsize": 12}
    with plt.rc_context(style):
        figure = Figure(figsize=(16, 9), dpi=100, layout="constrained")
        ((frame, depth, facing), (surface, section, residual)) = figure.subplots(2, 3)
        show_picture(picture, frame)
        show_depth(iterate.distance, depth, unit=unit)
        show_normals(iterate.normals, facing)
        show_cloud(iterate.points, picture, surface, unit=unit)
        show_section(curves, problem.field, section, unit=unit)
        error = 255 * (model_image(problem, iterate.log_distance) - problem.image)
        _diverging(error, residual, "Model - frame", "grey levels of 255", None)
        what = [f"iteration {iterate.k}", f"energy {iterate.energy:.4g}"]
        if isinstance(shown, Result):
            what.insert(0, shown.status.value.rstrip("."))
        if not problem.metric:
            what.append("relative units: the gain is unknown")
        figure.suptitle("  ·  ".join(what), fontsize=15)
    return figure
