"""What the tuner can show of an answer: a map or a chart for each subject."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from endolab.model.photometry import CHANNELS
from endolab.numerics.arrays import FloatArray
from endolab.reconstruction.contours.lines import find_contours
from endolab.reconstruction.uncertainty.causes import CAUSES, bounced_light
from endolab.reconstruction.uncertainty.estimate import noise_left
from endolab.solvers.problem import LOWER_BOUND, NONE
from endolab.workbench.plots.scales import OKABE_ITO, SOURCE_COLOURS, common_limits
from endolab.workbench.tuning.engine import Answer, Stage
from endolab.workbench.tuning.pictures import (
    DRAWING,
    Chart,
    Limits,
    Map,
    grey_or_colour,
    to_colours,
)
from endolab.workbench.tuning.source import Knobs


@dataclass(frozen=True)
class Dot:
    """An answer of this session, on the λ curve."""

    answer: Answer | None  # as long as it is remembered
    settings: Knobs
    data: float
    roughness: float


@dataclass(frozen=True)
class View:
    """How an answer is looked at."""

    # Whether the section is a row, and how far down or to the right.
    line: tuple[bool, float] = (
        False,
        0.5,
    )
    like: Answer | None = None  # whose scales are taken, by default the answer's own
    beside: Answer | None = None  # A, whose section is shown as well
    dots: Sequence[Dot] = ()


Panel = Map | Chart


def end_of(values: FloatArray, percentile: float) -> float:
    """The first of some round ends that is beyond so many % of the values."""
    ends = (2.0, 5.0, 10.0, 20.0, 50.0, 100.0)  # so that a colour keeps its meaning a while
    known = np.abs(values[np.isfinite(values)])
    size = float(np.percentile(known, percentile)) if known.size else 0.0
    return next((end for end in ends if end >= size), ends[-1])


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


def _frame(answer: Answer, view: View) -> Panel:
    shown = answer.result.problem.shown

    def says(i: int, j: int) -> str:
        values = np.atleast_1d(255 * shown[i, j])
        names = ["grey"] if len(values) == 1 else [name[0].upper() for name in CHANNELS]
        return "  ".join(
            f"{name} {value:.0f}" for name, value in zip(names, values, strict=True)
        )

    title = f"Frame, {shown.shape[1]} x {shown.shape[0]} px"
    return Map(title, grey_or_colour(shown), line=view.line, says=says)


def _distance(answer: Answer, view: View) -> Panel:
    unit, (low, high) = (
        answer.result.problem.unit,
        common_limits([_scale_distance(view.like or answer)]),
    )
    title = f"Distance [{unit}]" + (
        "" if answer.stage == Stage.FINAL else f", {answer.stage}"
    )
    limits = (low, max(high, 1.01 * low))
    form = f"{{:.4g}} {unit}"
    return _value_map(
        title, answer.result.distance, limits, "viridis", form, line=view.line
    )


def _residual(answer: Answer, view: View) -> Panel:
    residual = answer.residual
    # Two standard deviations of the noise are no news.
    floor = 2 * 255 * noise_left(answer.result)[0]
    end = end_of((view.like or answer).residual, 98)
    quiet = np.abs(residual) <= floor
    share = 100 * float(quiet.sum()) / max(int(np.isfinite(residual).sum()), 1)
    title = f"Model - frame [of 255], {share:.0f} % within the noise"
    picture = to_colours(residual, (-end, end), "diverging")
    picture[quiet] = DRAWING.below_noise
    form = "{:+.1f} grey levels"
    return replace(
        _value_map(title, residual, (-end, end), "diverging", form), picture=picture
    )


def _error(answer: Answer, view: View) -> Panel:
    error = answer.error
    if error is None:
        return Map("Error: the truth is unknown", None)
    like = (view.like or answer).error
    end = end_of(error if like is None else like, 90)
    title = f"Error of the distance [%], median {answer.median_error:.2g}"
    return _value_map(title, error, (-end, end), "diverging", "{:+.1f} %")


def _normals(answer: Answer, view: View) -> Panel:
    normals = answer.result.normals
    rays = answer.result.problem.field.rays

    def says(i: int, j: int) -> str:
        slant = np.degrees(np.arccos(np.clip(-normals[i, j] @ rays[i, j], -1, 1)))
        return f"seen at {slant:.0f}°"

    return Map("Normals, (n + 1)/2", grey_or_colour((normals + 1) / 2), says=says)


def _contours(answer: Answer, view: View) -> Panel:
    """Where the surface is cut, and what pixels say."""
    problem = answer.result.problem
    grey = np.asarray(problem.shown, float)
    picture = grey_or_colour(0.35 + 0.5 * (grey if grey.ndim == 2 else grey.mean(axis=-1)))
    maybe = (find_contours(problem.log_d0, problem.mask) > CAUSES.possible_steepness).any(
        axis=0
    )
    evidence = (
        np.zeros(problem.mask.shape) if problem.evidence is None else problem.evidence
    )
    cut = np.zeros_like(problem.mask) if problem.cuts is None else problem.cuts.any(axis=0)
    parts = {
        "may be a contour": (maybe, OKABE_ITO.sky),
        "saturated: at least so bright": (
            problem.mask & (evidence == LOWER_BOUND),
            OKABE_ITO.orange,
        ),
        "highlight: ignored": (problem.mask & (evidence == NONE), OKABE_ITO.purple),
        "left out": (~problem.mask, DRAWING.left_out),
        f"cut, {answer.cut_count:,} px": (cut, OKABE_ITO.vermilion),
    }
    for where, colour in parts.values():
        picture[where] = colour
    keys = [(name, colour) for name, (where, colour) in parts.items() if where.any()]
    kinds = [(name.split(":")[0], where) for name, (where, _) in parts.items()]

    def says(i: int, j: int) -> str:
        return ", ".join(name for name, where in kinds if where[i, j])

    return Map("Contours and highlights", picture, keys=keys, says=says)


def _indirect_light(answer: Answer, view: View) -> Panel:
    if answer.stage != Stage.FINAL:
        return Map("Bounced light: with the final answer", None)
    result = answer.result
    share = np.where(result.mask, -100 * np.expm1(-bounced_light(result.iterate)), np.nan)
    taken = "left in" if result.provenance.albedo is None else "removed"
    title = f"Bounced light [% of all], {taken}"
    return _value_map(title, share, (0.0, end_of(share, 99)), "magma", "{:.1f} %")


def _sigma(answer: Answer, view: View) -> Panel:
    if answer.uncertainty is None:
        return Map("σ: press find σ, below advanced", None)
    percent = 100 * answer.uncertainty.sigma / answer.result.distance
    title = f"σ of the distance [%], median {np.nanmedian(percent):.2g}"
    return _value_map(title, percent, (0.0, end_of(percent, 98)), "magma", "± {:.1f} %")


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
    unit, (is_row, share) = answer.result.problem.unit, view.line
    length = answer.result.mask.shape[not is_row]
    index = min(int(share * length), length - 1)

    def section_line(of: Answer, distance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """z, and x of a row or y of a column."""
        line = np.s_[index] if is_row else np.s_[:, index]
        rays = of.result.problem.field.rays[line]
        return rays[:, 2] * distance[line], rays[:, 0 if is_row else 1] * distance[line]

    like = view.like or answer
    curves = []
    if view.beside is not None:
        curves.append(
            ("A", *section_line(view.beside, view.beside.result.distance), OKABE_ITO.green)
        )
    if answer.truth is not None:
        curves.append(("truth", *section_line(answer, answer.truth), OKABE_ITO.black))
    name = "result" if view.beside is None else "B"
    curves.append(
        (name, *section_line(answer, answer.result.distance), OKABE_ITO.vermilion)
    )
    title = f"Section along {'row' if is_row else 'column'} {index}"
    labels = f"z [{unit}]", f"{'x' if is_row else 'y'} [{unit}]"
    fitted = section_line(like, _scale_distance(like))
    return Chart(title, *labels, curves, down=not is_row, equal=True, fitted=fitted)


def _energy(answer: Answer, view: View) -> Panel:
    history = answer.result.history
    steps = np.array([entry["k"] for entry in history], float)
    terms = (
        ("data", OKABE_ITO.blue),
        ("regulariser", OKABE_ITO.vermilion),
        ("energy", OKABE_ITO.black),
    )
    curves = [
        (name, steps, np.array([entry[name] for entry in history]), colour)
        for name, colour in terms
    ]
    title = f"Energy, {answer.result.iterations} iterations"
    return Chart(title, "iteration", "energy [1]", curves, log=(False, True))


def _lam_curve(answer: Answer, view: View) -> Panel:
    """Data term and roughness of the answers so far; those that differ by λ alone hang together."""
    by_lam = (dot for dot in view.dots if differs_by_lam(dot.settings, answer.settings))
    family = sorted(by_lam, key=lambda dot: dot.settings.lam)
    x, y = (
        np.array([getattr(dot, name) for dot in family]) for name in ("data", "roughness")
    )
    colours = (OKABE_ITO.sky if dot in family else DRAWING.left_out for dot in view.dots)
    dots = [
        (dot.data, dot.roughness, colour)
        for dot, colour in zip(view.dots, colours, strict=True)
    ]
    dots.append((answer.data, answer.roughness, OKABE_ITO.vermilion))
    curves = [("", x, y, OKABE_ITO.sky)] if family else []
    title = f"λ curve: λ = {answer.settings.lam:.3g}; click on a dot"
    return Chart(title, "data term [1]", "roughness [°]", curves, dots, log=(True, True))


def differs_by_lam(settings: Knobs, other: Knobs) -> bool:
    """Whether two settings differ by λ, if at all."""
    return replace(settings, lam=other.lam) == other


def _surface(answer: Answer, view: View) -> Panel:
    """Room for the surface in 3D, which lies above it."""
    return Map("3D: drag to turn", None)


PANELS: dict[str, Callable[[Answer, View], Panel]] = {
    "frame": _frame,
    "distance": _distance,
    "model - frame": _residual,
    "section": _section,
    "3D": _surface,
    "λ curve": _lam_curve,
    "normals": _normals,
    "error": _error,
    "contours": _contours,
    "bounced light": _indirect_light,
    "σ": _sigma,
    "what determined each pixel": _dominant_source,
    "energy": _energy,
}
USUAL_PANELS = ("frame", "distance", "model - frame", "section", "3D", "λ curve")
NEED_UNCERTAINTY = ("σ", "what determined each pixel")


def ratio_of(a: Answer, b: Answer) -> Map:
    """B over A, in %, without what is common if one of them has no unit."""
    ratio = b.result.distance / a.result.distance
    title = "B / A - 1 [%]"
    if not (a.result.metric and b.result.metric):
        ratio = ratio / np.nanmedian(ratio)
        title = "B / A - 1 [%], but for the scale"
    change: FloatArray = 100 * (ratio - 1)
    end = end_of(change, 98)
    return _value_map(title, change, (-end, end), "diverging", "{:+.1f} %")
