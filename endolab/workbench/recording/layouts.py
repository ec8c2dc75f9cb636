"""How the Rerun viewer opens a recording: what is shown, and where.

`reconstruction` shows everything about a run, `comparison` several runs side by side, `sequence` a
video's frames.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun.blueprint as rrb

from endolab.workbench.plots.scales import LARGEST_RESIDUAL

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

    def words(self, entity: str) -> rrb.TextDocumentView:
        """A text that is called as its entity is."""
        return rrb.TextDocumentView(origin=self.at(entity), name=entity.capitalize())


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
    nearest, farthest = shown.limits
    title = f"Distance, {nearest:.3g} to {farthest:.3g} {shown.unit}"
    return shown.view(title, "distance")


def _residual(shown: Shown) -> rrb.Spatial2DView:
    end = f"{LARGEST_RESIDUAL:g}"
    return shown.view(f"Residual, blue -{end} to red +{end}/255", "residual")


def _sigma(shown: Shown) -> list[rrb.View]:
    """How far the run's end can be trusted, if it was recorded."""
    if shown.sigma is None:
        return []
    return [
        shown.view(f"σ, 0 to {shown.sigma:g} %", "uncertainty/sigma", "mask"),
        shown.view("What determined each pixel", "uncertainty/dominant_source"),
    ]


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


def _curves(title: str, contents: Sequence[str]) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin="/",
        contents=contents,
        name=title,
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop),
        # A few iterates make no line.
        interaction=rrb.PlotInteraction(points_display="always"),
    )


def _change(runs: Sequence[Shown]) -> rrb.TimeSeriesView:
    changes = [shown.at("log10/change") for shown in runs]
    return _curves("log₁₀ change of log-distance", changes)


def reconstruction(shown: Shown) -> rrb.Blueprint:
    """Pictures above, the surface, curves and words below."""
    sigma = _sigma(shown)
    pictures = rrb.Horizontal(
        shown.view("Frame", "input", "prepared", "mask"),
        _depth(shown),
        rrb.Tabs(*sigma[:1], shown.view("Normals", "normals"), active_tab=0),
        rrb.Tabs(_residual(shown), *sigma[1:], active_tab=0),
    )
    contents = [shown.at("log10/**"), f"- {shown.at('log10/change')}"]
    energy = _curves("log₁₀ energy", contents)
    stages = rrb.TextLogView(origin=shown.at("stage"), name="Stages")
    curves = rrb.Vertical(energy, stages, row_shares=[2, 1])
    words = rrb.Tabs(shown.words("settings"), shown.words("end"), _change([shown]))
    below = rrb.Horizontal(_surface(shown), curves, words, column_shares=[1.7, 1.4, 1.1])
    return _open_at(ITERATIONS, rrb.Vertical(pictures, below, row_shares=[1, 1.4]))


def comparison(runs: Sequence[Shown]) -> rrb.Blueprint:
    """Each run a column of pictures and its surface; energies and changes of all in one plot each."""
    columns = []
    for shown in runs:
        below = rrb.Tabs(_residual(shown), *_sigma(shown))
        columns.append(rrb.Vertical(_depth(shown), below, _surface(shown)))
    curves = ("log10/energy", "log10/begins/**")
    contents = [shown.at(name) for shown in runs for name in curves]
    plots = rrb.Vertical(_curves("log₁₀ energy", contents), _change(runs))
    return _open_at(ITERATIONS, rrb.Horizontal(*columns, plots))


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
