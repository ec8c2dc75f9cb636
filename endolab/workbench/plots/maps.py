"""Figures: a frame, its depth, normals and surface, errors and energies.

Every function but the pages, `overview` and `prepare_figure`, draws into the axes ``ax`` it
is given, or into new ones, under ``title``, and returns the axes. Maps are nan where unknown,
which is shown in neutral grey; where little is known, maps end around it. ``unit`` is that of the
distances. Colours are safe for colour-blind readers, and axes carry units (`style`).
"""

from collections.abc import Mapping
from textwrap import wrap
from typing import Any
from warnings import catch_warnings

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from endolab.metrics.depth_errors import depth_cuts
from endolab.model.cameras import RayField
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.reconstruction.prepare import prepare
from endolab.reconstruction.report import meaning, nominal_light, warnings
from endolab.reconstruction.uncertainty import Uncertainty
from endolab.solvers.energy import model_image
from endolab.solvers.result import Iterate, Result
from endolab.workbench.plots import scales
from endolab.workbench.plots.scales import SOURCE_COLOURS, in_colour, truth_for
from endolab.workbench.plots.style import (
    HOUSE,
    ROUND,
    AxesOrNew,
    crop,
    decorate,
    house,
    legend_below,
    page,
    show_pixels,
    show_values,
)
from endolab.workbench.plots.surface_view import show_cloud

Surface = FloatArray | Iterate | Result  # distances, or who knows where they are cut, too


def _distance_and_cuts(surface: Surface) -> tuple[FloatArray, BoolArray | None]:
    """Distances, (H, W), and cuts, (2, H, W), if the surface knows any."""
    if isinstance(surface, Iterate | Result):
        return surface.distance, surface.problem.cuts
    return surface, None


@house()
def show_picture(picture: FloatArray, ax: AxesOrNew = None, title: str = "Frame") -> Axes:
    """Show a frame.

    Parameters
    ----------
    picture : (H, W) or (H, W, 3) float array of stored values, clipped to [0, 1]; nan where unknown
    """
    colours = np.clip(in_colour(picture), 0, 1)
    return show_pixels(np.where(np.isfinite(colours), colours, HOUSE.left_out), ax, title)


@house()
def show_depth(
    surface: Surface,
    ax: AxesOrNew = None,
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
        need the same: ``plots.limits("distance", one, other)``.
    """
    distance, cuts = _distance_and_cuts(surface)
    limits = limits or scales.limits("distance", distance)
    label = f"distance [{unit}]"
    ax = show_values("distance", distance, ax, title, label, limits)
    if surface is distance:
        cuts = depth_cuts(distance)
    if cuts is not None:
        distance = np.where(cuts.any(axis=0), np.nan, distance)
    with catch_warnings(action="ignore"):  # there may be none
        levels = ROUND.tick_values(*limits)
        ax.contour(distance, levels, colors="white", linewidths=0.7, alpha=0.65)
    return ax


@house()
def show_map(
    values: FloatArray,
    ax: AxesOrNew = None,
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
    return show_values("any", values, ax, title, label, limits)


@house()
def show_normals(normals: FloatArray, ax: AxesOrNew = None, title: str = "Normals") -> Axes:
    """Show normals as colours, (n + 1)/2.

    Parameters
    ----------
    normals : (H, W, 3) float array of unit normals: x right, y down, z forward; nan where unknown
    """
    ax = show_picture((normals + 1) / 2, ax, title)
    crop(ax, np.isfinite(normals[..., 0]))
    return ax


@house()
def show_error(
    estimate: FloatArray,
    truth: FloatArray,
    ax: AxesOrNew = None,
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
    percent = 100 * (estimate - truth) / truth
    limits = None if limit is None else (-limit, limit)
    return show_values("error", percent, ax, title, label, limits)


@house()
def show_dominant_source(
    dominant_source: np.ndarray,
    ax: AxesOrNew = None,
    *,
    title: str = "What determined each pixel",
) -> Axes:
    """Show what determined each pixel, with how many of them each determined.

    Parameters
    ----------
    dominant_source : (H, W) array of 0 outside, 1 data, 2 border or contour, 3 prior
    """
    colours = np.vstack([HOUSE.left_out, np.array([*SOURCE_COLOURS.values()]) / 255])
    ax = show_pixels(colours[dominant_source], ax, title)
    inside = dominant_source > 0
    crop(ax, inside)
    for number, name in enumerate(SOURCE_COLOURS, 1):
        share = np.mean(dominant_source[inside] == number)
        label = f"{name}\n{share:.0%}".replace(" or ", "\nor ")
        ax.plot([], [], "s", ms=10, color=colours[number], label=label)
    # Where colour bars are: on the map it would hide what it names.
    ax.legend(loc="center left", bbox_to_anchor=(1, 0.5), labelspacing=1, handlelength=1)
    return ax


@house()
def show_section(
    distances: Mapping[str, Surface],
    field: RayField,
    ax: AxesOrNew = None,
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
    column = field.rays.shape[1] // 2 if column is None else column
    title = f"Section along column {column}" if title is None else title
    ax = decorate(ax, title, f"z [{unit}]", f"y [{unit}]")
    # The truth is black, as a reference should be.
    colours = {"truth": "black", "start": HOUSE.sky, "estimate": HOUSE.vermilion}
    ax.set_prop_cycle(color=HOUSE.curve_colours)  # of others
    ax.plot(0, 0, ">", color="black", ms=7, label="camera")
    for name, surface in distances.items():
        distance, cuts = _distance_and_cuts(surface)
        points = distance[:, column, None] * field.rays[:, column, [2, 1]]
        if cuts is not None:
            after = np.flatnonzero(cuts[1, :-1, column]) + 1
            points = np.insert(points, after, np.nan, axis=0)
        around = ax.dataLim.frozen()
        ax.plot(*points.T, color=colours.get(name), label=name)
        # The start may have spikes many times as far as all else.
        if name == "start" and len(distances) > 1:
            ax.dataLim.set(around)
    ax.margins(0.15)
    ax.set_aspect("equal", adjustable="datalim")
    ax.yaxis.set_inverted(True)  # as in the picture, y points down
    ax.legend(loc="best")
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
    problem = result.problem
    unit = problem.unit
    start = np.exp(np.where(problem.mask, problem.log_d0, np.nan))
    curves: dict[str, Surface] = {"start": start, "estimate": result}
    if truth is not None:
        curves = {"truth": truth_for(result, truth), **curves}
    residual = 255 * (model_image(problem, iterate.log_distance) - problem.image)
    words = [
        result.status.name.lower().replace("_", " "),
        f"channel {result.report.channel}",
        f"λ {problem.lam:g}, {problem.regulariser}",
        f"iteration {iterate.k}",
        f"energy {iterate.energy:.4g}",
        f"distances in {unit}",
    ]
    doubts = [line for one in warnings(result) for line in wrap(one, 130)]
    columns = 3 if uncertainty is None else 4
    with page(1 + 5 * columns, 9, 2 + len(doubts)) as figure:
        panels = figure.subplots(2, columns)
        show_picture(problem.shown, panels[0, 0])
        crop(panels[0, 0], problem.mask)
        show_depth(result, panels[0, 1], unit=unit)
        show_normals(result.normals, panels[0, 2])
        show_cloud(result.points, problem.shown, panels[1, 0], unit=unit)
        section = show_section(curves, problem.field, panels[1, 1], unit=unit)
        section.legend(loc="center left", bbox_to_anchor=(1, 0.5), handlelength=1)
        show_values("model - frame", residual, panels[1, 2])
        if uncertainty is not None:
            show_values("σ", 100 * uncertainty.sigma / result.distance, panels[0, 3])
            show_dominant_source(uncertainty.dominant_source, panels[1, 3])
        place: Any = {"va": "top", "ha": "center", "size": "large"}
        figure.text(0.5, 0.98, "  ·  ".join(words), **place)
        lines = "\n".join(["", *doubts])
        figure.text(0.5, 0.98, lines, color=HOUSE.vermilion, **place)
        below = [meaning(result)[0], *nominal_light(result)]
        figure.supxlabel("\n".join(below), size="medium")
    return figure


def prepare_figure(result: Result) -> Figure:
    """Draw what was solved of a frame (`endolab.prepare`), as the paper does: from the picture to its light.

    Returns
    -------
    Figure
        Four panels, 1600 px wide when saved; not one of pyplot's.
    """
    prepared = prepare(result)
    inside = prepared.field_of_view
    seen = np.where(inside[..., None], in_colour(prepared.picture), np.nan)
    tall = min(inside.shape[0] / inside.shape[1], 2.0)  # that a page stays one
    with page(16, 14 * tall + 3.2) as figure:
        panels = figure.subplots(2, 2)
        show_picture(prepared.picture, panels[0, 0])
        show_picture(prepared.canonical, panels[0, 1], "Canonical")
        pixels = show_picture(seen, panels[1, 0], "Pixels")
        for name, part, colour in (
            ("no ray within 80°", prepared.without_ray, HOUSE.vermilion),
            ("too dark", prepared.dark, HOUSE.blue),
            ("saturated", prepared.saturated, HOUSE.orange),
            ("highlights", prepared.highlights, HOUSE.green),
        ):
            over = part[..., None] * to_rgba(colour, 0.75)
            pixels.imshow(over, interpolation="nearest")
            label = f"{name}, {100 * part[inside].mean():.2g} %"
            pixels.plot([], [], "s", ms=10, color=colour, label=label)
        legend_below(pixels)
        show_picture(prepared.solved, panels[1, 1], "Light that was solved")
    return figure
