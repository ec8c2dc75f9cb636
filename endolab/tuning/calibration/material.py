"""What a calibration was made of, and the same fits again without some of its frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from endolab.calibration.detection.detect import Detection
from endolab.calibration.geometric.fit import GeometricFit, calibrate_camera
from endolab.calibration.geometric.pose import Pose
from endolab.calibration.geometric.reprojection import View, find_pose, views_of
from endolab.calibration.least_squares import FitIterate
from endolab.calibration.photometric.fit import calibrate_light
from endolab.calibration.photometric.left_out import why_left_out
from endolab.calibration.photometric.model import GREY
from endolab.calibration.photometric.result import PhotometricFit
from endolab.calibration.photometric.samples import Samples
from endolab.calibration.session import Session
from endolab.calibration.targets import Target
from endolab.model.brdf import Lambertian
from endolab.model.cameras import Camera
from endolab.numerics.arrays import BoolArray, FloatArray, IntArray

Watcher = Callable[[FitIterate], bool | None]
COUNTS, BY_HAND, DROPPED, NOTHING = "counts", "left out by hand", "left out by the fit", "nothing found"


def light_options(light: PhotometricFit) -> dict[str, Any]:
    """Tell from a fit of the light how `calibrate_light` was asked, as far as it shows.

    A γ or a reflectance that was roughly known comes out as one that was free.
    """
    gamma = light.photometry.gamma
    reflectance = [
        None if f"reflectance {m}" in light.names else float(light.reflectance[m])
        for m in range(1, len(light.reflectance))
    ]
    return {
        "gamma": "free" if "gamma" in light.names else gamma,
        "brdf": "lambertian" if isinstance(light.photometry.brdf, Lambertian) else "tabulated",
        "gain": "free" if light.photometry.gain is None else "locked",
        "light": "free" if light.photometry.lights else "centred",
        "reflectance": reflectance,
    }


def _asked(
    fit: GeometricFit, target: Target, detections: Mapping[str, Detection]
) -> tuple[dict[str, list[View]], dict[str, str]]:
    """Views of the frames that a fit of the camera was shown, by name; and why the others were not."""
    shown = {view.name for view in fit.views} | {label.split(", panel ")[0] for label in fit.dropped}
    views = {name: views_of(name, one, target) for name, one in detections.items() if name in shown}
    reasons = {}
    for name, detection in detections.items():
        if name not in shown:
            few = detection.reason or "too few points"
            enough = bool(views_of(name, detection, target))
            reasons[name] = (
                "the camera was not asked of it: one frame in so many is enough" if enough else few
            )
    return views, reasons


@dataclass(frozen=True)
class Material:
    """What a calibration was made of; `names` are those of all its frames, in order."""

    names: tuple[str, ...]
    target: Target | None = None
    views: Mapping[str, Sequence[View]] = field(default_factory=dict)  # what was found in a frame
    reasons: Mapping[str, str] = field(default_factory=dict)  # why there is nothing of a frame
    samples: Samples | None = None
    lit: tuple[str, ...] = ()  # names by the number of a sample's frame
    options: Mapping[str, Any] = field(default_factory=dict)  # of `calibrate_light`
    camera: Camera | None = None  # by which the samples were read
    poses: Mapping[str, Sequence[Pose | None]] = field(default_factory=dict)  # likewise

    @classmethod
    def of_session(cls, session: Session, options: Mapping[str, Any]) -> Material:
        """Take a whole calibration apart."""
        views: dict[str, list[View]] = {}
        reasons: dict[str, str] = {}
        if session.geometry is not None:
            views, reasons = _asked(session.geometry, session.target, session.detections)
        return cls(
            names=tuple(session.detections),
            target=session.target,
            views=views,
            reasons=reasons | session.dropped,
            samples=session.samples if session.light is not None else None,
            lit=tuple(session.poses),
            options=dict(options),
            camera=session.camera,
            poses=session.poses,
        )

    @classmethod
    def of_camera(
        cls, fit: GeometricFit, target: Target, detections: Mapping[str, Detection] | None
    ) -> Material:
        """Take a calibration of the camera apart; `detections` bring back the views that it left out."""
        if detections is None:
            seen = dict.fromkeys(view.name for view in fit.views)
            views = {name: [view for view in fit.views if view.name == name] for name in seen}
            return cls(names=tuple(views), target=target, views=views)
        views, reasons = _asked(fit, target, detections)
        return cls(names=tuple(detections), target=target, views=views, reasons=reasons)

    @classmethod
    def of_light(cls, samples: Samples, camera: Camera | None, options: Mapping[str, Any]) -> Material:
        """Take a calibration of the light apart; its frames are called by their numbers."""
        lit = tuple(str(number) for number in range(int(samples.frame.max(initial=-1)) + 1))
        present = tuple(str(number) for number in np.unique(samples.frame))
        return cls(names=present, samples=samples, lit=lit, options=dict(options), camera=camera)

    @cached_property
    def _of_frame(self) -> dict[str, slice]:
        """Which samples are of which frame."""
        assert self.samples is not None
        numbers, first = np.unique(self.samples.frame, return_index=True)
        ends = np.append(first[1:], len(self.samples))
        return {
            self.lit[number]: slice(int(a), int(b)) for number, a, b in zip(numbers, first, ends, strict=True)
        }

    def is_evidence(self, name: str) -> bool:
        """Whether anything was found in a frame."""
        here = self.samples_of(name)
        return bool(self.views.get(name)) or here.stop > here.start

    def samples_of(self, name: str) -> slice:
        """Which samples are of a frame."""
        return slice(0, 0) if self.samples is None else self._of_frame.get(name, slice(0, 0))

    def shown(self, left_out: frozenset[str]) -> BoolArray:
        """Which samples a fit without some frames is shown, (n,)."""
        assert self.samples is not None
        away = [number for number, name in enumerate(self.lit) if name in left_out]
        return ~np.isin(self.samples.frame, away)

    # The same fits again -------------------------------------------------------------------

    def fit_camera(
        self, start: GeometricFit, left_out: frozenset[str], observers: Sequence[Watcher] = ()
    ) -> GeometricFit:
        """Fit the camera without some frames, beginning at an earlier fit, to which it owes nothing else."""
        assert self.target is not None
        views = [view for name, some in self.views.items() if name not in left_out for view in some]
        fixed = [name for name, error in start.standard_errors.items() if error == 0]
        size = start.camera.width, start.camera.height
        how: dict[str, Any] = {"start": start, "fixed": fixed, "observers": observers}
        return calibrate_camera(views, self.target, *size, **how)

    def fit_light(self, left_out: frozenset[str], observers: Sequence[Watcher] = ()) -> PhotometricFit:
        """Fit the light without some frames; it needs no start, as its first step is linear."""
        assert self.samples is not None
        return calibrate_light(self.samples[self.shown(left_out)], observers=observers, **self.options)


# What a fit makes of each frame ----------------------------------------------------------------
@dataclass(frozen=True)
class Dots:
    """The dots of one frame and where a camera expects them."""

    state: str  # COUNTS, …
    why: str  # in a sentence, if they do not count
    found: FloatArray  # (n, 2), px
    residual: FloatArray  # (n, 2), found less expected, px; nan if they have no pose
    inliers: BoolArray  # (n,), dots that agree
    poses: tuple[Pose | None, ...]  # of the panels, as far as known

    @property
    def error(self) -> float:
        """Root mean square distance of the dots that agree, px; nan if there are none."""
        return _rms(np.linalg.norm(self.residual[self.inliers], axis=1))

    @property
    def error_of_all(self) -> float:
        """The same of all dots."""
        return _rms(np.linalg.norm(self.residual, axis=1))


@dataclass(frozen=True)
class Levels:
    """The samples of one frame and what is expected of them."""

    state: str
    why: str
    samples: Samples
    expected: FloatArray  # (n,), stored values; by a gain of its own if the fit was not shown the frame
    reason: IntArray  # (n,), of `left_out.reasons`; if the frame was left out, what it would be
    used: BoolArray  # (n,), that count, or would

    @property
    def residual(self) -> FloatArray:
        """Measured less expected, (n,), grey levels."""
        return GREY * (self.samples.level - self.expected)

    @property
    def error(self) -> float:
        """Root mean square residual of the samples that count, grey levels."""
        return _rms(self.residual[self.used])

    @property
    def relative_error(self) -> float:
        """The same over what is expected, %."""
        return 100 * _rms(self.residual[self.used] / (GREY * self.expected[self.used]))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size and np.isfinite(values).all() else np.nan


def dots_of(material: Material, fit: GeometricFit, left_out: frozenset[str], name: str) -> Dots:
    """Compare the dots of a frame with a camera, whether it took part in the fit or not."""
    assert material.target is not None
    poses: list[Pose | None] = [None] * material.target.panels
    parts, taken = [], False
    why = material.reasons.get(name, "")
    for view in material.views.get(name, ()):
        at = next((i for i, v in enumerate(fit.views) if (v.name, v.panel) == (name, view.panel)), None)
        if at is not None and name not in left_out:
            pose, inliers, residual, taken = fit.poses[at], fit.inliers[at], fit.residuals[at], True
        else:
            label = name if material.target.panels == 1 else f"{name}, panel {view.panel}"
            why = fit.dropped.get(label, why)
            try:
                pose, inliers, residual = find_pose(view, material.target, fit.camera)
            except ValueError as error:
                why = str(error)
                nowhere, nobody = np.full((len(view.ids), 2), np.nan), np.zeros(len(view.ids), bool)
                parts.append((view.pixels, nowhere, nobody))
                continue
        poses[view.panel] = pose
        parts.append((view.pixels, residual, inliers))
    if not parts:
        return Dots(NOTHING, why, np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0, bool), tuple(poses))
    state = BY_HAND if name in left_out else COUNTS if taken else DROPPED
    found, residual, inliers = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Dots(state, why, found, residual, inliers, tuple(poses))


def levels_of(
    material: Material, fit: PhotometricFit, left_out: frozenset[str], name: str, index: slice
) -> Levels:
    """Compare the samples of a frame with a light, whether it took part in the fit or not.

    `index` tells where they are among those that the fit was shown.
    """
    assert material.samples is not None
    here = material.samples_of(name)
    samples = material.samples[here]
    limits = {"levels": material.options["levels"]} if "levels" in material.options else {}
    if not len(samples):
        why, nothing = material.reasons.get(name, "no sample was read in it"), np.zeros(0)
        return Levels(NOTHING, why, samples, nothing, nothing.astype(int), nothing.astype(bool))
    if name in left_out:
        try:
            told = fit.held_out(samples, **limits)
        except ValueError as error:
            unknown = np.full(len(samples), np.nan)
            nobody = np.zeros(len(samples), bool)
            return Levels(BY_HAND, str(error), samples, unknown, np.ones(len(samples), int), nobody)
        expected, used = samples.level - told.residuals / GREY, told.used
        reason = why_left_out(samples.level, expected, used, fit.sigma, **limits)
        return Levels(BY_HAND, "", samples, expected, reason, used)
    expected, used = samples.level - fit.residuals[index] / GREY, fit.used[index]
    reason = why_left_out(samples.level, expected, used, fit.sigma, **limits)
    if used.any():
        return Levels(COUNTS, "", samples, expected, reason, used)
    return Levels(DROPPED, "none of its samples counts", samples, expected, reason, used)
