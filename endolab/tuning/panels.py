"""What the tuner shows of an outcome: one board of six linked panels, with the same limits throughout."""

from dataclasses import dataclass, field

import numpy as np

from endolab.depth.result import Result
from endolab.numerics.arrays import FloatArray
from endolab.plots.scales import DECIDERS
from endolab.tuning.engine import CURVE, TRUST, Outcome
from endolab.tuning.pictures import (
    LEFT_OUT,
    Limits,
    Picture,
    board,
    coloured,
    curve_panel,
    cut_panel,
    grey_or_colour,
    key_panel,
    map_panel,
    map_spot,
)
from endolab.tuning.source import Settings

ERROR_LIMITS = (2.0, 5.0, 10.0, 20.0, 50.0, 100.0)  # %, so that a colour keeps its meaning for a while
NAMES = {"gauss_newton": "Gauss-Newton", "primal_dual": "primal-dual"}
NAMES |= {"fast_marching": "fast marching", "facing": "facing"}
SIGNS = {"scene": "scene", "epsilon": "ε", "k": "k", "gamma": "γ", "gain": "gain ×", "noise": "noise"}
SIGNS |= {"xi": "ξ", "regulariser": "order", "solver": "solver", "channel": "channel", "width": "width"}
UNSET = {"scene": "frame", "channel": "green or grey"}  # else "as calibrated"
PANELS = 6
NORMALS, SIGMA, DECIDED, WEIGHTS = "normals", "σ", "who decided", "λ"  # what the third can show
BESIDES = {NORMALS: None, SIGMA: TRUST, DECIDED: TRUST, WEIGHTS: CURVE}  # and what has to be found for it
SECTION_SHAPE = 314 / 204  # width by height of the axes of a section


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


def limits_of(outcome: Outcome) -> Shared:
    """Limits that suit an outcome: the truth's distances if there is one."""
    assert outcome.result is not None
    truth, distance = outcome.truth, outcome.result.distance
    seen = distance if truth is None else truth
    low, high = (float(value) for value in np.nanpercentile(seen, [1, 99]))
    error = ERROR_LIMITS[0]
    if truth is not None:
        size = float(np.nanpercentile(np.abs(100 * (distance / truth - 1)), 90))
        error = next((limit for limit in ERROR_LIMITS if limit >= size), ERROR_LIMITS[-1])
    return Shared((low, high if high > low else low * 1.01), error, outcome)


def _section(result: Result, distance: FloatArray, cut: Cut) -> tuple[FloatArray, FloatArray]:
    """z, and x of a row or y of a column."""
    index = cut.index(distance.shape)
    line = np.s_[index] if cut.is_row else np.s_[:, index]
    rays, along = result.problem.field.rays[line], distance[line]
    return rays[:, 2] * along, rays[:, 0 if cut.is_row else 1] * along


def _section_panel(outcome: Outcome, cut: Cut, of: Outcome) -> Picture:
    """Section of an outcome, on axes that suit the truth of another, or else its result."""
    result = outcome.result
    assert result is not None
    assert of.result is not None
    truth = outcome.truth
    start = np.exp(np.where(result.mask, result.problem.log_facing, np.nan))
    curves = [("start", *_section(result, start, cut))]
    if truth is not None:
        curves.append(("truth", *_section(result, truth, cut)))
    curves.append(("result", *_section(result, result.distance, cut)))
    z, across = _section(of.result, of.result.distance if of.truth is None else of.truth, cut)
    name, unit = ("row" if cut.is_row else "column"), result.problem.unit
    title = f"Section along {name} {cut.index(result.mask.shape)}"
    labels = f"z [{unit}]", f"{'x' if cut.is_row else 'y'} [{unit}]"
    known = np.isfinite(z)
    if not known.any():
        return curve_panel(f"{title}: nothing seen", [], *labels)
    # One scale on both axes, so that angles are angles.
    middle = [(float(value[known].max()) + float(value[known].min())) / 2 for value in (z, across)]
    half = [1.1 * float(np.ptp(value[known])) / 2 + 1e-9 for value in (z, across)]
    tall = max(half[1], half[0] / SECTION_SHAPE)
    x_limits, y_limits = ((m - h, m + h) for m, h in zip(middle, (tall * SECTION_SHAPE, tall), strict=True))
    return curve_panel(title, curves, *labels, down=not cut.is_row, x_limits=x_limits, y_limits=y_limits)


def spots(outcome: Outcome, columns: int = 3) -> list[tuple[float, float, float, float]]:
    """Where input and distance lie on a board: left, top, right, bottom, as shares of it."""
    assert outcome.result is not None
    rows = -(-PANELS // columns)
    return [map_spot(outcome.result.mask.shape, divmod(i, columns), (rows, columns)) for i in (0, 1)]


def _third_panel(outcome: Outcome, third: str, of: Outcome) -> Picture:
    """What was chosen to be shown, σ in colours that suit another outcome, if its σ is known."""
    result, trust, curve = outcome.result, outcome.trust, outcome.curve
    assert result is not None
    if third == NORMALS:
        return map_panel("Normals, (n + 1)/2", grey_or_colour((result.normals + 1) / 2))
    if third == WEIGHTS and curve is not None:
        return _weights_panel(outcome)
    if third == WEIGHTS or trust is None:
        why = "not known, see the line above" if outcome.untold else "to come when the sliders rest"
        return map_panel(
            f"{third[0].upper()}{third[1:]}: {why}", grey_or_colour(np.full(result.mask.shape, np.nan))
        )
    if third == DECIDED:
        shares = [100 * float(np.mean(trust.decided_by[result.mask] == k)) for k in (1, 2, 3)]
        names = [f"{name} {share:.0f} %" for name, share in zip(DECIDERS, shares, strict=True)]
        colours = np.array([LEFT_OUT, *DECIDERS.values()], np.uint8)
        return key_panel("Who decided", names, colours[trust.decided_by], list(DECIDERS.values()))
    percent = 100 * trust.sigma / result.distance
    other = percent if of.trust is None or of.result is None else 100 * of.trust.sigma / of.result.distance
    size = float(np.nanpercentile(other, 98))
    ends = (0.0, next((limit for limit in ERROR_LIMITS if limit >= size), ERROR_LIMITS[-1]))
    title = f"Trust: σ of the distance [%], median {np.nanmedian(percent):.2g}"
    return map_panel(title, coloured(percent, ends, "magma"), ends, palette="magma")


def _weights_panel(outcome: Outcome) -> Picture:
    """How much smoother than noise is what each λ leaves, with the λ to be chosen and the slider's."""
    curve, lam = outcome.curve, outcome.settings.lam
    assert curve is not None
    c = curve.criterion
    known = c[np.isfinite(c)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    margin = 0.1 * (high - low) or 0.1
    low, high = min(low, 0.0) - margin, max(high, 0.0) + margin
    at = np.log10([*curve.lam[[0, -1]], curve.chosen, lam])
    ends = (float(at.min()) - 0.1, float(at.max()) + 0.1)
    curves = [
        ("", np.array(ends), np.zeros(2)),
        ("criterion", np.log10(curve.lam), c),
        ("chosen", np.full(2, at[2]), np.array([low, high])),
        ("now", np.full(2, at[3]), np.array([low, high])),
    ]
    title = f"λ: {curve.chosen:.3g} would be chosen, now {lam:.3g}"
    return curve_panel(title, curves, "log10 λ", "ρ - ρ of noise [1]", x_limits=ends, y_limits=(low, high))


def outcome_board(
    outcome: Outcome, cut: Cut, limits: Shared | None = None, columns: int = 3, third: str = NORMALS
) -> Picture:
    """Draw an outcome that has a result: input, distance, a `third` of `BESIDES`; error, section, energy.

    Colours and section have by default the limits that suit this outcome.
    """
    result, truth = outcome.result, outcome.truth
    assert result is not None
    limits = limits or limits_of(outcome)
    problem, shape = result.problem, result.mask.shape
    frame = map_panel(f"Input, {shape[1]} x {shape[0]} px", grey_or_colour(problem.shown))
    colours = coloured(result.distance, limits.depth)
    depth = map_panel(f"Distance [{problem.unit}], {outcome.label}", colours, limits.depth)
    for panel in (frame, depth):
        cut_panel(panel, shape, cut.index(shape), cut.is_row)
    chosen = _third_panel(outcome, third, limits.of)
    if truth is None:
        error = map_panel("Error: the truth is unknown", grey_or_colour(np.full(shape, np.nan)))
    else:
        ends = (-limits.error, limits.error)
        error = coloured(100 * (result.distance / truth - 1), ends, "diverging")
        error = map_panel("Error of the distance [%]", error, ends, palette="diverging")
    steps = np.array([entry["k"] for entry in result.history], float)
    terms = [
        (name, steps, np.array([entry[name] for entry in result.history]))
        for name in ("data", "regulariser", "energy")
    ]
    curve = curve_panel("Energy", terms, "iteration", "energy [1]", log=True)
    panels = [frame, depth, chosen, error, _section_panel(outcome, cut, limits.of), curve]
    return board([panels[first : first + columns] for first in range(0, PANELS, columns)])


def contrast(settings: Settings, other: Settings) -> str:
    """Say λ, and whatever else differs from other settings."""
    parts = [f"λ = {settings.lam:.3g}"]
    for name, sign in SIGNS.items():
        value = getattr(settings, name)
        if value != getattr(other, name):
            value = NAMES.get(value, value) if isinstance(value, str) else value
            said = f"{value:.3g}" if isinstance(value, float) else value or UNSET.get(name, "as calibrated")
            parts.append(f"{sign} {said}" if name == "gain" else f"{sign} = {said}")
    return ", ".join(parts)


def error_of(outcome: Outcome) -> str:
    """Say the median error of an outcome."""
    error = outcome.median_error
    return "truth unknown" if error is None else f"median error {error:.2f} %"


def summary(outcome: Outcome, drawing: float | None = None) -> str:
    """Say in one line how an outcome came about; `drawing` is what its picture took, s."""
    result, settings = outcome.result, outcome.settings
    assert result is not None
    parts = [
        f"{settings.scene or 'frame'}, λ = {settings.lam:.3g}",
        f"{NAMES[settings.solver]}, {outcome.label}",
        f"{result.iterations} iteration{'' if result.iterations == 1 else 's'}",
        f"energy {result.energy:.3g}",
        error_of(outcome),
        f"solved in {1e3 * outcome.seconds:.0f} ms",
    ]
    if outcome.untold is not None:
        parts.append(outcome.untold)
    if drawing is not None:
        parts.append(f"drawn in {1e3 * drawing:.0f} ms")
    return " · ".join(parts)
