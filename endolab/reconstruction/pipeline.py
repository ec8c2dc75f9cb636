"""Frame and endoscope in, surface out: the one call most people need, and its stages.

    frame, calibration, settings
       |
       |  problem of frame         one channel, or three, in full and on few pixels
       v
    Problem
       |  light and contours       light that came by way of other walls is computed and taken out; where a
       |                           fold hides a wall, the surface is cut
       v
    Problem
       |  solve                    the energy of the paper is minimised
       v
    surface
       |  to scale                 millimetres, if a length is known
       v
    Result

The second is endolab's own. With ``channel="green", contours=False`` it does nothing, and what is left is
the method of the paper: one channel, all light taken for the lamp's, a surface without a cut.

All that is solved on the way is yielded, so that observers see it. Who turns λ or the light's law holds what
was found of light and contours (`held`), and only the third is done again.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

from endolab.frames.frame import Frame
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import check_kinds
from endolab.numerics.side_by_side import in_background
from endolab.numerics.threads import limit_threads
from endolab.reconstruction.colours import prior_of
from endolab.reconstruction.held import Held
from endolab.reconstruction.light_and_contours import (
    light_and_contours,
    problem_as_before,
)
from endolab.reconstruction.problem_of_frame import (
    check_frame,
    on_few_pixels,
    problem_of_frame,
    start_from,
)
from endolab.reconstruction.scale import scale_by_length
from endolab.reconstruction.settings import Settings, takes_settings
from endolab.solvers.gauss_newton import DESCENT
from endolab.solvers.problem import Problem
from endolab.solvers.result import (
    SOLUTION,
    Iterate,
    Observer,
    Result,
    Solver,
    limit_steps,
    run,
)
from endolab.solvers.solvers import check_solver_options, options_of, solve

# The solver ends when two steps change distances by less than this fraction, root mean square. It is more if
# the surface is cut: pieces that are joined at few pixels creep long after that.
SETTLED_CUT = 1e-2
SETTLED_UNCUT = 5e-4


@check_kinds(frame=Frame, calibration=Calibration, start=Result)
@takes_settings
def reconstruct(
    frame: Frame,
    calibration: Calibration,
    *,
    start: Result | None = None,
    held: Held | None = None,
    observers: Iterable[Observer] = (),
    threads: int | None = None,
    **options: Any,
) -> Result:
    """Find the depth map that explains a frame.

    Parameters
    ----------
    frame : Frame
        The picture, as `endolab.read_frame` gives it. If its mask leaves nothing out, what surrounds the
        endoscope's field of view is found and left out.
    calibration : Calibration
        Camera and photometry of the endoscope, for pictures of that size.
    start : Result, optional
        An earlier result to start from. If it is of the same frame and endoscope, what was found of bounced
        light and contours stays: with another λ, say, the next result is a step or two away.
    held : Held, optional
        Direct light, contours and a start that were found before, as the tuner exports them
        (`endolab.load_held`). Only energy, light and solver are then as asked.
    observers : iterable of callables
        Each is shown every iterate of every stage (`Iterate.stage`), and at last the answer in mm if a
        length is given; one that returns True stops the run.
    threads : int, optional
        The most cores to use, on which no result depends; all by default, or `ENDOLAB_THREADS` of the
        environment.
    **options
        Those of `Settings`, below; others are the solver's, such as `inflow` of `fast_marching` and
        `gauss_newton`.

    Returns
    -------
    Result
        Distances in mm, or in relative units (`metric` is False) if the gain is unknown and no
        length is given.

    Raises
    ------
    ValueError
        In one sentence, if frame, calibration or an option cannot be used.
    MemoryError
        If the problem is too large for this machine, before anything is computed.

    Examples
    --------
    >>> import endolab as el
    >>> sample = el.load_traced("matt")  # a frame that comes with endolab
    >>> result = el.reconstruct(sample.frame, sample.calibration, width=96)
    >>> result.status.name, result.metric, result.distance.shape
    ('CONVERGED', True, (72, 96))
    """
    with limit_threads(threads):
        settings = Settings.of(options)
        if held is not None:
            problem = held.problem_with(settings, calibration)
            return run(_solve(problem, settings, held.start), observers)
        give_full = _begin(frame, calibration, settings, start)
        stages = _solve_in_stages(frame, calibration, settings, start, give_full)

        def to_scale(answer: Iterate) -> Iterate:
            if answer.stage != SOLUTION:  # it was stopped on the way
                problem = give_full()
                report = replace(answer.report, asked=settings.as_dict())
                problem = replace(problem, report=report, colours=())
                answer = Iterate.of(problem, start_from(answer, problem))
            return scale_by_length(answer, **settings.lengths)

        return run(stages, observers, last=to_scale)


@check_kinds(frame=Frame, calibration=Calibration, start=Result)
@takes_settings
def iterate(
    frame: Frame, calibration: Calibration, *, start: Result | None = None, **options: Any
) -> Solver:
    """Yield the iterates of all stages, up to the solver's own: ``for step in iterate(...): ...``.

    Takes the keywords of `reconstruct` but for those that fix the scale.

    Examples
    --------
    >>> import endolab as el
    >>> sample = el.load_traced("matt")  # a frame that comes with endolab
    >>> steps = el.iterate(sample.frame, sample.calibration, width=96, channel="green", max_iterations=2)
    >>> [step.k for step in steps]
    [0, 1, 2]
    """
    settings = Settings.of(options)
    for name, length in settings.lengths.items():
        if length is not None:
            raise ValueError(
                f"{name} is an option of reconstruct(); iterates have the unit of the gain"
            )
    give_full = _begin(frame, calibration, settings, start)
    return _solve_in_stages(frame, calibration, settings, start, give_full)


def _begin(
    frame: Frame, calibration: Calibration, settings: Settings, start: Result | None
) -> Callable[[], Problem]:
    """Check what is given and prepare the frame on all its pixels, in the background if few come first."""
    check_frame(frame, calibration, settings)
    if start is not None:
        check_solver_options(settings.solver, {"start": start})

    def full() -> Problem:
        return problem_of_frame(frame, calibration, settings)

    if on_few_pixels(frame, settings) is not None:
        return in_background(full)
    problem = full()
    return lambda: problem


def _solve_in_stages(
    frame: Frame,
    calibration: Calibration,
    settings: Settings,
    start: Result | None,
    give_full: Callable[[], Problem],
) -> Solver:
    """Take indirect light out, cut the surface where contours are, and solve what is left."""
    contours = settings.contours if settings.searches_contours else False
    known = None  # the problem, if the start's light and contours are this picture's
    first: FloatArray | None = None  # log d to begin with
    converged_at = None
    if start is not None:
        full = give_full()
        if start.mask.shape != full.mask.shape:
            raise ValueError(
                f"start has shape {start.mask.shape}, the frame {full.mask.shape}"
            )
        known = problem_as_before(full, start, contours)
        converged_at = start.energy if start.status.is_done else None
    if start is not None and known is not None:
        problem, first = known, start_from(start.iterate, known)
    else:
        few = on_few_pixels(frame, settings)
        small = give_full() if few is None else problem_of_frame(frame, calibration, few)
        problem, first = yield from light_and_contours(
            small, give_full, prior_of(calibration), contours, start
        )

    # So many times are rows and columns halved, for a grid on which a start becomes this problem's own.
    halvings = DESCENT.like_halvings
    if start is not None and first is None:  # of another picture, of one channel
        first = start_from(start.iterate, problem)
        halvings = DESCENT.start_halvings
    return (yield from _solve(problem, settings, first, halvings, converged_at))


def _solve(
    problem: Problem,
    settings: Settings,
    start: FloatArray | None,
    halvings: int = DESCENT.start_halvings,
    converged_at: float | None = None,
) -> Solver:
    """Solve the problem that is left, from a first map if there is one."""
    asked = settings.as_dict() | {"regulariser": problem.regulariser}
    problem = replace(problem, report=replace(problem.report, asked=asked))
    offered: dict[str, Any] = {
        "start": start,
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
    steps = solve(problem, settings.solver, **{**options, **settings.solver_options})
    if "max_iterations" not in accepted:
        steps = limit_steps(steps, settings.max_iterations)
    return (yield from steps)
