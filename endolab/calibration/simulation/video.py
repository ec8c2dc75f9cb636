"""A calibration video as an endoscope would take it: a sheet of paper, moved by hand, with its truth."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from endolab.calibration.photometric.samples import Samples, sample_places
from endolab.calibration.simulation.sheet_image import (
    SENSOR,
    Sensor,
    SheetFrame,
    automatic_gain,
    linear_light,
    render_sheet,
    round_levels,
    store_levels,
)
from endolab.calibration.simulation.trajectory import (
    MOVEMENT,
    Movement,
    in_view,
    on_sheet,
    trajectory,
)
from endolab.calibration.targets import Target
from endolab.model.brdf import Glossy
from endolab.model.cameras import Camera
from endolab.model.photometry import Photometry
from endolab.numerics.arrays import FloatArray

PAPER_SHEET = Glossy(0.8, 0.0373, 10.0)  # a sheen that makes paper 28 % brighter at θ = 0
SAMPLED = Sensor(outliers=0.015)  # of samples, whose outliers may have any level


def simulate_video(
    target: Target,
    camera: Camera,
    photometry: Photometry,
    count: int = 300,
    *,
    movement: Movement = MOVEMENT,
    sensor: Sensor = SENSOR,
    seed: int = 0,
) -> Iterator[SheetFrame]:
    """Simulate a calibration video; each frame has a gain of its own, whatever the photometry's."""
    poses = trajectory(target, camera, count, movement, seed=seed)
    gains = automatic_gain(target, poses, camera, photometry, locked=sensor.locked)
    for number, (pose, gain) in enumerate(zip(poses, gains, strict=True)):
        light = replace(photometry, gain=float(gain))
        each = seed * 100_003 + number
        yield render_sheet(target, pose, camera, light, sensor, seed=each)


def simulate_samples(
    target: Target,
    camera: Camera,
    photometry: Photometry,
    count: int = 300,
    *,
    movement: Movement = MOVEMENT,
    sensor: Sensor = SAMPLED,
    per_frame: int = 100,
    seed: int = 0,
) -> tuple[Samples, FloatArray]:
    """Simulate the samples of a video without its pictures: true points and normals, and the true gains.

    At most `per_frame` of a frame, at random among the bare places in view. The sensor's `outliers` is the
    share of the samples whose level is anything between 0 and 1; it blurs nothing.
    """
    poses = trajectory(target, camera, count, movement, seed=seed)
    gains = automatic_gain(target, poses, camera, photometry, locked=sensor.locked)
    rng = np.random.default_rng([seed, 2])
    places, material = sample_places(target)
    points, normals = on_sheet(target, poses, places)
    visible = in_view(camera, points, normals)
    # The places of a frame in random order, those in view first.
    order = np.argsort(np.where(visible, rng.random(visible.shape), 2.0), axis=1)
    order = order[:, :per_frame]
    frame, rank = np.nonzero(np.take_along_axis(visible, order, axis=1))
    place = order[frame, rank]
    points = points[frame, place]
    normals = normals[frame, place]
    light = gains[frame] * places[place, 3] * linear_light(photometry, points, normals)
    level = store_levels(light, photometry.gamma, sensor, rng)
    wild = rng.random(len(level)) < sensor.outliers
    level[wild] = round_levels(rng.random(np.count_nonzero(wild)), sensor.bits)
    return Samples(frame, level, points, normals, material[place]), gains
