"""Frame and calibration in, surface out: the one call most people need."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from endolab.depth.energy import Problem
from endolab.depth.fast_marching import fast_marching
from endolab.depth.gauss_newton import gauss_newton
from endolab.depth.initial import facing
from endolab.iteration import Observer, Result, Solver, run
from endolab.preprocess import Frame, field_of_view, noise_level, smooth_light, usable

if TYPE_CHECKING:
    from endolab.endoscope import Calibration

SOLVERS: dict[str, Callable[..., Solver]] = {
    "facing": facing,
    "fast_marching": fast_marching,
    "gauss_newton": gauss_newton,
}
DEFAULT_SOLVER = "gauss_newton"


def _checked_solver(name: str) -> Callable[..., Solver]:
    if name not in SOLVERS:
        raise ValueError(f"unknown solver {name!r}; choose {', '.join(SOLVERS)}")
    return SOLVERS[name]


def pose(
    frame: Frame,
    calibration: Calibration,
    *,
    channel: str | None = None,
    width: int | None = None,
    smooth: float | None = None,
    xi: str = "1/d",
    regulariser: str = "second",
    lam: float = 1.0,
    epsilon: float = 1e-3,
    threshold: float = 0.05,
) -> Problem:
    """Turn a frame and a calibration into the problem that solvers take.

    See `reconstruct` for the parameters. With an unknown gain, one is chosen that makes the
    median of d₀ one unit.
    """
    camera, photometry = calibration.camera, calibration.photometry
    if (frame.width, frame.height) != (camera.width, camera.height):
        raise ValueError(
            f"{frame.name} is {frame.width}x{frame.height} px, "
            f"but the calibration is for {camera.width}x{camera.height} px"
        )
    if width is not None and width != frame.width:
        height = max(1, round(frame.height * width / frame.width))
        frame, camera = frame.resize(width, height, photometry.gamma), camera.resize(width, height)
    name, image = frame.channel(channel)
    one = photometry.simplified().channel(name)
    seen = frame.mask & camera.field.valid
    if frame.mask.all():
        seen &= field_of_view(image)
    if smooth is None:
        # The march follows the darkest of noisy neighbours. 2 px for one grey level of noise
        # loses nothing on the simple scenes that noise has not taken already.
        smooth = 2 * float(np.sqrt(255 * noise_level(image, seen)))
    elif not (np.isfinite(smooth) and smooth >= 0):
        raise ValueError(f"smooth must be finite and at least 0 (px), got {smooth}")
    elif smooth > frame.width:
        raise ValueError(f"smooth must not exceed the frame's width of {frame.width} px, got {smooth}")
    image = smooth_light(image, seen, photometry.gamma, smooth)
    mask = usable(image, seen, camera.field.cos_alpha, frame.name)
    problem = Problem(
        image=image,
        mask=mask,
        camera=camera,
        photometry=one if one.gain is not None else replace(one, gain=1.0),
        xi=xi,
        regulariser=regulariser,
        lam=lam,
        epsilon=epsilon,
        threshold=threshold,
        metric=one.gain is not None,
        picture=frame.image,
        settings={
            "frame": frame.name,
            "channel": name,
            "width": camera.width,
            "height": camera.height,
            "smooth": smooth,
        },
    )
    if problem.metric:
        return problem
    return _rescaled(problem, problem.log_facing, 1.0)


def _rescaled(problem: Problem, log_distance: np.ndarray, median: float) -> Problem:
    """Return the problem with the gain that would give this solution the median wanted."""
    factor = median / float(np.median(np.exp(log_distance[problem.mask])))
    gain = problem.photometry.gain
    assert gain is not None  # a problem's gain is always chosen
    return replace(problem, photometry=replace(problem.photometry, gain=gain * factor**2))


def solve(problem: Problem, solver: str = DEFAULT_SOLVER, **options: Any) -> Solver:
    """Iterates of one solver on a problem; the options are the solver's own."""
    return _checked_solver(solver)(problem, **options)


def iterate(
    frame: Frame, calibration: Calibration, *, solver: str = DEFAULT_SOLVER, **options: Any
) -> Solver:
    """Iterates of a solver on a frame: ``for step in iterate(frame, calibration): ...``.

    Takes the keywords of `pose`; others are the solver's own.
    """
    posing = {key: options.pop(key) for key in list(options) if key in (pose.__kwdefaults__ or {})}
    return solve(pose(frame, calibration, **posing), solver, **options)


def reconstruct(
    frame: Frame,
    calibration: Calibration,
    *,
    solver: str = DEFAULT_SOLVER,
    xi: str = "1/d",
    regulariser: str = "second",
    lam: float = 1.0,
    channel: str | None = None,
    width: int | None = None,
    smooth: float | None = None,
    median_distance: float | None = None,
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
    calibration : Calibration
        Camera and photometry of the endoscope, for pictures of that size.
    solver : {"fast_marching", "facing"}
        `fast_marching` is one pass to the viscosity solution, `facing` the paper's start d₀.
        Neither uses the regulariser; it counts in the energy that is reported.
    xi : {"1/z", "d", "1/d"}
        The map that the regulariser sees.
    regulariser : {"first", "second"}
        Total variation of ξ or of its gradient.
    lam : float
        λ, the regulariser's weight; larger is smoother.
    channel : {"red", "green", "blue", "grey"}, optional
        Of a colour picture; green by default.
    width : int, optional
        Shrink the picture to this many columns first, px.
    smooth : float, optional
        Standard deviation of a Gaussian that averages the light first, px. By default 2 √n,
        n being the noise that the picture shows, in grey levels.
    median_distance : float, optional
        Fix the scale so that the median distance is this, mm.
    observers : iterable of callables
        Each is shown every iterate; one that returns True stops the run.
    max_iterations : int, optional
        The most steps to take.
    **options
        `epsilon` and `threshold` of the energy, see `Problem`; others are the solver's own, such as
        `snapshots` and `inflow` of `fast_marching`.

    Returns
    -------
    Result
        Distances in mm, or in relative units (`metric` is False) if the gain is unknown and no
        median distance is given.

    Raises
    ------
    ValueError
        In one sentence, if frame, calibration or an option cannot be used.
    """
    make = _checked_solver(solver)
    if median_distance is not None and not (np.isfinite(median_distance) and median_distance > 0):
        raise ValueError(f"median_distance must be positive and finite (mm), got {median_distance}")
    posing = {key: options.pop(key) for key in ("epsilon", "threshold") if key in options}
    problem = pose(
        frame,
        calibration,
        channel=channel,
        width=width,
        smooth=smooth,
        xi=xi,
        regulariser=regulariser,
        lam=lam,
        **posing,
    )
    if median_distance is not None:
        # Distances scale with √gain and nothing else changes: solve once to learn the factor.
        pilot = run(make(problem, **options), max_iterations=max_iterations)
        problem = replace(_rescaled(problem, pilot.iterate.log_distance, median_distance), metric=True)
    settings: dict[str, object] = {"solver": solver, "xi": xi, "regulariser": regulariser, "lam": lam}
    settings |= posing | {"median_distance": median_distance}
    problem = replace(problem, settings=problem.settings | settings)
    return run(make(problem, **options), observers, max_iterations)
