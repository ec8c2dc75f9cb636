"""The tuner's knobs: eight in sight, the others below *advanced*."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import ipywidgets as w

from endolab.depth.problem import REGULARISERS
from endolab.tuning.panels import TEXTURES
from endolab.tuning.source import Settings

SIGHT = ("lam", "regulariser", "channel", "contours", "highlights", "scene", "width")  # and reset
VIEWS = ("section", "across", "texture")  # knobs that change what is seen and not what is solved
LOGARITHMIC = ("lam", "epsilon", "gain")
LINES = {"smooth": 1, "max_iterations": 1, "albedo": 3}  # how many numbers each has
TENTH = 0.1  # of a decade, by which an arrow key moves
ROUNDED = 2  # digits of what a slider says: the number that is shown is the one that counts
CHANNELS = [(name, name) for name in ("auto", "separated", "red", "green", "blue", "grey")]
HIGHLIGHTS = [(name, name) for name in ("keep", "ignore", "inpaint")]
SOLVERS = [("Gauss-Newton", "gauss_newton"), ("primal-dual", "primal_dual")]
SOLVERS += [("fast marching", "fast_marching"), ("facing", "facing")]
AUTO = [("auto", "")]
WIDE = {"lam": "330px", "scene": "170px", "width": "80px"}  # else as wide as their kind
NAMES = {"lam": "λ", "scene": "frame or scene", "width": "width [px]", "xi": "ξ", "epsilon": "ε"}
NAMES |= {"max_iterations": "iterations", "smooth": "smooth [px]", "gamma": "γ", "gain": "gain ×"}
NAMES |= {"section": "section [%]", "across": "section along", "texture": "3D shows"}
TIPS = {
    "lam": "More makes the surface smoother, less lets it follow the picture.",
    "regulariser": "What is smoothed: slopes (first), bends (second), or the surface's own curvature.",
    "channel": "The colour that is explained; separated takes bounced light out and deepens folds.",
    "contours": "Whether the surface is torn where a fold hides what lies behind it.",
    "highlights": "Whether mirrored light is taken for a near wall, passed over, or filled in.",
    "scene": "What is looked at: the frame, or a rendered scene whose true surface is known.",
    "width": "More columns show finer relief and take longer.",
    "xi": "The map that is smoothed: with 1/d what is near keeps more relief.",
    "epsilon": "More makes creases round, less makes them sharp.",
    "solver": "How the surface is found; facing and fast marching do not smooth it.",
    "max_iterations": "The most steps of the solver: few leave the surface near its start.",
    "smooth": "Blurs the light first: more hides noise, and small folds.",
    "k": "Light spread that the solver believes in: a wrong one bends the rim.",
    "gamma": "Response that the solver believes in: a wrong one bends all, the dark most.",
    "gain": "Brightness that the solver believes in: more puts all farther away.",
    "albedo": "The wall's colour that the solver believes in, 0 to 1: it tells how much light bounced.",
    "noise": "Noise of a rendered scene, grey levels of 255: more roughens the surface.",
    "section": "Where the surface is cut; a press on a map lays it there.",
    "across": "Which way the surface is cut.",
    "texture": "What lies on the surface in 3D.",
}


def choice(options: Sequence[Any]) -> w.Dropdown:
    """One of some options, at first the first one."""
    return w.Dropdown(options=options, layout={"width": "112px"})


def log_slider(value: float, low: float, high: float) -> w.FloatLogSlider:
    """A number between two powers of ten, which can be typed too."""
    how = {"step": TENTH, "readout_format": ".2g", "layout": {"width": "170px"}}
    return w.FloatLogSlider(value, min=low, max=high, **how)


def slider(value: float, low: float, high: float, step: float) -> w.FloatSlider:
    """A number between two others."""
    return w.FloatSlider(value, min=low, max=high, step=step, layout={"width": "170px"})


def line(hint: str) -> w.Text:
    """A line that may stay empty, read when it is done."""
    return w.Text(placeholder=hint, continuous_update=False, layout={"width": "130px"})


def button(name: str, tip: str, action: Callable[[], object]) -> w.Button:
    """A button as wide as its name."""
    made = w.Button(description=name, tooltip=tip, layout={"width": "auto"})
    made.on_click(lambda _: action())
    return made


class Knobs:
    """All of them, by the names of `Settings`, and those of `VIEWS`; `changed` is called with a name."""

    def __init__(
        self, scenes: Sequence[tuple[str, Any]], width: int, changed: Callable[[str], object]
    ) -> None:
        self.all: dict[str, Any] = {
            "lam": log_slider(1.0, -4, 2),
            "regulariser": choice(["auto", *REGULARISERS]),
            "channel": choice([("green or grey", ""), *CHANNELS]),
            "contours": choice([*AUTO, ("torn", True), ("not torn", False)]),
            "highlights": choice([*AUTO, *HIGHLIGHTS]),
            "scene": choice(scenes),
            "width": choice(sorted({160, 320, 480, 640, width})),
            "xi": choice(["1/d", "1/z", "d"]),
            "epsilon": log_slider(1e-3, -5, -1),
            "solver": choice(SOLVERS),
            "max_iterations": line("as it takes"),
            "smooth": line("by the noise"),
            "k": slider(2.5, 0, 8, 0.1),
            "gamma": slider(2.2, 1, 3, 0.05),
            "gain": log_slider(1.0, -1, 1),
            "albedo": line("red, green, blue"),
            "noise": slider(0.0, 0, 8, 0.5),
            "section": slider(50, 0, 100, 0.5),
            "across": choice(["column", "row"]),
            "texture": choice(TEXTURES),
        }
        self.named: dict[str, w.VBox] = {}  # each below its name
        for name, knob in self.all.items():
            knob.tooltip = TIPS[name]
            knob.layout.width = WIDE.get(name, knob.layout.width)
            said = w.Label(NAMES.get(name, name), tooltip=TIPS[name])
            self.named[name] = w.VBox([said, knob])
            self.named[name].add_class("endolab-knob")
        self.all["width"].value = width
        self._quiet = False
        self.frame = 0  # which one is looked at, of those among the scenes
        for name, knob in self.all.items():
            knob.observe(lambda _, name=name: None if self._quiet else changed(name), "value")

    def __getitem__(self, name: str) -> Any:
        return self.all[name]

    def reset_light(self, k: float, gamma: float) -> None:
        """Set k and γ to what the calibration says."""
        self._calibrated = {"k": k, "gamma": gamma}
        with self.quiet():
            for name, value in self._calibrated.items():
                self._set(name, value)

    @contextmanager
    def quiet(self) -> Iterator[None]:
        """Move knobs without a word."""
        self._quiet = True
        try:
            yield
        finally:
            self._quiet = False

    def settings(self) -> Settings:
        """What the knobs say; ValueError, in one sentence, if a line cannot be read."""
        values = {name: knob.value for name, knob in self.all.items() if name not in VIEWS}
        for name in LOGARITHMIC:
            values[name] = float(f"{values[name]:.{ROUNDED}g}")
        for name, calibrated in self._calibrated.items():
            is_so = abs(values[name] - calibrated) < 1e-9
            values[name] = None if is_so else float(f"{values[name]:.6g}")
        for name, count in LINES.items():
            found = numbers(values[name], name, count)
            values[name] = found if found is None or count > 1 else found[0]
        most = values["max_iterations"]
        if most is not None and most != round(most):
            raise ValueError(f"max_iterations: expected a whole number, found {most:g}")
        values["max_iterations"] = None if most is None else int(most)
        for name in ("channel", "highlights", "contours"):
            values[name] = None if values[name] == "" else values[name]
        values["scene"] = values["scene"] if isinstance(values["scene"], str) else None
        return Settings(**values)

    def take(self, settings: Settings) -> None:
        """Say what settings do, without a word; which frame is looked at stays."""
        with self.quiet():
            for name, value in vars(settings).items():
                if name in self._calibrated and value is None:
                    value = self._calibrated[name]
                if name in LINES:
                    value = "" if value is None else ", ".join(f"{one:g}" for one in numbers_of(value))
                elif value is None:
                    value = self.frame if name == "scene" else ""
                self._set(name, value)

    def _set(self, name: str, value: Any) -> None:
        knob = self.all[name]
        if isinstance(knob, w.FloatSlider):
            knob.min, knob.max = min(knob.min, value), max(knob.max, value)
        if name not in LOGARITHMIC or f"{knob.value:.{ROUNDED}g}" != f"{value:.{ROUNDED}g}":
            knob.value = value


def numbers_of(value: Any) -> tuple[float, ...]:
    """One number, or several, as several."""
    return value if isinstance(value, tuple) else (value,)


def numbers(text: str, name: str, count: int) -> tuple[float, ...] | None:
    """So many numbers of a line, or None of an empty one; ValueError, in one sentence, otherwise."""
    if not text.strip():
        return None
    try:
        found = tuple(float(one) for one in text.split(","))
    except ValueError:
        found = ()
    if len(found) != count:
        expected = "a number" if count == 1 else f"{count} numbers with commas between"
        raise ValueError(f"{name}: expected {expected}, found {text!r}")
    return found
