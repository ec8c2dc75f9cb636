"""The picture that an endoscope takes of a sheet of paper, exact down to the pixel's area.

The dots are averaged over each pixel in linear light. What the camera does to the light (gain,
response, noise, saturation, rounding) comes last.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import accumulate
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from endolab.calibration.geometric.pose import Pose
from endolab.calibration.simulation.trajectory import in_view, on_sheet
from endolab.calibration.targets import Target, darkness
from endolab.model.brdf import Lambertian
from endolab.model.cameras import Camera
from endolab.model.photometry import Photometry
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checks import check_int, number
from endolab.numerics.memory import RENDERING_BYTES, check_memory

Float32Array = NDArray[np.float32]


@dataclass(frozen=True)
class GainRules:
    """How the automatic gain of a simulated camera behaves."""

    white: float = 0.7  # stored value that it gives to the bright part of the sheet
    largest_ratio: float = 3.0  # largest gain over smallest, as in the paper
    lag: float = 1 / 60  # of the video, that it needs to follow


@dataclass(frozen=True)
class RenderRules:
    """How finely a sheet is drawn, and what lies behind it."""

    cloth_albedo: float = 0.03  # of a dark cloth ...
    behind: float = 20.0  # ... this far behind the sheet, mm
    cell: float = 0.025  # side of a cell of the finest raster of the sheet, mm ...
    most_cells: int = 6000  # ... which has at most so many along a side
    rasters: int = 5  # each half as fine as the one before
    rays: int = 2  # a pixel, in each direction
    tile: int = 120  # px


GAIN_RULES = GainRules()
RENDER_RULES = RenderRules()


@dataclass(frozen=True)
class Sensor:
    """What an endoscope's camera makes of the light."""

    noise: float = 3.0  # standard deviation, grey levels of 255
    bits: int = 8  # that values are rounded to
    blur: float = 0.0  # standard deviation of the defocus, px
    motion: float = 0.0  # length of the motion blur, px, in a random direction
    outliers: float = 0.0  # share of the sheet under glints and dust
    black: float = 0.04  # the ink's reflectance
    # One gain for all frames of a video, instead of one that follows the sheet.
    locked: bool = False

    def __post_init__(self) -> None:
        for name in ("noise", "blur", "motion"):
            number(name, getattr(self, name), 0)
        for name in ("outliers", "black"):
            if not 0 <= getattr(self, name) < 1:
                raise ValueError(
                    f"{name} must be from 0 to below 1, got {getattr(self, name)}"
                )
        if not 1 <= self.bits <= 16:
            raise ValueError(f"bits must be from 1 to 16, got {self.bits}")


SENSOR = Sensor()


@dataclass(frozen=True)
class SheetFrame:
    """A simulated frame and its truth."""

    image: FloatArray  # (H, W), stored values in [0, 1]
    poses: tuple[Pose, ...]  # of each panel of the sheet
    gain: float


def linear_light(
    photometry: Photometry, points: FloatArray, normals: FloatArray
) -> FloatArray:
    """Linear light of bare paper at gain 1; 0 where none arrives."""
    if photometry.lights:
        lit = replace(photometry, gain=1.0)
        return np.nan_to_num(lit.intensity(points, normals) ** lit.gamma)
    distance = np.linalg.norm(points, axis=-1)
    cosine = -np.einsum("...i,...i->...", points, normals) / distance
    reached = np.nan_to_num(photometry.attenuation(points[..., 2] / distance) / distance**2)
    facing = np.where(cosine > 0, cosine, 0.0)
    return reached * photometry.brdf.value(facing, facing) * facing


def automatic_gain(
    target: Target,
    poses: Sequence[tuple[Pose, ...]],
    camera: Camera,
    photometry: Photometry,
    *,
    locked: bool = False,
) -> FloatArray:
    """Gains that a camera would choose for the frames of a video, (frames,), given the poses of its panels.

    Each follows the brightness of the sheet, lags behind, and stays within a factor of `largest_ratio`, so
    that near frames are overexposed and far ones dark; `locked` chooses one, for the middle of the video.
    """
    points, normals = on_sheet(target, poses, target.points)
    light = np.where(
        in_view(camera, points, normals), linear_light(photometry, points, normals), np.nan
    )
    known = np.flatnonzero(np.isfinite(light).any(axis=1))
    if not len(known):
        raise ValueError("the sheet is in none of the frames, so no gain suits them")
    wanted = np.log(
        GAIN_RULES.white**photometry.gamma / np.nanpercentile(light[known], 80, axis=1)
    )
    wanted = np.interp(np.arange(len(poses)), known, wanted)
    middle = float(np.median(wanted))
    if locked:
        return np.full(len(poses), np.exp(middle))
    half = np.log(GAIN_RULES.largest_ratio) / 2
    wanted = np.clip(wanted, middle - half, middle + half)
    lag = max(GAIN_RULES.lag * len(wanted), 1.0)
    slow = accumulate(wanted.tolist(), lambda last, now: last + (now - last) / lag)
    return np.exp(list(slow))


def store_levels(
    linear: NDArray[Any], gamma: float, noise: float, bits: int, rng: np.random.Generator
) -> FloatArray:
    """Response, noise (grey levels), saturation and rounding."""
    level = np.maximum(linear, 0) ** (1 / gamma)  # a blur may leave rounding errors below 0
    if noise:
        level += rng.standard_normal(level.shape, level.dtype) * level.dtype.type(
            noise / 255
        )
    most = 2**bits - 1
    return np.round(np.clip(level, 0, 1) * most).astype(np.float64) / most


@lru_cache(maxsize=4)
def rays_of(camera: Camera, sub: int) -> Float32Array:
    """Unit rays of sub × sub places in every pixel, (sub H, sub W, 3)."""
    fine = camera.resize(sub * camera.width, sub * camera.height)
    rays = np.empty((fine.height, fine.width, 3), np.float32)
    for start in range(0, fine.height, 256):
        rows, columns = np.mgrid[start : min(start + 256, fine.height), : fine.width]
        rays[start : start + 256] = fine.unproject(np.stack([columns, rows], axis=-1))
    return rays


def _step(target: Target) -> float:
    """Side of the cells of the finest raster, mm."""
    return max(RENDER_RULES.cell, max(target.sheet[2:]) / RENDER_RULES.most_cells)


@lru_cache(maxsize=2)
def _rasters(target: Target, black: float) -> tuple[Float32Array, ...]:
    """Reflectance of the sheet averaged over cells of one step, two, four …, from its upper left corner."""
    left, top, width, height = target.sheet
    step = _step(target)
    coarse = step * 2 ** (RENDER_RULES.rasters - 1)
    shape = [
        int(np.ceil(length / coarse)) * 2 ** (RENDER_RULES.rasters - 1)
        for length in (height, width)
    ]
    levels = [1 - darkness(target.ink, (left, top), shape, step, black)]
    for _ in range(RENDER_RULES.rasters - 1):
        rows, columns = levels[-1].shape
        levels.append(levels[-1].reshape(rows // 2, 2, columns // 2, 2).mean(axis=(1, 3)))
    return tuple(levels)


def _paper(
    target: Target, panel: int, pose: Pose, camera: Camera, black: float
) -> tuple[Float32Array, Float32Array]:
    """Reflectance that each pixel sees of a panel, and the share of the pixel that is paper."""
    sub = RENDER_RULES.rays
    size = RENDER_RULES.tile
    shape = camera.height, camera.width
    seen = np.zeros(shape, np.float32)
    share = np.zeros(shape, np.float32)
    to_sheet = np.linalg.inv(
        np.column_stack([pose.rotation[:, :2], pose.translation])
    ).T.astype(np.float32)
    left, top, width, height = target.sheet
    right = left + width
    if target.fold_x is not None:
        left, right = ((left, target.fold_x), (target.fold_x, right))[panel]
    rays = rays_of(camera, sub)
    levels = _rasters(target, black)
    step = _step(target)
    for row in range(0, camera.height, size):
        for column in range(0, camera.width, size):
            tile = slice(row, row + size), slice(column, column + size)
            fine = rays[
                sub * row : sub * (row + size), sub * column : sub * (column + size)
            ]
            x, y, inverse = np.moveaxis(fine @ to_sheet, -1, 0)
            with np.errstate(invalid="ignore", divide="ignore"):
                x = x / inverse
                y = y / inverse
            inside = (
                (inverse > 0) & (x > left) & (x <= right) & (y >= top) & (y <= top + height)
            )
            if not inside.any():
                continue
            # The raster whose cells are as large as the tile's pixels are on the paper.
            both = inside[1:, 1:] & inside[:-1, 1:] & inside[1:, :-1]
            dx, dy = (np.diff(part, axis=0)[:, 1:][both] for part in (x, y))
            ex, ey = (np.diff(part, axis=1)[1:][both] for part in (x, y))
            cell = np.sqrt(np.median(np.abs(dx * ey - dy * ex))) if both.any() else step
            level = int(
                np.clip(np.round(np.log2(cell / step)), 0, RENDER_RULES.rasters - 1)
            )
            pitch = np.float32(step * 2**level)
            across, down = (
                np.where(
                    inside, (part - np.float32(start)) / pitch - np.float32(0.5), 0
                ).astype(np.float32)
                for part, start in ((x, target.sheet[0]), (y, top))
            )
            value = cv2.remap(
                levels[level],
                across,
                down,
                cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_REPLICATE,
            )
            h, w = inside.shape
            blocks = (h // sub, sub, w // sub, sub)
            seen[tile] = (value * inside).reshape(blocks).mean(axis=(1, 3))
            share[tile] = inside.reshape(blocks).mean(axis=(1, 3), dtype=np.float32)
    return seen, share


def _spots(shape: tuple[int, int], share: float, rng: np.random.Generator) -> Float32Array:
    """Blots of 2 to 5 px that cover a share of the picture, as their opacity in [0, 1]."""
    blots = np.zeros(shape, np.uint8)
    for _ in range(int(share * blots.size / (np.pi * 4.3**2)) + (share > 0)):
        place = [int(rng.integers(side)) for side in shape[::-1]]
        cv2.circle(blots, place, int(rng.integers(2, 6)), 255, -1, cv2.LINE_AA)
    return blots.astype(np.float32) * np.float32(1 / 255)


def _plane_light(
    photometry: Photometry,
    rays: Float32Array,
    normal: FloatArray,
    point: FloatArray,
    where: BoolArray,
) -> Float32Array:
    """Linear light of a bare plane at gain 1, (H, W); 0 elsewhere."""
    light = np.zeros(where.shape, np.float32)
    chosen = rays[where].astype(np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        reach = (point @ normal) / (chosen @ normal)
    met = reach > 0
    values = np.zeros(len(chosen))
    points = chosen[met] * reach[met, None]
    values[met] = linear_light(photometry, points, np.broadcast_to(normal, points.shape))
    light[where] = values
    return light


def render_sheet(
    target: Target,
    poses: Sequence[Pose],
    camera: Camera,
    photometry: Photometry,
    sensor: Sensor = SENSOR,
    *,
    seed: int = 0,
) -> SheetFrame:
    """Render a sheet as the endoscope sees it, from one pose a panel; a fold's ridge is towards the camera.

    The photometry's BRDF is that of the white paper; if its gain is unknown, that of `automatic_gain` is
    taken. Neither blur may be longer than the picture is wide.
    """
    for name in ("blur", "motion"):
        number(name, getattr(sensor, name), 0, camera.width)
    check_memory(
        RENDERING_BYTES * camera.width * camera.height,
        f"a picture of {camera.width}x{camera.height} px",
    )
    if len(poses) != target.panels:
        raise ValueError(
            f"poses must hold one for each of {target.panels} panels, got {len(poses)}"
        )
    gain = photometry.gain
    if gain is None:
        gain = float(automatic_gain(target, [tuple(poses)], camera, photometry)[0])
    rng = np.random.default_rng([check_int("seed", seed), 1])
    rays = rays_of(camera, 1)
    shape = camera.height, camera.width
    linear = np.zeros(shape, np.float32)
    paper = np.zeros(shape, np.float32)
    for panel, pose in enumerate(poses):
        if (
            pose.translation @ pose.normal >= 0
        ):  # seen from behind: hidden by the other panel
            continue
        seen, share = _paper(target, panel, pose, camera, sensor.black)
        linear += seen * _plane_light(
            photometry, rays, pose.normal, pose.translation, share > 0
        )
        paper += share
    cloth = replace(photometry, brdf=Lambertian(RENDER_RULES.cloth_albedo))
    behind = poses[0].translation - RENDER_RULES.behind * poses[0].normal
    linear += (1 - paper) * _plane_light(cloth, rays, poses[0].normal, behind, paper < 1)
    linear *= np.float32(gain)
    if sensor.outliers:
        linear *= 1 - 0.8 * _spots(shape, sensor.outliers / 2, rng) * paper
        linear += 1.5 * _spots(shape, sensor.outliers / 2, rng) * paper
    if sensor.blur:
        cv2.GaussianBlur(
            linear, (0, 0), sensor.blur, dst=linear, borderType=cv2.BORDER_REPLICATE
        )
    if sensor.motion:
        cv2.filter2D(
            linear,
            -1,
            _streak(sensor.motion, rng),
            dst=linear,
            borderType=cv2.BORDER_REPLICATE,
        )
    image = store_levels(linear, photometry.gamma, sensor.noise, sensor.bits, rng)
    return SheetFrame(image, tuple(poses), gain)


def _streak(length: float, rng: np.random.Generator) -> Float32Array:
    """Kernel of a motion blur: a straight line in a random direction, of sum 1."""
    angle = rng.uniform(0, np.pi)
    half = length / 2
    size = int(np.ceil(half)) + 1
    kernel = np.zeros((2 * size + 1, 2 * size + 1), np.float32)
    for along in np.linspace(-half, half, 8 * size + 1):
        x = size + along * np.cos(angle)
        y = size + along * np.sin(angle)
        column = int(x)
        row = int(y)
        shares = np.outer([1 - y + row, y - row], [1 - x + column, x - column])
        kernel[row : row + 2, column : column + 2] += shares
    return kernel / kernel.sum()
