"""How the Rerun viewer opens a recording: what is shown, and where."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from endolab.numerics.arrays import FloatArray
from endolab.workbench.plots.scales import MAPS
from endolab.workbench.recording.pictures import DIFFERENCES, ENDS, ROUNDS

ITERATIONS = "iteration"  # a timeline
FRAMES = "frame"  # another
LAMBDAS = "1000 log10 λ"  # a third, whose steps have names as well
FROM_BEHIND = (-0.5, -0.35, -0.8)  # the camera, to its left and above it
EYE = 2.0  # times half the surface's diagonal, from its middle: it then fills its panel


# Titles of maps and curves that may have been recorded, by entity.
MAPS_SHOWN = {
    entity: f"{MAPS[name].title}, {ENDS[name][0]:g} to {ENDS[name][1]:g} {MAPS[name].unit}"
    for entity, name in DIFFERENCES.items()
}
MAPS_SHOWN |= {"normals": "Normals", "dominant_source": "What determined each pixel"}
CURVES = {
    "log10/energy": "log₁₀ energy",
    "log10/change": "log₁₀ change of log d",
    "plots/error": "Mean error [%]",
    "plots/energy": "Energy",
    "plots/median_distance": "Median distance",
    "plots/gain": "Gain",
    "plots/iterations": "Iterations",
    "plots/seconds": "Seconds",
}


@dataclass(frozen=True, eq=False)
class Shown:
    """A run that was recorded, as far as the layout depends on it."""

    run: str  # its name, which its entities begin with; empty if the run is alone
    unit: str  # of distances
    limits: tuple[float, float]  # of distances
    box: FloatArray  # two corners of the surface, (2, 3)

    def title(self, words: str) -> str:
        """Title of a view, with the run's name."""
        return f"{words} · {self.run}" if self.run else words

    def view(self, title: str, *entities: str) -> rrb.Spatial2DView:
        """A map, with what is laid over it."""
        contents = [f"{self.run}/{entity}" for entity in entities]
        return rrb.Spatial2DView(contents=contents, name=self.title(title))

    def space(self, title: str, entity: str) -> rrb.Spatial3DView:
        """Points in space, beside the camera, seen from behind it."""
        middle = self.box.mean(axis=0)
        away = EYE * np.linalg.norm(self.box[1] - middle)
        origin = f"{self.run}/world"
        return rrb.Spatial3DView(
            origin=origin,
            contents=[f"{origin}/camera", f"{origin}/{entity}"],
            name=self.title(f"{title} [{self.unit}]"),
            eye_controls=rrb.EyeControls3D(
                position=middle + away * np.array(FROM_BEHIND),
                look_target=middle,
                eye_up=[0, -1, 0],
            ),
            background=(45, 50, 58),
            line_grid=False,
        )

    def pictures(self, entities: Collection[str], wide: int) -> rrb.Grid:
        """All pictures of the run, so many side by side."""
        near, far = self.limits
        lines = ", ".join(f"{x:g}" for x in ROUNDS if near < x < far)
        words = f"Distance [{self.unit}], lines at {lines}"
        shown = {name: title for name, title in MAPS_SHOWN.items() if name in entities}
        maps = [self.view(title, name) for name, title in shown.items()]
        is_known = "world/truth" in entities
        spaces = [self.space("Surface", "cloud")]
        spaces += [self.space("Truth", "truth")] if is_known else []
        cut = f"Section [{self.unit}]: {'truth grey, estimate orange' if is_known else 'estimate'}"
        return rrb.Grid(
            self.view("Frame", "input", "found"),
            self.view(words, "distance"),
            rrb.Tabs(*maps, active_tab=0),
            rrb.Tabs(*spaces, self.view(cut, "section/**"), active_tab=0),
            grid_columns=wide,
        )


class Layout(rrb.Blueprint):
    """How a recording opens. Its `stream`, on which Rerun writes it down, ends when it is disconnected."""

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        self.stream = stream
        super()._log_to_stream(stream)


def layout(runs: Sequence[Shown], entities: Collection[str], timeline: str) -> Layout:
    """Pictures and surface of each run, side by side; curves, stages and words of all beside them.

    `entities` are those that were logged of a run.
    """
    alone = len(runs) == 1
    beside: list[rrb.View] = [
        rrb.TimeSeriesView(
            contents=[f"{one.run}/{curve}/**" for one in runs],
            name=title,
            # Of one run the list of stages is the legend.
            plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop, visible=not alone),
            # A few iterates make no line.
            interaction=rrb.PlotInteraction(points_display="always"),
        )
        for curve, title in CURVES.items()
        if any(entity.startswith(curve) for entity in entities)
    ]
    stages = [f"{one.run}/stage" for one in runs]
    columns = rrb.TextLogColumns(
        text_log_columns=["body"] if alone else ["entitypath", "body"]
    )
    words: list[rrb.View] = [
        rrb.TextLogView(contents=stages, name="Stages", columns=columns)
    ]
    for one in runs:
        where = f"{one.run}/settings"
        words.append(rrb.TextDocumentView(origin=where, name=one.title("Settings")))
    sides = [one.pictures(entities, 2 if alone else 1) for one in runs]
    last = rrb.Vertical(rrb.Tabs(*beside, active_tab=0), rrb.Tabs(*words, active_tab=0))
    return Layout(
        rrb.Horizontal(*sides, last, column_shares=[2 if alone else 1, *[1] * len(runs)]),
        # Slow enough for a run of few iterates.
        rrb.TimePanel(state="collapsed", timeline=timeline, fps=5),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )
