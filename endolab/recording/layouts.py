"""How the Rerun viewer opens a recording: what is shown, where, and how large.

`reconstruction` shows everything about a run, `convergence` its curves at large, `comparison`
several runs side by side, `sequence` a video's frames, `calibration` a calibration's frames,
sheet and fit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from endolab.numerics.arrays import FloatArray
from endolab.recording.scales import BELOW, EDGE, KEY, RIGHT

TIMELINE, PICTURES = "iteration", "picture"
PLAYED, SLOWEST = 20.0, 1.0  # s that a run is played, and iterations a second at least: seven take as many
NEARER, AWAY = 0.3, 0.58  # of a surface's depth, that is looked at; of its diagonal, from where
A_PICTURE = 2.0  # a second, of runs side by side
BACKGROUND = (45, 50, 58)


@dataclass(frozen=True)
class Shown:
    """What a recorded run holds, as far as the layout depends on it."""

    run: str  # its name, which its entities begin with; empty if the run is alone
    unit: str  # of distances
    terms: tuple[str, ...]  # of the energy
    maps: tuple[str, ...]  # of the solver
    low: FloatArray = field(default_factory=lambda: np.zeros(3))  # ends of the surface along x, y and z
    high: FloatArray = field(default_factory=lambda: np.ones(3))
    box: FloatArray = field(default_factory=lambda: np.array([[0.0, -1.0], [1.0, 1.0]]))  # section: z and y
    shape: tuple[int, ...] = (1, 1)  # of maps
    last: int = 1  # of the timeline
    staged: bool = False  # whether there are several stages
    sigma: float | None = None  # %, end of the colour scale of σ; None if it was not recorded

    def at(self, entity: str) -> str:
        """Path of an entity."""
        return f"/{self.run}/{entity}" if self.run else f"/{entity}"

    def called(self, title: str) -> str:
        """Title of a view, with the run's name."""
        return f"{title} · {self.run}" if self.run else title


class Layout(rrb.Blueprint):
    """How the viewer opens a recording, which lets go of the stream that it was sent by.

    Rerun sends a layout by a stream of its own and keeps that for good, with two threads.
    """

    _sent_by: rr.RecordingStream | None = None

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        self._sent_by = stream
        super()._log_to_stream(stream)

    def let_go(self) -> None:
        """Let go of that stream, when the layout was sent."""
        if self._sent_by is not None:
            self._sent_by.disconnect()
            self._sent_by = None


def _opened(layout: rrb.Container, timeline: str = TIMELINE, fps: float | None = None) -> Layout:
    """A layout with the timeline to open on, played so fast, and without panels beside it."""
    return Layout(
        layout,
        rrb.TimePanel(state="collapsed", timeline=timeline, fps=fps),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )


def _pace(shown: Shown) -> float:
    """Iterations a second at which a run is played."""
    return max(SLOWEST, shown.last / PLAYED)


def _picture(
    shown: Shown, title: str, *entities: str, right: float = 0.0, below: float = 0.0
) -> rrb.Spatial2DView:
    """A map, with room for a scale beside it or a key below it."""
    contents = [shown.at(entity) for entity in entities]
    height, width = shown.shape[:2]
    bounds = rrb.VisualBounds2D(x_range=[0, (1 + right) * width], y_range=[0, (1 + below) * height])
    name = shown.called(title)
    return rrb.Spatial2DView(origin=shown.at(""), contents=contents, name=name, visual_bounds=bounds)


def _scaled(entity: str, title: str, shape: tuple[int, ...]) -> rrb.Spatial2DView:
    """A map of a recording that holds no run, with its scale."""
    alone = Shown("", "", (), (), shape=shape)
    return _picture(alone, title, entity, f"scales/{entity.rpartition('/')[2]}/**", right=RIGHT)


def _depth(shown: Shown) -> rrb.Spatial2DView:
    return _picture(shown, f"Distance [{shown.unit}]", "depth", "mask", "scales/depth/**", right=RIGHT)


def _residual(shown: Shown) -> rrb.Spatial2DView:
    return _picture(shown, "Residual [1/255]", "residual", "scales/residual/**", right=RIGHT)


def _trust(shown: Shown) -> list[rrb.View]:
    """How far the run's end can be trusted, if it was recorded."""
    if shown.sigma is None:
        return []
    alone, entity = replace(shown, run=""), shown.at("front/trust")[1:]  # tabs have no room for the run
    scales = shown.at("scales")[1:]
    sigma = f"{entity}/sigma", f"{entity}/mask", f"{scales}/sigma/**"
    decided = f"{entity}/decided_by", f"{scales}/decided_by/**"
    return [
        _picture(alone, "σ [%]", *sigma, right=RIGHT),
        _picture(alone, "Who decided", *decided, below=BELOW),
    ]


def _surface(shown: Shown, runs: Sequence[Shown] = ()) -> rrb.Spatial3DView:
    """A run's surface, seen from where all `runs` are seen from."""
    low = np.min([one.low for one in runs or [shown]], axis=0)
    high = np.max([one.high for one in runs or [shown]], axis=0)
    away = AWAY * float(np.linalg.norm(high - low))
    # What is near is large: were the middle looked at, most would be to one side.
    target = low + (high - low) * [0.5, 0.5, NEARER]
    hidden = [shown.at("world/truth")]
    name = shown.called(f"Surface [{shown.unit}]")
    return _space(name, target, away, origin=shown.at("world"), hidden=hidden)


def _space(
    name: str,
    target: FloatArray,
    away: float,
    *,
    direction: Sequence[float] = (-0.5, -0.35, -0.8),  # from behind the camera, to its left and above it
    origin: str = "/world",
    hidden: Sequence[str] = (),
) -> rrb.Spatial3DView:
    """A view of what lies about `target`, from `away` in that direction."""
    eye = target + away * np.array(direction)
    invisible = rrb.EntityBehavior(visible=False)
    return rrb.Spatial3DView(
        origin=origin,
        name=name,
        eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=[0, -1, 0]),
        overrides=dict.fromkeys(hidden, invisible),
        background=BACKGROUND,
        line_grid=False,
    )


def _section(runs: Sequence[Shown]) -> rrb.Spatial2DView:
    low, high = np.min([one.box[0] for one in runs], axis=0), np.max([one.box[1] for one in runs], axis=0)
    width, height = high - low
    x_range = [low[0] - EDGE * width, high[0] + EDGE * width]
    y_range = [low[1] - 1.2 * KEY * height, high[1] + EDGE * height]
    bounds = rrb.VisualBounds2D(x_range=x_range, y_range=y_range)
    contents = [shown.at("section/**") for shown in runs]
    return rrb.Spatial2DView(origin="/", contents=contents, name="Middle column", visual_bounds=bounds)


def _curves(title: str, contents: Sequence[str]) -> rrb.TimeSeriesView:
    legend = rrb.PlotLegend(corner=rrb.Corner2D.RightTop)
    return rrb.TimeSeriesView(
        origin="/",
        contents=list(contents),
        name=title,
        plot_legend=legend,
        interaction=rrb.PlotInteraction(points_display="always"),  # a few iterates make no line
    )


def _energy(shown: Shown) -> rrb.TimeSeriesView:
    return _curves("log₁₀ energy", [shown.at(f"log10/{name}") for name in ("energy", *shown.terms)])


def _change(*runs: Shown) -> rrb.TimeSeriesView:
    return _curves("log₁₀ change of log-distance", [shown.at("log10/change") for shown in runs])


def _steps(shown: Shown) -> rrb.Vertical:
    """The change, and curves of the solver's scalars but for a mere count, which would flatten the others."""
    without = [f"- {shown.at(f'plots/{name}')}" for name in ("energy", *shown.terms, "change", "steps")]
    return rrb.Vertical(_change(shown), _curves("Solver", [shown.at("plots/**"), *without]), name="Steps")


def reconstruction(shown: Shown) -> Layout:
    """Pictures above, the surface and the curves below."""
    residual: list[rrb.View] = [_residual(shown)]
    residual += [_picture(shown, name.capitalize(), f"front/{name}") for name in shown.maps]
    active = 0 if shown.staged else len(residual) - 1
    sigma, decided = (trust := _trust(shown))[:1], trust[1:]
    documents = [rrb.TextDocumentView(origin=shown.at("settings"), name="Settings")]
    if trust:
        documents.append(rrb.TextDocumentView(origin=shown.at("front/trust/words"), name="Trust"))
    words = rrb.Tabs(*documents, _steps(shown))
    frame = _picture(shown, "Frame", "input")
    # No more than two tabs with trust where there was one without: titles have little room.
    last = rrb.Tabs(*residual, *decided, active_tab=active)
    facing = _picture(shown, "Normals", "normals")
    normals: rrb.View | rrb.Container = rrb.Tabs(*sigma, facing, active_tab=0) if sigma else facing
    pictures = rrb.Horizontal(frame, _depth(shown), normals, last, column_shares=[1, 1.25, 1.25, 1.25])
    curves = rrb.Vertical(_energy(shown), _section([shown]))
    surface: rrb.View | rrb.Container = _surface(shown)
    if shown.staged:
        surface = rrb.Vertical(surface, _stages(shown), row_shares=[2.1, 1])
    below = rrb.Horizontal(surface, curves, words, column_shares=[1.7, 1.4, 1.1])
    return _opened(rrb.Vertical(pictures, below, row_shares=[1, 1.4]), fps=_pace(shown))


def _stages(*runs: Shown) -> rrb.StateTimelineView:
    """Which stage each iteration belongs to, as a lane."""
    contents = [shown.at(entity) for shown in runs for entity in ("stage", "round")]
    return rrb.StateTimelineView(origin="/", contents=contents, name="Stages")


def convergence(shown: Shown) -> Layout:
    """Curves of energy, change and steps above, at large; what they mean for the surface below."""
    curves = rrb.Horizontal(_energy(shown), _steps(shown), column_shares=[1.4, 1])
    below = rrb.Horizontal(_residual(shown), _section([shown]), _depth(shown))
    return _opened(rrb.Vertical(curves, below, row_shares=[1.4, 1]), fps=_pace(shown))


BLUEPRINTS = {"reconstruction": reconstruction, "convergence": convergence}


def comparison(runs: Sequence[Shown]) -> Layout:
    """Each run a column of pictures and its surface; energies and sections of all in one plot each.

    On the timeline of pictures, where a run of seven iterates and one of hundreds are both seen.
    """
    columns = [
        rrb.Vertical(
            _depth(shown),
            rrb.Tabs(_residual(shown), *_trust(shown)) if shown.sigma is not None else _residual(shown),
            _surface(shown, runs),
            row_shares=[1, 1, 1.2],
            name=shown.run,
        )
        for shown in runs
    ]
    energy = _curves("log₁₀ energy", [shown.at("log10/energy") for shown in runs])
    staged = [shown for shown in runs if shown.staged]
    plots = rrb.Vertical(energy, _change(*runs), *([_stages(*staged)] if staged else []), _section(runs))
    layout = rrb.Horizontal(*columns, plots, column_shares=[*(1.0 for _ in runs), 1.2])
    return _opened(layout, PICTURES, A_PICTURE)


def sequence(
    unit: str,
    middle: float,
    far: float,
    shape: tuple[int, ...],
    timeline: str,
    curves: Mapping[str, Sequence[str]] | None = None,
) -> Layout:
    """Pictures of a video's frame above, its surface and the curves over the frames below.

    `middle` and `far` are distances of the first surface, in `unit`, `shape` that of its map; `curves` are
    titles of what lies below ``plots``.
    """
    distance = _scaled("depth", f"Distance [{unit}]", shape)
    frame = rrb.Spatial2DView(origin="/input", name="Frame")
    pictures = [frame, distance, rrb.Spatial2DView(origin="/normals", name="Normals")]
    curves = curves or {
        "Energy": ["energy"],
        f"Median distance [{unit}]": ["median_distance"],
        "Gain": ["gain"],
        "Iterations, seconds": ["iterations", "seconds"],
    }
    plots = [
        rrb.TimeSeriesView(origin="/", contents=[f"/plots/{name}" for name in names], name=title)
        for title, names in curves.items()
    ]
    surface = _space(f"Surface [{unit}]", np.array([0.0, 0.0, middle]), 1.5 * far)
    below = rrb.Horizontal(surface, rrb.Grid(*plots, grid_columns=2), column_shares=[1, 1.2])
    return _opened(rrb.Vertical(rrb.Horizontal(*pictures), below, row_shares=[1, 1.3]), timeline)


def calibration(
    centre: FloatArray,
    distance: float,
    curves: Mapping[str, str],
    maps: Mapping[str, tuple[str, tuple[int, ...]]],
    light: bool,
    timeline: str,
) -> Layout:
    """The frame, the sheet in space, the curves over the frames; behind tabs the light's fit and the maps.

    The sheet is mostly at `centre`, (3,), mm, `distance` away; `curves` are titles of what lies
    below ``plots``, `maps` titles and shapes of what lies below ``uncertainty``; `light` tells whether it
    was fitted.
    """
    fit: list[rrb.View | rrb.Container] = [
        rrb.TimeSeriesView(origin="/fit", contents=["/fit/k", "/fit/gamma"], name="k and γ"),
        rrb.TimeSeriesView(origin="/fit", contents=["/fit/sigma"], name="σ [grey levels]"),
    ]
    if light:
        fit.append(rrb.Spatial2DView(origin="/brdf", name="BRDF over θ [°]"))
    fit.append(rrb.BarChartView(origin="/residuals", name="Residuals [grey levels]"))
    found = ["/picture", "/picture/detected", "/picture/reprojection"]
    read = ["/picture", "/picture/samples"]
    # Between the camera and where the sheet mostly is.
    sheet = _space("Sheet", centre / 2, 2.0 * distance, direction=(-0.6, -0.4, -0.7))
    plots = [rrb.TimeSeriesView(origin=f"/plots/{entity}", name=title) for entity, title in curves.items()]
    tabs: list[rrb.View | rrb.Container] = [
        rrb.TextDocumentView(origin="/account", name="Account"),
        rrb.Vertical(*fit, name="Fit"),
    ]
    if maps:
        known = [_scaled(f"uncertainty/{name}", *what) for name, what in maps.items()]
        tabs.append(rrb.Vertical(*known, name="Uncertainty"))
    columns = (
        rrb.Vertical(
            rrb.Spatial2DView(origin="/", contents=found, name="Detection"),
            rrb.Spatial2DView(origin="/", contents=read, name="Brightness"),
        ),
        rrb.Vertical(sheet, rrb.Horizontal(*plots), row_shares=[2, 1]),
        rrb.Tabs(*tabs),
    )
    return _opened(rrb.Horizontal(*columns, column_shares=[1.2, 1.5, 1]), timeline)
