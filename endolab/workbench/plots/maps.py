"""Figures: a frame, its depth, normals and surface, errors and energies.

Every function but the page, `overview`, draws into the axes ``ax`` it
is given, or into new ones, under ``title``, and returns the axes. Maps are nan where unknown,
which is shown in neutral grey; where little is known, maps end around it. ``unit`` is that of the
distances. Colours are safe for colour-blind readers, and axes carry units (`style`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from endolab.metrics.depth_errors import depth_cuts
from endolab.model.cameras import RayField
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.reconstruction.sentences import meaning
from endolab.solvers.energy import model_image
from endolab.solvers.result import Iterate, Result
from endolab.workbench.plots import style
from endolab.workbench.plots.scales import (
    SOURCE_COLOURS,
    break_line,
    common_limit,
    common_limits,
    isoline_levels,
)
from endolab.workbench.plots.surface_view import show_cloud

if TYPE_CHECKING:
    from endolab.reconstruction.uncertainty import Uncertainty


Surface = FloatArray | Iterate | Result  # distances, or who knows where they are cut, too


def _distance_and_cuts(surface: Surface) -> tuple[FloatArray, BoolArray | None]:
    """Distances, (H, W), and cuts, (2, H, W), if the surface knows any."""
    if isinstance(surface, Iterate | Result):
        return surface.distance, surface.problem.cuts
    return surface, None


def _draw(picture: FloatArray, ax: Axes | None, title: str, **look: Any) -> Axes:
    """Show a picture on pixel axes."""
    ax = style.pixel_axes(ax, title)
    ax.imshow(picture, interpolation="nearest", **look)
    ax.locator_params(nbins=3)
    return ax


def _draw_signed(
    values: FloatArray, ax: Axes | None, title: str, label: str, limit: float | None = None
) -> Axes:
    """Show a map of values of both signs, white at 0."""
    limit = common_limit([values]) if limit is None else limit
    limits = (-limit, limit)
    return style.show_values(values, ax, title, label, limits, ends="both", cmap="RdBu_r")


@style.house()
def show_picture(picture: FloatArray, ax: Axes | None = None, title: str = "Frame") -> Axes:
    """Show a frame.

    Parameters
    ----------
    picture : (H, W) or (H, W, 3) float array of stored values, clipped to [0, 1]
    """
    return _draw(np.clip(picture, 0, 1), ax, title, cmap="gray", vmin=0, vmax=1)


@style.house()
def show_depth(
    surface: Surface,
    ax: Axes | None = None,
    *,
    unit: str = "mm",
    limits: tuple[float, float] | None = None,
    title: str = "Distance",
) -> Axes:
    """Show distances in logarithmic colours, with isolines at the ticks of the colour bar.

    Equal ratios are equal steps of colour. Isolines end where the surface is cut.

    Parameters
    ----------
    surface : (H, W) float array in `unit`, nan where unknown; or Iterate or Result
        An array is taken to be cut where it jumps, see `metrics.depth_cuts`.
    limits : two positive floats, optional
        Ends of the colour bar; the 1st and 99th percentile by default. Panels to be compared
        need the same: see `common_limits`.
    """
    distance, cuts = _distance_and_cuts(surface)
    low, high = common_limits([distance]) if limits is None else limits
    low = max(low, 1e-3 * high)
    high = max(high, 1.01 * low)
    look: Any = {"scale": LogNorm, "cmap": "viridis"}
    ax = style.show_values(distance, ax, title, f"distance [{unit}]", (low, high), **look)
    if surface is distance:
        cuts = depth_cuts(distance)
    if cuts is not None:
        distance = np.where(cuts.any(axis=0), np.nan, distance)
    known = distance[np.isfinite(distance)]
    levels = isoline_levels(low, high)
    # Matplotlib would warn of levels none of which is crossed.
    if np.any((levels > known.min(initial=high)) & (levels < known.max(initial=low))):
        ax.contour(distance, levels, colors="white", linewidths=0.7, alpha=0.65)
    return ax


@style.house()
def show_map(
    values: FloatArray,
    ax: Axes | None = None,
    *,
    label: str,
    limits: tuple[float, float] | None = None,
    title: str = "",
) -> Axes:
    """Show a map of what is no distance, in linear colours.

    Parameters
    ----------
    values : (H, W) float array; nan where unknown
    label : str
        Of the colour bar: quantity [unit].
    limits : two floats, optional
        As of `show_depth`.
    """
    limits = common_limits([values]) if limits is None else limits
    return style.show_values(values, ax, title, label, limits, cmap="viridis")


@style.house()
def show_normals(
    normals: FloatArray, ax: Axes | None = None, title: str = "Normals"
) -> Axes:
    """Show normals as colours, (n + 1)/2.

    Parameters
    ----------
    normals : (H, W, 3) float array of unit normals: x right, y down, z forward; nan where unknown
    """
    known: BoolArray = np.all(np.isfinite(normals), axis=-1)
    colours = np.clip((normals + 1) / 2, 0, 1)
    ax = _draw(np.where(known[..., None], colours, style.HOUSE.left_out), ax, title)
    style.crop(ax, known)
    return ax


@style.house()
def show_error(
    estimate: FloatArray,
    truth: FloatArray,
    ax: Axes | None = None,
    *,
    limit: float | None = None,
    label: str = "error [%]",
    title: str = "Error",
) -> Axes:
    """Show estimate - truth in per cent of the truth: red is too far, blue too near.

    Parameters
    ----------
    estimate, truth : (H, W) float array, distances of one unit; nan where unknown
    limit : float, optional
        End of the colour bar; the 98th percentile of the absolute error by default.
    label : str, optional
        Of the colour bar.
    """
    return _draw_signed(100 * (estimate - truth) / truth, ax, title, label, limit)


@style.house()
def show_sigma(percent: FloatArray, ax: Axes | None = None) -> Axes:
    """Show σ of the distance with a colour bar to its 98th percentile; dark is certain.

    Parameters
    ----------
    percent : (H, W) float array, 100 σ/d; nan where unknown
    """
    limits = (0.0, common_limit([percent]))
    label = "σ of the distance [%]"
    return style.show_values(percent, ax, "Uncertainty: σ", label, limits, cmap="magma")


@style.house()
def show_dominant_source(
    dominant_source: np.ndarray,
    ax: Axes | None = None,
    *,
    title: str = "What determined each pixel",
) -> Axes:
    """Show what determined each pixel, with how many of them each determined.

    Parameters
    ----------
    dominant_source : (H, W) array of 0 outside, 1 data, 2 border or contour, 3 prior
    """
    colours = [style.HOUSE.left_out, *np.array([*SOURCE_COLOURS.values()]) / 255]
    ax = _draw(np.array(colours)[dominant_source], ax, title)
    style.crop(ax, dominant_source > 0)
    inside = dominant_source[dominant_source > 0]
    patches = []
    for k, name in enumerate(SOURCE_COLOURS, 1):
        share = 100 * (inside == k).sum() / max(inside.size, 1)
        lines = name.replace(" or ", "\nor ")
        patches.append(Patch(color=colours[k], label=f"{lines}\n{share:.0f} %"))
    # Where colour bars are: on the map it would hide what it names.
    ax.legend(
        handles=patches,
        loc="center left",
        bbox_to_anchor=(1.0, 0.5),
        handlelength=1.0,
        labelspacing=1.0,
    )
    return ax


@style.house()
def show_section(
    distances: Mapping[str, Surface],
    field: RayField,
    ax: Axes | None = None,
    *,
    column: int | None = None,
    unit: str = "mm",
    title: str | None = None,
) -> Axes:
    """Show where a column of the picture cuts surfaces, seen from the side.

    Parameters
    ----------
    distances : mapping of str to (H, W) float array in `unit`, or Iterate or Result
        The surfaces by name; "truth", "start" and "estimate" have colours of their own. The line of an
        Iterate or Result has gaps where its surface is cut.
    field : RayField
        Of the camera.
    column : int, optional
        Which; the middle one by default.
    """
    column = field.shape[1] // 2 if column is None else column
    title = f"Section along column {column}" if title is None else title
    ax = style.decorate(ax, title, f"z [{unit}]", f"y [{unit}]")
    # The truth is black, as a reference should be.
    lines = {"truth": "black", "start": style.HOUSE.sky, "estimate": style.HOUSE.vermilion}
    more_colours = iter(style.HOUSE.curve_colours * len(distances))
    followed = [np.zeros((1, 2))]  # what the axes show; the camera is at 0
    for label, surface in distances.items():
        distance, cuts = _distance_and_cuts(surface)
        points = distance[:, column, None] * field.rays[:, column, [2, 1]]
        if cuts is not None:
            points = break_line(points, cuts[1, :, column])
        colour = lines.get(label) or next(more_colours)
        ax.plot(*points.T, color=colour, lw=1.8, label=label)
        # The start may have spikes many times as far as all else.
        if label != "start" or len(distances) == 1:
            followed.append(points[np.isfinite(points).all(axis=1)])
    ax.plot(0, 0, marker=">", color="black", ms=7, ls="none")
    # Below it: to its left the axis may have its numbers.
    ax.annotate(
        "camera",
        (0, 0),
        xytext=(0, -8),
        textcoords="offset points",
        ha="center",
        va="top",
    )
    shown = np.concatenate(followed)
    low = shown.min(axis=0)
    high = shown.max(axis=0)
    # Room for half of the word to the camera's left, and above and below for the legend.
    spare = np.array([[-0.25, -0.15], [0.0, 0.15]])
    ax.dataLim.set_points(np.stack([low, high]) + spare * (high - low))
    ax.autoscale_view()
    ax.set_aspect("equal", adjustable="datalim")
    if not ax.yaxis_inverted():
        ax.invert_yaxis()  # as in the picture, y points down
    ax.legend(loc="best")
    return ax


@style.house()
def show_history(
    history: Sequence[Mapping[str, float]], ax: Axes | None = None, title: str = "Energy"
) -> Axes:
    """Show energy and terms against the iteration, on a logarithmic axis.

    Parameters
    ----------
    history : sequence of mappings: k, energy and its terms, as in `Result.history`
    """
    ax = style.decorate(ax, title, "iteration", "energy [1]")
    k = [entry["k"] for entry in history]
    lines = (
        ("energy", "black", "-"),
        ("data", style.HOUSE.blue, "--"),
        ("regulariser", style.HOUSE.vermilion, ":"),
    )
    for name, colour, dashes in lines:
        values = np.array([entry.get(name, np.nan) for entry in history], dtype=float)
        # A term of exactly 0 (λ = 0, say) has no place on a logarithmic axis.
        if np.any(values > 0):
            values[values <= 0] = np.nan
            ax.plot(k, values, dashes, color=colour, lw=2, label=name)
    ax.set_yscale("log")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.legend()
    return ax


def overview(
    result: Result, truth: FloatArray | None = None, uncertainty: Uncertainty | None = None
) -> Figure:
    """Draw everything about a result on one page.

    Parameters
    ----------
    result : Result
    truth : (H, W) float array, optional
        True distance, mm. Where the result has no unit, the truth takes the result's scale.
    uncertainty : Uncertainty, optional
        How far it can be trusted: two panels more.

    Returns
    -------
    Figure
        1600 x 900 px when saved, 2100 x 900 px with uncertainty. It is not one of pyplot's: nothing to close.
    """
    iterate = result.iterate
    problem = iterate.problem
    unit = problem.unit
    residual = 255 * (model_image(problem, iterate.log_distance) - problem.image)
    curves: dict[str, Surface] = {
        "start": np.exp(np.where(problem.mask, problem.log_d0, np.nan)),
        "estimate": iterate,
    }
    if truth is not None:
        scale = np.nanmedian((iterate.distance / truth)[problem.mask])
        truth = truth if problem.metric else scale * truth
        curves = {"truth": np.where(problem.mask, truth, np.nan), **curves}
    words = [
        result.status.value.rstrip("."),
        f"λ {problem.lam:g}, {problem.regulariser}",
        f"iteration {iterate.k}",
        f"energy {iterate.energy:.4g}",
    ]
    if channel := iterate.provenance.channel:
        words.insert(1, f"channel {channel}")
    if not problem.metric:
        words.append("relative units")
    columns = 3 if uncertainty is None else 4
    with style.page(1 + 5 * columns, 9) as figure:
        panels = figure.subplots(2, columns)
        show_picture(problem.shown, panels[0, 0])
        style.crop(panels[0, 0], problem.mask)
        show_depth(iterate, panels[0, 1], unit=unit)
        show_normals(iterate.normals, panels[0, 2])
        show_cloud(iterate.points, problem.shown, panels[1, 0], unit=unit)
        show_section(curves, problem.field, panels[1, 1], unit=unit)
        _draw_signed(residual, panels[1, 2], "Model - frame", "grey levels of 255")
        if uncertainty is not None:
            show_sigma(100 * uncertainty.sigma / iterate.distance, panels[0, 3])
            show_dominant_source(uncertainty.dominant_source, panels[1, 3])
        figure.suptitle("  ·  ".join(words), fontsize=15)
        figure.supxlabel(meaning(result)[0], fontsize=13)
    return figure
