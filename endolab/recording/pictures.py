"""What a recording shows of an iterate, as it is stored: pictures, a cloud of points and a section."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from endolab.depth.problem import Problem
from endolab.depth.result import Iterate
from endolab.model.thinned import ThinnedMaps
from endolab.numerics.arrays import FloatArray
from endolab.plots.scales import blue_white_red
from endolab.recording.stream import every, grey, palette_png, png_bytes

CLOUD_WIDTH = 160  # columns of a cloud: coordinates would be most of a recording
SHADES = 65  # of the residual: fewer than a byte tells, and a picture that is half as large
DIVERGING = np.append(blue_white_red(np.linspace(-1, 1, SHADES)), np.zeros((1, 3), np.uint8), axis=0)
# How PNG is compressed, which costs more than all else, where colours change little from row to row.
SMOOTH = (cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, 2, cv2.IMWRITE_PNG_FILTER, 32)


@dataclass(frozen=True)
class Pictures:
    """What is shown of one iterate."""

    depth: NDArray[np.float32]  # (h, w), distance; nan outside the mask
    normals: bytes  # PNG
    misfit: NDArray[np.float32]  # model - frame, grey levels of 255; nan outside the mask
    maps: dict[str, bytes]  # PNG, by name
    cloud: NDArray[np.float32]  # (n, 3)
    section: list[FloatArray]  # strips (m, 2)


class Painter:
    """Makes pictures of a problem's iterates; what these have in common is made once.

    Nothing is made larger than it is shown: `thin` and `sparse` take the pixels of pictures, at most
    `max_width` columns of them, and of clouds.
    """

    def __init__(self, problem: Problem, max_width: int) -> None:
        self.problem = problem
        self.thin = thin = every(problem.camera.width, max_width)
        # Clouds are thinned further, by a whole number.
        self._further = max(1, -(-problem.camera.width // (thin[0].step * CLOUD_WIDTH)))
        self.sparse = sparse = (slice(None, None, thin[0].step * self._further),) * 2
        self.seen = np.ascontiguousarray(problem.mask[thin])
        self._inside = problem.mask[sparse]
        self._rays = problem.field.rays[sparse][self._inside]
        self._maps = ThinnedMaps(problem.field, problem.mask, problem.cuts, thin[0].step)
        self._attenuation = problem.photometry.attenuation(problem.field.cos_alpha[thin])
        self._image = np.ascontiguousarray(problem.image[thin])

    def misfit(self, log_distance: FloatArray) -> FloatArray:
        """What `energy.model_image` has more than the picture, (h, w); nan outside the mask."""
        slant, v = self._maps.slant(log_distance), log_distance[self.thin]
        model = self.problem.photometry.brightness(v, slant, self._attenuation)
        return np.subtract(model, self._image, out=model)

    def paint(self, iterate: Iterate) -> Pictures:
        """Make the pictures of an iterate."""
        v = iterate.log_distance
        distance = np.exp(v[self.thin])
        points = distance[:: self._further, :: self._further][self._inside][:, None] * self._rays
        # OpenCV's ways to bytes take a tenth of NumPy's time; nan becomes 0.
        facing = cv2.convertScaleAbs(self._maps.normals(v), alpha=127.5, beta=127.5)
        return Pictures(
            distance.astype(np.float32),
            png_bytes(facing, SMOOTH),
            (255 * self.misfit(v)).astype(np.float32),
            {name: png_bytes(grey(np.asarray(a)[self.thin], self.seen)) for name, a in iterate.maps.items()},
            points.astype(np.float32),
            section(v, self.problem),
        )


def section(log_distance: FloatArray, problem: Problem) -> list[FloatArray]:
    """Where the middle column cuts the surface, in strips (m, 2): z to the right, y down."""
    middle = log_distance.shape[1] // 2
    line = np.exp(log_distance[:, middle, None]) * problem.field.rays[:, middle][:, [2, 1]]
    seen = np.zeros(len(line) + 2, bool)
    seen[1:-1] = np.isfinite(line).all(axis=-1)
    ends = np.flatnonzero(seen[1:] != seen[:-1]).reshape(-1, 2)
    return [line[first:end] for first, end in ends if end - first > 1]


def residual_png(misfit: NDArray[np.float32], grey_levels: float) -> bytes:
    """Encode a misfit, (h, w), in blue, white and red up to so many grey levels."""
    return palette_png(shades(misfit, grey_levels), DIVERGING)


def shades(values: NDArray, most: float) -> NDArray[np.uint8]:
    """Places of values from -`most` to `most`, (h, w), in `DIVERGING`; nan is black, its last."""
    half = (SHADES - 1) / 2
    places: NDArray[np.uint8] = np.empty(values.shape, np.uint8)
    cv2.convertScaleAbs(np.clip(values, -most, most), places, half / most, half)
    places[np.isnan(values)] = SHADES
    return places
