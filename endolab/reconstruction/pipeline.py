"""Frame and endoscope in, surface out, in five stages.

    frame, endoscope, settings
       |
       |  prepare                  `channels`: one channel, or three, in full and on few pixels
       v
    Channels
       |  remove indirect light    `light`: what came by way of other walls is computed and taken out
       v
    Task
       |  choose contours          `contours`: where a fold hides a wall, the surface is cut; with three
       |                           colours, the stage before has chosen them already
       v
    Task
       |  solve                    `solvers`: the energy of the paper is minimised
       v
    surface
       |  to scale                 `scale`: millimetres, if a length is known
       v
    Result

The second and the third are endolab's own. With ``channel="green", contours=False`` they do nothing, and what
is left is the method of the paper: one channel, all light taken for the lamp's, a surface without a cut.

All that is solved on the way is yielded, so that observers see it.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from endolab.frames.frame import Frame
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import excerpt
from endolab.reconstruction.channels import (
    Channels,
    Task,
    prepare_channels,
    start_from,
)
from endolab.reconstruction.contours.choice import choose_contours
from endolab.reconstruction.light.separation import remove_indirect_light
from endolab.reconstruction.scale import scale_by_length
from endolab.reconstruction.settings import Settings
from endolab.solvers.gauss_newton import DESCENT
from endolab.solvers.result import (
    SOLUTION,
    Iterate,
    Result,
    Solver,
    limit_steps,
    with_provenance,
)
from endolab.solvers.solvers import check_solver_options, options_of, solve

# The solver ends when two steps change distances by less than this share, root mean square. It is more if the
# surface is cut: pieces that are joined at few pixels creep long after that.
SETTLED_CUT = 1e-2
SETTLED_UNCUT = 5e-4


def prepare(
    frame: Frame,
    calibration: Calibration,
    settings: Settings,
    start: Result | None,
) -> Channels:
    """Check what was given, and prepare the frame."""
    for name, value, kind, expected in (
        ("frame", frame, Frame, "a Frame"),
        ("calibration", calibration, Calibration, "a Calibration"),
        ("start", start, Result | np.ndarray | None, "an earlier Result"),
    ):
        if not isinstance(value, kind):
            raise ValueError(f"{name} must be {expected}, got {excerpt(value)}")
    if start is not None:
        check_solver_options(settings.solver, {"start": start})
    channels = prepare_channels(frame, calibration, settings)
    if isinstance(start, Result):
        shape = channels.middle.problem.mask.shape
        if start.mask.shape != shape:
            raise ValueError(f"start has shape {start.mask.shape}, the frame {shape}")
    return channels


def solve_in_stages(
    channels: Channels,
    albedo: FloatArray | None,
    settings: Settings,
    start: Result | FloatArray | None,
) -> Solver:
    """Remove indirect light, choose contours, and solve what is left."""
    before = start if isinstance(start, Result) else None
    contours = settings.contours if settings.searches_contours else False
    task = yield from remove_indirect_light(channels, albedo, contours, before)
    task = yield from choose_contours(task, contours, before)
    return (yield from _solve(task, settings, start))


def _solve(task: Task, settings: Settings, start: Result | FloatArray | None) -> Solver:
    """Solve the problem that is left."""
    problem = task.problem
    first_map = task.start
    halvings = DESCENT.like_halvings  # as it was found on fewer pixels
    converged_at = None
    if isinstance(start, np.ndarray):
        first_map = start
        halvings = DESCENT.start_halvings
    elif start is not None:
        if start.status.is_done:
            converged_at = start.energy
        if first_map is None:
            first_map = start_from(start.iterate, problem)
            halvings = DESCENT.start_halvings
    offered: dict[str, Any] = {
        "start": first_map,
        "halvings": halvings,
        "converged_at": converged_at,
        "settled": SETTLED_UNCUT if problem.cuts is None else SETTLED_CUT,
        "max_iterations": settings.max_iterations,
    }
    accepted = options_of(settings.solver)
    options = {
        name: value
        for name, value in offered.items()
        if name in accepted and value is not None
    }
    options |= settings.solver_options
    settings_used = settings.as_dict() | {"regulariser": problem.regulariser}
    provenance = replace(task.provenance, asked=settings_used)
    steps = with_provenance(solve(problem, settings.solver, **options), provenance)
    if "max_iterations" not in accepted:
        steps = limit_steps(steps, settings.max_iterations)
    return (yield from steps)


def to_scale(answer: Iterate, channels: Channels, settings: Settings) -> Iterate:
    """Return the answer in mm, if a length is known; on the frame's pixels, if it was stopped on the way."""
    if answer.stage != SOLUTION:
        problem = channels.middle.problem
        provenance = replace(answer.provenance, asked=settings.as_dict())
        answer = Iterate.of(problem, start_from(answer, problem), provenance=provenance)
    return scale_by_length(answer, **settings.lengths)
