"""Photometric samples: how bright the frame is at places of a sheet of known pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import Self

import cv2
import numpy as np

from endolab.calibration.geometric.pose import Pose
from endolab.calibration.targets import Target
from endolab.model.cameras import Camera
from endolab.numerics.arrays import BoolArray, FloatArray, IntArray
from endolab.numerics.checks import readonly_copy


@dataclass(frozen=True, eq=False)
class Samples:
    """Brightness at known places of a surface, in many frames."""

    frame: IntArray  # (n,), number of the frame, ascending
    level: FloatArray  # (n,), stored value, in [0, 1]
    points: FloatArray  # (n, 3), place on the surface in the camera frame, mm
    normals: FloatArray  # (n, 3), unit normal there, towards the camera
    material: IntArray  # (n,), 0 for the white of the paper; grey patches, or other channels, count from 1

    def __post_init__(self) -> None:
        if np.any(np.diff(self.frame) < 0):
            raise ValueError("frame must be in ascending order")

    def __len__(self) -> int:
        return len(self.frame)

    def __getitem__(self, which: BoolArray | IntArray | slice) -> Self:
        """Return some of the samples."""
        return type(self)(*(getattr(self, column.name)[which] for column in fields(self)))

    @classmethod
    def concatenate(cls, parts: Sequence[Samples]) -> Samples:
        """Join samples, whose frames are in order."""
        parts = [part for part in parts if len(part)] or [NO_SAMPLES]
        columns = ([getattr(part, column.name) for part in parts] for column in fields(cls))
        return cls(*map(np.concatenate, columns))

    @cached_property
    def distance(self) -> FloatArray:
        """Euclidean distance from the optical centre, (n,), mm."""
        return np.linalg.norm(self.points, axis=1)

    @property
    def cos_alpha(self) -> FloatArray:
        """Cosine of the angle off the camera's axis, (n,)."""
        return self.points[:, 2] / self.distance

    @property
    def cos_theta(self) -> FloatArray:
        """Cosine of the angle between the normal and the direction to the camera, (n,)."""
        return -np.einsum("ni,ni->n", self.points, self.normals) / self.distance

    @property
    def theta(self) -> FloatArray:
        """Angle of incidence, (n,), rad; 90° where no light can come from."""
        return np.arccos(np.clip(self.cos_theta, 0.0, 1.0))

    @property
    def lit(self) -> BoolArray:
        """Which are in front of the camera, and face it, (n,)."""
        return (self.cos_alpha > 0) & (self.cos_theta > 0)


NO_SAMPLES = Samples(
    np.zeros(0, int), np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, int)
)


@lru_cache(maxsize=8)
def sample_places(target: Target) -> tuple[FloatArray, IntArray]:
    """Places of a sheet whose brightness tells of the light: bare paper and grey patches.

    Returns (n, 4): x, y and the radius of one reflectance around, mm, and the reflectance relative to the
    paper; and the material, (n,): 0 for the paper, greys from 1, the lightest first.
    """
    white = target.white_places()
    white = np.column_stack([white, np.ones(len(white))])
    spots = np.concatenate([white, target.grey_discs])
    _, material = np.unique(-spots[:, 3], return_inverse=True)
    return readonly_copy(spots), material


def sample_sheet(
    image: FloatArray,
    target: Target,
    poses: Sequence[Pose | None],
    camera: Camera,
    *,
    frame: int = 0,
    most: int = 200,
) -> Samples:
    """Read the brightness of the paper in one frame: one channel, (H, W), stored values in [0, 1].

    Each sample lies at the centre of a pixel; its point is where the pixel's ray meets the panel. It is the
    mean of a square of pixels, 3 × 3 in a large picture, else 1. At most `most` are kept, at random: more
    would only make one frame count more than another.
    """
    spots, material = sample_places(target)
    panel = target.panel_of(spots)
    centre = np.column_stack([spots[:, :2], np.zeros(len(spots))])
    edges = np.array([[[1, 0, 0]], [[0, 1, 0]]]) * spots[:, 2, None]
    size = np.array(image.shape[::-1])
    side = 3 if size[0] >= 960 else 1
    half = side // 2
    mean = cv2.blur(image.astype(np.float32), (side, side))
    parts = []
    for number, pose in enumerate(poses):
        if pose is None:
            continue
        pixel = camera.project(pose.transform(centre))
        axes = camera.project(pose.transform(centre + edges)) - pixel
        # The window's corner, the rounding to a pixel and its blur must all lie on bare paper,
        # in the narrowest direction: the short axis of the ellipse that these two axes span. 1.5 px: half
        # of rounding, the rest of blur.
        axes = np.nan_to_num(axes).transpose(1, 2, 0)
        bare = np.linalg.svd(axes, compute_uv=False)[:, 1] >= 1.5 + np.sqrt(2) * side / 2
        nearest = np.round(pixel)
        inside = np.all((nearest >= half) & (nearest < size - half), axis=1)
        points = pose.meet(camera.unproject(nearest))
        seen = bare & inside & np.isfinite(points[:, 0])
        read = np.flatnonzero(seen & (panel == number))
        column, row = nearest[read].astype(int).T
        level = mean[row, column].astype(np.float64)
        frames = np.full(len(read), frame)
        normals = np.tile(pose.normal, (len(read), 1))
        parts.append(Samples(frames, level, points[read], normals, material[read]))
    samples = Samples.concatenate(parts)
    if len(samples) <= most:
        return samples
    kept = np.random.default_rng(frame).choice(len(samples), most, replace=False)
    return samples[np.sort(kept)]
