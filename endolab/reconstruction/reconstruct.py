"""The one call most people need: a frame and an endoscope in, a surface out."""

from collections.abc import Iterable
from typing import Any

from endolab.frames.frame import Frame
from endolab.model.endoscope import Calibration
from endolab.numerics.checks import check_kinds
from endolab.numerics.threads import limit_threads
from endolab.reconstruction.light.colours import known_albedo
from endolab.reconstruction.pipeline import prepare, solve_in_stages, to_scale
from endolab.reconstruction.settings import Settings, takes_settings
from endolab.solvers.result import Observer, Result, Solver, run


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
        settings = Settings.of(options)
        channels = prepare(frame, calibration, settings, start)
        stages = solve_in_stages(channels, known_albedo(calibration), settings, start)
        return run(
            stages, observers, last=lambda answer: to_scale(answer, channels, settings)
        )


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
    channels = prepare(frame, calibration, settings, start)
    return solve_in_stages(channels, known_albedo(calibration), settings, start)
