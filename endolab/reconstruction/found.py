"""What was found of a picture, and stays while energy, solver, light's law and unit are turned."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from endolab.frames.frame import Frame
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import FloatArray
from endolab.reconstruction.problem_of_frame import fingerprint_of
from endolab.reconstruction.settings import SEPARATED, Settings
from endolab.solvers.problem import Problem


@dataclass(frozen=True, eq=False)
class Found:
    """Light and contours that were found, for all surfaces of one picture.

    `problem` is of direct light, and cut, on the pixels that were asked for; its report has the picture's
    `fingerprint`. A solver begins with `start`, log d (H, W) in the problem's unit, or by itself.
    """

    problem: Problem
    settings: Settings  # by which it was found
    believed: Calibration  # camera of the picture, and light when it was found
    start: FloatArray | None = None
    # So many times are rows and columns halved, for a grid on which the start becomes this problem's own.
    halvings: int = 1
    converged_at: float | None = None  # energy of the start, if it is where a run ended

    def problem_with(
        self, settings: Settings, calibration: Calibration
    ) -> tuple[Problem, FloatArray | None]:
        """Return the problem of the energy and the endoscope that are asked for, and a start in its unit."""
        found = self.problem
        rows, columns = found.mask.shape
        asked = settings.as_dict() | {"regulariser": settings.used_regulariser}
        image = found.image
        shift = 1 / found.photometry.gamma - 1 / calibration.photometry.gamma
        if found.lamp_ratio is not None and shift:  # ω is of light
            image = image * found.lamp_ratio**shift
        problem = replace(
            found,
            image=image,
            camera=calibration.camera.resize(columns, rows),
            **settings.energy,
            report=replace(found.report, asked=asked, calibration=calibration),
        )
        channel = found.report.channel
        channel = "green" if channel in (SEPARATED, None) else channel
        before, light = (
            known.photometry.simplify().channel(channel)
            for known in (self.believed, calibration)
        )
        if light != before or problem.camera != found.camera:
            is_known = light.gain is not None
            gain = light.gain if is_known else found.photometry.gain
            light = replace(light, gain=gain)
            problem = replace(problem, photometry=light, metric=is_known).in_units()
        if self.start is None:
            return problem, None
        # d goes with the square root of the gain.
        ratio = (problem.photometry.gain or 1.0) / (found.photometry.gain or 1.0)
        return problem, self.start + 0.5 * np.log(ratio)

    def is_of(self, frame: Frame) -> bool:
        """Whether it was found in this picture, under whatever mask; 0.2 did not tell in which."""
        own = self.problem.report.fingerprint
        return own is None or own[0] == fingerprint_of(frame)[0]

    def differences(
        self, frame: Frame, calibration: Calibration, settings: Settings
    ) -> list[str]:
        """Name what would have to be found anew for a frame, an endoscope and settings; usually nothing."""
        rows, columns = self.problem.mask.shape
        before, now = (
            {
                "camera": known.camera.resize(columns, rows),
                "wall": known.photometry.brdf,
                **asked.search,
            }
            for known, asked in (
                (self.believed, self.settings),
                (calibration, settings),
            )
        )
        other = [name for name in now if before[name] != now[name]]
        if columns != (settings.width or frame.width):
            other.insert(0, "width")
        own = self.problem.report.fingerprint
        if own is not None and own[1] != fingerprint_of(frame)[1]:
            other.insert(0, "mask")
        return other if self.is_of(frame) else ["picture", *other]
