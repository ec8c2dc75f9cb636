"""What a recording shows, as it is logged: maps, a section and clouds of points.

Maps are numbers of classes, of which the viewer is told names and colours: those of `FIXED`, and equal
`STEPS` from one end of a map's colours to the other.
"""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from endolab.numerics.arrays import FloatArray
from endolab.solvers.energy import model_image
from endolab.solvers.problem import Problem
from endolab.solvers.result import Iterate
from endolab.workbench.plots.scales import (
    MAPS,
    OKABE_ITO,
    SOURCE_COLOURS,
    Colour,
    in_colour,
    palette,
    three_digits,
    truth_for,
)

Ends = tuple[float, float]
Painted = dict[str, rr.AsComponents]  # what to log, by entity
THIN = rr.Radius.ui_points(1.5)
TRUTH_COLOUR = (160, 160, 160)
NAMED = {
    "left out": (0, 0, 0, 255),
    "as it is": (0, 0, 0, 0),
    # In the order of `Problem.evidence`.
    "saturated": OKABE_ITO.yellow,
    "highlight": OKABE_ITO.sky,
    "contour": OKABE_ITO.vermilion,
    "a round distance": (255, 255, 255),
    **SOURCE_COLOURS,
}
FIXED = [(k, *one) for k, one in enumerate(NAMED.items())]
CONTOUR = 4
LINE = 5  # the sources follow
FIRST = len(FIXED)  # of the steps
# All fit into a byte: of more than 256, Rerun confuses colours where the largest changes with time.
STEPS = 240
ENDS: dict[str, Ends] = {
    "model - frame": (-10.0, 10.0),
    "error": (-20.0, 20.0),
    "σ": (0.0, 20.0),
}
DIFFERENCES = {"error": "error", "residual": "model - frame", "sigma": "σ"}  # entities
ROUNDS = np.outer(10.0 ** np.arange(-3, 3), [1, 2, 3, 5, 7]).ravel()


# Classes ----------------------------------------------------------------------------------
def in_steps(values: FloatArray, ends: Ends) -> NDArray[np.uint8]:
    """Numbers of the classes of a map's values; of nan 0. Of distances give logarithms."""
    low, high = ends
    share = (values.clip(low, high) - low) / (high - low)
    return np.nan_to_num(FIRST + 0.5 + share * (STEPS - 1)).astype(np.uint8)


def names(name: str, ends: Ends, unit: str = "") -> rr.AnnotationContext:
    """Names and colours of the classes of a map of `MAPS` from one end to the other."""
    scale = MAPS[name]
    spread = np.geomspace if scale.kind == "log" else np.linspace
    words = [f"{three_digits(x)} {scale.unit or unit}" for x in spread(*ends, STEPS)]
    colours = palette(name)[np.linspace(0, 255, STEPS).astype(int)]
    steps = zip(range(FIRST, FIRST + STEPS), words, map(tuple, colours), strict=True)
    return rr.AnnotationContext([*FIXED, *steps])


def all_names() -> Painted:
    """Names and colours of all classes but those of distances, by what they are of.

    Not told once above all: Rerun then drew a second run's frame white.
    """
    fixed = rr.AnnotationContext(FIXED)
    named = {entity: names(name, ENDS[name]) for entity, name in DIFFERENCES.items()}
    return {"found": fixed, "dominant_source": fixed, **named}


def class_map(codes: NDArray) -> rr.SegmentationImage:
    """A map of classes, (h, w)."""
    return rr.SegmentationImage(np.ascontiguousarray(codes, np.uint8), opacity=1.0)


# What is shown ----------------------------------------------------------------------------
def scalars(values: Mapping[str, float]) -> Painted:
    """Numbers by their entities; those that are finite."""
    return {k: rr.Scalars(float(x)) for k, x in values.items() if np.isfinite(x)}


def paint_frame(picture: FloatArray, found: NDArray, step: int) -> Painted:
    """Show a picture, on a map and on the cloud, and what was found in it, (H, W), of `FIXED`."""
    # OpenCV's way to bytes takes a tenth of NumPy's time; nan becomes 0.
    colours = cv2.convertScaleAbs(in_colour(picture), alpha=255)
    few = 2 * step
    on_cloud = colours[::few, ::few][found[::few, ::few] > 0]
    radii = rr.Radius.ui_points(2.5)
    return {
        "input": rr.Image(colours[::step, ::step]),
        "found": class_map(found[::step, ::step]),
        "world/cloud": rr.Points3D.from_fields(colors=on_cloud, radii=radii),
    }


def found_in(problem: Problem) -> NDArray:
    """What was found in a frame, and what is left out, (H, W), of `FIXED`."""
    found = 1 * problem.mask
    if problem.evidence is not None:
        found[problem.mask] += problem.evidence[problem.mask]
    if problem.cuts is not None:
        found[problem.cuts.any(axis=0)] = CONTOUR
    return found


def paint_surface(
    points: FloatArray, normals: FloatArray, ends: Ends, step: int
) -> Painted:
    """Show a surface by its points and normals, (H, W, 3), and where the colours of distances end."""
    distance = np.linalg.norm(points[::step, ::step], axis=-1)
    codes = in_steps(np.log(distance), (np.log(ends[0]), np.log(ends[1])))
    below = np.searchsorted(ROUNDS, np.nan_to_num(distance)).astype(np.uint8)
    codes[(cv2.dilate(below, np.ones((3, 3))) > below) & (codes > 0)] = LINE
    facing = cv2.convertScaleAbs(normals[::step, ::step], alpha=127.5, beta=127.5)
    cloud = _finite(points[:: 2 * step, :: 2 * step])
    return {
        "distance": class_map(codes),
        "normals": rr.Image(facing),
        "section/estimate": _section(points, OKABE_ITO.vermilion),
        "world/cloud": rr.Points3D.from_fields(positions=cloud),
    }


def paint(iterate: Iterate, truth: FloatArray | None, ends: Ends, step: int) -> Painted:
    """Show an iterate: its surface, and how far it is from the frame and from the truth."""
    problem = iterate.problem
    painted = paint_surface(iterate.points, iterate.normals, ends, step)
    # To be read back; the viewer shows it in steps.
    exact = iterate.distance[::step, ::step].astype(np.float32)
    painted["depth"] = rr.DepthImage(exact, meter=1000.0 if problem.metric else 1.0)
    residual = 255 * (model_image(problem, iterate.log_distance) - problem.image)
    codes = in_steps(residual[::step, ::step], ENDS["model - frame"])
    painted["residual"] = class_map(codes)
    if truth is not None:
        error = error_percent(iterate, truth)[::step, ::step]
        painted["error"] = class_map(in_steps(error, ENDS["error"]))
    return painted


def paint_truth(last: Iterate, truth: FloatArray, step: int) -> Painted:
    """Show the truth in space and in the section, in the unit of a stage's last iterate."""
    points = truth_for(last, truth)[..., None] * last.problem.field.rays
    cloud = _finite(points[:: 2 * step, :: 2 * step])
    return {
        "world/truth": rr.Points3D(cloud, colors=TRUTH_COLOUR, radii=THIN),
        "section/truth": _section(points, TRUTH_COLOUR),
    }


def error_percent(iterate: Iterate, truth: FloatArray) -> FloatArray:
    """How far an iterate is from the truth, %, (H, W); after scaling by the median if it has no unit."""
    return 100 * (iterate.distance / truth_for(iterate, truth) - 1)


def looks_along(distance: FloatArray) -> rr.Arrows3D:
    """The camera and where it looks, a third of the way long."""
    axis = [0, 0, 0.35 * float(np.nanmedian(distance))]
    return rr.Arrows3D(vectors=[axis], colors=OKABE_ITO.sky, radii=THIN)


def box_of(points: FloatArray) -> FloatArray:
    """Two corners of a surface, (2, 3), and of nearly all of it: a pixel may be far off."""
    return np.percentile(_finite(points), (2, 98), axis=0)


def _finite(points: FloatArray) -> NDArray[np.float32]:
    return points[np.isfinite(points).all(axis=-1)].astype(np.float32)


def _section(points: FloatArray, colour: Colour) -> rr.Points2D:
    """Where the middle column cuts a surface, seen from the side: z to the right, y down."""
    column = _finite(points[:, points.shape[1] // 2, [2, 1]])
    return rr.Points2D(column, colors=colour, radii=THIN)
