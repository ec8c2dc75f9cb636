"""What some fits make of all frames: the errors that are drawn as bars, and who does not count."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from endolab.calibration.photometric.left_out import why_left_out
from endolab.calibration.summary import counted
from endolab.numerics.arrays import FloatArray, IntArray
from endolab.tuning.calibration.material import (
    BY_HAND,
    COUNTS,
    Dots,
    Levels,
    Material,
    dots_of,
    levels_of,
)
from endolab.tuning.calibration.refit import State
from endolab.tuning.calibration.space import Line, panel_corners

PIXELS, LEVELS_OFF, PERCENT = "camera: px", "light: grey levels", "light: %"
UNITS = {PIXELS: "px", LEVELS_OFF: "grey levels", PERCENT: "%"}


@dataclass(frozen=True)
class Judged:
    """All frames beside the fits of a `State`, by the names of the frames."""

    material: Material
    state: State
    dots: dict[str, Dots]  # empty if there is no fit of the camera
    levels: dict[str, Levels]  # empty if there is none of the light

    @classmethod
    def of(cls, made: Material, state: State) -> Judged:
        """Compare all frames with the fits."""
        dots, levels = {}, {}
        if state.camera is not None:
            dots = {name: dots_of(made, state.camera, state.camera_without, name) for name in made.names}
        if state.light is not None:
            shown = np.cumsum(np.append(0, made.shown(state.light_without)))
            for name in made.names:
                here = made.samples_of(name)
                index = slice(int(shown[here.start]), int(shown[here.stop]))
                levels[name] = levels_of(made, state.light, state.light_without, name, index)
        return cls(made, state, dots, levels)

    def error(self, name: str, quantity: str) -> float:
        """Error of a frame; nan if it is not known."""
        if quantity == PIXELS:
            return self.dots[name].error
        levels = self.levels[name]
        return levels.relative_error if quantity == PERCENT else levels.error

    def overall(self, quantity: str) -> float:
        """Root mean square error of all that counts."""
        if quantity == PIXELS:
            return 0.0 if self.state.camera is None else self.state.camera.rmse
        count = {name: one for name, one in self.levels.items() if one.state == COUNTS}
        squares = sum(one.used.sum() * self.error(name, quantity) ** 2 for name, one in count.items())
        return float(np.sqrt(squares / max(sum(one.used.sum() for one in count.values()), 1)))

    def bar(self, name: str, quantity: str, left_out: frozenset[str], common: int) -> dict[str, Any]:
        """Describe a frame as `Bars` draws it; labels lack what all names have in `common`, so many signs."""
        error = self.error(name, quantity)
        seen: Dots | Levels = self.dots[name] if quantity == PIXELS else self.levels[name]
        if isinstance(seen, Dots):
            out = int(np.sum(~seen.inliers))
            tip = f"{error:.3f} px; {out} of {counted(len(seen.inliers), 'dot')} disagree"
        else:
            out, of = int(np.sum(~seen.used)), counted(len(seen.used), "sample")
            tip = f"{error:.2f} {UNITS[quantity]}; {out} of {of} do not count"
        # Perhaps the fit that does without it is on its way.
        state = BY_HAND if name in left_out and seen.state == COUNTS else seen.state
        told = f"{name}: {state}" + (f": {seen.why}" if seen.why else "")
        return {
            "label": name[common:] or name,
            "value": error if np.isfinite(error) else None,
            "out": out,
            "state": state,
            "tip": told + (f"\n{tip}" if np.isfinite(error) else ""),
        }

    def expected(self) -> FloatArray:
        """What is expected of every sample, (n,), stored values; nan where that is not known."""
        assert self.material.samples is not None
        expected = np.full(len(self.material.samples), np.nan)
        for name, levels in self.levels.items():
            expected[self.material.samples_of(name)] = levels.expected
        return expected

    def reasons(self, expected: FloatArray, limits: tuple[float, float]) -> IntArray:
        """Why every sample does not count, (n,), as `why_left_out` numbers it."""
        samples, light = self.material.samples, self.state.light
        assert samples is not None
        assert light is not None
        used = np.zeros(len(samples), bool)
        shown = self.material.shown(self.state.light_without)
        used[shown] = light.used
        return why_left_out(samples.level, expected, used, light.sigma, limits, by_hand=~shown)

    def sheets(self, quantity: str, left_out: frozenset[str]) -> list[tuple[str, str, Line]]:
        """Frame, state and corners of every panel that is located."""
        target = self.material.target
        found: list[tuple[str, str, Line]] = []
        for name in self.material.names if target is not None else ():
            seen: Dots | Levels = self.dots[name] if quantity == PIXELS else self.levels[name]
            poses = seen.poses if isinstance(seen, Dots) else self.material.poses.get(name, ())
            state = BY_HAND if name in left_out else seen.state
            assert target is not None
            found += [(name, state, corners) for corners in panel_corners(target, poses)]
        return found
