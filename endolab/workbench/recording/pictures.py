"""What a recording shows of an iterate, as it is logged: maps and a cloud of points."""

from __future__ import annotations

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from endolab.model.thinned import ThinnedMaps
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.solvers.problem import LOWER_BOUND, NONE, Problem
from endolab.solvers.result import Iterate
from endolab.workbench.plots.scales import LARGEST_RESIDUAL, OKABE_ITO, blue_white_red
from endolab.workbench.recording.stream import classes, depth_map, every

OPAQUE_BLACK = (0, 0, 0, 255)
CLEAR = (0, 0, 0, 0)
SHADES = np.linspace(-1, 1, 65)  # of a residual, as shares of `LARGEST_RESIDUAL`
RESIDUAL_COLOURS = {"left out": OPAQUE_BLACK} | {
    f"{LARGEST_RESIDUAL * share:+.2g}/255": (*colour.tolist(), 255)
    for share, colour in zip(SHADES, blue_white_red(SHADES), strict=True)
}
USED_COLOURS = {"left out": OPAQUE_BLACK, "used": CLEAR}
FINDING_COLOURS = {
    "as it is": CLEAR,
    "saturated": (*OKABE_ITO.yellow, 255),
    "highlight": (*OKABE_ITO.sky, 255),
    "contour": (*OKABE_ITO.vermilion, 255),
}


class Painter:
    """Makes pictures of a problem's iterates; what these have in common is made once.

    Nothing is made larger than it is shown: `thin` and `sparse` take the pixels of pictures, at most
    `max_width` columns of them, and of clouds.
    """

    def __init__(self, problem: Problem, max_width: int) -> None:
        self.problem = problem
        self.thin = thin = every(problem.camera.width, max_width)
        # A cloud has 160 columns at most: coordinates would be most of a recording.
        further = max(1, -(-problem.camera.width // (thin[0].step * 160)))
        self.sparse = sparse = (slice(None, None, thin[0].step * further),) * 2
        self._inside = problem.mask[sparse]
        self._rays = problem.field.rays[sparse][self._inside]
        self._maps = ThinnedMaps(problem.field, problem.mask, problem.cuts, thin[0].step)
        self._attenuation = problem.photometry.attenuation(problem.field.cos_alpha[thin])

    def paint(self, iterate: Iterate) -> dict[str, tuple[rr.AsComponents, ...]]:
        """Make the pictures of an iterate, by their entities."""
        v = iterate.log_distance
        problem = self.problem
        points = np.exp(v[self.sparse][self._inside])[:, None] * self._rays
        # OpenCV's ways to bytes take a tenth of NumPy's time; nan becomes 0.
        facing = cv2.convertScaleAbs(self._maps.normals(v), alpha=127.5, beta=127.5)
        maps = {
            f"front/{name}": (rr.Image(grey(a[self.thin])),)
            for name, a in iterate.maps.items()
        }
        return {
            "depth": (depth_map(np.exp(v[self.thin]), problem.metric),),
            "normals": (rr.Image(facing),),
            "residual": (rr.SegmentationImage(self._shades(v), opacity=1.0),),
            "world/cloud": (rr.Points3D.from_fields(positions=points.astype(np.float32)),),
            **maps,
        }

    def _shades(self, v: FloatArray) -> NDArray[np.uint8]:
        """Model - frame, (h, w), as places in `RESIDUAL_COLOURS`."""
        problem = self.problem
        model = problem.photometry.brightness(
            v[self.thin], self._maps.slant(v), self._attenuation
        )
        share = 255 / LARGEST_RESIDUAL * (model - problem.image[self.thin])
        half = len(SHADES) // 2
        return np.asarray(
            cv2.convertScaleAbs(np.clip(share, -1, 1), alpha=half, beta=half + 1)
        )

    def show_preparation(self) -> dict[str, tuple[rr.AsComponents, ...]]:
        """What is left out, and what was found in the frame, by their entities."""
        mask = np.ascontiguousarray(self.problem.mask[self.thin])
        return {
            "mask": classes(mask, USED_COLOURS),
            "prepared": classes(preparation_of(self.problem)[self.thin], FINDING_COLOURS),
        }


def preparation_of(problem: Problem) -> NDArray[np.uint8]:
    """What a frame's pixels were found to be, (H, W), as places in `FINDING_COLOURS`."""
    places = np.zeros(problem.mask.shape, np.uint8)
    if problem.evidence is not None:
        places[problem.mask & (problem.evidence == LOWER_BOUND)] = 1
        places[problem.mask & (problem.evidence == NONE)] = 2
    if problem.cuts is not None:
        places[problem.cuts.any(axis=0)] = 3
    return places


def grey(values: NDArray | BoolArray) -> NDArray[np.uint8]:
    """Stretch a map to bytes, from 0 or less to 1 or more; nan is black."""
    values = np.nan_to_num(np.asarray(values, float))
    low = min(values.min(), 0.0)
    high = max(values.max(), 1.0)
    return np.round(255 * (values - low) / (high - low)).astype(np.uint8)
