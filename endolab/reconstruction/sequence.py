"""Frame after frame: each starts from the last, and their scales are linked.

A frame whose gain is unknown has a scale of its own. Between neighbours two things are known:
the gain that an automatic exposure sets changes smoothly, and the surface that both see moves
little and rigidly. `scale_between` weighs the one against the other.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from endolab.frames.frame import Frame
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import FloatArray, freeze
from endolab.numerics.iteration import Status
from endolab.reconstruction.pipeline import reconstruct
from endolab.reconstruction.scale import in_unit
from endolab.reconstruction.settings import LENGTHS, Settings
from endolab.solvers.problem import Problem
from endolab.solvers.provenance import ContourOutcome, Report
from endolab.solvers.result import Iterate, Result
from endolab.solvers.solvers import DEFAULT_SOLVER, options_of

Picture = Frame | FloatArray | ValueError


@dataclass(frozen=True, eq=False)
class State:
    """All that a frame hands to the next: with it a sequence goes on as if it had hardly been left."""

    # Of which `restore` knows only the surface, its unit, and whether it is cut.
    result: Result
    brightness: float  # of the picture, see `_brightness`
    cold_energy: float  # of the last cold start
    frames_since: int

    @classmethod
    def restore(
        cls,
        distance: FloatArray,
        row: Mapping[str, Any],
        frame: Frame,
        calibration: Calibration,
    ) -> Self:
        """Take up a frame's surface, (H, W), nan where unknown, that was kept at its linked scale.

        The row says its gain, unit, energy, and the `min_steepness` of the lines where it was cut, or 0.
        """
        height, width = distance.shape
        min_steepness = row["min_steepness"] or None
        report = Report(contours=ContourOutcome.AS_BEFORE, min_steepness=min_steepness)
        problem = Problem(
            np.zeros(distance.shape),
            np.isfinite(distance),
            calibration.camera.resize(width, height),
            replace(calibration.photometry, gain=row["gain"]),
            metric=row["unit"] == "mm",
            cuts=np.zeros((2, height, width), dtype=bool) if min_steepness else None,
            report=report,
        )
        iterate = Iterate(problem, 0, freeze(np.log(distance, dtype=np.float64)))
        result = Result(iterate, Status.CONVERGED, [], 0.0)
        return cls(
            result, _brightness(frame, calibration.photometry.gamma), row["energy"], 1
        )


@dataclass(frozen=True, eq=False)
class Step:
    """What became of one frame."""

    index: int  # counts the frames given, from 0
    name: str
    result: Result | None  # None if there is an error
    error: str = ""  # one sentence; empty if there is a result
    warm: bool = False  # whether the result was started from the last frame's
    seconds: float = 0.0  # what the frame took, a second try from cold included
    # What the next frame takes up; None if there is an error.
    state: State | None = None


def reconstruct_sequence(
    frames: Iterable[tuple[str, Picture]],
    calibration: Calibration,
    *,
    before: State | None = None,
    **options: Any,
) -> Iterator[Step]:
    """Reconstruct the frames of a video, one after the other.

    A frame starts from the last one's result if the solver can. Its result is kept if the solver
    got on and the energy is at most 1.3 times that of the last cold start; otherwise, and
    every 25 frames, it is begun again and the lower energy wins: an error is not passed on
    for long. Where the gain is unknown, scales are linked by `scale_between`.

    Parameters
    ----------
    frames : iterable of (str, Frame or array or ValueError)
        Names and pictures, as `endolab.open_frames` gives them; what says why for one that cannot be read.
    calibration : Calibration
        For pictures of that size.
    before : State, optional
        `Step.state` of the frame before the first, with which all goes on as if there had hardly been a
        break.
    **options
        See `endolab.reconstruct`. What fixes the scale, such as `median_distance`, is said of the
        first frame and fixes that of all; it is not used with `before`.

    Yields
    ------
    Step
        One for every frame. One that cannot be read or used has an error, and the next goes on
        from the last that could. After a result that was interrupted or stopped nothing follows.

    Raises
    ------
    MemoryError
        If frames of that size need more memory than there is.
    ValueError
        If a known distance or diameter cannot be used: it is said of the first frame alone.
    """
    lengths = {name: options.pop(name, None) for name in LENGTHS}
    Settings(**lengths)  # checks them
    is_of_the_first_alone = lengths["median_distance"] is None and any(lengths.values())
    can_start = "start" in options_of(options.get("solver", DEFAULT_SOLVER))
    state = before
    known = calibration.evidence
    for index, (name, picture) in enumerate(frames):
        started = time.perf_counter()
        step = Step(index, name, None)
        try:
            frame = as_frame(name, picture)
            size = None if state is None else state.result.report.picture_size
            is_alike = size in (None, (frame.width, frame.height))
            start = state if can_start and is_alike else None
            asked = options | (lengths if state is None else {})
            believed = calibration
            if state is not None and state.result.metric:
                # By the usual distance lamps are placed.
                median = float(np.nanmedian(state.result.distance))
                photometric = known.get("photometry", {}) | {"usual_distance": median}
                believed = replace(
                    calibration, evidence=known | {"photometry": photometric}
                )
            found, warm = _solve_next(frame, believed, start, asked)
            result = found.result
            iterate = result.iterate
            if state is not None:
                factor = scale_between(state.result, result)
                if not (result.metric and np.isclose(factor, 1)):
                    metric = state.result.metric
                    iterate = in_unit(iterate, factor, metric, scale="frame before")
        except (ValueError, OSError) as error:
            message = str(error) if name in str(error) else f"{name}: {error}"
            if state is None and is_of_the_first_alone:
                raise ValueError(message) from error  # another frame shows other places
            step = replace(step, error=message)
        else:
            state = replace(found, result=replace(result, iterate=iterate))
            step = replace(step, result=state.result, warm=warm, state=state)
        yield replace(step, seconds=time.perf_counter() - started)
        if step.result is not None and step.result.status is Status.STOPPED:
            return


def _solve_next(
    frame: Frame,
    calibration: Calibration,
    before: State | None,
    options: dict[str, Any],
) -> tuple[State, bool]:
    """Solve a frame from what the last one handed on, or anew; and say whether the former is the answer."""
    brightness = _brightness(frame, calibration.photometry.gamma)
    warm = None
    if before is not None:
        start = before.result
        if calibration.photometry.gain is None:
            # `reconstruct` takes a brighter picture of unknown gain for one of the same surface with more
            # gain, in a unit that is smaller; but the unit is tied to the picture's brightness, so that the
            # surface stays what it was.
            moved = start.iterate.log_distance - 0.5 * np.log(
                brightness / before.brightness
            )
            start = replace(start, iterate=replace(start.iterate, log_distance=moved))
        warm = reconstruct(frame, calibration, start=start, **options)
        is_good = (
            warm.status.is_done
            and warm.energy <= 1.3 * before.cold_energy
            and before.frames_since < 25
        )
        if is_good or warm.status is Status.STOPPED:
            return State(
                warm, brightness, before.cold_energy, before.frames_since + 1
            ), True
    cold = reconstruct(frame, calibration, **options)
    if warm is not None and warm.energy < cold.energy:
        return State(warm, brightness, cold.energy, 1), True
    return State(cold, brightness, cold.energy, 1), False


def as_frame(name: str, picture: Picture) -> Frame:
    """Make a frame of a picture that has no mask; raise what it is instead, if it could not be read."""
    if isinstance(picture, ValueError):
        raise picture
    if isinstance(picture, Frame):
        return picture
    return Frame(picture, np.ones(np.shape(picture)[:2], dtype=bool), name)


def _brightness(frame: Frame, gamma: float) -> float:
    """Brightness of a picture: the median of its lit pixels, as light."""
    image = frame.image[frame.mask]
    lit = image[image > 0]
    return float(np.median(lit)) ** gamma if lit.size else 1.0


def scale_between(before: Result, result: Result) -> float:
    """What a frame's distances must be multiplied by to be in the unit of the frame before.

    The unknowns are the log of that factor c, and the camera's motion T, ω between the two frames.
    Along a ray u that meets the old surface at D u with normal n, a rigid motion changes the distance
    by (n·T/D + ω·(u × n))/(-n·u) parts of it (range flow: Horn and Harris, Rigid body motion from
    range image sequences, 1991), so that every pixel says

        log D - log d = c + (n·T/D + ω·(u × n))/(n·u) + error.

    Prior beliefs are that log gain makes a random walk of 0.1 a frame, and that T, in
    median distances, and ω, in rad, are of the order 0.05. The maximum a posteriori is
    found by reweighting (Cauchy), because at folds the motion is none of the linear kind; the
    pixels' errors are alike, so that all count as a hundred. Coming straight at a flat wall
    and turning up the gain look the same: then the priors divide the change between them. Where the gain is
    known, it alone tells.
    """
    gains = [seen.problem.photometry.gain or 1.0 for seen in (before, result)]
    by_gain = float(np.sqrt(gains[0] / gains[1]))
    if result.metric or before.mask.shape != result.mask.shape:
        return by_gain
    step = max(
        1, int(np.sqrt(result.mask.size / 8000))
    )  # whose link is all pixels' within 1e-4
    maps = (
        before.distance,
        result.distance,
        before.iterate.normals,
        result.problem.field.rays,
    )
    old, new, n, u = (one[::step, ::step] for one in maps)
    facing = np.vecdot(n, u)
    with np.errstate(invalid="ignore"):
        # A surface that turns away more says little of its place.
        good = (old > 0) & (new > 0) & (facing < -0.25)
    independent = 100.0
    if good.sum() < independent:
        return by_gain
    old = old[good]
    n = n[good]
    facing = facing[good, None]
    y = np.log(old / new[good])
    by_motion = n * (np.median(old) / old)[:, None] / facing
    by_turn = np.cross(u[good], n) / facing
    a = np.concatenate([np.ones_like(facing), by_motion, by_turn], axis=-1)
    prior = np.array([np.log(by_gain), *[0.0] * 6])
    prior_weight = np.array([2 / 0.1, *[1 / 0.05] * 6]) ** 2
    x = np.array([np.median(y), *[0.0] * 6])
    for _ in range(20):
        residual = y - a @ x
        spread = max(1.4826 * float(np.median(np.abs(residual))), 1e-4)
        weight = 1 / (1 + (residual / (2 * spread)) ** 2) / spread**2
        weight *= min(1.0, independent / len(y))
        information = (weight * a.T) @ a + np.diag(prior_weight)
        x = np.linalg.solve(information, a.T @ (weight * y) + prior_weight * prior)
    return float(np.exp(x[0]))
