"""Frame and calibration in, surface out: the one call most people need."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import psutil

from endolab.depth.energy import Problem
from endolab.depth.fast_marching import fast_marching
from endolab.depth.gauss_newton import gauss_newton
from endolab.depth.initial import facing
from endolab.depth.primal_dual import primal_dual
from endolab.iteration import Observer, Result, Solver, run
from endolab.operators import BoolArray, FloatArray
from endolab.preprocess import Frame, field_of_view, noise_level, smooth_light, usable

if TYPE_CHECKING:
    from endolab.endoscope import Calibration

SOLVERS: dict[str, Callable[..., Solver]] = {
    "facing": facing,
    "fast_marching": fast_marching,
    "gauss_newton": gauss_newton,
    "primal_dual": primal_dual,
}
DEFAULT_SOLVER = "gauss_newton"
BYTES_PER_PIXEL = 900  # at the peak of the solver that needs most, the frame's own arrays included


def _checked_solver(name: str, options: Mapping[str, Any]) -> Callable[..., Solver]:
    """Return the solver of that name, if there is one and it has these options."""
    if name not in SOLVERS:
        raise ValueError(f"unknown solver {name!r}; choose {', '.join(SOLVERS)}")
    known = _options_of(name)
    for option in options:
        if option not in known:
            choice = f"it takes {', '.join(known)}" if known else "it takes none"
            raise ValueError(f"solver {name!r} has no option {option!r}; {choice}")
    return SOLVERS[name]


def _options_of(solver: str) -> list[str]:
    return list(inspect.signature(SOLVERS[solver]).parameters)[1:]


def _check_memory(width: int, height: int) -> None:
    needed, free = width * height * BYTES_PER_PIXEL, psutil.virtual_memory().available
    if needed > free:
        raise MemoryError(
            f"a frame of {width}x{height} px needs about {needed / 1e9:.1f} GB of memory, "
            f"{free / 1e9:.1f} GB are free; make it smaller with width="
        )


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
    cuts: BoolArray | None = None,
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
    _check_memory(frame.width, frame.height)
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
        cuts=cuts,
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
    return _checked_solver(solver, options)(problem, **options)


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
    calibration : Calibration
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
    channel : {"red", "green", "blue", "grey"}, optional
        Of a colour picture; green by default.
    width : int, optional
        Shrink the picture to this many columns first, px.
    smooth : float, optional
        Standard deviation of a Gaussian that averages the light first, px. By default 2 √n,
        n being the noise that the picture shows, in grey levels.
    median_distance : float, optional
        Fix the scale so that the median distance is this, mm.
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
        median distance is given.

    Raises
    ------
    ValueError
        In one sentence, if frame, calibration or an option cannot be used.
    MemoryError
        If the problem is too large for this machine, before anything is computed.
    """
    posing = {key: options.pop(key) for key in ("epsilon", "threshold", "cuts") if key in options}
    make = _checked_solver(solver, options if start is None else options | {"start": start})
    if median_distance is not None and not (np.isfinite(median_distance) and median_distance > 0):
        raise ValueError(f"median_distance must be positive and finite (mm), got {median_distance}")
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
    if max_iterations is not None and "max_iterations" in _options_of(solver):
        options["max_iterations"], max_iterations = max_iterations, None  # the solver counts itself
    if start is not None:
        options["start"] = _started(problem, start)
    if median_distance is not None:
        # Distances scale with √gain and nothing else changes: solve once to learn the factor.
        pilot = run(make(problem, **options), max_iterations=max_iterations)
        problem = replace(_rescaled(problem, pilot.iterate.log_distance, median_distance), metric=True)
        if start is not None:
            options["start"] = _started(problem, start)
    settings: dict[str, object] = {"solver": solver, "xi": xi, "regulariser": regulariser, "lam": lam}
    settings |= {key: value for key, value in posing.items() if key != "cuts"}
    settings["median_distance"] = median_distance
    problem = replace(problem, settings=problem.settings | settings)
    return run(make(problem, **options), observers, max_iterations)


def _started(problem: Problem, start: Result) -> FloatArray:
    """Log-distance of an earlier result, at the scale that this problem's gain gives it."""
    gains = [one.photometry.gain or 1.0 for one in (problem, start.problem)]
    if start.mask.shape != problem.mask.shape:
        raise ValueError(f"start has shape {start.mask.shape}, the frame {problem.mask.shape}")
    v = np.where(start.mask, start.iterate.log_distance, np.nan) + 0.5 * np.log(gains[0] / gains[1])
    return np.where(np.isnan(v), problem.log_facing, v)  # where only the new mask reaches
