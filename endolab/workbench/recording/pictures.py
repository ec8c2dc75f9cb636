"""What a recording shows of an iterate, as it is logged: maps and a cloud of points."""

from __future__ import annotations

import cv2
import numpy as np
import rerun as rr

from endolab.numerics.arrays import FloatArray
from endolab.solvers.energy import model_image
from endolab.solvers.problem import Problem
from endolab.solvers.result import Iterate
from endolab.workbench.plots.scales import LARGEST_RESIDUAL, OKABE_ITO, palette
from endolab.workbench.recording.stream import Thinned, classes, depth_map

OPAQUE_BLACK = (0, 0, 0, 255)
CLEAR = (0, 0, 0, 0)
# Colours of residuals up to `LARGEST_RESIDUAL`.
SHADES = palette("model - frame")[np.linspace(0, 255, 65).astype(int)].tolist()
RESIDUAL_COLOURS = {"left out": OPAQUE_BLACK} | {
    f"{LARGEST_RESIDUAL * share:+.2g}/255": tuple(colour)
    for share, colour in zip(np.linspace(-1, 1, len(SHADES)), SHADES, strict=True)
}
# A class for each hundredth of log distance, from a thousandth of a unit to 900 of them, and one for lines.
STEPS, NEAREST, LINE = 100, 1e-3, 1400
ROUNDS = np.outer(10.0 ** np.arange(-3, 3), [1, 2, 3, 5, 7]).ravel()
USED_COLOURS = {"left out": OPAQUE_BLACK, "used": CLEAR}
# The first three in the order of `Problem.evidence`.
FINDING_COLOURS = {
    "as it is": CLEAR,
    "saturated": OKABE_ITO.yellow,
    "highlight": OKABE_ITO.sky,
    "contour": OKABE_ITO.vermilion,
}


def paint(iterate: Iterate, thin: Thinned, sparse: Thinned) -> dict[str, rr.AsComponents]:
    """Make the pictures of an iterate, and the cloud of its sparse pixels, by their entities."""
    problem = iterate.problem
    difference = model_image(problem, iterate.log_distance) - problem.image
    share = np.clip(255 / LARGEST_RESIDUAL * difference[thin], -1, 1)
    # OpenCV's ways to bytes take a tenth of NumPy's time; nan becomes 0.
    half = len(SHADES) // 2
    shades = np.asarray(cv2.convertScaleAbs(share, alpha=half, beta=half + 1), np.uint8)
    facing = cv2.convertScaleAbs(iterate.normals[thin], alpha=127.5, beta=127.5)
    points = iterate.points[sparse][problem.mask[sparse]].astype(np.float32)
    return {
        "depth": depth_map(iterate.distance[thin], problem.metric),
        "distance": distance_codes(iterate.distance[thin]),
        "normals": rr.Image(facing),
        "residual": rr.SegmentationImage(shades, opacity=1.0),
        "world/cloud": rr.Points3D.from_fields(positions=points),
    }


def distance_codes(distance: FloatArray) -> rr.SegmentationImage:
    """Make a map of classes of distances, and of lines where these are round; 0 is unknown."""
    known = np.nan_to_num(distance, nan=NEAREST)
    codes = np.clip(STEPS * np.log(known / NEAREST), 0, LINE - 1).astype(np.uint16)
    below = np.searchsorted(ROUNDS, known).astype(np.uint8)
    codes[cv2.dilate(below, np.ones((3, 3))) > below] = LINE
    codes[np.isnan(distance)] = 0
    return rr.SegmentationImage(codes, opacity=1.0)


def distance_classes(limits: tuple[float, float], unit: str) -> rr.AnnotationContext:
    """Name the classes of distances, whose colours run from one limit to the other."""
    codes = np.arange(1, LINE)
    distances = NEAREST * np.exp((codes + 0.5) / STEPS)
    low, high = np.log(limits)
    place = np.clip(255 * (np.log(distances) - low) / max(high - low, 0.01), 0, 255)
    colours = palette("distance")[place.astype(int)].tolist()
    named = [
        (int(code), f"{distance:.3g} {unit}", tuple(colour))
        for code, distance, colour in zip(codes, distances, colours, strict=True)
    ]
    round_ones = (LINE, "a round distance", (255, 255, 255, 255))
    return rr.AnnotationContext([(0, "left out", OPAQUE_BLACK), *named, round_ones])


def paint_preparation(
    problem: Problem, thin: Thinned
) -> dict[str, tuple[rr.AsComponents, ...]]:
    """Show what is left out, and what was found in the frame, by their entities."""
    found = np.zeros(problem.mask.shape, np.uint8)
    if problem.evidence is not None:
        found[problem.mask] = problem.evidence[problem.mask]
    if problem.cuts is not None:
        found[problem.cuts.any(axis=0)] = 3
    return {
        "mask": classes(problem.mask[thin], USED_COLOURS),
        "prepared": classes(found[thin], FINDING_COLOURS),
    }
