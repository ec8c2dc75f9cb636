"""How the Rerun viewer opens a recording: what is shown, where, and how large.

`reconstruction` shows everything about a run, `convergence` its curves at large, `comparison`
several runs side by side, `sequence` a video's frames, `calibration` a calibration's frames,
sheet and fit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from endolab.numerics.arrays import FloatArray

TIMELINE = "iteration"
BACKGROUND = (45, 50, 58)


@dataclass(frozen=True)
class Shown:
    """What a recorded run holds, as far as the layout depends on it."""

    run: str  # its name, which its entities begin with; empty if the run is alone
    unit: str  # of distances
    terms: tuple[str, ...]  # of the energy
    maps: tuple[str, ...]  # of the solver
    low: FloatArray  # (3,), ends of the surface along x, y and z
    high: FloatArray
    far: float  # z up to which the section is shown
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


def _opened(layout: rrb.Container, timeline: str = TIMELINE) -> Layout:
    """A layout with the timeline to open on, and without panels beside it."""
    return Layout(
        layout,
        rrb.TimePanel(state="collapsed", timeline=timeline),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )


def _picture(shown: Shown, entity: str, title: str) -> rrb.Spatial2DView:
    return rrb.Spatial2DView(origin=shown.at(entity), name=shown.called(title))


def _depth(shown: Shown) -> rrb.Spatial2DView:
    contents, name = [shown.at("depth"), shown.at("mask")], shown.called(f"Distance [{shown.unit}]")
    return rrb.Spatial2DView(origin=shown.at(""), contents=contents, name=name)


def _trust(shown: Shown) -> list[rrb.View]:
    """How far the run's end can be trusted, if it was recorded."""
    if shown.sigma is None:
        return []
    contents = [shown.at("front/trust/sigma"), shown.at("front/trust/mask")]
    title = f"σ, 0 to {shown.sigma:g} %"  # a tab has no room for more; the words tell the rest
    sigma = rrb.Spatial2DView(origin=shown.at("front/trust"), contents=contents, name=shown.called(title))
    return [sigma, _picture(shown, "front/trust/decided_by", "Who decided")]


def _surface(shown: Shown) -> rrb.Spatial3DView:
    target = (shown.low + shown.high) / 2
    away = 0.9 * float(np.linalg.norm(shown.high - shown.low))
    hidden = [shown.at("world/truth")]
    return _space(shown.called("Surface"), target, away, origin=shown.at("world"), hidden=hidden)


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
    far = max(shown.far for shown in runs)
    top, bottom = min(shown.low[1] for shown in runs), max(shown.high[1] for shown in runs)
    bounds = rrb.VisualBounds2D(x_range=[-0.1 * far, 1.1 * far], y_range=[1.2 * top, 1.2 * bottom])
    contents = [shown.at("section/**") for shown in runs]
    return rrb.Spatial2DView(origin="/", contents=contents, name="Middle column", visual_bounds=bounds)


def _curves(title: str, contents: Sequence[str]) -> rrb.TimeSeriesView:
    legend = rrb.PlotLegend(corner=rrb.Corner2D.RightTop)
    return rrb.TimeSeriesView(origin="/", contents=list(contents), name=title, plot_legend=legend)


def _energy(shown: Shown) -> rrb.TimeSeriesView:
    return _curves("Energy", [shown.at(f"plots/{name}") for name in ("energy", *shown.terms)])


def _change(*runs: Shown) -> rrb.TimeSeriesView:
    return _curves("Change of log-distance", [shown.at("plots/change") for shown in runs])


def _others(shown: Shown, *left_out: str) -> rrb.TimeSeriesView:
    """Curves of other scalars, without some and without a mere count, which would flatten the others."""
    without = [f"- {shown.at(f'plots/{name}')}" for name in ("energy", *shown.terms, *left_out, "steps")]
    return _curves("Steps", [shown.at("plots/**"), *without])


def reconstruction(shown: Shown) -> Layout:
    """Pictures above, the surface and the curves below."""
    residual = [_picture(shown, "residual", "Residual")]
    residual += [_picture(shown, f"front/{name}", name.capitalize()) for name in shown.maps]
    trust = _trust(shown)
    documents = [rrb.TextDocumentView(origin=shown.at("settings"), name="Settings")]
    if trust:
        documents.append(rrb.TextDocumentView(origin=shown.at("front/trust/words"), name="Trust"))
    words: rrb.View | rrb.Container = rrb.Tabs(*documents, _others(shown))
    if shown.staged:
        stage = rrb.TextDocumentView(origin=shown.at("stage"), name="Stage")
        words = rrb.Vertical(stage, words, row_shares=[1, 7])
    frame = rrb.Spatial2DView(origin=shown.at(""), contents=[shown.at("input")], name="Frame")
    last = rrb.Tabs(*residual, active_tab=0 if shown.staged else len(residual) - 1)
    facing = _picture(shown, "normals", "Normals")
    normals: rrb.View | rrb.Container = rrb.Tabs(*trust, facing, active_tab=0) if trust else facing
    pictures = rrb.Horizontal(frame, _depth(shown), normals, last)
    curves = rrb.Vertical(_energy(shown), _section([shown]))
    below = rrb.Horizontal(_surface(shown), curves, words, column_shares=[2, 1.4, 1])
    return _opened(rrb.Vertical(pictures, below, row_shares=[1, 1.4]))


def convergence(shown: Shown) -> Layout:
    """Curves of energy, change and steps above, at large; what they mean for the surface below."""
    steps = rrb.Vertical(_change(shown), _others(shown, "change"))
    curves = rrb.Horizontal(_energy(shown), steps, column_shares=[1.4, 1])
    below = rrb.Horizontal(_picture(shown, "residual", "Residual"), _section([shown]), _depth(shown))
    return _opened(rrb.Vertical(curves, below, row_shares=[1.4, 1]))


BLUEPRINTS = {"reconstruction": reconstruction, "convergence": convergence}


def comparison(runs: Sequence[Shown]) -> Layout:
    """Each run a column of pictures; energies and sections of all in one plot each, beside them."""
    columns = [
        rrb.Vertical(
            _depth(shown), _picture(shown, "residual", "Residual"), *_trust(shown)[:1], name=shown.run
        )
        for shown in runs
    ]
    energy = _curves("Energy", [shown.at("plots/energy") for shown in runs])
    plots = rrb.Vertical(energy, _change(*runs), _section(runs))
    return _opened(rrb.Horizontal(*columns, plots, column_shares=[*(1.0 for _ in runs), 1.2]))


def sequence(
    unit: str, middle: float, far: float, timeline: str, curves: Mapping[str, Sequence[str]] | None = None
) -> Layout:
    """Pictures of a video's frame above, its surface and the curves over the frames below.

    `middle` and `far` are distances of the first surface, in `unit`; `curves` are titles of what lies below
    ``plots``.
    """
    titles = {"input": "Frame", "depth": f"Distance [{unit}]", "normals": "Normals"}
    pictures = [rrb.Spatial2DView(origin=f"/{entity}", name=title) for entity, title in titles.items()]
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
    maps: Mapping[str, str],
    light: bool,
    timeline: str,
) -> Layout:
    """The frame, the sheet in space, the curves over the frames; behind tabs the light's fit and the maps.

    The sheet is mostly at `centre`, (3,), mm, `distance` away; `curves` are titles of what lies
    below ``plots``, `maps` of what lies below ``uncertainty``; `light` tells whether it was fitted.
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
        known = [rrb.Spatial2DView(origin=f"/uncertainty/{name}", name=title) for name, title in maps.items()]
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
