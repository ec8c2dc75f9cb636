"""The picture that an endoscope takes of a sheet of paper.

The sheet is rasterised once, and read where nine rays a pixel meet it. What the camera does to the light
(gain, response, noise, saturation, rounding) comes last.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from endolab.calibration.detection.blobs import Numbers
from endolab.calibration.geometric.pose import Pose
from endolab.calibration.simulation.trajectory import Panels, in_view, on_sheet
from endolab.calibration.targets import Target
from endolab.model.brdf import Lambertian
from endolab.model.cameras import Camera
from endolab.model.photometry import Photometry
from endolab.numerics.arrays import BoolArray, FloatArray, nan_if_undefined
from endolab.numerics.checked_types import Whole, checked
from endolab.numerics.memory import RENDERING_BYTES, check_memory

BLACK = 0.04  # the ink's reflectance
CLOTH = Lambertian(0.03)  # what is seen beside the sheet, ...
BEHIND = 20.0  # ... so far behind it, mm
FINEST = 0.025  # mm, side of a cell of the sheet's raster, ...
MOST_CELLS = 6000  # ... which has at most so many along a side
WHITE = 0.7  # stored value that the gain gives to the bright part of the sheet
GAINS = 3.0  # largest over smallest, as in the paper
RAYS = 3  # a pixel, in each direction


@checked
class Sensor:
    """What an endoscope's camera makes of the light."""

    noise: Annotated[float, Field(ge=0)] = 3.0  # standard deviation, grey levels of 255
    bits: Annotated[Whole, Field(ge=1, le=16)] = 8  # that values are rounded to
    outliers: Annotated[float, Field(ge=0, lt=1)] = 0.0  # share of glints and dust
    # One gain for all frames of a video, instead of one that follows the sheet.
    locked: bool = False


SENSOR = Sensor()


@dataclass(frozen=True)
class SheetFrame:
    """A simulated frame and its truth."""

    image: FloatArray  # (H, W), stored values in [0, 1]
    poses: Panels  # of each panel of the sheet
    gain: float


@lru_cache(maxsize=2)
def rasterise(target: Target) -> tuple[Numbers, float]:
    """Reflectance of a sheet averaged over cells, from its upper left on; and the side of a cell, mm.

    Exact for squares; the rim of a disc is taken as straight within a cell.
    """
    left, top, width, height = target.sheet
    step = max(FINEST, max(width, height) / MOST_CELLS)
    white = np.ones(np.ceil([height / step, width / step]).astype(int), np.float32)

    def places(middle: float, half: float) -> tuple[slice, Numbers]:
        """Cells that an interval touches, and how far off its middle they are, in cells."""
        first = max(int((middle - half) / step) - 1, 0)
        last = int((middle + half) / step) + 2
        return slice(first, last), np.arange(first, last) + 0.5 - middle / step

    def within(offset: Numbers, half: float) -> Numbers:
        """Shares of cells that lie within."""
        return np.clip(half / step - np.abs(offset) + 0.5, 0, 1)

    for x, y, radius, reflectance in target.discs:
        column, across = places(x - left, radius)
        row, down = places(y - top, radius)
        inked = within(np.hypot(down[:, None], across), radius)
        white[row, column] -= (inked * (1 - (reflectance or BLACK))).astype(np.float32)
    for x, y, side in target.squares:
        column, across = places(x + side / 2 - left, side / 2)
        row, down = places(y + side / 2 - top, side / 2)
        inked = np.outer(within(down, side / 2), within(across, side / 2))
        white[row, column] -= (inked * (1 - BLACK)).astype(np.float32)
    return white, step


def linear_light(
    photometry: Photometry, points: FloatArray, normals: FloatArray
) -> FloatArray:
    """Linear light of bare paper at gain 1; 0 where none arrives."""
    with nan_if_undefined():
        stored = replace(photometry, gain=1.0).intensity(points, normals)
        return np.nan_to_num(stored**photometry.gamma)


def automatic_gain(
    target: Target,
    poses: Sequence[Panels],
    camera: Camera,
    photometry: Photometry,
    *,
    locked: bool = False,
) -> FloatArray:
    """Gains that a camera would choose for the frames of a video, (frames,), given the poses of its panels.

    Each follows the brightness of the sheet within a factor of `GAINS`, so that near frames are overexposed
    and far ones dark; `locked` chooses one, for the middle of the video.
    """
    points, normals = on_sheet(target, poses, target.points)
    light = linear_light(photometry, points, normals)
    light[~in_view(camera, points, normals)] = np.nan
    wanted = np.log(WHITE**photometry.gamma / np.nanpercentile(light, 80, axis=1))
    half = 0 if locked else np.log(GAINS) / 2
    middle = np.median(wanted)
    return np.exp(np.clip(wanted, middle - half, middle + half))


def store_levels(
    linear: ArrayLike, gamma: float, sensor: Sensor, rng: np.random.Generator
) -> FloatArray:
    """Response, noise, saturation and rounding."""
    level = np.maximum(linear, 0) ** (1 / gamma)
    level += rng.normal(0, sensor.noise / 255, level.shape)
    return round_levels(level, sensor.bits)


def round_levels(level: FloatArray, bits: int) -> FloatArray:
    """Clip values to [0, 1], and round them to so many bits."""
    most = 2**bits - 1
    return np.round(np.clip(level, 0, 1) * most) / most


@lru_cache(maxsize=4)
def rays_of(camera: Camera) -> Numbers:
    """Unit rays of the pixels, (H, W, 3)."""
    rows, columns = np.indices((camera.height, camera.width))
    return camera.unproject(np.stack([columns, rows], axis=-1)).astype(np.float32)


def _paper(
    target: Target, panel: int, pose: Pose, camera: Camera
) -> tuple[Numbers, Numbers]:
    """Reflectance that each pixel sees of a panel, and the share of the pixel that is paper."""
    left, top, width, height = target.sheet
    plane = np.column_stack([pose.rotation[:, :2], pose.translation])
    rays = rays_of(camera)
    x, y, facing = np.moveaxis(rays @ np.linalg.inv(plane).T.astype(np.float32), -1, 0)
    with nan_if_undefined():
        ahead = np.where(facing > 0, facing, np.nan)
        x = np.nan_to_num(x / ahead - left, nan=-width)
        y = np.nan_to_num(y / ahead - top, nan=-height)
    white, step = rasterise(target)
    # Averaged over what one ray stands for.
    inside = (x > 0) & (x < width) & (y > 0) & (y < height)
    apart = np.hypot(np.gradient(x, axis=1), np.gradient(y, axis=1))[inside]
    half = int(np.median(apart) / RAYS / step / 2) if len(apart) else 0
    blurred = cv2.blur(white, (2 * half + 1, 2 * half + 1))
    x, y = (cv2.resize(one.astype(np.float32), None, fx=RAYS, fy=RAYS) for one in (x, y))
    inside = (x > 0) & (x < width) & (y > 0) & (y < height)
    if target.fold_x is not None:
        inside &= (x > target.fold_x - left) == panel
    share = inside.astype(np.float32)
    column, row = (one * np.float32(1 / step) - np.float32(0.5) for one in (x, y))
    seen = share * cv2.remap(
        blurred, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    size = camera.width, camera.height
    return (
        cv2.resize(seen, size, interpolation=cv2.INTER_AREA),
        cv2.resize(share, size, interpolation=cv2.INTER_AREA),
    )


def _spots(shape: tuple[int, int], share: float, rng: np.random.Generator) -> Numbers:
    """Blots of 7 px that cover a share of the picture: 1 there, else 0."""
    blot = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7))
    seeds = rng.random(shape) < share / blot.sum()
    return cv2.dilate(seeds.astype(np.float32), blot)


def _plane_light(
    photometry: Photometry,
    camera: Camera,
    normal: FloatArray,
    point: FloatArray,
    where: BoolArray,
) -> FloatArray:
    """Linear light of a bare plane at gain 1, (H, W); 0 elsewhere."""
    light = np.zeros(where.shape)
    rays = rays_of(camera)[where].astype(np.float64)
    with nan_if_undefined():
        reach = (point @ normal) / (rays @ normal)
        points = rays * np.where(reach > 0, reach, np.nan)[:, None]
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
    gain = photometry.gain
    if gain is None:
        gain = float(automatic_gain(target, [tuple(poses)], camera, photometry)[0])
    shape = camera.height, camera.width
    check_memory(RENDERING_BYTES * camera.height * camera.width, "such a picture")
    rng = np.random.default_rng([seed, 1])
    linear = np.zeros(shape)
    paper = np.zeros(shape)
    for panel, pose in enumerate(poses):
        if pose.translation @ pose.normal < 0:  # else hidden by the other panel
            seen, share = _paper(target, panel, pose, camera)
            light = _plane_light(
                photometry, camera, pose.normal, pose.translation, share > 0
            )
            linear += seen * light
            paper += share
    cloth = replace(photometry, brdf=CLOTH)
    normal = poses[0].normal
    behind = poses[0].translation - BEHIND * normal
    linear += (1 - paper) * _plane_light(cloth, camera, normal, behind, paper < 1)
    linear *= gain
    linear *= 1 - 0.8 * _spots(shape, sensor.outliers / 2, rng) * paper
    linear += 1.5 * _spots(shape, sensor.outliers / 2, rng) * paper
    image = store_levels(linear, photometry.gamma, sensor, rng)
    return SheetFrame(image, tuple(poses), gain)
