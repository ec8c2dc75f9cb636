"""The real lamps, where they are: their light over that of the virtual lamp at the optical centre.

Solvers know one lamp, at the optical centre. At a surface that is known roughly follows

    ω = Σ_l b_l cosᵐψ_l f_r(θ_l) cos θ_l / d_l²  over  b cosᵐα f_r(θ) cos θ / d²,

the real lamps' light over the virtual one's (`Photometry.intensity` of both). The picture divided by ω^(1/γ)
is what the virtual lamp would have made; it is solved, and ω follows again from a better surface. As d_l is
in mm, so must the surface be: by the gain, or by a length.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from endolab.model.endoscope import Calibration
from endolab.model.photometry import Photometry
from endolab.model.surface import normals, points
from endolab.numerics.arrays import FloatArray
from endolab.numerics.resampling import resample
from endolab.reconstruction.scale import to_scale
from endolab.reconstruction.settings import Settings
from endolab.solvers.problem import Problem
from endolab.solvers.result import Iterate

# Nearer than twice a lamp's offset ω has no bound, and there a surface is too rough to tell it.
BOUNDS = (1 / 3, 3.0)


@dataclass(frozen=True)
class Lamps:
    """Lamps that do not stand at the optical centre, and what makes mm of a surface."""

    photometry: Photometry
    settings: Settings

    @classmethod
    def of(cls, calibration: Calibration, settings: Settings) -> Lamps | None:
        """Return the lamps that a calibration lists; None if one at the centre says the same, or without mm.

        Of an endoscope whose usual distance is known, that will do.
        """
        photometry = calibration.photometry
        if not photometry.lamps_aside:
            return None
        if photometry.gain is None and not any(settings.lengths.values()):
            usual = calibration.evidence.get("photometry", {}).get("usual_distance")
            if usual is None:
                return None
            settings = replace(settings, median_distance=usual)
        return cls(photometry, settings)

    def median(self, surface: Iterate) -> float:
        """Return the median distance of a surface, mm."""
        scaled = to_scale(surface, self.settings)
        return float(np.median(scaled.distance[scaled.mask]))

    def ratio(self, surface: Iterate, step: int = 1) -> FloatArray:
        """Return ω at a surface, (H, W), within `BOUNDS`; 1 where it is unknown.

        Of every `step`-th row and column alone, if it is given.
        """
        scaled = to_scale(surface, self.settings)
        real = replace(self.photometry, gain=1.0, brdf=scaled.problem.photometry.brdf)
        field, v = scaled.problem.field, scaled.log_distance
        seen = (
            points(v[::step, ::step], field.every(step)),
            normals(v, field, scaled.mask, step, scaled.problem.cuts),
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            stored = [light.intensity(*seen) for light in (real, real.simplify())]
            ratio = (stored[0] / stored[1]) ** real.gamma
        return np.clip(np.where(np.isfinite(ratio), ratio, 1.0), *BOUNDS)


def divide_by_lamps(problem: Problem, ratio: FloatArray | None) -> Problem:
    """Return a problem, and its colours, as the virtual lamp would have lit it.

    ω is (h, w) of any size; None: as it was lit.
    """
    before, after = problem.lamp_ratio, None
    if ratio is not None:
        after = np.clip(resample(ratio, problem.mask.shape), *BOUNDS)
    elif before is None:
        return problem
    factor = (1.0 if before is None else before) / (1.0 if after is None else after)
    return replace(
        problem,
        image=problem.image * factor ** (1 / problem.photometry.gamma),
        lamp_ratio=after,
        colours=tuple(divide_by_lamps(colour, ratio) for colour in problem.colours),
    )
