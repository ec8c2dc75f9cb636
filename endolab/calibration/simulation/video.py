"""A calibration video as an endoscope would take it: a sheet of paper, moved by hand, with its truth."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from endolab.calibration.photometric.samples import Samples, sample_places
from endolab.calibration.simulation.sheet_image import (
    SheetFrame,
    automatic_gain,
    linear_light,
    render_sheet,
    stored,
)
from endolab.calibration.simulation.trajectory import in_view, on_sheet, trajectory
from endolab.calibration.targets import Target
from endolab.model.brdf import Glossy
from endolab.model.cameras import Camera
from endolab.model.photometry import Photometry
from endolab.numerics.arrays import FloatArray

PAPER_SHEET = Glossy(0.8, 0.0373, 10.0)  # a sheen that makes paper 28 % brighter at θ = 0
MOTION = ("fold", "distance", "tilt", "reach", "seen")  # options of `trajectory`


def simulate_video(
    target: Target,
    camera: Camera,
    photometry: Photometry,
    count: int = 300,
    *,
    locked: bool = False,
    seed: int = 0,
    **sensor: Any,
) -> Iterator[SheetFrame]:
    """Simulate a calibration video of `count` frames; each has a gain of its own, whatever the photometry's.

    `locked` keeps one gain for all frames instead of one that follows the sheet. `how`: fold, distance,
    tilt, reach and seen as for `trajectory`; noise, bits, blur, motion, outliers and black as for
    `render_sheet`.
    """
    motion = {name: sensor.pop(name) for name in MOTION if name in sensor}
    poses = trajectory(target, camera, count, seed=seed, **motion)
    gains = automatic_gain(target, poses, camera, photometry, locked=locked)
    for number, (pose, gain) in enumerate(zip(poses, gains, strict=True)):
        light = replace(photometry, gain=float(gain))
        yield render_sheet(target, pose, camera, light, seed=seed * 100_003 + number, **sensor)


def simulate_samples(
    target: Target,
    camera: Camera,
    photometry: Photometry,
    count: int = 300,
    *,
    per_frame: int = 100,
    locked: bool = False,
    noise: float = 3.0,
    bits: int = 8,
    outliers: float = 0.015,
    seed: int = 0,
    **motion: Any,
) -> tuple[Samples, FloatArray]:
    """Simulate the samples of a video without its pictures: true points and normals, and the true gains.

    At most `per_frame` of a frame, at random among the bare places in view. `outliers` is the share of the
    samples whose level is anything between 0 and 1; the rest, fold to seen, is as for `simulate_video`.
    """
    poses = trajectory(target, camera, count, seed=seed, **motion)
    gains = automatic_gain(target, poses, camera, photometry, locked=locked)
    rng = np.random.default_rng([seed, 2])
    places, material = sample_places(target)
    points, normals = on_sheet(target, poses, places)
    visible = in_view(camera, points, normals)
    # The places of a frame in random order, those in view first.
    order = np.argsort(np.where(visible, rng.random(visible.shape), 2.0), axis=1)[:, :per_frame]
    frame, rank = np.nonzero(np.take_along_axis(visible, order, axis=1))
    place = order[frame, rank]
    points, normals = points[frame, place], normals[frame, place]
    light = gains[frame] * places[place, 3] * linear_light(photometry, points, normals)
    level = stored(light, photometry.gamma, noise, bits, rng)
    wild = rng.random(len(level)) < outliers
    level[wild] = stored(rng.random(np.count_nonzero(wild)), 1.0, 0.0, bits, rng)
    return Samples(frame, level, points, normals, material[place]), gains
