"""Frame and endoscope in, surface out: the one call most people need, and the three it is made of.

    frame, endoscope, settings
       |
       |  find        one channel, or three, in full and on few pixels; light that came by way of other walls
       |              is computed and taken out; where a fold hides a wall, the surface is cut
       v
    Found
       |  solve       the energy of the paper is minimised, under any λ, regulariser, solver and light's law
       v
    surface
       |  to scale    millimetres, if a length is known
       v
    Result

The first is endolab's own. With ``channel="green", contours=False`` it finds nothing, and what is left is
the method of the paper: one channel, all light taken for the lamp's, a surface without a cut.

All that is solved on the way is yielded, so that observers see it. Who turns λ or the light's law keeps what
was found, and does only the rest again (`solve_found`).
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from endolab.frames.frame import Frame
from endolab.model.endoscope import Calibration
from endolab.numerics.checks import check_kinds
from endolab.numerics.threads import limit_threads
from endolab.reconstruction.colours import prior_of
from endolab.reconstruction.found import Found
from endolab.reconstruction.lamps import Lamps, divide_by_lamps
from endolab.reconstruction.light_and_contours import (
    light_and_contours,
    problem_as_before,
    settle_lamps,
)
from endolab.reconstruction.problem_of_frame import (
    check_frame,
    problem_of_frame,
    problems_of_frame,
)
from endolab.reconstruction.scale import to_scale
from endolab.reconstruction.settings import Settings, takes_settings
from endolab.solvers import solvers
from endolab.solvers.problem import Problem
from endolab.solvers.result import (
    SOLUTION,
    Iterate,
    Observer,
    Result,
    Solver,
    Solving,
    limit_steps,
    run,
)
from endolab.solvers.solvers import check_solver_options, options_of


@check_kinds(frame=Frame, calibration=Calibration, start=Result)
@takes_settings
def reconstruct(
    frame: Frame,
    calibration: Calibration,
    *,
    start: Result | None = None,
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
        if "held" in options:
            raise ValueError("held= went: give what was found to endolab.solve_found()")
        settings = Settings.of(options)
        calibration = calibration.for_size(frame.width, frame.height)
        steps = _stages(frame, calibration, settings, start)

        def finish(answer: Iterate) -> Iterate:
            if answer.stage != SOLUTION:  # it was stopped on the way
                full = problem_of_frame(frame, calibration, settings)
                asked = replace(full.report, asked=settings.as_dict(), stage=answer.stage)
                full = replace(full, report=asked, colours=())
                answer = Iterate.of(full, answer.start_of(full))
            return to_scale(answer, settings)

        return run(steps, observers, last=finish)


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
    calibration = calibration.for_size(frame.width, frame.height)
    return _stages(frame, calibration, settings, start)


@check_kinds(found=Found, calibration=Calibration)
@takes_settings
def solve_found(
    found: Found,
    calibration: Calibration,
    *,
    observers: Iterable[Observer] = (),
    threads: int | None = None,
    **options: Any,
) -> Result:
    """Solve for a surface with the light and the contours that were found before.

    Parameters
    ----------
    found : Found
        As the tuner exports it (`endolab.load_found`).
    calibration : Calibration
        Camera and photometry as they are believed to be; k, γ and gain may be others than when it was found.
    observers, threads
        As for `reconstruct`.
    **options
        Those of `reconstruct`. What decides which light and contours are found must be as it was.

    Returns
    -------
    Result
        Of the pixels that were asked for when it was found.

    Raises
    ------
    ValueError
        In one sentence, if an argument cannot be used, or if an option wants light and contours found anew.
    """
    settings = Settings.of(options)
    now = settings.search | {"width": settings.width, "cuts": settings.cuts}
    was = found.settings.search | {"width": found.problem.mask.shape[1], "cuts": None}
    for name in options.keys() & now.keys():
        if name == "cuts" or now[name] != was[name]:
            raise ValueError(
                f"{name} belongs to what was found, with {was[name]}: reconstruct() finds light and contours "
                "anew"
            )
    with limit_threads(threads):
        steps = solve(found, settings, calibration)
        return run(steps, observers, last=lambda answer: to_scale(answer, settings))


def _stages(
    frame: Frame, calibration: Calibration, settings: Settings, start: Result | None
) -> Solver:
    """Check what is given, and return the iterates of all that is solved."""
    check_frame(frame, calibration, settings)
    if start is not None:
        check_solver_options(settings.solver, {"start": start})

    def stages() -> Solver:
        found = yield from find(frame, calibration, settings, start)
        return (yield from solve(found, settings, calibration))

    return stages()


def find(
    frame: Frame, calibration: Calibration, settings: Settings, start: Result | None = None
) -> Solving[Found]:
    """Take indirect light out of a frame, and cut its surface where contours are; yield all iterates.

    Of a start that is of this picture and endoscope, light and contours stay.
    """
    contours = settings.contours if settings.searches_contours else False
    known = converged_at = None
    if start is not None:
        full = problem_of_frame(frame, calibration, settings)
        if start.mask.shape != full.mask.shape:
            raise ValueError(
                f"start has shape {start.mask.shape}, the frame {full.mask.shape}"
            )
        known = problem_as_before(full, start, contours)
        lengths = {name: start.report.asked.get(name) for name in settings.lengths}
        if known is not None and full.report.lamps and lengths != settings.lengths:
            known = start = None  # ω is of that unit
        elif start.status.is_done:
            converged_at = start.energy
    if known is None:
        lamps = Lamps.of(calibration, settings)
        small, full = problems_of_frame(frame, calibration, settings, lamps is not None)
        problem, first = yield from light_and_contours(
            small, full, prior_of(calibration), contours, start, lamps
        )
        if lamps is not None and first is not None:
            # Once more, if ω of the surface on all pixels would move half of log d by more than 0.005; every
            # third row and column tells, as a hand waits for it.
            few = slice(None, None, 3)
            assert problem.lamp_ratio is not None
            ratio = lamps.ratio(Iterate(problem, 0, first), 3)
            moved = np.abs(np.log(ratio / problem.lamp_ratio[few, few])) / 2
            if np.median(moved[problem.mask[few, few]]) > 0.005:
                problem, first = yield from settle_lamps(problem, first, lamps, (1,))
    else:
        problem, first = known, None
    found = Found(problem, settings, calibration, first, converged_at=converged_at)
    if start is None or first is not None:
        return found
    halvings = 2 if known is None else found.halvings
    return replace(found, start=start.iterate.start_of(problem), halvings=halvings)


def lamps_stay(found: Found, problem: Problem, lamps: Lamps) -> bool:
    """Whether ω stays: the lamps stand as before, and the surface is as far away, but for a twentieth."""
    before = Lamps.of(found.believed, found.settings)
    if before is None or problem.lamp_ratio is None:
        return False
    was, now = (
        one.median(Iterate(of, 0, of.log_d0))
        for one, of in ((before, found.problem), (lamps, problem))
    )
    same = lamps.photometry.lights == before.photometry.lights
    return same and abs(np.log(now / was)) < 0.05


def solve(found: Found, settings: Settings, calibration: Calibration) -> Solver:
    """Solve what was found, under the energy and the light's law that are asked for."""
    problem, start = found.problem_with(settings, calibration)
    lamps = Lamps.of(calibration, settings)
    if lamps is None:
        problem = divide_by_lamps(problem, None)
    elif not lamps_stay(found, problem, lamps):
        if start is not None:
            problem = divide_by_lamps(problem, lamps.ratio(Iterate(problem, 0, start)))
        problem, start = yield from settle_lamps(problem, start, lamps, (2, 2, 2, 2))
    is_near = settings.energy == found.settings.energy and problem.is_lit_as(found.problem)
    offered: dict[str, Any] = {
        "start": start,
        "halvings": found.halvings,
        "converged_at": found.converged_at,
        # The solver ends when two steps change distances by less than this fraction, root mean square. It is
        # more for a surface that is cut, under the energy for which its start was found: pieces that are
        # joined at few pixels creep long after that. Under another it has a way to go, and would seem to
        # rest long before.
        "settled": 1e-2 if is_near and problem.cuts is not None else 5e-4,
        "max_iterations": settings.max_iterations,
    }
    accepted = options_of(settings.solver)
    options = {
        name: value
        for name, value in offered.items()
        if name in accepted and value is not None
    }
    steps = solvers.solve(
        problem, settings.solver, **{**options, **settings.solver_options}
    )
    if "max_iterations" not in accepted:
        steps = limit_steps(steps, settings.max_iterations)
    return (yield from steps)
