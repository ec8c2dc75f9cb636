"""What a recording shows of an iterate, as it is logged: maps and a cloud of points."""

from __future__ import annotations

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from endolab.model.surface import normals, slant
from endolab.numerics.arrays import FloatArray
from endolab.numerics.stencils import central_gradient
from endolab.solvers.problem import Problem
from endolab.solvers.result import Iterate
from endolab.workbench.plots.scales import LARGEST_RESIDUAL, OKABE_ITO, palette
from endolab.workbench.recording.stream import classes, depth_map, every

OPAQUE_BLACK = (0, 0, 0, 255)
CLEAR = (0, 0, 0, 0)
# Colours of residuals up to `LARGEST_RESIDUAL`.
SHADES = palette("model - frame")[np.linspace(0, 255, 65).astype(int)].tolist()
RESIDUAL_COLOURS = {"left out": OPAQUE_BLACK} | {
    f"{LARGEST_RESIDUAL * share:+.2g}/255": tuple(colour)
    for share, colour in zip(np.linspace(-1, 1, len(SHADES)), SHADES, strict=True)
}
USED_COLOURS = {"left out": OPAQUE_BLACK, "used": CLEAR}
# The first three in the order of `Problem.evidence`.
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
        self.thin = every(problem.camera.width, max_width)
        step = self.thin[0].step
        # A cloud has 160 columns at most: coordinates would be most of a recording.
        further = -(-problem.camera.width // (step * 160))
        self.sparse = (slice(None, None, step * further),) * 2
        self.inside = problem.mask[self.sparse]
        self._rays = problem.field.rays[self.sparse][self.inside]
        self._step = step
        self._field = problem.field.every(step)
        cos_alpha = problem.field.cos_alpha[self.thin]
        self._attenuation = problem.photometry.attenuation(cos_alpha)

    def paint(self, iterate: Iterate) -> dict[str, rr.AsComponents]:
        """Make the pictures of an iterate, by their entities."""
        problem = self.problem
        v = iterate.log_distance
        distance = iterate.distance[self.sparse][self.inside]
        points = (distance[:, None] * self._rays).astype(np.float32)
        # OpenCV's ways to bytes take a tenth of NumPy's time; nan becomes 0.
        towards = normals(v, problem.field, problem.mask, self._step)
        facing = cv2.convertScaleAbs(towards, alpha=127.5, beta=127.5)
        return {
            "depth": depth_map(iterate.distance[self.thin], problem.metric),
            "normals": rr.Image(facing),
            "residual": rr.SegmentationImage(self._shades(v), opacity=1.0),
            "world/cloud": rr.Points3D.from_fields(positions=points),
        }

    def _shades(self, v: FloatArray) -> NDArray[np.uint8]:
        """Model - frame, (h, w), as places in `RESIDUAL_COLOURS`."""
        problem = self.problem
        v_u, v_v = central_gradient(v, problem.mask, problem.cuts)
        slants = slant(v_u[self.thin], v_v[self.thin], self._field)
        photometry = self.problem.photometry
        model = photometry.brightness(v[self.thin], slants, self._attenuation)
        share = 255 / LARGEST_RESIDUAL * (model - self.problem.image[self.thin])
        half = len(SHADES) // 2
        shades = cv2.convertScaleAbs(np.clip(share, -1, 1), alpha=half, beta=half + 1)
        return np.asarray(shades)

    def paint_preparation(self) -> dict[str, tuple[rr.AsComponents, ...]]:
        """Show what is left out, and what was found in the frame, by their entities."""
        problem = self.problem
        found = np.zeros(problem.mask.shape, np.uint8)
        if problem.evidence is not None:
            found[problem.mask] = problem.evidence[problem.mask]
        if problem.cuts is not None:
            found[problem.cuts.any(axis=0)] = 3
        return {
            "mask": classes(problem.mask[self.thin], USED_COLOURS),
            "prepared": classes(found[self.thin], FINDING_COLOURS),
        }
