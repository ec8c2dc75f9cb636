"""What the tuner can show of an answer: a map or a chart for each subject."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from endolab.depth.problem import AT_LEAST, NONE
from endolab.model.photometry import CHANNELS
from endolab.numerics.arrays import FloatArray
from endolab.plots.scales import DECIDERS
from endolab.preprocessing.contours import find_contours
from endolab.tuning.engine import FINAL, Answer
from endolab.tuning.pictures import (
    BLACK,
    BLUE,
    GREEN,
    LEFT_OUT,
    SKY,
    VERMILION,
    Chart,
    Limits,
    Map,
    coloured,
    grey_or_colour,
)
from endolab.uncertainty.causes import MAYBE, bounced_light
from endolab.uncertainty.trust import noise_left

ENDS = (2.0, 5.0, 10.0, 20.0, 50.0, 100.0)  # of scales, so that a colour keeps its meaning a while
BELOW_NOISE = (236, 236, 236)  # colour of residuals that noise explains
NOISY = 2.0  # standard deviations of the noise that are no news
TORN, SATURATED, SILENT = VERMILION, (230, 159, 0), (204, 121, 167)


@dataclass(frozen=True)
class Dot:
    """An answer of this session, on the λ curve."""

    answer: Answer | None  # as long as it is remembered
    settings: Any
    data: float
    roughness: float
    picture: tuple[Any, ...]  # what was explained: data terms of the same can be compared


@dataclass(frozen=True)
class View:
    """How an answer is looked at."""

    is_row: bool = False  # whether the section lies along a row
    share: float = 0.5  # how far down or to the right
    like: Answer | None = None  # whose scales are taken, by default the answer's own
    beside: Answer | None = None  # A, whose section is shown as well
    name: str = ""  # "A", "B" or a λ, if several are compared
    dots: Sequence[Dot] = field(default=(), repr=False)

    def title(self, text: str) -> str:
        """A title that says whose it is."""
        return f"{self.name}: {text}" if self.name else text


Panel = Map | Chart


def end_of(values: FloatArray, percentile: float) -> float:
    """The first of some round ends that is beyond so many % of the values."""
    known = np.abs(values[np.isfinite(values)])
    size = float(np.percentile(known, percentile)) if known.size else 0.0
    return next((end for end in ENDS if end >= size), ENDS[-1])


def depth_limits(answer: Answer) -> Limits:
    """Ends of the scale of distances that suits an answer: the truth's if there is one."""
    seen = answer.result.distance if answer.truth is None else answer.truth
    low, high = (float(value) for value in np.nanpercentile(seen, [1, 99]))
    return low, high if high > low else 1.01 * low


def _value_map(
    view: View, title: str, values: FloatArray, limits: Limits, palette: str, said: str, line: bool = False
) -> Map:
    """A map of numbers; `said` is how one of them is told."""
    cut = (view.is_row, view.share) if line else None
    picture = coloured(values, limits, palette)
    return Map(
        view.title(title), picture, limits, palette, line=cut, says=lambda i, j: said.format(values[i, j])
    )


def _message(answer: Answer, view: View, text: str) -> Map:
    return Map(view.title(text), grey_or_colour(np.full(answer.result.mask.shape, np.nan)))


def _frame(answer: Answer, view: View) -> Panel:
    shown = answer.result.problem.shown

    def says(i: int, j: int) -> str:
        values = np.atleast_1d(255 * shown[i, j])
        names = ["grey"] if len(values) == 1 else [name[0].upper() for name in CHANNELS]
        return "  ".join(f"{name} {value:.0f}" for name, value in zip(names, values, strict=True))

    title = f"Frame, {shown.shape[1]} x {shown.shape[0]} px"
    return Map(view.title(title), grey_or_colour(shown), line=(view.is_row, view.share), says=says)


def _distance(answer: Answer, view: View) -> Panel:
    limits, unit = depth_limits(view.like or answer), answer.result.problem.unit
    title = f"Distance [{unit}]" + ("" if answer.stage == FINAL else f", {answer.stage}")
    return _value_map(view, title, answer.result.distance, limits, "viridis", f"{{:.4g}} {unit}", True)


def _residual(answer: Answer, view: View) -> Panel:
    residual, floor = answer.residual, NOISY * 255 * noise_left(answer.result.problem)[0]
    end = end_of((view.like or answer).residual, 98)
    quiet = np.abs(residual) <= floor
    share = 100 * float(quiet.sum()) / max(int(np.isfinite(residual).sum()), 1)
    title = f"Model - frame [grey of 255], {share:.0f} % is noise"
    picture = coloured(residual, (-end, end), "diverging")
    picture[quiet] = BELOW_NOISE
    return replace(
        _value_map(view, title, residual, (-end, end), "diverging", "{:+.1f} grey levels"), picture=picture
    )


def _error(answer: Answer, view: View) -> Panel:
    error = answer.error
    if error is None:
        return _message(answer, view, "Error: the truth is unknown")
    like = (view.like or answer).error
    end = end_of(error if like is None else like, 90)
    title = f"Error of the distance [%], median {answer.median_error:.2g}"
    return _value_map(view, title, error, (-end, end), "diverging", "{:+.1f} %")


def _normals(answer: Answer, view: View) -> Panel:
    normals, rays = answer.result.normals, answer.result.problem.field.rays

    def says(i: int, j: int) -> str:
        slant = np.degrees(np.arccos(np.clip(-normals[i, j] @ rays[i, j], -1, 1)))
        return f"seen at {slant:.0f}°"

    return Map(view.title("Normals, (n + 1)/2"), grey_or_colour((normals + 1) / 2), says=says)


def _contours(answer: Answer, view: View) -> Panel:
    """Where the surface is torn, and what pixels say."""
    problem = answer.result.problem
    grey = np.asarray(problem.shown, float)
    picture = grey_or_colour(0.35 + 0.5 * (grey if grey.ndim == 2 else grey.mean(axis=-1)))
    maybe = (find_contours(problem.log_facing, problem.mask) > MAYBE).any(axis=0)
    evidence = np.zeros(problem.mask.shape) if problem.evidence is None else problem.evidence
    torn = np.zeros_like(problem.mask) if problem.cuts is None else problem.cuts.any(axis=0)
    parts = {
        "may be a contour": (maybe, SKY),
        "saturated: at least so bright": (problem.mask & (evidence == AT_LEAST), SATURATED),
        "highlight: says nothing": (problem.mask & (evidence == NONE), SILENT),
        "left out": (~problem.mask, LEFT_OUT),
        f"torn, {answer.torn:,} px": (torn, TORN),
    }
    for where, colour in parts.values():
        picture[where] = colour
    keys = [(name, colour) for name, (where, colour) in parts.items() if where.any()]
    kinds = [(name.split(":")[0], where) for name, (where, _) in parts.items()]

    def says(i: int, j: int) -> str:
        return ", ".join(name for name, where in kinds if where[i, j])

    return Map(view.title("Contours and highlights"), picture, keys=keys, says=says)


def _bounced(answer: Answer, view: View) -> Panel:
    if answer.stage != FINAL:
        return _message(answer, view, "Bounced light: with the final answer")
    problem = answer.result.problem
    log_ratio = bounced_light(problem, answer.result.iterate.log_distance)
    share = np.where(problem.mask, -100 * np.expm1(-log_ratio), np.nan)
    taken = "left in" if problem.origin.albedo is None else "taken out"
    title = f"Bounced light [% of all], {taken}"
    return _value_map(view, title, share, (0.0, end_of(share, 99)), "magma", "{:.1f} %")


def _sigma(answer: Answer, view: View) -> Panel:
    if answer.trust is None:
        return _message(answer, view, "σ: press find σ, below advanced")
    percent = 100 * answer.trust.sigma / answer.result.distance
    title = f"σ of the distance [%], median {np.nanmedian(percent):.2g}"
    return _value_map(view, title, percent, (0.0, end_of(percent, 98)), "magma", "± {:.1f} %")


def _decided(answer: Answer, view: View) -> Panel:
    trust = answer.trust
    if trust is None:
        return _message(answer, view, "Who decided: press find σ, below advanced")
    colours = np.array([LEFT_OUT, *DECIDERS.values()], np.uint8)
    names = ("left out", *DECIDERS)

    def says(i: int, j: int) -> str:
        return names[trust.decided_by[i, j]]

    return Map(view.title("Who decided"), colours[trust.decided_by], keys=[*DECIDERS.items()], says=says)


def _section(answer: Answer, view: View) -> Panel:
    """Section of an answer, on axes that suit the truth, or else the result, of the one it is like."""
    shape, unit = answer.result.mask.shape, answer.result.problem.unit
    index = min(int(view.share * shape[not view.is_row]), shape[not view.is_row] - 1)

    def along(of: Answer, distance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """z, and x of a row or y of a column."""
        line = np.s_[index] if view.is_row else np.s_[:, index]
        rays = of.result.problem.field.rays[line]
        return rays[:, 2] * distance[line], rays[:, 0 if view.is_row else 1] * distance[line]

    like = view.like or answer
    curves = []
    if view.beside is not None:
        curves.append(("A", *along(view.beside, view.beside.result.distance), GREEN))
    if answer.truth is not None:
        curves.append(("truth", *along(answer, answer.truth), BLACK))
    name = "result" if view.beside is None else "B"
    curves.append((name, *along(answer, answer.result.distance), VERMILION))
    title = f"Section along {'row' if view.is_row else 'column'} {index}"
    labels = f"z [{unit}]", f"{'x' if view.is_row else 'y'} [{unit}]"
    fitted = along(like, like.result.distance if like.truth is None else like.truth)
    return Chart(view.title(title), *labels, curves, down=not view.is_row, equal=True, fitted=fitted)


def _energy(answer: Answer, view: View) -> Panel:
    history = answer.result.history
    steps = np.array([entry["k"] for entry in history], float)
    terms = (("data", BLUE), ("regulariser", VERMILION), ("energy", BLACK))
    curves = [(name, steps, np.array([entry[name] for entry in history]), colour) for name, colour in terms]
    title = f"Energy, {answer.result.iterations} iterations"
    return Chart(view.title(title), "iteration", "energy [1]", curves, log=(False, True))


def _lam_curve(answer: Answer, view: View) -> Panel:
    """Data term and roughness of the answers so far; those that differ by λ alone hang together."""
    family = sorted((dot for dot in view.dots if differs_by_lam(dot.settings, answer.settings)), key=_lam)
    x, y = (np.array([getattr(dot, name) for dot in family]) for name in ("data", "roughness"))
    dots = [(dot.data, dot.roughness, SKY if dot in family else LEFT_OUT) for dot in view.dots]
    marked = [(answer.data, answer.roughness, VERMILION)]
    return Chart(
        view.title(f"λ curve: λ = {answer.settings.lam:.2g}; click on a dot"),
        "data term [1]",
        "roughness [°]",
        [("", x, y, SKY)] if family else [],
        [*dots, *marked],
        log=(True, True),
    )


def _lam(dot: Dot) -> float:
    return float(dot.settings.lam)


def differs_by_lam(one: Any, other: Any) -> bool:
    """Whether two settings differ by λ, if at all."""
    return all(name == "lam" or value == getattr(other, name) for name, value in vars(one).items())


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
    "bounced light": _bounced,
    "σ": _sigma,
    "who decided": _decided,
    "energy": _energy,
}
USUAL = ("frame", "distance", "model - frame", "section", "3D", "λ curve")
NEED_TRUST = ("σ", "who decided")
TEXTURES = ("frame", "distance", "model - frame", "error", "normals", "contours", "σ")  # on the surface


def ratio_of(a: Answer, b: Answer) -> Map:
    """B over A, in %, without what is common if one of them has no unit."""
    ratio, title = b.result.distance / a.result.distance, "B / A - 1 [%]"
    if not (a.result.metric and b.result.metric):
        ratio, title = ratio / np.nanmedian(ratio), "B / A - 1 [%], but for the scale"
    change: FloatArray = 100 * (ratio - 1)
    end = end_of(change, 98)
    return _value_map(View(), title, change, (-end, end), "diverging", "{:+.1f} %")
