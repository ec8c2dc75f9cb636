"""What the tuner says of an outcome, in a line."""

import numpy as np

from endolab.tuning.engine import FINE, Outcome
from endolab.tuning.source import Settings

NAMES = {"gauss_newton": "Gauss-Newton", "primal_dual": "primal-dual"}
NAMES |= {"fast_marching": "fast marching", "facing": "facing"}
SIGNS = {"scene": "scene", "epsilon": "ε", "k": "k", "gamma": "γ", "gain": "gain ×", "noise": "noise"}
SIGNS |= {"xi": "ξ", "regulariser": "order", "solver": "solver", "channel": "channel", "width": "width"}
SIGNS |= {"highlights": "highlights", "contours": "contours", "smooth": "smooth", "albedo": "albedo"}
UNSET = {"scene": "frame", "channel": "green or grey", "highlights": "auto", "contours": "auto"}
UNSET |= {"smooth": "auto"}  # else "as calibrated"
APART = 1.0  # %; two surfaces that differ by more are not the same


def contrast(settings: Settings, other: Settings) -> str:
    """Say λ, and whatever else differs from other settings."""
    parts = [f"λ = {settings.lam:.2g}"]
    for name, sign in SIGNS.items():
        value = getattr(settings, name)
        if value != getattr(other, name):
            value = NAMES.get(value, value) if isinstance(value, str) else value
            said = UNSET.get(name, "as calibrated") if value is None else value
            said = f"{said:.3g}" if isinstance(said, float) else said
            parts.append(f"{sign} {said}" if name == "gain" else f"{sign} = {said}")
    return ", ".join(parts)


def error_of(outcome: Outcome) -> str:
    """Say the median error of an outcome."""
    error = outcome.median_error
    return "truth unknown" if error is None else f"median error {error:.2f} %"


def ended(outcome: Outcome) -> str:
    """Say how many steps it took, what the most was, and why the last answer ended."""
    result, most = outcome.result, outcome.settings.max_iterations
    assert result is not None
    steps = f"{result.iterations} iteration{'' if result.iterations == 1 else 's'}"
    steps += "" if most is None else f" of {most} at most"
    if outcome.stage != FINE:
        return steps
    return f"{steps}, {result.status.name.lower().replace('_', ' ')}"


def summary(outcome: Outcome, drawing: float | None = None) -> str:
    """Say in one line how an outcome came about; `drawing` is what its picture took, s."""
    result, settings = outcome.result, outcome.settings
    assert result is not None
    parts = [
        f"{settings.scene or 'frame'}, λ = {settings.lam:.2g}",
        f"{NAMES[settings.solver]}, {outcome.label}",
        ended(outcome),
        f"energy {result.energy:.3g}",
        error_of(outcome),
        f"solved in {1e3 * outcome.seconds:.0f} ms",
    ]
    apart = other_start(outcome)
    if apart:
        parts.append(apart)
    if outcome.untold is not None:
        parts.append(outcome.untold)
    if drawing is not None:
        parts.append(f"drawn in {1e3 * drawing:.0f} ms")
    return " · ".join(parts)


def other_start(outcome: Outcome) -> str:
    """Say if the quick answer, which started from the one before, is another surface than this one."""
    if outcome.change is None:
        return ""
    size = np.abs(outcome.change[np.isfinite(outcome.change)])
    if not size.size or size.max() <= APART:
        return ""
    share = 100 * float(np.mean(size > APART))
    where = f"up to {size.max():.2g} % elsewhere ({share:.2g} % of it by over 1 %)"
    return f"from the last answer it would end {where}"
