"""What is uncertain, in numbers: stated here, or the standard errors of a calibration.

A light that nobody measured is some endoscope's, with k from 0.5 to 3 and γ from 1.2 to 2.2: the nominal 1
and 1.5 are off by 1 and by 0.4, root mean square. A description whose numbers are another endoscope's says
so by `"evidence": {"photometry": {"nominal": true}}`; if k was asked of frames, γ is still nobody's.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from endolab.model.endoscope import Calibration
from endolab.numerics.checked_types import checked
from endolab.reconstruction.report import prior_notes

Sigma = Annotated[float, Field(ge=0)]


@checked
class PriorSigma:
    """Standard deviations of what a reconstruction takes for granted; 0 is certainty.

    Those by default are of an endoscope that was calibrated with care, by somebody who did not say how well;
    for one that was not, see `of`.
    """

    k: Sigma = 0.05  # of the joint exponent of lamp and lens
    gamma: Sigma = 0.02  # of γ
    gain: Sigma = 0.05  # of the gain's logarithm
    albedo: Sigma = 0.05  # of the logarithm of the wall's mean albedo
    texture: Sigma = 0.03  # of the logarithm of its albedo from place to place, at least
    bumps: Sigma = 0.03  # of log d from place to place, where nothing tells of them
    bounced: Sigma = 0.15  # fraction of the indirect light that was removed
    left_in: Sigma = 1.0  # the same where all of it was left in, as in a single colour
    lamp: Sigma = 0.5  # of the lamps' common place off the optical centre, each way, mm
    lam: Sigma = 2.0  # of λ's logarithm
    border: Sigma = 0.035  # of log d where it enters over the picture's rim
    behind: Sigma = 0.07  # of log d where it enters behind a contour
    # That every line that may be a contour is one: so or not, each as likely.
    contours: Sigma = 0.5
    notes: tuple[str, ...] = ()  # sentences: which of them are measured, which stated

    @classmethod
    def of(cls, calibration: Calibration | None = None) -> PriorSigma:
        """Standard errors of a calibration's evidence, as far as it has them, or that nobody measured it."""
        evidence = getattr(calibration, "evidence", None) or {}
        is_unmeasured = _entry(evidence, "photometry", "nominal") is True
        is_unmeasured |= "unknown_light" in evidence
        errors = _entry(evidence, "photometry", "standard_errors")
        errors = errors if isinstance(errors, Mapping) else {}
        listed = {} if evidence.get("lamps") == "given" else errors
        places = [
            error
            for name, error in listed.items()
            if name.startswith("lamp ") and isinstance(error, int | float)
        ]
        # Of the mean place of n lamps, each way, of which there are 2 n numbers.
        common = np.sqrt(2 * np.sum(np.square(places))) / len(places) if places else None
        stated = (
            ("lamp", common and float(common)),
            ("k", _entry(evidence, "unknown_light", "standard_error")),
            ("k", _entry(errors, "k")),
            ("gamma", _entry(errors, "gamma")),
        )
        measured = {  # a fixed γ's 0 says nothing
            name: float(error)
            for name, error in stated
            if isinstance(error, int | float) and 0 < error < np.inf
        }
        assumed = (
            {"k": 1.0, "gamma": 0.4} if is_unmeasured else {"k": cls.k, "gamma": cls.gamma}
        )
        assumed = {name: error for name, error in assumed.items() if name not in measured}
        notes = tuple(prior_notes(measured, assumed, is_unmeasured))
        return cls(**measured, **assumed, notes=notes)


def _entry(value: Any, *keys: str) -> Any:
    """What is found in mappings of mappings, or None."""
    for key in keys:
        value = value.get(key) if isinstance(value, Mapping) else None
    return value
