"""What a recording shows of an iterate, as it is logged: maps and a cloud of points."""

from __future__ import annotations

import cv2
import numpy as np
import rerun as rr

from endolab.metrics.depth_errors import resample_truth
from endolab.numerics.arrays import FloatArray
from endolab.solvers.energy import model_image
from endolab.solvers.problem import Problem
from endolab.solvers.result import Iterate
from endolab.workbench.plots.scales import (
    LARGEST_ERROR,
    LARGEST_RESIDUAL,
    OKABE_ITO,
    Colour,
    palette,
    round_length,
    three_digits,
)
from endolab.workbench.recording.stream import THIN, Thinned, classes, depth_map

OPAQUE_BLACK = (0, 0, 0, 255)
CLEAR = (0, 0, 0, 0)
Painted = dict[str, tuple[rr.AsComponents, ...]]  # what to log, by entity
TRUTH_COLOUR = (160, 160, 160)
SHADES = palette("error")[np.linspace(0, 255, 65).astype(int)].tolist()
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


def paint(
    iterate: Iterate, truth: FloatArray | None, thin: Thinned, sparse: Thinned
) -> Painted:
    """Make the pictures of an iterate, and the cloud of its sparse pixels, by their entities."""
    problem = iterate.problem
    residual = 255 * (model_image(problem, iterate.log_distance) - problem.image)
    facing = cv2.convertScaleAbs(iterate.normals[thin], alpha=127.5, beta=127.5)
    points = iterate.points[sparse][problem.mask[sparse]].astype(np.float32)
    pictures: Painted = {
        "depth": (depth_map(iterate.distance[thin], problem.metric),),
        "distance": (distance_codes(iterate.distance[thin]),),
        "normals": (rr.Image(facing),),
        "residual": _signed_map(residual[thin], LARGEST_RESIDUAL, "/255"),
        "section/estimate": (_section(iterate.points, OKABE_ITO.vermilion),),
        "world/cloud": (rr.Points3D.from_fields(positions=points),),
    }
    if truth is not None:
        error = error_percent(iterate, truth)[thin]
        pictures["error"] = _signed_map(error, LARGEST_ERROR, " %")
    return pictures


def _signed_map(values: FloatArray, end: float, unit: str) -> tuple[rr.AsComponents, ...]:
    """A map of what may be below 0 and above, with colours up to an end of either sign."""
    steps = np.linspace(-end, end, len(SHADES))
    colours = {
        f"{step:+.3g}{unit}": tuple(shade)
        for step, shade in zip(steps, SHADES, strict=True)
    }
    # OpenCV's way to bytes takes a tenth of NumPy's time; nan becomes 0.
    half = len(SHADES) // 2
    codes = cv2.convertScaleAbs(np.clip(values / end, -1, 1), alpha=half, beta=half + 1)
    return classes(codes, {"left out": OPAQUE_BLACK, **colours})


def paint_truth(last: Iterate, truth: FloatArray, sparse: Thinned) -> Painted:
    """Show the truth in space and in the section, in the unit of a stage's last iterate, and that unit."""
    points = _truth_for(last, truth)[..., None] * last.problem.field.rays
    seen = points[sparse].reshape(-1, 3).astype(np.float32)
    seen = seen[np.isfinite(seen).all(axis=1)]
    length = round_length(np.nanmax(points[..., 2]))
    unit = f"{length:g} {last.problem.unit} from the camera"
    return {
        "world/truth": (rr.Points3D(seen, colors=TRUTH_COLOUR, radii=THIN),),
        "section/truth": (_section(points, TRUTH_COLOUR),),
        "section/length": (rr.LineStrips2D([[(0, 0), (length, 0)]], labels=unit),),
    }


def error_percent(iterate: Iterate, truth: FloatArray) -> FloatArray:
    """How far an iterate is from the truth, %, (H, W); after scaling by the median if it has no unit."""
    return 100 * (iterate.distance / _truth_for(iterate, truth) - 1)


def _truth_for(iterate: Iterate, truth: FloatArray) -> FloatArray:
    """The truth on an iterate's grid, in its unit; nan where either is unknown."""
    same = resample_truth(truth, iterate.mask.shape)
    same[~iterate.mask | (same <= 0)] = np.nan
    scale = 1.0 if iterate.problem.metric else np.nanmedian(iterate.distance / same)
    return same * scale


def _section(points: FloatArray, colour: Colour) -> rr.LineStrips2D:
    """Where the middle column cuts a surface, seen from the side: z to the right, y down."""
    column = np.ma.masked_invalid(points[:, points.shape[1] // 2, [2, 1]])
    parts = [column[part].data for part in np.ma.clump_unmasked(column[:, 0])]
    return rr.LineStrips2D(parts, colors=colour)


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
        (int(code), f"{three_digits(distance)} {unit}", tuple(colour))
        for code, distance, colour in zip(codes, distances, colours, strict=True)
    ]
    round_ones = (LINE, "a round distance", (255, 255, 255, 255))
    return rr.AnnotationContext([(0, "left out", OPAQUE_BLACK), *named, round_ones])


def paint_preparation(problem: Problem, thin: Thinned) -> Painted:
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
