"""The picture that an endoscope takes of a sheet of paper, exact down to the pixel's area.

The dots are averaged over each pixel in linear light. What the camera does to the light (gain,
response, noise, saturation, rounding) comes last.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import accumulate, product
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from endolab.calibration.detection.lattice import cross
from endolab.calibration.geometric.pose import Pose
from endolab.calibration.simulation.trajectory import Panels, in_view, on_sheet
from endolab.calibration.targets import Target, darkness
from endolab.model.brdf import Lambertian
from endolab.model.cameras import Camera
from endolab.model.photometry import Photometry
from endolab.numerics.arrays import BoolArray, FloatArray, SingleArray, nan_if_undefined
from endolab.numerics.checks import check_int, number
from endolab.numerics.memory import RENDERING_BYTES, check_memory


@dataclass(frozen=True)
class GainRules:
    """How the automatic gain of a simulated camera behaves."""

    white: float = 0.7  # stored value that it gives to the bright part of the sheet
    largest_ratio: float = 3.0  # largest gain over smallest, as in the paper
    lag: float = 1 / 60  # of the video, that it needs to follow


@dataclass(frozen=True)
class RenderRules:
    """How a sheet is drawn, and what lies behind it."""

    black: float = 0.04  # the ink's reflectance
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
    outliers: float = 0.0  # share of the sheet under glints and dust
    # One gain for all frames of a video, instead of one that follows the sheet.
    locked: bool = False

    def __post_init__(self) -> None:
        number("noise", self.noise, 0)
        number(
            "outliers",
            self.outliers,
            0,
            0.99,
        )
        number(
            "bits",
            check_int("bits", self.bits),
            1,
            16,
        )


SENSOR = Sensor()


@dataclass(frozen=True)
class SheetFrame:
    """A simulated frame and its truth."""

    image: FloatArray  # (H, W), stored values in [0, 1]
    poses: Panels  # of each panel of the sheet
    gain: float


def linear_light(
    photometry: Photometry,
    points: FloatArray,
    normals: FloatArray,
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
    poses: Sequence[Panels],
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
    light = linear_light(photometry, points, normals)
    light[~in_view(camera, points, normals)] = np.nan
    known = np.flatnonzero(np.isfinite(light).any(axis=1))
    if not len(known):
        raise ValueError("the sheet is in none of the frames, so no gain suits them")
    bright = np.nanpercentile(light[known], 80, axis=1)
    wanted = np.log(GAIN_RULES.white**photometry.gamma / bright)
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
    linear: NDArray[Any],
    gamma: float,
    sensor: Sensor,
    rng: np.random.Generator,
) -> FloatArray:
    """Response, noise, saturation and rounding."""
    level = np.maximum(linear, 0) ** (1 / gamma)  # a blur may leave rounding errors below 0
    if sensor.noise:
        scale = level.dtype.type(sensor.noise / 255)
        level += rng.standard_normal(level.shape, level.dtype) * scale
    return round_levels(level, sensor.bits)


def round_levels(level: NDArray[Any], bits: int) -> FloatArray:
    """Clip values to [0, 1], and round them to so many bits."""
    most = 2**bits - 1
    return np.round(np.clip(level, 0, 1) * most).astype(np.float64) / most


@lru_cache(maxsize=4)
def rays_of(camera: Camera, sub: int) -> SingleArray:
    """Unit rays of sub × sub places in every pixel, (sub H, sub W, 3)."""
    fine = camera.resize(sub * camera.width, sub * camera.height)
    rays = np.empty((fine.height, fine.width, 3), np.float32)
    for start in range(0, fine.height, 256):
        rows, columns = np.mgrid[start : min(start + 256, fine.height), : fine.width]
        rays[start : start + 256] = fine.unproject(np.stack([columns, rows], axis=-1))
    return rays


def _block_mean(values: NDArray[Any], side: int) -> SingleArray:
    """Average squares of so many pixels."""
    rows, columns = values.shape
    blocks = values.reshape(
        rows // side,
        side,
        columns // side,
        side,
    )
    return blocks.mean(axis=(1, 3), dtype=np.float32)


@lru_cache(maxsize=2)
def _rasters(
    target: Target,
) -> tuple[list[SingleArray], float]:
    """Reflectance of the sheet averaged over cells of one step, two, four …; and the step, mm.

    All begin at the sheet's upper left corner.
    """
    left, top, width, height = target.sheet
    step = max(RENDER_RULES.cell, max(width, height) / RENDER_RULES.most_cells)
    coarsest = 2 ** (RENDER_RULES.rasters - 1)
    shape = [
        int(np.ceil(length / (step * coarsest))) * coarsest for length in (height, width)
    ]
    levels = [1 - darkness(target.ink, (left, top), shape, step, RENDER_RULES.black)]
    for _ in range(RENDER_RULES.rasters - 1):
        levels.append(_block_mean(levels[-1], 2))
    return levels, step


def _paper(
    target: Target,
    panel: int,
    pose: Pose,
    camera: Camera,
) -> tuple[SingleArray, SingleArray]:
    """Reflectance that each pixel sees of a panel, and the share of the pixel that is paper."""
    sub = RENDER_RULES.rays
    size = RENDER_RULES.tile
    shape = camera.height, camera.width
    seen = np.zeros(shape, np.float32)
    share = np.zeros(shape, np.float32)
    plane = np.column_stack([pose.rotation[:, :2], pose.translation])
    to_sheet = np.linalg.inv(plane).T.astype(np.float32)
    left, top, width, height = target.sheet
    corner = np.array([left, top], np.float32)
    low = corner.copy()
    high = np.array([left + width, top + height], np.float32)
    if target.fold_x is not None:
        (high if panel == 0 else low)[0] = target.fold_x
    rays = rays_of(camera, sub)
    levels, step = _rasters(target)
    for row, column in product(*(range(0, side, size) for side in shape)):
        tile = slice(row, row + size), slice(column, column + size)
        fine = tuple(slice(sub * part.start, sub * part.stop) for part in tile)
        place = rays[fine] @ to_sheet
        with nan_if_undefined():
            xy = place[..., :2] / place[..., 2:]
        inside = (place[..., 2] > 0) & np.all((xy > low) & (xy <= high), axis=-1)
        if not inside.any():
            continue
        # The raster whose cells are as large as the tile's pixels are on the paper.
        both = inside[1:, 1:] & inside[:-1, 1:] & inside[1:, :-1]
        down = np.diff(xy, axis=0)[:, 1:][both]
        right = np.diff(xy, axis=1)[1:][both]
        area = np.abs(cross(down, right))
        cell = np.sqrt(np.median(area)) if len(area) else step
        level = round(np.clip(np.log2(cell / step), 0, RENDER_RULES.rasters - 1))
        pitch = np.float32(step * 2**level)
        at = (xy - corner) / pitch - np.float32(0.5)
        at[~inside] = 0
        value = cv2.remap(  # type: ignore[call-overload]
            levels[level],
            at,
            None,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        seen[tile] = _block_mean(value * inside, sub)
        share[tile] = _block_mean(inside, sub)
    return seen, share


def _spots(
    shape: tuple[int, int],
    share: float,
    rng: np.random.Generator,
) -> SingleArray:
    """Blots of 2 to 5 px that cover a share of the picture, as their opacity in [0, 1]."""
    blots = np.zeros(shape, np.uint8)
    for _ in range(int(share * blots.size / (np.pi * 4.3**2)) + (share > 0)):
        place = [int(rng.integers(side)) for side in shape[::-1]]
        cv2.circle(
            blots,
            place,
            int(rng.integers(2, 6)),
            255,
            -1,
            cv2.LINE_AA,
        )
    return blots.astype(np.float32) * np.float32(1 / 255)


def _plane_light(
    photometry: Photometry,
    rays: SingleArray,
    normal: FloatArray,
    point: FloatArray,
    where: BoolArray,
) -> SingleArray:
    """Linear light of a bare plane at gain 1, (H, W); 0 elsewhere."""
    light = np.zeros(where.shape, np.float32)
    chosen = rays[where].astype(np.float64)
    with nan_if_undefined():
        reach = (point @ normal) / (chosen @ normal)
        points = chosen * np.where(reach > 0, reach, np.nan)[:, None]
        light[where] = linear_light(photometry, points, np.tile(normal, (len(points), 1)))
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
    taken.
    """
    size = f"a picture of {camera.width}x{camera.height} px"
    check_memory(RENDERING_BYTES * camera.width * camera.height, size)
    gain = photometry.gain
    if gain is None:
        gain = float(automatic_gain(target, [tuple(poses)], camera, photometry)[0])
    rng = np.random.default_rng([check_int("seed", seed), 1])
    rays = rays_of(camera, 1)
    shape = camera.height, camera.width
    linear = np.zeros(shape, np.float32)
    paper = np.zeros(shape, np.float32)
    for panel, pose in enumerate(poses):
        normal = pose.normal
        if pose.translation @ normal >= 0:  # from behind: hidden by the other panel
            continue
        seen, share = _paper(
            target,
            panel,
            pose,
            camera,
        )
        linear += seen * _plane_light(photometry, rays, normal, pose.translation, share > 0)
        paper += share
    cloth = replace(photometry, brdf=Lambertian(RENDER_RULES.cloth_albedo))
    normal = poses[0].normal
    behind = poses[0].translation - RENDER_RULES.behind * normal
    linear += (1 - paper) * _plane_light(cloth, rays, normal, behind, paper < 1)
    linear *= np.float32(gain)
    if sensor.outliers:
        linear *= 1 - 0.8 * _spots(shape, sensor.outliers / 2, rng) * paper
        linear += 1.5 * _spots(shape, sensor.outliers / 2, rng) * paper
    image = store_levels(
        linear,
        photometry.gamma,
        sensor,
        rng,
    )
    return SheetFrame(image, tuple(poses), gain)
