"""How the Rerun viewer opens a recording: what is shown, and where.

`reconstruction` shows everything about a run, `comparison` several runs side by side, `sequence` a
video's frames, `calibration` a calibration's frames, sheet and fit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun.blueprint as rrb

from endolab.numerics.arrays import FloatArray
from endolab.workbench.plots.scales import LARGEST_RESIDUAL
from endolab.workbench.recording.stream import Layout

ITERATIONS = "iteration"  # a timeline
SECONDS_PLAYED = 20.0  # of a run, whatever its length


@dataclass(frozen=True)
class Shown:
    """What a recorded run holds, as far as the layout depends on it."""

    run: str  # its name, which its entities begin with; empty if the run is alone
    unit: str  # of distances
    terms: tuple[str, ...]  # of the energy
    maps: tuple[str, ...]  # of the solver
    limits: tuple[float, float]  # of distances
    last: int = 1  # of the timeline
    sigma: float | None = None  # %, where the colours of σ end; None if it was not recorded

    def at(self, entity: str) -> str:
        """Path of an entity."""
        return f"/{self.run}/{entity}" if self.run else f"/{entity}"

    def view(self, title: str, *entities: str) -> rrb.Spatial2DView:
        """A map, with what is laid over it, and the run's name in its title."""
        name = f"{title} · {self.run}" if self.run else title
        return rrb.Spatial2DView(
            origin=self.at(""), contents=[self.at(entity) for entity in entities], name=name
        )


def _open_at(
    layout: rrb.Container, timeline: str = ITERATIONS, fps: float | None = None
) -> Layout:
    """A layout with the timeline to open on, played so fast, and without panels beside it."""
    return Layout(
        layout,
        rrb.TimePanel(state="collapsed", timeline=timeline, fps=fps),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )


def _depth(shown: Shown) -> rrb.Spatial2DView:
    nearest, farthest = shown.limits
    return shown.view(
        f"Distance, {nearest:.3g} to {farthest:.3g} {shown.unit}", "depth", "mask"
    )


def _residual(shown: Shown) -> rrb.Spatial2DView:
    return shown.view(
        f"Residual, blue -{LARGEST_RESIDUAL:g} to red +{LARGEST_RESIDUAL:g}/255", "residual"
    )


def _uncertainty(shown: Shown) -> list[rrb.View]:
    """How far the run's end can be trusted, if it was recorded."""
    if shown.sigma is None:
        return []
    sigma = shown.view(f"σ, 0 to {shown.sigma:g} %", "uncertainty/sigma", "mask")
    return [sigma, shown.view("What determined each pixel", "uncertainty/dominant_source")]


def _surface(shown: Shown) -> rrb.Spatial3DView:
    nearest, farthest = shown.limits
    name = f"Surface [{shown.unit}]" + (f" · {shown.run}" if shown.run else "")
    return _space(
        name,
        np.array([0.0, 0.0, (nearest + farthest) / 2]),
        1.2 * farthest,
        origin=shown.at("world"),
    )


def _space(
    name: str,
    target: FloatArray,
    away: float,
    *,
    direction: Sequence[float] = (
        -0.5,
        -0.35,
        -0.8,
    ),  # from behind the camera, to its left and above it
    origin: str = "/world",
) -> rrb.Spatial3DView:
    """A view of what lies about `target`, from `away` in that direction."""
    eye = rrb.EyeControls3D(
        position=target + away * np.array(direction), look_target=target, eye_up=[0, -1, 0]
    )
    return rrb.Spatial3DView(
        origin=origin, name=name, eye_controls=eye, background=(45, 50, 58), line_grid=False
    )


def _curves(title: str, contents: Sequence[str]) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin="/",
        contents=list(contents),
        name=title,
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop),
        interaction=rrb.PlotInteraction(
            points_display="always"
        ),  # a few iterates make no line
    )


def _energy(shown: Shown) -> rrb.TimeSeriesView:
    return _curves(
        "log₁₀ energy", [shown.at(f"log10/{name}") for name in ("energy", *shown.terms)]
    )


def _change(runs: Sequence[Shown]) -> rrb.TimeSeriesView:
    return _curves(
        "log₁₀ change of log-distance", [shown.at("log10/change") for shown in runs]
    )


def _solver(shown: Shown) -> rrb.TimeSeriesView:
    """Curves of the solver's scalars, but for a mere count, which would flatten the others."""
    without = [
        f"- {shown.at(f'plots/{name}')}"
        for name in ("energy", *shown.terms, "change", "steps")
    ]
    return _curves("Solver", [shown.at("plots/**"), *without])


def reconstruction(shown: Shown) -> Layout:
    """Pictures above, the surface, curves and words below."""
    maps = [shown.view(name.capitalize(), f"front/{name}") for name in shown.maps]
    sigma = (uncertainty := _uncertainty(shown))[:1]
    decided = uncertainty[1:]
    pictures = rrb.Horizontal(
        shown.view("Frame", "input", "prepared", "mask"),
        _depth(shown),
        rrb.Tabs(*sigma, shown.view("Normals", "normals"), active_tab=0),
        rrb.Tabs(_residual(shown), *decided, *maps, active_tab=0),
    )
    documents = {"settings": "Settings", "end": "End"}
    words = [
        rrb.TextDocumentView(origin=shown.at(entity), name=name)
        for entity, name in documents.items()
    ]
    steps = rrb.Vertical(_change([shown]), _solver(shown), name="Steps")
    stages = rrb.TextLogView(origin=shown.at("stage"), name="Stages")
    curves = rrb.Vertical(_energy(shown), stages, row_shares=[2, 1])
    below = rrb.Horizontal(
        _surface(shown), curves, rrb.Tabs(*words, steps), column_shares=[1.7, 1.4, 1.1]
    )
    fps = max(1.0, shown.last / SECONDS_PLAYED)
    return _open_at(rrb.Vertical(pictures, below, row_shares=[1, 1.4]), fps=fps)


def comparison(runs: Sequence[Shown]) -> Layout:
    """Each run a column of pictures and its surface; energies and changes of all in one plot each."""
    columns = [
        rrb.Vertical(
            _depth(shown), rrb.Tabs(_residual(shown), *_uncertainty(shown)), _surface(shown)
        )
        for shown in runs
    ]
    energy = _curves("log₁₀ energy", [shown.at("log10/energy") for shown in runs])
    layout = rrb.Horizontal(*columns, rrb.Vertical(energy, _change(runs)))
    return _open_at(
        layout, fps=max(1.0, max(shown.last for shown in runs) / SECONDS_PLAYED)
    )


def _plots(curves: Mapping[str, Sequence[str]]) -> list[rrb.TimeSeriesView]:
    """Curves below ``plots``, by their titles."""
    return [
        _curves(title, [f"/plots/{name}" for name in names])
        for title, names in curves.items()
    ]


def sequence(
    unit: str,
    limits: tuple[float, float],
    timeline: str,
    curves: Mapping[str, Sequence[str]],
) -> Layout:
    """Pictures of a video's frame above, its surface and the curves over the frames below.

    `limits` are those of the distances of the first surface, in `unit`; `curves` titles of what lies below
    ``plots``.
    """
    alone = Shown("", unit, (), (), limits)
    pictures = rrb.Horizontal(
        alone.view("Frame", "input"), _depth(alone), alone.view("Normals", "normals")
    )
    below = rrb.Horizontal(
        _surface(alone), rrb.Grid(*_plots(curves), grid_columns=2), column_shares=[1, 1.2]
    )
    return _open_at(rrb.Vertical(pictures, below, row_shares=[1, 1.3]), timeline)


def calibration(
    centre: FloatArray, curves: Mapping[str, Sequence[str]], timeline: str
) -> Layout:
    """The frame, the sheet in space, the curves over the frames; the account, and behind it the light's fit.

    The sheet is mostly at `centre`, (3,), mm; `curves` are titles of what lies below ``plots``.
    """
    pictures = ["/picture", "/picture/detected", "/picture/reprojection"]
    frame = rrb.Vertical(
        rrb.Spatial2DView(origin="/", contents=pictures, name="Detection"),
        rrb.Spatial2DView(
            origin="/", contents=["/picture", "/picture/samples"], name="Brightness"
        ),
    )
    # From aside, between the camera and where the sheet mostly is.
    away = 2 * float(np.linalg.norm(centre))
    sheet = _space("Sheet", centre / 2, away, direction=(-0.6, -0.4, -0.7))
    fit = rrb.Vertical(
        _curves("k and γ", ["/fit/k", "/fit/gamma"]),
        _curves("σ [grey levels]", ["/fit/sigma"]),
        name="Fit",
    )
    words = rrb.Tabs(rrb.TextDocumentView(origin="/account", name="Account"), fit)
    middle = rrb.Vertical(sheet, rrb.Horizontal(*_plots(curves)), row_shares=[2, 1])
    return _open_at(
        rrb.Horizontal(frame, middle, words, column_shares=[1.2, 1.5, 1]), timeline
    )
