"""What is uncertain, in numbers: stated here, or the standard errors of a calibration.

A light that nobody measured is some endoscope's, with k from 0.5 to 3.5 and γ from 1.9 to 2.5: 2.5 and 2.2
are off by 1 and by 0.2, root mean square. A description whose numbers are another endoscope's says so by
`"evidence": {"photometry": {"nominal": true}}`; if k was asked of frames, γ is still nobody's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from endolab.model.endoscope import Calibration
from endolab.numerics.checks import number
from endolab.reconstruction.light.unknown_light import EXPONENT_SEARCH

GAMMA_ERROR = 0.2  # standard deviation of the γ of cameras


@dataclass(frozen=True)
class PriorSigma:
    """Standard deviations of what a reconstruction takes for granted; 0 is certainty.

    Those by default are of an endoscope that was calibrated with care, by somebody who did not say how well;
    for one that was not, see `of`.
    """

    k: float = 0.05  # of the joint exponent of lamp and lens
    gamma: float = 0.02  # of γ
    gain: float = 0.05  # of the gain's logarithm
    albedo: float = 0.05  # of the logarithm of the wall's mean albedo
    texture: float = 0.03  # of the logarithm of its albedo from place to place, at least
    bumps: float = 0.03  # of log d from place to place, where nothing tells of them
    bounced: float = 0.15  # share of the indirect light that was removed
    left_in: float = 1.0  # the same where all of it was left in, as in a single colour
    lamp: float = 0.5  # of the lamps' common place off the optical centre, each way, mm
    lam: float = 2.0  # of λ's logarithm
    border: float = 0.035  # of log d where it enters over the picture's rim
    behind: float = 0.07  # of log d where it enters behind a contour
    # That every line that may be a contour is one: so or not, each as likely.
    contours: float = 0.5
    notes: tuple[str, ...] = ()  # sentences: which of them are measured, which stated

    def __post_init__(self) -> None:
        for choice in fields(self):
            if choice.name != "notes":
                number(f"the doubt about {choice.name}", getattr(self, choice.name), 0)

    @classmethod
    def of(cls, calibration: Calibration | None = None) -> PriorSigma:
        """Standard errors of a calibration's evidence, as far as it has them, or that nobody measured it."""
        evidence = getattr(calibration, "evidence", None) or {}
        stated = cls()
        errors = _standard_errors(evidence)
        nominal = _is_nominal(evidence)
        if nominal:
            stated = replace(stated, k=EXPONENT_SEARCH.usual_error, gamma=GAMMA_ERROR)
        notes = []
        if errors:
            listed = ", ".join(f"{name} ± {value:.2g}" for name, value in errors.items())
            notes.append(f"Standard errors of the calibration: {listed}.")
        if len(errors) < 2:
            listed = ", ".join(
                f"{n} ± {getattr(stated, n):g}" for n in ("k", "gamma") if n not in errors
            )
            why = "The calibration states no standard errors"
            if nominal:
                why = "Light partly uncalibrated" if errors else "Light uncalibrated"
            notes.append(f"{why}; assuming {listed}.")
        k, gamma = (errors.get(name, getattr(stated, name)) for name in ("k", "gamma"))
        return replace(stated, k=k, gamma=gamma, notes=tuple(notes))


def _is_nominal(evidence: Mapping[str, Any]) -> bool:
    """Whether it says that nobody measured the light on this endoscope."""
    return "unknown_light" in evidence or _at(evidence, "photometry", "nominal") is True


def _standard_errors(evidence: Mapping[str, Any]) -> dict[str, float]:
    """Those of k and γ that are there and are numbers; a fixed γ's 0 says nothing."""
    errors = {
        name: _at(evidence, "photometry", "standard_errors", name)
        for name in ("k", "gamma")
    }
    if not _is_positive(errors["k"]):
        errors["k"] = _at(evidence, "unknown_light", "standard_error")
    return {name: float(value) for name, value in errors.items() if _is_positive(value)}


def _at(value: Any, *keys: str) -> Any:
    """What is found in mappings of mappings, or None."""
    for key in keys:
        value = value.get(key) if isinstance(value, Mapping) else None
    return value


def _is_positive(value: Any) -> bool:
    return isinstance(value, int | float) and 0 < value < np.inf
