"""What the tuner can show of an outcome: a panel for each subject, and what it says of one pixel.

All maps of an outcome have the same geometry, so that a point of one is the same point of all.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from endolab.depth.problem import AT_LEAST, NONE
from endolab.depth.result import Result
from endolab.model.photometry import CHANNELS
from endolab.numerics.arrays import FloatArray
from endolab.plots.scales import DECIDERS
from endolab.preprocessing.contours import find_contours
from endolab.tuning.engine import FINE, TRUST, Outcome
from endolab.tuning.pictures import (
    LEFT_OUT,
    PLAIN,
    Limits,
    Look,
    Picture,
    coloured,
    curve_panel,
    cut_panel,
    grey_or_colour,
    key_panel,
    map_panel,
)
from endolab.tuning.sentences import ended
from endolab.uncertainty.causes import MAYBE

PERCENT = (2.0, 5.0, 10.0, 20.0, 50.0, 100.0)  # ends of scales, so that a colour keeps its meaning a while
GREYS = (2.0, 5.0, 10.0, 20.0, 50.0, 128.0)  # likewise, of 255
BELOW_NOISE = (236, 236, 236)  # colour of residuals that noise explains
NOISY = 2.0  # standard deviations of the noise that are no news
SHAPE = 314 / 204  # width by height of the axes of a section
TORN, MAYBE_TORN = (213, 94, 0), (86, 180, 233)
SATURATED, SILENT = (230, 159, 0), (204, 121, 167)


@dataclass(frozen=True)
class Cut:
    """Where the section lies: how far down (a row) or to the right (a column), in [0, 1]."""

    share: float = 0.5
    is_row: bool = False

    def index(self, shape: tuple[int, ...]) -> int:
        """Row or column of a picture of that shape."""
        count = shape[0] if self.is_row else shape[1]
        return min(max(int(self.share * count), 0), count - 1)


@dataclass(frozen=True)
class Shared:
    """Limits that compared boards share: of distances, and of the error in %; and whose section's axes."""

    depth: Limits
    error: float
    of: Outcome = field(compare=False)


def pixel_at(x: float, y: float, shape: tuple[int, ...]) -> tuple[int, int]:
    """Row and column of a picture of that shape at shares of it, to the right and down."""
    return min(int(y * shape[0]), shape[0] - 1), min(int(x * shape[1]), shape[1] - 1)


def limits_of(outcome: Outcome) -> Shared:
    """Limits that suit an outcome: the truth's distances if there is one."""
    assert outcome.result is not None
    truth, distance = outcome.truth, outcome.result.distance
    seen = distance if truth is None else truth
    low, high = (float(value) for value in np.nanpercentile(seen, [1, 99]))
    error = PERCENT[0]
    if truth is not None:
        error = end_of(100 * (distance / truth - 1), 90)
    return Shared((low, high if high > low else low * 1.01), error, outcome)


def end_of(values: FloatArray, percentile: float, ends: tuple[float, ...] = PERCENT) -> float:
    """The first of some ends that is beyond so many % of the values."""
    known = np.abs(values[np.isfinite(values)])
    size = float(np.percentile(known, percentile)) if known.size else 0.0
    return next((end for end in ends if end >= size), ends[-1])


@dataclass(frozen=True)
class View:
    """How an outcome is looked at; `limits` and `beside`, of an outcome that is compared, by default none."""

    cut: Cut | None = Cut()  # none is drawn if there is none
    look: Look = PLAIN
    limits: Shared | None = None
    beside: Outcome | None = None  # A, whose section is shown as well
    who: str = ""  # "A" or "B", if two are compared

    def titled(self, title: str) -> str:
        """A title that says whose it is."""
        return f"{self.who}: {title}" if self.who else title


Drawer = Callable[[Outcome, View], Picture]
Reader = Callable[[Outcome, int, int], str]


@dataclass(frozen=True)
class Panel:
    """One subject: how it is drawn, what it says of a pixel if it is a map, and what it needs."""

    draw: Drawer
    read: Reader | None = None
    besides: str | None = None  # what has to be found for it
    needs_truth: bool = False


def _of(outcome: Outcome) -> Result:
    assert outcome.result is not None
    return outcome.result


def _map(
    view: View, title: str, picture: Picture, limits: Limits | None = None, palette: str = "viridis"
) -> Picture:
    """A map's panel."""
    return map_panel(view.titled(title), picture, limits, palette, view.look)


def _message(outcome: Outcome, view: View, text: str) -> Picture:
    nothing = np.full(_of(outcome).mask.shape, np.nan)
    return _map(view, text, grey_or_colour(nothing))


def _with_cut(paper: Picture, outcome: Outcome, view: View) -> Picture:
    shape = _of(outcome).mask.shape
    if view.cut is None:
        return paper
    cut_panel(paper, shape, view.cut.index(shape), view.cut.is_row, view.look)
    return paper


# The picture ---------------------------------------------------------------------------


def _frame(outcome: Outcome, view: View) -> Picture:
    shown = _of(outcome).problem.shown
    paper = _map(view, f"Frame, {shown.shape[1]} x {shown.shape[0]} px", grey_or_colour(shown))
    return _with_cut(paper, outcome, view)


def _read_frame(outcome: Outcome, i: int, j: int) -> str:
    values = np.atleast_1d(255 * _of(outcome).problem.shown[i, j])
    names = ["grey"] if len(values) == 1 else [name[0].upper() for name in CHANNELS]
    return "  ".join(f"{name} {value:.0f}" for name, value in zip(names, values, strict=True))


def _prepared(outcome: Outcome, view: View) -> Picture:
    problem = _of(outcome).problem
    what = str(problem.settings.get("channel", "the channel"))
    blur = f", averaged σ {problem.origin.smooth:.2g} px" if problem.origin.smooth else ""
    return _map(
        view, f"Explained: {what}{blur}", grey_or_colour(np.where(problem.mask, problem.image, np.nan))
    )


def _read_prepared(outcome: Outcome, i: int, j: int) -> str:
    return f"{255 * _of(outcome).problem.image[i, j]:.1f} of 255"


def _canonical(outcome: Outcome, view: View) -> Picture:
    light = -2 * _of(outcome).problem.log_facing / np.log(10)
    low, high = (float(end) for end in np.nanpercentile(light, [1, 99]))
    ends = (low, high if high > low else low + 1)
    return _map(view, "Canonical: log10 of cos θ / d²", coloured(light, ends, "magma"), ends, "magma")


def _read_canonical(outcome: Outcome, i: int, j: int) -> str:
    problem = _of(outcome).problem
    return f"d₀ = {np.exp(problem.log_facing[i, j]):.3g} {problem.unit}, if it faced the camera"


def _evidence(outcome: Outcome, view: View) -> Picture:
    problem = _of(outcome).problem
    mask, picture = problem.mask, grey_or_colour(problem.shown)
    picture[~mask] = LEFT_OUT
    names, colours = [f"left out {100 * float(np.mean(~mask)):.0f} %"], [LEFT_OUT]
    if problem.evidence is not None:
        for kind, name, colour in (
            (AT_LEAST, "saturated: at least", SATURATED),
            (NONE, "says nothing", SILENT),
        ):
            there = mask & (problem.evidence == kind)
            picture[there] = colour
            names.append(f"{name} {100 * float(there.mean()):.1f} %")
            colours.append(colour)
    return key_panel(view.titled("Mask and highlights"), names, picture, colours, view.look)


def _read_evidence(outcome: Outcome, i: int, j: int) -> str:
    problem = _of(outcome).problem
    kind = 0 if problem.evidence is None else int(problem.evidence[i, j])
    return "left out" if not problem.mask[i, j] else ("exact", "at least so bright", "no evidence")[kind]


def _contours(outcome: Outcome, view: View) -> Picture:
    problem = _of(outcome).problem
    shown = np.asarray(problem.shown, float)
    grey = shown if shown.ndim == 2 else shown.mean(axis=-1)
    picture = grey_or_colour(0.35 + 0.5 * grey)
    maybe = (find_contours(problem.log_facing, problem.mask) > MAYBE).any(axis=0)
    picture[maybe] = MAYBE_TORN
    torn = 0
    if problem.cuts is not None:
        picture[problem.cuts.any(axis=0)] = TORN
        torn = int(problem.cuts.sum())
    names, colours = [f"torn, {torn} steps", "may be a contour"], [TORN, MAYBE_TORN]
    return key_panel(view.titled("Contours"), names, picture, colours, view.look)


def _read_contours(outcome: Outcome, i: int, j: int) -> str:
    cuts = _of(outcome).problem.cuts
    return "torn here" if cuts is not None and cuts[:, i, j].any() else "whole"


def _bounced(outcome: Outcome, view: View) -> Picture:
    if outcome.stage != FINE:
        return _message(outcome, view, "Bounced light: when the sliders rest")
    share = outcome.bounced
    ends = (0.0, end_of(share, 99))
    taken = "taken out" if _of(outcome).problem.origin.albedo is not None else "left in"
    median = float(np.nanmedian(share))
    title = f"Bounced light [% of all], {taken}, median {median:.2g}"
    return _map(view, title, coloured(share, ends, "magma"), ends, "magma")


def _read_bounced(outcome: Outcome, i: int, j: int) -> str:
    return f"{outcome.bounced[i, j]:.1f} %" if outcome.stage == FINE else ""


# The surface ---------------------------------------------------------------------------


def _distance(outcome: Outcome, view: View) -> Picture:
    limits = (view.limits or limits_of(outcome)).depth
    problem = _of(outcome).problem
    paper = _map(
        view, f"Distance [{problem.unit}], {outcome.label}", coloured(_of(outcome).distance, limits), limits
    )
    return _with_cut(paper, outcome, view)


def _read_distance(outcome: Outcome, i: int, j: int) -> str:
    result, truth = _of(outcome), outcome.truth
    true = "" if truth is None else f", true {truth[i, j]:.4g}"
    return f"d = {result.distance[i, j]:.4g}{true} {result.problem.unit}"


def _normals(outcome: Outcome, view: View) -> Picture:
    return _map(view, "Normals, (n + 1)/2", grey_or_colour((_of(outcome).normals + 1) / 2))


def _read_normals(outcome: Outcome, i: int, j: int) -> str:
    result = _of(outcome)
    normal, ray = result.normals[i, j], result.problem.field.rays[i, j]
    slant = np.degrees(np.arccos(np.clip(-normal @ ray, -1, 1)))
    return f"n = ({', '.join(f'{one:.2f}' for one in normal)}), θ = {slant:.0f}°"


def _residual(outcome: Outcome, view: View) -> Picture:
    residual, floor = outcome.residual, NOISY * 255 * outcome.noise
    end = end_of(residual if view.limits is None else view.limits.of.residual, 98, GREYS)
    picture = coloured(residual, (-end, end), "diverging")
    with np.errstate(invalid="ignore"):
        quiet = np.abs(residual) <= floor
    picture[quiet] = BELOW_NOISE
    told = np.isfinite(residual)
    share = 100 * float(quiet.sum()) / max(int(told.sum()), 1)
    title = f"Model - frame [grey], {share:.0f} % is noise"
    return _map(view, title, picture, (-end, end), "diverging")


def _read_residual(outcome: Outcome, i: int, j: int) -> str:
    return f"{outcome.residual[i, j]:+.1f} grey levels (noise ± {255 * outcome.noise:.1f})"


def _error(outcome: Outcome, view: View) -> Picture:
    if outcome.truth is None:
        return _message(outcome, view, "Error: the truth is unknown")
    end = (view.limits or limits_of(outcome)).error
    error = coloured(100 * (_of(outcome).distance / outcome.truth - 1), (-end, end), "diverging")
    return _map(view, "Error of the distance [%]", error, (-end, end), "diverging")


def _read_error(outcome: Outcome, i: int, j: int) -> str:
    truth = outcome.truth
    return "" if truth is None else f"{100 * (_of(outcome).distance[i, j] / truth[i, j] - 1):+.1f} %"


def _start(outcome: Outcome, view: View) -> Picture:
    change = outcome.change
    if change is None:
        return _message(outcome, view, "By another start: turn λ or ε first")
    end = end_of(change, 99)
    title = "Started from the last answer instead [%]"
    return _map(view, title, coloured(change, (-end, end), "diverging"), (-end, end), "diverging")


def _read_start(outcome: Outcome, i: int, j: int) -> str:
    return "" if outcome.change is None else f"{outcome.change[i, j]:+.1f} %"


def _sigma(outcome: Outcome, view: View) -> Picture:
    trust = outcome.trust
    if trust is None:
        return _message(outcome, view, f"σ: {_why(outcome)}")
    percent = 100 * trust.sigma / _of(outcome).distance
    other = None if view.limits is None else view.limits.of
    like = percent if other is None or other.trust is None else 100 * other.trust.sigma / _of(other).distance
    ends = (0.0, end_of(like, 98))
    title = f"Trust: σ of the distance [%], median {np.nanmedian(percent):.2g}"
    return _map(view, title, coloured(percent, ends, "magma"), ends, "magma")


def _why(outcome: Outcome) -> str:
    return "not known, see the line above" if outcome.untold else "to come when the sliders rest"


def _read_sigma(outcome: Outcome, i: int, j: int) -> str:
    if outcome.trust is None:
        return ""
    result, sigma = _of(outcome), outcome.trust.sigma[i, j]
    return f"± {sigma:.2g} {result.problem.unit}, {100 * sigma / result.distance[i, j]:.1f} %"


def _decided(outcome: Outcome, view: View) -> Picture:
    trust = outcome.trust
    if trust is None:
        return _message(outcome, view, f"Who decided: {_why(outcome)}")
    shares = [100 * float(np.mean(trust.decided_by[_of(outcome).mask] == k)) for k in (1, 2, 3)]
    names = [f"{name} {share:.0f} %" for name, share in zip(DECIDERS, shares, strict=True)]
    colours = np.array([LEFT_OUT, *DECIDERS.values()], np.uint8)
    return key_panel(
        view.titled("Who decided"), names, colours[trust.decided_by], list(DECIDERS.values()), view.look
    )


def _read_decided(outcome: Outcome, i: int, j: int) -> str:
    if outcome.trust is None:
        return ""
    parts = outcome.trust.shares[:, i, j]
    return ", ".join(f"{name} {100 * part:.0f} %" for name, part in zip(DECIDERS, parts, strict=True))


# Curves --------------------------------------------------------------------------------


def _along(result: Result, distance: FloatArray, cut: Cut) -> tuple[FloatArray, FloatArray]:
    """z, and x of a row or y of a column."""
    index = cut.index(distance.shape)
    line = np.s_[index] if cut.is_row else np.s_[:, index]
    rays, along = result.problem.field.rays[line], distance[line]
    return rays[:, 2] * along, rays[:, 0 if cut.is_row else 1] * along


def _section(outcome: Outcome, view: View) -> Picture:
    """Section of an outcome, on axes that suit the truth of another, or else its result."""
    result, cut, truth = _of(outcome), view.cut or Cut(), outcome.truth
    of = outcome if view.limits is None else view.limits.of
    start = np.exp(np.where(result.mask, result.problem.log_facing, np.nan))
    curves = [("start", *_along(result, start, cut))] if view.beside is None else []
    if truth is not None:
        curves.append(("truth", *_along(result, truth, cut)))
    if view.beside is not None:
        curves.append(("A", *_along(_of(view.beside), _of(view.beside).distance, cut)))
    curves.append(("result" if view.beside is None else "B", *_along(result, result.distance, cut)))
    z, across = _along(_of(of), _of(of).distance if of.truth is None else of.truth, cut)
    name, unit = ("row" if cut.is_row else "column"), result.problem.unit
    title = f"Section along {name} {cut.index(result.mask.shape)}"
    labels = f"z [{unit}]", f"{'x' if cut.is_row else 'y'} [{unit}]"
    known = np.isfinite(z)
    if not known.any():
        return curve_panel(f"{title}: nothing seen", [], *labels, look=view.look)
    # One scale on both axes, so that angles are angles.
    middle = [(float(value[known].max()) + float(value[known].min())) / 2 for value in (z, across)]
    half = [1.1 * float(np.ptp(value[known])) / 2 + 1e-9 for value in (z, across)]
    tall = max(half[1], half[0] / SHAPE)
    x_limits, y_limits = ((m - h, m + h) for m, h in zip(middle, (tall * SHAPE, tall), strict=True))
    return curve_panel(
        title, curves, *labels, down=not cut.is_row, x_limits=x_limits, y_limits=y_limits, look=view.look
    )


def _energy(outcome: Outcome, view: View) -> Picture:
    history = _of(outcome).history
    steps = np.array([entry["k"] for entry in history], float)
    terms = [(name, steps, np.array([entry[name] for entry in history])) for name in ("data", "regulariser")]
    terms.append(("energy", steps, np.array([entry["energy"] for entry in history])))
    floor, below = outcome.noise_floor, ""
    terms.insert(0, ("noise", np.array([0.0, max(steps[-1], 1.0)]), np.full(2, floor)))
    if _of(outcome).iterate.terms["data"] < floor:
        below = ", data below noise"
    title = f"Energy: {ended(outcome)}{below}"
    return curve_panel(title, terms, "iteration", "[1]", log=True, look=view.look)


PANELS = {
    "frame": Panel(_frame, _read_frame),
    "distance": Panel(_distance, _read_distance),
    "model - frame": Panel(_residual, _read_residual),
    "error": Panel(_error, _read_error, needs_truth=True),
    "normals": Panel(_normals, _read_normals),
    "section": Panel(_section),
    "energy": Panel(_energy),
    "explained": Panel(_prepared, _read_prepared),
    "canonical": Panel(_canonical, _read_canonical),
    "bounced light": Panel(_bounced, _read_bounced),
    "contours": Panel(_contours, _read_contours),
    "mask and highlights": Panel(_evidence, _read_evidence),
    "σ": Panel(_sigma, _read_sigma, TRUST),
    "who decided": Panel(_decided, _read_decided, TRUST),
    "another start": Panel(_start, _read_start),
}


def map_alone(outcome: Outcome, name: str, look: Look = PLAIN) -> Picture:
    """A panel's map without title, colour bar and section: what can lie on a surface."""
    drawn = PANELS[name].draw(outcome, View(None, look))
    width, height = look.fitted(_of(outcome).mask.shape)
    return drawn[look.top : look.top + height, look.edge : look.edge + width]


FIRST = ("frame", "distance", "model - frame", "normals", "section", "energy")
FIRST_WITH_TRUTH = ("frame", "distance", "model - frame", "error", "section", "energy")
