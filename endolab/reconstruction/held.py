"""What stays while λ, the energy or the light's law are turned: direct light, cuts, scale, and a start."""

from __future__ import annotations

from dataclasses import dataclass, replace

from endolab.model.endoscope import Calibration
from endolab.model.photometry import Photometry
from endolab.numerics.arrays import FloatArray
from endolab.reconstruction.problem_of_frame import in_units
from endolab.reconstruction.settings import Settings
from endolab.solvers.problem import Problem


@dataclass(frozen=True, eq=False)
class Held:
    """Light and contours that were found, for other surfaces of the same picture.

    `problem` is of direct light, and cut; `light` is what was believed when it was found; `start` is log d to
    begin with, (H, W): a surface that is solved from it depends on nothing else that was tried.
    """

    problem: Problem
    light: Photometry
    start: FloatArray

    def problem_with(self, settings: Settings, calibration: Calibration) -> Problem:
        """Return the problem with the energy that is asked for, by the endoscope that is believed in."""
        known = self.problem.photometry
        before = self.light.simplify()
        now = calibration.photometry.simplify()
        rows, columns = self.problem.mask.shape
        camera = calibration.camera.resize(columns, rows)
        is_same = now == before and camera == self.problem.camera
        gain = known.gain
        if gain and before.gain and now.gain:
            gain *= now.gain / before.gain
        k = max(known.k + now.k - before.k, 0.0)
        problem = replace(
            self.problem,
            camera=camera,
            photometry=replace(known, k=k, gamma=now.gamma, gain=gain),
            xi=settings.xi,
            regulariser=settings.used_regulariser,
            lam=settings.lam,
            epsilon=settings.epsilon,
            threshold=settings.threshold,
        )
        return problem if is_same else in_units(problem)
