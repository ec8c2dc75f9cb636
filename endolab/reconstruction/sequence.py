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
from endolab.model.surface import normals
from endolab.numerics.arrays import FloatArray, freeze
from endolab.numerics.iteration import Status
from endolab.reconstruction.reconstruct import reconstruct
from endolab.reconstruction.scale import check_scale, in_unit, scale_by_length
from endolab.reconstruction.settings import LENGTHS
from endolab.solvers.problem import Problem
from endolab.solvers.provenance import ContourOutcome, ContourReport, Provenance, Scale
from endolab.solvers.result import Iterate, Result
from endolab.solvers.solvers import DEFAULT_SOLVER, options_of


@dataclass(frozen=True)
class Linking:
    """How much neighbouring frames are believed to share."""

    # Times the energy of the last cold start: then a warm start is not trusted.
    worse: float = 1.3
    refresh: int = 25  # frames after which a cold start is tried anyway
    # Standard deviation of the change of log gain from frame to frame.
    gain_step: float = 0.1
    motion_step: float = 0.05  # of the camera's motion: median distances, and rad
    samples: int = 8000  # pixels that are compared; their link is that of all within 1e-4
    independent: float = 100.0  # as many of them tell their own story
    rounds: int = 20  # of reweighting
    settled: float = 1e-5  # change of the unknowns after which there is no other round
    # Cosine between ray and normal below which a surface says little of its place.
    grazing: float = 0.25


LINKING = Linking()


@dataclass(frozen=True)
class Carried:
    """All that a frame hands to the next: with it a sequence goes on as if it had hardly been left."""

    result: (
        Result  # of which `take_up` knows only the surface, its unit, and whether it is cut
    )
    light: float  # how bright the picture was, see `_light`
    least: float  # energy of the last cold start
    age: int  # frames since

    @classmethod
    def take_up(
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
        problem = Problem(
            np.zeros(distance.shape),
            np.isfinite(distance),
            calibration.camera.resize(width, height),
            replace(calibration.photometry, gain=row["gain"]),
            metric=row["unit"] == "mm",
            cuts=np.zeros((2, height, width), dtype=bool) if min_steepness else None,
        )
        contours = ContourReport(ContourOutcome.AS_BEFORE, min_steepness=min_steepness)
        provenance = Provenance(contours=contours)
        v = freeze(np.log(distance, dtype=np.float64))
        iterate = Iterate(problem, 0, v, {}, provenance=provenance)
        result = Result(iterate, Status.CONVERGED, [], 0.0)
        return cls(result, _light(frame, calibration.photometry.gamma), row["energy"], 1)


@dataclass(frozen=True)
class Step:
    """What became of one frame."""

    index: int  # counts the frames given, from 0
    name: str
    result: Result | None  # None if there is an error
    error: str = ""  # one sentence; empty if there is a result
    warm: bool = False  # whether the result was started from the last frame's
    seconds: float = 0.0  # what the frame took, a second try from cold included
    # What the next frame takes up; None if there is an error.
    carried: Carried | None = None


def reconstruct_sequence(
    frames: Iterable[tuple[str, Frame | FloatArray | None]],
    calibration: Calibration,
    *,
    before: Carried | None = None,
    **options: Any,
) -> Iterator[Step]:
    """Reconstruct the frames of a video, one after the other.

    A frame starts from the last one's result if the solver can. Its result is kept if the solver
    got on and the energy is at most `LINKING.worse` times that of the last cold start; otherwise, and
    every `LINKING.refresh` frames, it is begun again and the lower energy wins: an error is not passed on
    for long. Where the gain is unknown, scales are linked by `scale_between`.

    Parameters
    ----------
    frames : iterable of (str, Frame or array or None)
        Names and pictures, as `endolab.open_frames` gives them; None for a broken one.
    calibration : Calibration
        For pictures of that size.
    before : Carried, optional
        `Step.carried` of the frame before the first, with which all goes on as if there had hardly been a
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
    lengths = {name: options.pop(name, None) for name in LENGTHS[1:]}
    check_scale(median_distance=options.get("median_distance"), **lengths)
    can_start = "start" in options_of(options.get("solver", DEFAULT_SOLVER))
    carried = before
    for index, (name, picture) in enumerate(frames):
        started = time.perf_counter()
        if carried is not None:
            options.pop("median_distance", None)
        try:
            frame = as_frame(name, picture)
            start = carried if can_start else None
            found, warm = _solve_next(frame, calibration, start, options)
            result = found.result
            if carried is None:
                result = replace(result, iterate=scale_by_length(result.iterate, **lengths))
            else:
                result = _link(carried.result, result)
        except (ValueError, OSError) as error:
            message = str(error)
            if name not in message:
                message = f"{name}: {message}"
            if carried is None and any(length is not None for length in lengths.values()):
                raise ValueError(message) from error  # another frame shows other places
            seconds = time.perf_counter() - started
            yield Step(index, name, None, message, seconds=seconds)
            continue
        carried = replace(found, result=result)
        seconds = time.perf_counter() - started
        yield Step(
            index,
            name,
            result,
            warm=warm,
            seconds=seconds,
            carried=carried,
        )
        if result.status is Status.STOPPED:
            return


def _solve_next(
    frame: Frame,
    calibration: Calibration,
    before: Carried | None,
    options: dict[str, Any],
) -> tuple[Carried, bool]:
    """Solve a frame from what the last one handed on, or anew; and say whether the former is the answer."""
    photometry = calibration.photometry
    light = _light(frame, photometry.gamma)
    warm = None
    if before is not None:
        start = before.result
        if photometry.gain is None:
            start = _as_bright(start, light / before.light)
        warm = reconstruct(frame, calibration, start=start, **options)
        is_good = (
            warm.status.is_done
            and warm.energy <= LINKING.worse * before.least
            and before.age < LINKING.refresh
        )
        if is_good or warm.status is Status.STOPPED:
            return Carried(warm, light, before.least, before.age + 1), True
    cold = reconstruct(frame, calibration, **options)
    if warm is not None and warm.energy < cold.energy:
        return Carried(warm, light, cold.energy, 1), True
    return Carried(cold, light, cold.energy, 1), False


def _link(before: Result, result: Result) -> Result:
    """Give a result the scale of the frame before."""
    scale: Scale | None = Scale("frame before")
    factor = scale_between(before, result)
    if result.metric:
        factor = _by_gain(before, result)
        scale = None if np.isclose(factor, 1) else scale
    iterate = in_unit(result.iterate, factor, before.metric, scale)
    return replace(result, iterate=iterate)


def _by_gain(before: Result, result: Result) -> float:
    """What a frame's distances must be multiplied by if the light did not change since the frame before."""
    gains = [seen.problem.photometry.gain or 1.0 for seen in (before, result)]
    return float(np.sqrt(gains[0] / gains[1]))


def as_frame(name: str, picture: Frame | FloatArray | None) -> Frame:
    """Make a frame of a picture that has no mask; ValueError in one sentence, if there is none."""
    if picture is None:
        raise ValueError(f"{name}: cannot be read")
    if isinstance(picture, Frame):
        return picture
    return Frame(picture, np.ones(np.shape(picture)[:2], dtype=bool), name)


def _light(frame: Frame, gamma: float) -> float:
    """Brightness of a picture: the median of its lit pixels, as light."""
    step = max(
        1, frame.width // 320
    )  # the median of a large picture is that of some of its pixels
    image = frame.image[::step, ::step][frame.mask[::step, ::step]]
    lit = image[image > 0]
    return float(np.median(lit)) ** gamma if lit.size else 1.0


def _as_bright(last: Result, ratio: float) -> Result:
    """Undo what `reconstruct` does to a start when gains differ.

    It takes a brighter picture of unknown gain for one of the same surface with more gain, in a unit that
    is smaller; but the unit is tied to the picture's brightness, so that the surface stays what it was.
    """
    moved = last.iterate.log_distance - 0.5 * np.log(ratio)
    return replace(last, iterate=replace(last.iterate, log_distance=moved))


def scale_between(before: Result, result: Result) -> float:
    """What a frame's distances must be multiplied by to be in the unit of the frame before.

    The unknowns are the log of that factor c, and the camera's motion T, ω between the two frames.
    Along a ray u that meets the old surface at D u with normal n, a rigid motion changes the distance
    by (n·T/D + ω·(u × n))/(-n·u) parts of it (range flow: Horn and Harris, Rigid body motion from
    range image sequences, 1991), so that every pixel says

        log D - log d = c + (n·T/D + ω·(u × n))/(n·u) + error.

    Prior beliefs are that log gain makes a random walk of `LINKING.gain_step` a frame, and that T, in
    median distances, and ω, in rad, are of the order `LINKING.motion_step`. The maximum a posteriori is
    found by reweighting (Cauchy), because at folds the motion is none of the linear kind; the
    pixels' errors are alike, so that all count as `LINKING.independent` ones. Coming straight at a flat wall
    and turning up the gain look the same: then the priors share the change between them.
    """
    by_gain = _by_gain(before, result)
    field = result.problem.field
    step = max(1, int(np.sqrt(result.mask.size / LINKING.samples)))
    thin = (slice(None, None, step),) * 2
    if before.mask.shape != result.mask.shape:
        return by_gain
    old = before.distance[thin]
    new = result.distance[thin]
    n = normals(before.iterate.log_distance, field, before.mask, step)
    u = field.rays[thin]
    facing = np.einsum("...i,...i->...", n, u)
    with np.errstate(invalid="ignore"):
        good = (old > 0) & (new > 0) & (facing < -LINKING.grazing)
    if good.sum() < LINKING.independent:
        return by_gain
    old = old[good]
    n = n[good]
    facing = facing[good, None]
    y = np.log(old / new[good])
    by_motion = n * (np.median(old) / old)[:, None] / facing
    by_turn = np.cross(u[good], n) / facing
    a = np.concatenate([np.ones_like(facing), by_motion, by_turn], axis=-1)
    prior = np.array([np.log(by_gain), 0, 0, 0, 0, 0, 0])
    prior_weight = np.array([2 / LINKING.gain_step, *[1 / LINKING.motion_step] * 6]) ** 2
    x = np.array([np.median(y), 0, 0, 0, 0, 0, 0])
    for _ in range(LINKING.rounds):
        residual = y - a @ x
        last = x
        spread = max(1.4826 * float(np.median(np.abs(residual))), 1e-4)
        weight = 1 / (1 + (residual / (2 * spread)) ** 2) / spread**2
        weight *= min(1.0, LINKING.independent / len(y))
        information = (a * weight[:, None]).T @ a + np.diag(prior_weight)
        x = np.linalg.solve(information, a.T @ (weight * y) + prior_weight * prior)
        if np.abs(x - last).max() < LINKING.settled:
            break
    return float(np.exp(x[0]))
