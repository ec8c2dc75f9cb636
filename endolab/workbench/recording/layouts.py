"""How the Rerun viewer opens a recording: what is shown, and where.

`reconstructions` shows everything about a run, or several side by side, `sequence` a video's frames.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun.blueprint as rrb

from endolab.workbench.plots.scales import LARGEST_ERROR, LARGEST_RESIDUAL, three_digits

ITERATIONS = "iteration"  # a timeline
FRAMES = "frame"  # another
FROM_BEHIND = (-0.5, -0.35, -0.8)  # the camera, to its left and above it
Curves = Mapping[str, Sequence[str]]  # names of what lies below ``plots``, by their title


@dataclass(frozen=True)
class Shown:
    """What a recorded run holds, as far as the layout depends on it."""

    run: str  # its name, which its entities begin with; empty if the run is alone
    unit: str  # of distances
    limits: tuple[float, float]  # of distances
    truth: bool = False  # whether it is shown
    sigma: float | None = None  # %, where the colours of σ end; None if it was not recorded

    def at(self, entity: str) -> str:
        """Path of an entity."""
        return f"/{self.run}/{entity}" if self.run else f"/{entity}"

    def title(self, words: str) -> str:
        """Title of a view, with the run's name."""
        return f"{words} · {self.run}" if self.run else words

    def view(self, title: str, *entities: str) -> rrb.Spatial2DView:
        """A map, with what is laid over it."""
        contents = [self.at(entity) for entity in entities]
        return rrb.Spatial2DView(
            origin=self.at(""), contents=contents, name=self.title(title)
        )


def _open_at(timeline: str, layout: rrb.Container) -> rrb.Blueprint:
    """A layout with the timeline to open on, and without panels beside it."""
    return rrb.Blueprint(
        layout,
        # Slow enough for a run of few iterates.
        rrb.TimePanel(state="collapsed", timeline=timeline, fps=5),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )


def _depth(shown: Shown) -> rrb.Spatial2DView:
    nearest, farthest = map(three_digits, shown.limits)
    title = f"Distance, {nearest} to {farthest} {shown.unit}"
    return shown.view(title, "distance")


def _surface(shown: Shown) -> rrb.Spatial3DView:
    """The surface from behind the camera."""
    target = np.array([0, 0, np.mean(shown.limits)])
    position = target + 1.2 * shown.limits[1] * np.array(FROM_BEHIND)
    eye = rrb.EyeControls3D(position=position, look_target=target, eye_up=[0, -1, 0])
    return rrb.Spatial3DView(
        origin=shown.at("world"),
        name=shown.title(f"Surface [{shown.unit}]"),
        eye_controls=eye,
        background=(45, 50, 58),
        line_grid=False,
    )


def _curves(title: str, contents: Sequence[str], legend: bool = True) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin="/",
        contents=contents,
        name=title,
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop, visible=legend),
        # A few iterates make no line.
        interaction=rrb.PlotInteraction(points_display="always"),
    )


def _maps(shown: Shown) -> rrb.Tabs:
    """How far the answer is from the truth and from the frame, and how far it can be trusted."""
    views = [
        shown.view(
            f"Residual, -{LARGEST_RESIDUAL:g} to +{LARGEST_RESIDUAL:g}/255", "residual"
        ),
        shown.view("Normals", "normals"),
    ]
    if shown.truth:
        title = f"Error, -{LARGEST_ERROR:g} to +{LARGEST_ERROR:g} %"
        views.insert(0, shown.view(title, "error"))
    if shown.sigma is not None:
        views += [
            shown.view(f"σ, 0 to {shown.sigma:g} %", "uncertainty/sigma", "mask"),
            shown.view("What determined each pixel", "uncertainty/dominant_source"),
        ]
    return rrb.Tabs(*views, active_tab=0)


def reconstructions(runs: Sequence[Shown]) -> rrb.Blueprint:
    """Pictures and surface of each run, side by side; curves, stages and words of all beside them."""
    alone = len(runs) == 1
    columns = []
    curves = {"log₁₀ energy": "log10/energy/**", "log₁₀ change of log d": "log10/change/**"}
    if any(shown.truth for shown in runs):
        curves["Mean error [%]"] = "plots/error"
    words: list[rrb.View] = [
        rrb.TextLogView(
            origin="/", contents=[one.at("stage") for one in runs], name="Stages"
        )
    ]
    for shown in runs:
        frame = shown.view("Frame", "input", "prepared", "mask")
        section = shown.view("Section: truth grey, estimate orange", "section/**")
        surface = rrb.Tabs(_surface(shown), section, active_tab=0)
        views = (frame, _depth(shown), _maps(shown), surface)
        columns.append(rrb.Grid(*views, grid_columns=2 if alone else 1))
        for text in ("settings", "end"):
            title = shown.title(text.capitalize())
            words.append(rrb.TextDocumentView(origin=shown.at(text), name=title))
    plots = [
        # Of one run the list of stages is the legend.
        _curves(title, [shown.at(curve) for shown in runs], not alone)
        for title, curve in curves.items()
    ]
    beside = rrb.Vertical(rrb.Tabs(*plots, active_tab=0), rrb.Tabs(*words, active_tab=0))
    shares = [2.0] if alone else [1.0] * len(runs)
    return _open_at(
        ITERATIONS, rrb.Horizontal(*columns, beside, column_shares=[*shares, 1.0])
    )


def sequence(unit: str, limits: tuple[float, float], curves: Curves) -> rrb.Blueprint:
    """Pictures of a video's frame above, its surface and the curves over the frames below.

    `limits` are those of the distances of the first surface, in `unit`.
    """
    alone = Shown("", unit, limits)
    frame = alone.view("Frame", "input")
    pictures = rrb.Horizontal(frame, _depth(alone), alone.view("Normals", "normals"))
    plots = [
        _curves(title, [f"/plots/{name}" for name in names])
        for title, names in curves.items()
    ]
    grid = rrb.Grid(*plots, grid_columns=2)
    below = rrb.Horizontal(_surface(alone), grid, column_shares=[1, 1.2])
    return _open_at(FRAMES, rrb.Vertical(pictures, below, row_shares=[1, 1.3]))
