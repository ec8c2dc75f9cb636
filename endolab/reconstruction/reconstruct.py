"""Frame and calibration in, surface out: the one call most people need.

Stages, each of which hands the next one plain value:

1. *prepared*: the frame becomes a `Problem`, or `Colours` (`problem_setup`);
2. *λ chosen*, if that is asked for, on fewer pixels, for which the next two are done (`trust`);
3. *bounced light and contours found*: `Colours` become a `Problem` of direct light and a start
   (`separation`), the surface of one channel is torn (`contours`);
4. *solved*: the solver's iterates, the last or the best of which is the answer;
5. *scaled*: the same surface in mm, if a length is known (`scale`).

All that is solved on the way is yielded, so that observers see it.
"""

from collections.abc import Generator, Iterable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from endolab.depth.problem import Problem
from endolab.depth.result import SOLUTION, Iterate, Observer, Result, Solver, run
from endolab.depth.solvers import DEFAULT_SOLVER, checked_solver, knows_curvature, options_of, solve
from endolab.model.endoscope import Endoscope
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import told as said
from endolab.numerics.threads import limited_threads
from endolab.preprocessing.frame import Frame
from endolab.reconstruction.contours import OneChannel, judged
from endolab.reconstruction.problem_setup import (
    AUTO,
    LEAST_SIDE,
    SEPARATED,
    check_start,
    noted,
    on_grid,
    remarked,
)
from endolab.reconstruction.scale import KnownDiameter, KnownDistance, check_scale, known_scale
from endolab.reconstruction.separation import Colours, direct_light
from endolab.uncertainty.choice_of_lam import CHOICE, LamCurve, choose_lam

PREPARING = (
    *("channel", "width", "smooth", "highlights"),
    *("xi", "regulariser", "lam", "epsilon", "threshold", "cuts"),
)
SETTLED = 5e-3  # of distances: a torn surface hangs together by little, and creeps long after that
WEIGHING = ("gauss_newton", "primal_dual")  # solvers that λ is for
CHOOSING = 160  # px; a wall that is told from noise there is seen, and takes a tenth of a second or two
GREY = (
    "The picture is grey, so that light which came by way of other walls cannot be told from the lamp's: "
    "it was left in."
)


def iterate(frame: Frame, calibration: Endoscope, *, solver: str = DEFAULT_SOLVER, **options: Any) -> Solver:
    """Iterates of all stages up to the solver's: ``for step in iterate(frame, calibration): ...``.

    Takes the keywords of `reconstruct` but for those that fix the scale.
    """
    how = {name: options.pop(name) for name in PREPARING if name in options}
    start, contours = options.pop("start", None), options.pop("contours", None)
    _check(frame, calibration, contours, start)
    checked_solver(solver, options if start is None else options | {"start": start})
    how["channel"] = channel_for(how.get("channel"), solver)
    contours = _wanted(contours, how["channel"])
    best = how.setdefault("regulariser", AUTO) == AUTO
    prepared = _prepared(frame, calibration, contours, **how)
    return _stages(prepared, contours, best, start, solver, options)


def _check(frame: Any, calibration: Any, contours: Any, start: Any) -> None:
    """Raise a ValueError if what is no number is not what it must be."""
    for name, value, kind, expected in (
        ("frame", frame, Frame, "a Frame"),
        ("calibration", calibration, Endoscope, "an Endoscope"),
        ("start", start, Result | np.ndarray | None, "an earlier Result"),
    ):
        if not isinstance(value, kind):
            raise ValueError(f"{name} must be {expected}, got {said(value)}")
    if not isinstance(contours, bool | np.bool_ | None):
        raise ValueError(f"contours must be True, False or None, got {said(contours)}")


def channel_for(channel: str | None, solver: str) -> str | None:
    """Return the channel, by default the one for the solver: those of the paper take the paper's, green."""
    return AUTO if channel is None and solver == DEFAULT_SOLVER else channel


def _wanted(contours: bool | None, channel: str | None) -> bool | None:
    """Whether to tear at contours; None if the evidence is to tell."""
    return False if contours is None and channel not in (AUTO, SEPARATED) else contours


def _prepared(
    frame: Frame,
    calibration: Endoscope,
    contours: bool | None,
    *,
    channel: str | None = None,
    regulariser: str,
    **how: Any,
) -> OneChannel | Colours:
    how["regulariser"] = "second" if regulariser == AUTO else regulariser
    if channel == SEPARATED or (channel == AUTO and frame.image.ndim == 3):
        return Colours.of(frame, calibration, must=channel == SEPARATED, **how)
    if channel != AUTO:
        return OneChannel.of(frame, calibration, channel, contours is not False, **how)
    if how.get("highlights") is None:
        how["highlights"] = "ignore"
    one = OneChannel.of(frame, calibration, None, contours is not False, **how)
    return replace(one, fine=remarked(one.fine, GREY))


def _whole(prepared: OneChannel | Colours) -> Problem:
    """Return the problem that is as large as the answer."""
    return prepared.fine[1] if isinstance(prepared, Colours) else prepared.fine


def _stages(
    prepared: OneChannel | Colours,
    contours: bool | None,
    best: bool,
    start: Result | FloatArray | None,
    solver: str,
    options: dict[str, Any],
    told: Mapping[str, object] = MappingProxyType({}),
    curve: LamCurve | None = None,
) -> Solver:
    """All that is solved, at last with the `best` regulariser or with that of what was prepared.

    `told` is added to the settings of the problem whose answer counts. A λ that was chosen, see its `curve`,
    is for the last solve alone; the stages before, whose constants go with the usual one, keep that. On walls
    whose light bounced, which have a texture as well, curvature is no better than the second order, and it
    is slower.
    """
    before, begin = (start, None) if isinstance(start, Result) else (None, start)
    if before is not None:
        check_start(before, _whole(prepared))
    if isinstance(prepared, Colours):
        problem, near = yield from direct_light(prepared, contours, before)
    else:
        problem, near = yield from judged(prepared, contours, before)
    if curve is not None:
        problem = _weighted(problem, curve)
    begin = near if begin is None else begin
    if before is not None and begin is None:
        begin = on_grid(before.iterate, problem)
    if begin is not None and "start" in options_of(solver):
        options = options | {"start": begin}
    if best and problem.origin.albedo is None and knows_curvature(solver, problem.xi):
        problem = replace(problem, regulariser="curvature")
    if problem.cuts is not None and "settled" in options_of(solver):
        options = {"settled": SETTLED} | options
    told = {**told, "regulariser": problem.regulariser}
    return (yield from solve(noted(problem, **told), solver, **options))


# λ, if it is to be chosen ---------------------------------------------------------------


def _checked_lam(lam: float | str, solver: str) -> bool:
    """Whether λ is to be chosen; a ValueError if it cannot be."""
    if not isinstance(lam, str):
        return False
    if lam != AUTO:
        raise ValueError(f"lam must be a number or {AUTO!r}, got {said(lam)}")
    if solver not in WEIGHING:
        choice = " or ".join(WEIGHING)
        raise ValueError(f"lam='auto' weighs an energy, and solver {solver!r} minimises none: use {choice}")
    return True


def _smaller(frame: Frame, width: int | None, smooth: float | None) -> dict[str, Any]:
    """How a frame is prepared for λ to be chosen; its blur is that of the whole, in its own pixels."""
    full = frame.width if width is None else width
    enough = max(CHOOSING, -(-LEAST_SIDE * frame.width // frame.height))
    small = min(full, enough)
    return {"width": small, "smooth": None if smooth is None else smooth * small / full}


def _chosen_lam(
    small: OneChannel | Colours, contours: bool | None, best: bool
) -> Generator[Iterate, None, LamCurve]:
    """Solve a smaller frame with λ = 1, and choose λ from there."""
    steps = _stages(small, contours, best, None, DEFAULT_SOLVER, {})
    try:
        for step in steps:
            last = replace(step, stage=CHOICE, round=0)
            yield last
    finally:
        steps.close()
    problem = last.problem
    settled = SETTLED if problem.cuts is not None else 0.0
    smooth = problem.origin.smooth
    return (yield from choose_lam(problem, last.log_distance, smooth, settled=settled))


def _weighted(problem: Problem, curve: LamCurve) -> Problem:
    """Give a problem the λ that was chosen."""
    origin = replace(problem.origin, lam_curve=curve)
    return remarked(replace(problem, lam=curve.chosen, origin=origin), curve.told)


def reconstruct(
    frame: Frame,
    calibration: Endoscope,
    *,
    solver: str = DEFAULT_SOLVER,
    xi: str = "1/d",
    regulariser: str = AUTO,
    lam: float | str = 1.0,
    channel: str | None = None,
    width: int | None = None,
    smooth: float | None = None,
    highlights: str | None = None,
    contours: bool | None = None,
    median_distance: float | None = None,
    known_distance: KnownDistance | None = None,
    known_diameter: KnownDiameter | None = None,
    start: Result | None = None,
    observers: Iterable[Observer] = (),
    max_iterations: int | None = None,
    threads: int | None = None,
    **options: Any,
) -> Result:
    """Find the depth map that explains a frame.

    Parameters
    ----------
    frame : Frame
        The picture, as `endolab.read_frame` gives it. If its mask leaves nothing out, the black
        frame around what the endoscope shows is found and left out.
    calibration : Endoscope
        Camera and photometry of the endoscope, for pictures of that size.
    solver : {"gauss_newton", "primal_dual", "fast_marching", "facing"}
        `gauss_newton` minimises the energy, `primal_dual` does so along the paper's path.
        `fast_marching` is one pass to the viscosity solution, `facing` the paper's start d₀: they
        do not use the regulariser; it counts in the energy that is reported.
    xi : {"1/z", "d", "1/d"}
        The map that the regulariser sees.
    regulariser : {"auto", "first", "second", "curvature"}
        Total variation of ξ, of its gradient, or, for ξ = 1/d, of how the surface bends: planes cost nothing
        then, and what a sheet can be rolled into, as a tube, little. `auto` is "curvature", and "second" if
        bounced light was taken out, for another ξ and by `primal_dual`.
    lam : float or "auto"
        λ, the regulariser's weight; larger is smoother. With `auto` the frame is solved 160 px wide first,
        and λ chosen there, such that what the surface leaves unexplained is as rough as what it would leave
        of noise. The whole frame's last solve takes it; the stages before, λ = 1. The
        result's ``problem.origin.lam_curve`` holds what each λ that was tried leaves.
    channel : {"auto", "separated", "red", "green", "blue", "grey"}, optional
        `separated` finds how much of each colour's light came by way of other walls, takes it out, and
        merges the three (`separation`). It uses the wall's albedos of the calibration, if there are
        three, and estimates them otherwise. `auto`, the default with `gauss_newton`, does that with a colour
        picture, and takes a grey one as it is; what was done and why is noted (`assumptions.notes`). The
        other solvers take green, as the paper does, if nothing is said.
    width : int, optional
        Shrink the picture to this many columns first, px.
    smooth : float, optional
        Standard deviation of a Gaussian that averages the light first, px. By default 2 √n,
        n being the noise that the picture shows, in grey levels.
    highlights : {"keep", "ignore", "inpaint"}, optional
        What to do with mirrored light: take it as it is, as no evidence, or fill it in from around.
        By default "ignore" with `auto` and `separated`, and "keep" otherwise.
    contours : bool, optional
        Whether to tear the surface at the occluding contours that are found in the picture. By default
        with `auto` and `separated` if energy and colours speak for it (`separation`), and not otherwise.
    median_distance : float, optional
        Fix the scale so that the median distance is this, mm.
    known_distance : (mm, column, row), optional
        Fix it so that the surface at this pixel of the picture is so far away.
    known_diameter : (mm, (column, row), (column, row)), optional
        Fix it so that the surface points at two pixels are so far apart.
    start : Result, optional
        An earlier result of the same frame, to start from: after a small change of λ, say, the
        next result is a step or two away.
    observers : iterable of callables
        Each is shown every iterate of every stage (`Iterate.stage`), and at last the answer in mm if a
        length is given; one that returns True stops the run.
    max_iterations : int, optional
        The most steps to take.
    threads : int, optional
        The most cores to use, on which no result depends; all by default, or `ENDOLAB_THREADS` of the
        environment.
    **options
        `epsilon`, `threshold` and `cuts` of the energy, see `Problem`; others are the solver's own,
        such as `inflow` of `fast_marching` and `gauss_newton`.

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
    """
    _check(frame, calibration, contours, start)
    choosing = _checked_lam(lam, solver)
    of_problem: dict[str, Any] = {"xi": xi, "regulariser": regulariser, "lam": 1.0 if choosing else lam}
    of_problem |= {name: options.pop(name) for name in ("epsilon", "threshold", "cuts") if name in options}
    checked_solver(solver, options if start is None else options | {"start": start})
    lengths: dict[str, Any] = {"median_distance": median_distance, "known_distance": known_distance}
    lengths["known_diameter"] = known_diameter
    check_scale(**lengths)
    if max_iterations is not None and "max_iterations" in options_of(solver):
        options["max_iterations"], max_iterations = max_iterations, None  # the solver counts itself
    told = {"solver": solver, **of_problem, **lengths}
    told.pop("cuts", None)
    channel = channel_for(channel, solver)
    how: dict[str, Any] = {"width": width, "smooth": smooth, "highlights": highlights}
    contours = _wanted(contours, channel)
    with limited_threads(threads):
        prepared = _prepared(frame, calibration, contours, channel=channel, **how, **of_problem)
        if choosing:
            of_problem.pop("cuts", None)
            how |= _smaller(frame, width, smooth)
            small = _prepared(frame, calibration, contours, channel=channel, **how, **of_problem)

    def scaled(answer: Iterate) -> Iterate:
        if answer.stage != SOLUTION:  # stopped on the way
            whole = noted(_whole(prepared), **told)
            answer = Iterate.of(whole, on_grid(answer, whole))
        return known_scale(answer, **lengths)

    best = regulariser == AUTO

    def all_stages() -> Solver:
        curve = None
        if choosing:
            curve = yield from _chosen_lam(small, contours, best and knows_curvature(solver, xi))
            told.update(lam=curve.chosen, lam_chosen=True)
        return (yield from _stages(prepared, contours, best, start, solver, options, told, curve))

    with limited_threads(threads):
        return run(all_stages(), observers, max_iterations, scaled)
