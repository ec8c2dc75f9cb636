"""What is uncertain, in numbers: stated here, or the standard errors of a calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from endolab.model.endoscope import Endoscope
from endolab.numerics.checks import number


@dataclass(frozen=True)
class Doubts:
    """Standard deviations of what a reconstruction takes for granted; 0 is certainty.

    Those by default are of an endoscope that was calibrated with care, by somebody who did not say how well.
    """

    k: float = 0.05  # of the joint exponent of lamp and lens
    gamma: float = 0.02  # of γ
    gain: float = 0.05  # of the gain's logarithm
    albedo: float = 0.05  # of the logarithm of the wall's mean albedo
    texture: float = 0.03  # of the logarithm of its albedo from place to place, at least
    bumps: float = 0.03  # of log d from place to place, where nothing tells of them
    bounced: float = 0.15  # share of the bounced light that was taken out
    left_in: float = 1.0  # the same where all of it was left in, as in a single colour
    lamp: float = 0.5  # of the lamps' common place off the optical centre, each way, mm
    lam: float = 1.5  # of λ's logarithm
    border: float = 0.05  # of log d where it enters, over the picture's rim or behind a contour
    contours: float = 0.5  # that every line that may be a contour is one: so or not, each as likely
    notes: tuple[str, ...] = ()  # sentences: which of them are measured, which stated

    def __post_init__(self) -> None:
        for one in fields(self):
            if one.name != "notes":
                number(f"the doubt about {one.name}", getattr(self, one.name), 0)

    @classmethod
    def of(cls, calibration: Endoscope | None = None) -> Doubts:
        """Standard errors of a calibration's evidence, as far as it has them."""
        found, stated = _standard_errors(getattr(calibration, "evidence", None) or {}), cls()
        notes = []
        if found:
            told = ", ".join(f"{name} ± {value:.2g}" for name, value in found.items())
            notes.append(f"The calibration's standard errors are used: {told}.")
        if len(found) < 2:
            told = ", ".join(f"{n} ± {getattr(stated, n):g}" for n in ("k", "gamma") if n not in found)
            notes.append(f"No standard errors of the calibration are known: taken are {told}.")
        k, gamma = (found.get(name, getattr(stated, name)) for name in ("k", "gamma"))
        return replace(stated, k=k, gamma=gamma, notes=tuple(notes))


def _standard_errors(evidence: Mapping[str, Any]) -> dict[str, float]:
    """Those of k and γ that are there and are numbers; a fixed γ's 0 says nothing."""
    found = {}
    for name in ("k", "gamma"):
        for place in (("photometry", "standard_errors", name), ("unknown_light", "standard_error")):
            value: Any = evidence
            for key in place:
                value = value.get(key) if isinstance(value, Mapping) else None
            if place[0] == "unknown_light" and name != "k":
                continue
            if isinstance(value, int | float) and np.isfinite(value) and value > 0:
                found[name] = float(value)
                break
    return found
