"""Frame and calibration in, surface out: the one call most people need.

Stages, each of which hands the next one plain value:

1. *prepared*: the frame becomes a `Problem`, or `Colours` (`problem_setup`);
2. *bounced light and contours found*: `Colours` become a `Problem` of direct light and a start
   (`separation`), the surface of one channel is torn (`contours`);
3. *solved*: the solver's iterates, the last or the best of which is the answer;
4. *scaled*: the same surface in mm, if a length is known (`scale`).

All that is solved on the way is yielded, so that observers see it.
"""

from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from endolab.depth.result import SOLUTION, Iterate, Observer, Result, Solver, carrying, run
from endolab.depth.solvers import DEFAULT_SOLVER, checked_solver, knows_curvature, options_of, solve
from endolab.model.endoscope import Endoscope
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import excerpt
from endolab.numerics.iteration import Status
from endolab.numerics.threads import limited_threads
from endolab.preprocessing.frame import Frame
from endolab.reconstruction.contours import OneChannel, choose_bar
from endolab.reconstruction.problem_setup import AUTO, SEPARATED, PosedProblem, Preparation, on_grid
from endolab.reconstruction.scale import KnownDiameter, KnownDistance, check_scale, known_scale
from endolab.reconstruction.separation import Colours, direct_light

PREPARING = tuple(choice.name for choice in fields(Preparation))
TOLD = ("xi", "regulariser", "lam", "epsilon", "threshold")  # of a result's settings
SETTLED = 5e-3  # of distances: a torn surface hangs together by little, and creeps long after that
GREY = (
    "The picture is grey, so that light which came by way of other walls cannot be told from the lamp's: "
    "it was left in."
)


def iterate(frame: Frame, calibration: Endoscope, *, solver: str = DEFAULT_SOLVER, **options: Any) -> Solver:
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
    return _begun(frame, calibration, solver, options)[1]


def _begun(
    frame: Frame,
    calibration: Endoscope,
    solver: str,
    options: dict[str, Any],
    settings: Mapping[str, object] = MappingProxyType({}),
) -> tuple[PosedProblem, Solver]:
    """Return the problem of the frame's own pixels, and the iterates of all stages.

    `settings` is added to those of the problem whose answer counts.
    """
    choices = {name: options[name] for name in PREPARING if name in options}
    start, contours = options.get("start"), options.get("contours")
    own = {name: value for name, value in options.items() if name not in (*PREPARING, "start", "contours")}
    for name, value, kind, expected in (
        ("frame", frame, Frame, "a Frame"),
        ("calibration", calibration, Endoscope, "an Endoscope"),
        ("start", start, Result | np.ndarray | None, "an earlier Result"),
        ("contours", contours, bool | np.bool_ | None, "True, False or None"),
    ):
        if not isinstance(value, kind):
            raise ValueError(f"{name} must be {expected}, got {excerpt(value)}")
    checked_solver(solver, own if start is None else own | {"start": start})
    if choices.get("channel") is None and solver == DEFAULT_SOLVER:  # the paper's take the paper's, green
        choices["channel"] = AUTO
    if contours is None and choices.get("channel") not in (AUTO, SEPARATED):
        contours = False
    choose_order = choices.get("regulariser", AUTO) == AUTO
    if choose_order:
        choices["regulariser"] = "second"
    prepared = _prepared(frame, calibration, Preparation(**choices), contours is not False)
    whole = prepared.fine[1] if isinstance(prepared, Colours) else prepared.fine
    shape = whole.problem.mask.shape
    if isinstance(start, Result) and start.mask.shape != shape:
        raise ValueError(f"start has shape {start.mask.shape}, the frame {shape}")
    return whole, _stages(prepared, contours, choose_order, start, solver, own, settings)


def _prepared(
    frame: Frame, calibration: Endoscope, preparation: Preparation, search: bool
) -> OneChannel | Colours:
    if preparation.channel == SEPARATED or (preparation.channel == AUTO and frame.image.ndim == 3):
        return Colours.of(frame, calibration, preparation)
    if preparation.channel != AUTO:
        return OneChannel.of(frame, calibration, preparation, search)
    grey = replace(preparation, channel=None, highlights=preparation.highlights or "ignore")
    prepared = OneChannel.of(frame, calibration, grey, search)
    return replace(prepared, fine=prepared.fine.remarked(GREY))


def _stages(
    prepared: OneChannel | Colours,
    contours: bool | None,
    choose_order: bool,
    start: Result | FloatArray | None,
    solver: str,
    options: dict[str, Any],
    settings: Mapping[str, object],
) -> Solver:
    """All that is solved; at last with the best order if `choose_order`, else with that of what was prepared.

    On walls whose light bounced, which have a texture as well, curvature is no better than the second order,
    and it is slower.
    """
    before, begin = (start, None) if isinstance(start, Result) else (None, start)
    if isinstance(prepared, Colours):
        posed, around = yield from direct_light(prepared, contours, before)
    else:
        posed, around = yield from choose_bar(prepared, contours, before)
    problem = posed.problem
    if begin is None:
        begin = around if around is not None or before is None else on_grid(before.iterate, problem)
    if begin is not None and "start" in options_of(solver):
        options = options | {"start": begin}
    if choose_order and posed.provenance.albedo is None and knows_curvature(solver, problem.xi):
        problem = replace(problem, regulariser="curvature")
    if before is not None and before.status is Status.CONVERGED and "converged_at" in options_of(solver):
        options = {"converged_at": before.energy} | options
    if problem.discontinuities is not None and "settled" in options_of(solver):
        options = {"settled": SETTLED} | options
    posed = posed.noted(**{**settings, "regulariser": problem.regulariser})
    return (yield from carrying(solve(problem, solver, **options), posed.provenance))


def reconstruct(
    frame: Frame,
    calibration: Endoscope,
    *,
    solver: str = DEFAULT_SOLVER,
    xi: str = "1/d",
    regulariser: str = AUTO,
    lam: float = 1.0,
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
        then, and tubes little. `auto` is "curvature"; it is "second" if indirect light was removed, for
        another ξ, and by `primal_dual`.
    lam : float
        λ, the regulariser's weight; larger is smoother.
    channel : {"auto", "separated", "red", "green", "blue", "grey"}, optional
        `separated` finds how much of each colour's light came by way of other walls, removes it, and merges
        the three (`separation`). It uses the calibration's albedos if there are three, and estimates them
        otherwise. `auto`, the default with `gauss_newton`, does that with a colour picture, and takes a grey
        one as it is; the notes say what was done and why (`assumptions.notes`). By default the other solvers
        take green, as the paper does.
    width : int, optional
        Shrink the picture to this many columns first, px.
    smooth : float, optional
        Standard deviation of a Gaussian that averages the light first, px. By default 2 √n,
        n being the noise that the picture shows, in grey levels.
    highlights : {"keep", "ignore", "inpaint"}, optional
        Take mirrored light as it is, as no evidence, or fill the picture in from around it.
        By default "ignore" with `auto` and `separated`, and "keep" otherwise.
    contours : bool, optional
        Whether to tear the surface at occluding contours that are found in the picture. By default `auto` and
        `separated` do where colours or energy speak for it (`separation`), and single channels do not.
    median_distance : float, optional
        Fix the scale so that the median distance is this, mm.
    known_distance : (mm, column, row), optional
        Fix it so that the surface at this pixel of the picture is so far away.
    known_diameter : (mm, (column, row), (column, row)), optional
        Fix it so that the surface points at two pixels are so far apart.
    start : Result, optional
        An earlier result to start from. If it is of the same frame and endoscope, what was found of bounced
        light and contours stays: with another λ, say, the next result is a step or two away.
    observers : iterable of callables
        Each is shown every iterate of every stage (`Iterate.stage`), and at last the answer in mm if a
        length is given; one that returns True stops the run.
    max_iterations : int, optional
        The most steps to take.
    threads : int, optional
        The most cores to use, on which no result depends; all by default, or `ENDOLAB_THREADS` of the
        environment.
    **options
        `epsilon`, `threshold` and `discontinuities` of the energy, see `Problem`; others are the solver's,
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

    Examples
    --------
    >>> import endolab as el
    >>> sample = el.load_traced("matt")  # a frame that comes with endolab
    >>> result = el.reconstruct(sample.frame, sample.calibration, width=96)
    >>> result.status.name, result.metric, result.distance.shape
    ('CONVERGED', True, (72, 96))
    """
    lengths: dict[str, Any] = {"median_distance": median_distance, "known_distance": known_distance}
    lengths["known_diameter"] = known_diameter
    check_scale(**lengths)
    if max_iterations is not None and "max_iterations" in options_of(solver):
        options["max_iterations"], max_iterations = max_iterations, None  # the solver counts itself
    options |= {"xi": xi, "regulariser": regulariser, "lam": lam, "channel": channel, "width": width}
    options |= {"smooth": smooth, "highlights": highlights, "contours": contours, "start": start}
    settings = {name: options[name] for name in TOLD if name in options}
    settings = {"solver": solver, **settings, **lengths}
    with limited_threads(threads):
        whole, steps = _begun(frame, calibration, solver, options, settings)

        def scaled(answer: Iterate) -> Iterate:
            if answer.stage != SOLUTION:  # stopped on the way
                provenance = whole.noted(**settings).provenance
                answer = Iterate.of(whole.problem, on_grid(answer, whole.problem), provenance=provenance)
            return known_scale(answer, **lengths)

        return run(steps, observers, max_iterations, scaled)
