"""Frame and calibration in, surface out: the one call most people need."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from endolab.depth.result import Observer, Result, Solver, run
from endolab.depth.solvers import DEFAULT_SOLVER, checked_solver, options_of, solve
from endolab.preprocessing.frame import Frame
from endolab.reconstruction.problem_setup import enlarged, pose, posed, started
from endolab.reconstruction.scale import KnownDiameter, KnownDistance, check_scale, with_known_length

if TYPE_CHECKING:
    from endolab.model.endoscope import Endoscope


def iterate(frame: Frame, calibration: Endoscope, *, solver: str = DEFAULT_SOLVER, **options: Any) -> Solver:
    """Iterates of a solver on a frame: ``for step in iterate(frame, calibration): ...``.

    Takes the keywords of `pose`; others are the solver's own.
    """
    posing = {key: options.pop(key) for key in list(options) if key in (pose.__kwdefaults__ or {})}
    checked_solver(solver, options)
    problem, start = posed(frame, calibration, **posing)
    if start is not None and "start" in options_of(solver):
        options.setdefault("start", start)
    return solve(problem, solver, **options)


def reconstruct(
    frame: Frame,
    calibration: Endoscope,
    *,
    solver: str = DEFAULT_SOLVER,
    xi: str = "1/d",
    regulariser: str = "second",
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
    regulariser : {"first", "second"}
        Total variation of ξ or of its gradient.
    lam : float
        λ, the regulariser's weight; larger is smoother.
    channel : {"red", "green", "blue", "grey", "separated"}, optional
        Of a colour picture; green by default. `separated` finds how much of each colour's light came
        by way of other walls, takes it out, and merges the three (`separation`). It uses the
        wall's albedos of the calibration, if there are three, and estimates them otherwise.
    width : int, optional
        Shrink the picture to this many columns first, px.
    smooth : float, optional
        Standard deviation of a Gaussian that averages the light first, px. By default 2 √n,
        n being the noise that the picture shows, in grey levels.
    highlights : {"keep", "ignore", "inpaint"}, optional
        What to do with mirrored light: take it as it is, as no evidence, or fill it in from around.
        By default "ignore" with `separated` and "keep" otherwise.
    contours : bool, optional
        Whether to tear the surface at the occluding contours that are found in the picture. By
        default not, but with `separated` if the surface explains the picture much better then.
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
        Each is shown every iterate; one that returns True stops the run.
    max_iterations : int, optional
        The most steps to take.
    **options
        `epsilon` and `threshold` of the energy and `cuts`, see `Problem`; others are the solver's
        own, such as `inflow` of `fast_marching` and `gauss_newton`.

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
    posing: dict[str, Any] = {"xi": xi, "regulariser": regulariser, "lam": lam}
    posing |= {key: options.pop(key) for key in ("epsilon", "threshold", "cuts") if key in options}
    make = checked_solver(solver, options if start is None else options | {"start": start})
    check_scale(median_distance, known_distance, known_diameter)
    problem, found = posed(
        frame,
        calibration,
        channel=channel,
        width=width,
        smooth=smooth,
        highlights=highlights,
        contours=contours,
        before=start,
        **posing,
    )
    if max_iterations is not None and "max_iterations" in options_of(solver):
        options["max_iterations"], max_iterations = max_iterations, None  # the solver counts itself
    if start is not None and found is None:
        found = started(problem, start)
    if found is not None and "start" in options_of(solver):
        options["start"] = found
    settings: dict[str, object] = {"solver": solver} | posing
    settings.pop("cuts", None)
    lengths = {"median_distance": median_distance, "known_distance": known_distance}
    settings |= lengths | {"known_diameter": known_diameter}
    problem = replace(problem, settings=problem.settings | settings)
    if not all(length is None for length in (*lengths.values(), known_diameter)):
        # Distances scale with √gain and nothing else changes: solve once to learn the factor.
        pilot = run(make(problem, **options), max_iterations=max_iterations)
        if median_distance is not None:
            factor = median_distance / float(np.median(pilot.distance[pilot.mask]))
        else:
            whole = with_known_length(pilot, known_distance, known_diameter)
            factor = float(np.median(whole.distance[pilot.mask] / pilot.distance[pilot.mask]))
            problem = replace(problem, settings=whole.problem.settings)
        problem = enlarged(problem, factor)
        if "start" in options:
            options["start"] = options["start"] + np.log(factor)
    return run(make(problem, **options), observers, max_iterations)
