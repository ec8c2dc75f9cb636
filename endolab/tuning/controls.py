"""The tuner's knobs: eight in sight, counting *reset*, and the others below *advanced*."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from endolab.depth.problem import REGULARISERS
from endolab.model.photometry import Photometry
from endolab.tuning.panels import TEXTURES

VIEWS = {"section": 50.0, "across": False, "texture": "frame"}  # change what is seen and not what is solved
AUTO = ("auto", None)


@dataclass(frozen=True)
class Knob:
    """A list if there are `options`, a slider if there is a `range`, else a line that may stay empty."""

    name: str  # of `Settings`, or of `VIEWS`
    label: str
    tip: str
    options: Sequence[tuple[str, Any]] = ()  # as they are called, and their values
    range: tuple[float, float, float] | None = None  # least, greatest and step, ...
    log: bool = False  # ... of the value, or of its decimal logarithm
    hint: str = ""  # in an empty line
    first: float | None = None  # what None stands for


def described(
    scenes: Sequence[tuple[str, Any]], widths: Sequence[int], known: Photometry
) -> list[dict[str, Any]]:
    """Describe all knobs to the page: frames and scenes by name, widths, and a light as it is calibrated."""
    channels = ["auto", "separated", "red", "green", "blue", "grey"]
    solvers = [("Gauss-Newton", "gauss_newton"), ("primal-dual", "primal_dual")]
    solvers += [("fast marching", "fast_marching"), ("facing", "facing")]
    lam = "More makes the surface smoother, less lets it follow the picture."
    regulariser = "What is smoothed: slopes (first), bends (second), or the surface's own curvature."
    channel = "The colour that is explained; separated takes bounced light out and deepens folds."
    contours = "Whether the surface is torn where a fold hides what lies behind it."
    highlights = "Whether mirrored light is taken for a near wall, passed over, or filled in."
    scene = "What is looked at: the frame, or a rendered scene whose true surface is known."
    in_sight = [
        Knob("lam", "λ", lam, range=(-4, 2, 0.1), log=True),
        Knob("regulariser", "regulariser", regulariser, _named("auto", *REGULARISERS)),
        Knob("channel", "channel", channel, [("green or grey", None), *_named(*channels)]),
        Knob("contours", "contours", contours, [AUTO, ("torn", True), ("not torn", False)]),
        Knob("highlights", "highlights", highlights, [AUTO, *_named("keep", "ignore", "inpaint")]),
        Knob("scene", "frame or scene", scene, scenes),
        Knob("width", "width [px]", "More columns show finer relief and take longer.", _named(*widths)),
    ]
    xi = "The map that is smoothed: with 1/d what is near keeps more relief."
    epsilon = "More makes creases round, less makes them sharp."
    solver = "How the surface is found; facing and fast marching do not smooth it."
    iterations = "The most steps of the solver: few leave the surface near its start."
    smooth = "Blurs the light first: more hides noise, and small folds."
    k = "Light spread that the solver believes in: a wrong one bends the rim."
    gamma = "Response that the solver believes in: a wrong one bends all, the dark most."
    gain = "Brightness that the solver believes in: more puts all farther away."
    albedo = "The wall's colour that the solver believes in, 0 to 1: it tells how much light bounced."
    noise = "Noise of a rendered scene, grey levels of 255: more roughens the surface."
    section = "Where the surface is cut; a press on a map lays it there."
    folded = [
        Knob("xi", "ξ", xi, _named("1/d", "1/z", "d")),
        Knob("epsilon", "ε", epsilon, range=(-5, -1, 0.1), log=True),
        Knob("solver", "solver", solver, solvers),
        Knob("max_iterations", "iterations", iterations, hint="as it takes"),
        Knob("smooth", "smooth [px]", smooth, hint="by the noise"),
        Knob("k", "k", k, range=(0, 8, 0.1), first=known.k),
        Knob("gamma", "γ", gamma, range=(1, 3, 0.05), first=known.gamma),
        Knob("gain", "gain ×", gain, range=(-1, 1, 0.1), log=True),
        Knob("albedo", "albedo", albedo, hint="red, green, blue"),
        Knob("noise", "noise", noise, range=(0, 8, 0.5)),
        Knob("section", "section [%]", section, range=(0, 100, 0.5)),
        Knob("across", "section along", "Which way the surface is cut.", [("column", False), ("row", True)]),
        Knob("texture", "3D shows", "What lies on the surface in 3D.", _named(*TEXTURES)),
    ]
    return [vars(knob) | {"hidden": knob in folded} for knob in (*in_sight, *folded)]


def _named(*values: Any) -> list[tuple[str, Any]]:
    return [(str(value), value) for value in values]
