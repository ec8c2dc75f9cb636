"""What the tuner can show of an answer: a map or a chart for each subject."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator

from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.reconstruction.contrast import ENOUGH_CONTRAST
from endolab.reconstruction.uncertainty import bounced_light
from endolab.solvers.problem import LOWER_BOUND, NONE
from endolab.workbench.plots.scales import (
    OKABE_ITO,
    SOURCE_COLOURS,
    Colour,
    break_line,
    common_limit,
    common_limits,
    round_length,
)
from endolab.workbench.tuning.engine import LAM_FACTORS, Answer, Stage
from endolab.workbench.tuning.pictures import (
    DRAWING,
    WHOLE,
    Chart,
    Curve,
    Dot,
    Drawing,
    Limits,
    Map,
    Window,
    grey_or_colour,
    remember,
    to_colours,
)
from endolab.workbench.tuning.tried import Tried, lines_of, suggested_lam


@dataclass(frozen=True)
class View:
    """How an answer is looked at."""

    # Whether the section is a row, and how far down or to the right.
    line: tuple[bool, float] = (False, 0.5)
    like: Answer | None = None  # whose scales are taken, by default the answer's own
    beside: Answer | None = None  # A, whose section is shown as well
    tried: Sequence[Tried] = ()  # what the λ curve shows
    room: tuple[int, int] = (1200, 640)  # of the board, px
    text: int = 12  # px, of letters
    zoom: Window = WHOLE  # the part of the maps that is shown
    look: Drawing = DRAWING


Panel = Map | Chart
SECTION_COLOURS = {
    "truth": OKABE_ITO.black,
    "result": OKABE_ITO.vermilion,
    "A": OKABE_ITO.green,
    "B": OKABE_ITO.vermilion,
}


def end_of(values: FloatArray) -> float:
    """A round end of a scale, beyond 98 % of the values, so that a colour keeps its meaning a while."""
    return max(2.0, 2.5 * round_length(common_limit([values])))


def _scale_distance(answer: Answer) -> FloatArray:
    """The distance that sets the scales: the true one if it is known."""
    return answer.result.distance if answer.truth is None else answer.truth


def _value_map(
    title: str, values: FloatArray, limits: Limits, palette: str, form: str, **options: Any
) -> Map:
    """A map of numbers; `form` is how one of them is told."""
    colours = to_colours(values, limits, palette)
    return Map(
        title,
        colours,
        limits,
        palette,
        says=lambda i, j: form.format(values[i, j]),
        **options,
    )


_frame_colours = remember(grey_or_colour)


def _frame(answer: Answer, view: View) -> Panel:
    shown = answer.result.problem.shown

    def says(i: int, j: int) -> str:
        return " ".join(f"{value:.0f}" for value in np.atleast_1d(255 * shown[i, j]))

    title = f"Frame, {shown.shape[1]} x {shown.shape[0]} px [of 255]"
    return Map(title, _frame_colours(shown), line=view.line, says=says)


def _distance(answer: Answer, view: View) -> Panel:
    unit = answer.result.problem.unit
    low, high = common_limits([_scale_distance(view.like or answer)])
    title = f"Distance [{unit}]"
    if answer.stage != Stage.FINAL:
        title += f", {answer.stage}"
    distance = answer.result.distance
    limits = (low, max(high, 1.01 * low))
    return Map(
        title,
        to_colours(distance, limits, log=True),
        limits,
        line=view.line,
        says=lambda i, j: f"{distance[i, j]:.4g} {unit}",
        distance=distance,
    )


def _residual(answer: Answer, view: View) -> Panel:
    residual = answer.residual
    # Two standard deviations of the noise are no news.
    floor = 2 * 255 * answer.noise
    end = end_of((view.like or answer).residual)
    quiet = np.abs(residual) <= floor
    share = 100 * float(quiet.sum()) / max(int(np.isfinite(residual).sum()), 1)
    title = f"Model - frame [of 255], {share:.0f} % within the noise"
    limits = (-end, end)
    picture = to_colours(residual, limits, "RdBu_r")
    picture[quiet] = DRAWING.below_noise

    def says(i: int, j: int) -> str:
        return f"{residual[i, j]:+.1f} grey levels"

    return Map(title, picture, limits, "RdBu_r", says=says)


def _error(answer: Answer, view: View) -> Panel:
    error = answer.error
    if error is None:
        return Map("Error: the truth is unknown", None)
    like = (view.like or answer).error
    end = end_of(error if like is None else like)
    title = f"Error of the distance [%], median {answer.median_error:.2g}"
    return _value_map(title, error, (-end, end), "RdBu_r", "{:+.1f} %")


def _normals(answer: Answer, view: View) -> Panel:
    return Map("Normals, (n + 1)/2", grey_or_colour((answer.result.normals + 1) / 2))


def _contours(answer: Answer, view: View) -> Panel:
    """Where the surface is cut, and what pixels say."""
    problem = answer.result.problem
    grey = np.mean(np.atleast_3d(problem.shown), axis=-1)
    picture = grey_or_colour(0.35 + 0.5 * grey)
    nowhere = np.zeros(problem.mask.shape, bool)
    evidence = nowhere if problem.evidence is None else problem.evidence
    cut = nowhere if problem.cuts is None else problem.cuts.any(axis=0)
    parts = [
        ("saturated: at least so bright", evidence == LOWER_BOUND, OKABE_ITO.orange),
        ("highlight: ignored", evidence == NONE, OKABE_ITO.purple),
        ("left out", ~problem.mask, DRAWING.left_out),
        (f"cut, {answer.cut_count:,} px", cut, OKABE_ITO.vermilion),
    ]
    for _, where, colour in parts:
        picture[where] = colour
    keys = [(name, colour) for name, where, colour in parts if where.any()]

    def says(i: int, j: int) -> str:
        return ", ".join(name for name, where, _ in parts if where[i, j])

    return Map("Contours and highlights", picture, keys=keys, says=says)


def _indirect_light(answer: Answer, view: View) -> Panel:
    if answer.stage != Stage.FINAL:
        return Map("Bounced light: with the final answer", None)
    result = answer.result
    share = np.where(result.mask, -100 * np.expm1(-bounced_light(result.iterate)), np.nan)
    taken = "left in" if result.provenance.albedo is None else "removed"
    title = f"Bounced light [% of all], {taken}"
    return _value_map(title, share, (0.0, end_of(share)), "magma", "{:.1f} %")


def _sigma(answer: Answer, view: View) -> Panel:
    if answer.uncertainty is None:
        return Map("σ: press find σ, below advanced", None)
    percent = 100 * answer.uncertainty.sigma / answer.result.distance
    title = f"σ of the distance [%], median {np.nanmedian(percent):.2g}"
    return _value_map(title, percent, (0.0, end_of(percent)), "magma", "± {:.1f} %")


def _dominant_source(answer: Answer, view: View) -> Panel:
    uncertainty = answer.uncertainty
    if uncertainty is None:
        return Map("What determined each pixel: press find σ, below advanced", None)
    colours = np.array([DRAWING.left_out, *SOURCE_COLOURS.values()], np.uint8)
    names = ("left out", *SOURCE_COLOURS)

    def says(i: int, j: int) -> str:
        return names[uncertainty.dominant_source[i, j]]

    return Map(
        "What determined each pixel",
        colours[uncertainty.dominant_source],
        keys=[*SOURCE_COLOURS.items()],
        says=says,
    )


def _section(answer: Answer, view: View) -> Panel:
    """Section of an answer, on axes that suit the truth, or else the result, of the one it is like."""
    unit = answer.result.problem.unit
    is_row, share = view.line
    length = answer.result.mask.shape[not is_row]
    index = min(int(share * length), length - 1)
    rays = answer.result.problem.field.rays
    line = np.s_[index] if is_row else np.s_[:, index]
    across = 0 if is_row else 1

    def section_line(
        distance: FloatArray, cuts: BoolArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """z, and x of a row or y of a column, with a gap where the surface is cut."""
        points = rays[line] * distance[line][:, None]
        if cuts is not None:
            points = break_line(points, cuts[across][line])
        return points[:, 2], points[:, across]

    def locate(i: int, j: int) -> FloatArray:
        point = rays[i, j] * answer.result.distance[i, j]
        return np.array([point[2], point[across]])

    shown = {"result": answer}
    if view.beside is not None:
        shown = {"A": view.beside, "B": answer}
    curves = [
        (
            name,
            *section_line(other.result.distance, other.result.problem.cuts),
            SECTION_COLOURS[name],
        )
        for name, other in shown.items()
    ]
    if answer.truth is not None:
        curves = [("truth", *section_line(answer.truth), SECTION_COLOURS["truth"]), *curves]
    title = f"Section along {'row' if is_row else 'column'} {index}"
    return Chart(
        title,
        f"z [{unit}]",
        f"{'xy'[across]} [{unit}]",
        curves,
        down=not is_row,
        equal=True,
        fitted=section_line(_scale_distance(view.like or answer)),
        locate=locate,
    )


def _energy(answer: Answer, view: View) -> Panel:
    history = answer.result.history
    steps = np.array([entry["k"] for entry in history], float)
    curves = []
    for name, colour in (
        ("data", OKABE_ITO.blue),
        ("regulariser", OKABE_ITO.vermilion),
        ("energy", OKABE_ITO.black),
    ):
        values = np.array([entry[name] for entry in history])
        curves.append((name, steps, values, colour))
    title = f"Energy, {answer.result.iterations} iterations"
    return Chart(title, "iteration", "energy [1]", curves, log=(False, True))


def _lam_curve(answer: Answer, view: View) -> Panel:
    """Explained contrast and roughness over λ: a line for each set of contours, this answer's in colour."""
    if not answer.uses_lam:
        return Map(f"λ curve: {answer.settings.solver} has no λ", None)
    lines = lines_of(view.tried, answer)
    roughest = max((tried.roughness for line in lines for tried in line), default=1.0)
    curves: list[Curve] = []
    dots: list[Dot] = []
    for line in filter(None, lines):
        is_now = line is lines[-1]
        lams = np.array([tried.settings.lam for tried in line])
        heights = np.array([_height(tried.explained) for tried in line])
        sizes = _TOP * np.array([tried.roughness for tried in line]) / roughest
        pairs: list[tuple[str, FloatArray, Colour]] = [
            ("roughness [°]", sizes, OKABE_ITO.orange),
            ("explained [%]", heights, OKABE_ITO.blue),
        ]
        for name, values, colour in pairs:
            shade = colour if is_now else DRAWING.left_out
            curves.append((name * is_now, lams, values, shade))
            for tried, height in zip(line, map(float, values), strict=True):
                lam = tried.settings.lam
                label = f"{lam:.2g}" if is_now and values is heights else ""
                dots.append(Dot(lam, height, shade, label, tried.settings))
    lam = answer.settings.lam
    dots.append(Dot(lam, _height(answer.explained_contrast), OKABE_ITO.vermilion))
    ends = np.array([min(dot.x for dot in dots), max(dot.x for dot in dots)])
    enough = np.full(2, _height(ENOUGH_CONTRAST))
    beyond = np.array([ends[0] / 10, ends[1] * 10])
    guides = [(beyond, enough)]
    title = "λ curve"
    best = suggested_lam(view.tried, answer)
    if best is not None:
        guides.append((np.full(2, best), np.array([-1, 2 * _TOP])))
        title = f"λ curve: 99 % explained up to {best:.2g}"
    steps = [*map(float, MaxNLocator(5).tick_values(0, roughest))]
    return Chart(
        title,
        "λ [1]",
        "",
        curves,
        guides,
        dots,
        log=(True, False),
        fitted=(ends, np.array([0.0, 1.15 * _TOP])),
        y_ticks=[(_height(share / 100), f"{share:g}") for share in _SHARES],
        right=[(_TOP * step / roughest, f"{step:g}") for step in steps],
    )


# Explained contrast is drawn by what is left, on a logarithmic axis from 50 to 99.99 %.
_SHARES = (99, 50, 80, 90, 97, 99.7, 99.9, 99.97, 99.99)
_TOP = 4.0


def _height(explained: float) -> float:
    return -float(np.log10(np.clip(1 - explained, 1e-4, 0.9)))


def _spread(answer: Answer, view: View) -> Panel:
    """How far apart the answers to all λ that were tried are."""
    others = answer.variants_of_lam()
    title = f"Spread over λ [%], {1 + len(others)} of {len(LAM_FACTORS)}"
    if not others:
        return Map(f"{title}: with the final answer", None)
    spread = answer.spread
    return _value_map(title, spread, (0.0, end_of(spread)), "magma", "{:.1f} %")


def _surface(answer: Answer, view: View) -> Panel:
    """Room for the surface in 3D, which lies above it."""
    return Map("3D: drag to turn", None)


PANELS: dict[str, Callable[[Answer, View], Any]] = {
    "frame": _frame,
    "distance": _distance,
    "model - frame": _residual,
    "section": _section,
    "3D": _surface,
    "λ curve": _lam_curve,
    "normals": _normals,
    "error": _error,
    "spread over λ": _spread,
    "contours": _contours,
    "bounced light": _indirect_light,
    "σ": _sigma,
    "what determined each pixel": _dominant_source,
    "energy": _energy,
}
USUAL_PANELS = ("frame", "distance", "model - frame", "section", "3D", "λ curve")
NEED_UNCERTAINTY = ("σ", "what determined each pixel")


def relative_change(a: Answer, b: Answer) -> FloatArray:
    """B over A, less one, (H, W), %, without what is common if one of them has no unit."""
    ratio = b.result.distance / a.result.distance
    if not (a.result.metric and b.result.metric):
        ratio = ratio / np.nanmedian(ratio)
    return np.asarray(100 * (ratio - 1))


def change_map(title: str, change: FloatArray, end: float) -> Map:
    """A map of a change, %."""
    return _value_map(title, change, (-end, end), "RdBu_r", "{:+.1f} %")


def ratio_of(a: Answer, b: Answer) -> Map:
    """B over A, in %."""
    change = relative_change(a, b)
    title = "B / A - 1 [%]"
    if not (a.result.metric and b.result.metric):
        title += ", but for the scale"
    return change_map(title, change, end_of(change))
