"""A calibration video as an endoscope would take it: a sheet of paper, moved by hand, with its truth.

The sheet is rasterised once, and read where many rays a pixel meet it; a pixel's light is that of its middle.
What the camera does to the light (gain, response, noise, rounding) comes last.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from endolab.calibration.detection.blobs import Numbers
from endolab.calibration.photometric.samples import Samples, sample_places
from endolab.calibration.simulation.trajectory import (
    Panels,
    Shooting,
    see,
    trajectory,
)
from endolab.calibration.targets import Target
from endolab.model.brdf import Glossy
from endolab.model.cameras import Camera
from endolab.model.photometry import Photometry
from endolab.numerics.arrays import FloatArray, nan_if_undefined
from endolab.numerics.memory import RENDERING_BYTES, check_memory
from endolab.synthetic.rendering import develop

PAPER_SHEET = Glossy(0.8, 0.0373, 10.0)  # a sheen that makes paper 28 % brighter at θ = 0
BLACK = 0.04  # the ink's reflectance
FAR = -1e3  # mm; a place that is beside any sheet
FINEST = 0.025  # mm, side of a cell of the sheet's raster, ...
MOST_CELLS = 6000  # ... which has at most so many along a side
WHITE = 0.7  # stored value that the gain gives to the bright part of the sheet
GAINS = 3.0  # largest over smallest, as in the paper
RAYS = 3000  # across the picture, at least


@dataclass(frozen=True, eq=False)
class SheetFrame:
    """A simulated frame and its truth."""

    image: FloatArray  # (H, W), stored values in [0, 1]
    poses: Panels  # of each panel of the sheet
    gain: float


@lru_cache(maxsize=2)
def rasterise(target: Target) -> tuple[Numbers, float]:
    """Reflectance of a sheet averaged over cells, from its upper left on; and the side of a cell, mm.

    What is printed is taken to end at a straight line within a cell.
    """
    left, top, width, height = target.sheet
    step = max(FINEST, max(width, height) / MOST_CELLS)
    x = left + step * (np.arange(np.ceil(width / step)) + 0.5)
    y = top + step * (np.arange(np.ceil(height / step)) + 0.5)
    white = np.ones((len(y), len(x)), np.float32)
    inked = [(*disc, np.hypot) for disc in target.discs.tolist()]
    half = target.squares[:, 2:] / 2
    middles = np.column_stack([target.squares[:, :2] + half, half, 0 * half])
    inked += [(*square, np.maximum) for square in middles.tolist()]
    for across, down, half, grey, distance in inked:
        reach = half + step
        row = slice(*np.searchsorted(y, [down - reach, down + reach]))
        column = slice(*np.searchsorted(x, [across - reach, across + reach]))
        offset = distance.outer(np.abs(y[row] - down), np.abs(x[column] - across))
        share = np.clip((half - offset) / step + 0.5, 0, 1)  # of a cell
        white[row, column] -= (1 - (grey or BLACK)) * share
    return np.maximum(white, BLACK), step


def linear_light(
    photometry: Photometry, points: FloatArray, normals: FloatArray
) -> FloatArray:
    """Linear light of bare paper at gain 1; 0 where none arrives."""
    with nan_if_undefined():
        stored = replace(photometry, gain=1.0).intensity(points, normals)
        return np.nan_to_num(stored**photometry.gamma)


def automatic_gain(
    target: Target, panels: Panels, camera: Camera, photometry: Photometry
) -> float:
    """Gain that a camera would choose, by the brightness of the sheet."""
    points, normals, seen = see(target, panels, camera, target.points)
    light = linear_light(photometry, points[seen], normals[seen])
    return float(WHITE**photometry.gamma / np.percentile(light, 80))


def _film(
    target: Target,
    camera: Camera,
    photometry: Photometry,
    count: int,
    seed: int,
    **shooting: Any,
) -> list[tuple[Panels, float]]:
    """Poses of the panels, and a gain, of each frame of a video.

    Gains differ by a factor of `GAINS` at most, so that near frames are overexposed and far ones dark.
    """
    poses = trajectory(target, camera, count, seed=seed, **shooting)
    wanted = [automatic_gain(target, panels, camera, photometry) for panels in poses]
    most = 1.0 if Shooting(**shooting).locked else np.sqrt(GAINS)
    middle = float(np.median(wanted))
    gains = np.clip(wanted, middle / most, middle * most).tolist()
    return list(zip(poses, gains, strict=True))


def render_sheet(
    target: Target,
    panels: Panels,
    camera: Camera,
    photometry: Photometry,
    *,
    seed: int = 0,
    **shooting: Any,
) -> SheetFrame:
    """Render a sheet in the dark as the endoscope sees it; a fold's ridge is towards the camera.

    The photometry's BRDF is that of the white paper; if its gain is unknown, that of `automatic_gain` is
    taken. `shooting`: noise and outliers, as in `Shooting`.
    """
    how = Shooting(**shooting)
    gain = photometry.gain
    if gain is None:
        gain = automatic_gain(target, panels, camera, photometry)
    size = camera.width, camera.height
    check_memory(RENDERING_BYTES * camera.width * camera.height, "such a picture")
    rays = camera.field.rays
    times = math.ceil(RAYS / camera.width)
    white, step = rasterise(target)
    linear = np.zeros(rays.shape[:2])
    for number, pose in enumerate(panels):
        points = pose.meet(rays)
        places = (points - pose.translation) @ pose.rotation[:, :2]
        places = np.nan_to_num(places, nan=FAR).astype(np.float32)
        fine = cv2.resize(places, None, fx=times, fy=times)
        x, y = ((fine[..., i] - target.sheet[i]) / step - 0.5 for i in (0, 1))
        seen = cv2.remap(white, x, y, cv2.INTER_LINEAR)
        seen *= target.panel_of(fine) == number
        normals = np.broadcast_to(pose.normal, rays.shape)
        light = linear_light(photometry, points, normals)
        linear += gain * light * cv2.resize(seen, size, interpolation=cv2.INTER_AREA)
    # Dust, and glints, of 7 px.
    blot = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7))
    draws = np.random.default_rng([seed, 2]).random((*linear.shape, 2))
    spots = (draws < how.outliers / 2 / blot.sum()).astype(np.float32)
    dust, glints = np.moveaxis(cv2.dilate(spots, blot), -1, 0)
    linear = linear * (1 - 0.8 * dust) + 1.5 * glints
    image = develop(linear, photometry.gamma, how.noise, how.bits, seed)
    return SheetFrame(image, panels, gain)


def simulate_video(
    target: Target,
    camera: Camera,
    photometry: Photometry,
    count: int = 300,
    *,
    seed: int = 0,
    **shooting: Any,
) -> Iterator[SheetFrame]:
    """Simulate a calibration video, as `Shooting` says; each frame has a gain of its own."""
    film = _film(target, camera, photometry, count, seed, **shooting)
    for number, (panels, gain) in enumerate(film):
        light = replace(photometry, gain=gain)
        each = seed * 100_003 + number
        yield render_sheet(target, panels, camera, light, seed=each, **shooting)


def simulate_samples(
    target: Target,
    camera: Camera,
    photometry: Photometry,
    count: int = 300,
    *,
    per_frame: int = 100,
    seed: int = 0,
    outliers: float = 0.015,
    **shooting: Any,
) -> tuple[Samples, FloatArray]:
    """Simulate the samples of a video without its pictures: true points and normals, and the true gains.

    At most `per_frame` of a frame, at random among the bare places in view. `outliers` is the share of the
    samples whose level is anything between 0 and 1.
    """
    how = Shooting(outliers=outliers, **shooting)
    film = _film(target, camera, photometry, count, seed, **shooting)
    rng = np.random.default_rng([seed, 2])
    places, material = sample_places(target)
    parts = []
    for number, (panels, gain) in enumerate(film):
        points, normals, seen = see(target, panels, camera, places)
        light = gain * places[:, 3] * linear_light(photometry, points, normals)
        frame = np.full(len(places), number)
        some = rng.permutation(np.flatnonzero(seen))[:per_frame]
        parts.append(Samples(frame, light, points, normals, material)[some])
    samples = Samples.concatenate(parts)
    level = develop(samples.level, photometry.gamma, how.noise, how.bits, seed)
    wild = rng.random(len(level)) < how.outliers
    level = np.where(wild, rng.random(len(level)), level)
    return replace(samples, level=level), np.array([gain for _, gain in film])
