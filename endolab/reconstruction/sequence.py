"""Frame after frame: each starts from the last, and their scales are linked.

A frame whose gain is unknown has a scale of its own. Between neighbours two things are known:
the gain that an automatic exposure sets changes smoothly, and the surface that both see moves
little and rigidly. `scale_between` weighs the one against the other.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from endolab.frames.frame import Frame
from endolab.model.endoscope import Calibration
from endolab.model.thinned import ThinnedMaps
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
class Surface:
    """What the next frame's scale is linked to."""

    distance: FloatArray  # (H, W), at its linked scale, mm or relative; nan where unknown
    gain: float  # that belongs to this scale
    metric: bool  # whether distances are in mm

    @classmethod
    def of(cls, result: Result) -> Surface:
        """Take it from a result."""
        gain = result.problem.photometry.gain or 1.0
        return cls(result.distance, gain, result.metric)


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
        surface: Surface,
        frame: Frame,
        calibration: Calibration,
        min_steepness: float,
        least: float,
    ) -> Self:
        """Take up a surface that was kept: of a frame, with the energy `least`.

        It was cut at lines steeper than `min_steepness`; 0 if it was not cut.
        """
        v = np.log(surface.distance)
        camera = calibration.camera
        if v.shape != (camera.height, camera.width):
            camera = camera.resize(v.shape[1], v.shape[0])
        photometry = replace(calibration.photometry, gain=surface.gain)
        problem = Problem(
            np.zeros(v.shape),
            np.isfinite(v),
            camera,
            photometry,
            metric=surface.metric,
            cuts=np.zeros((2, *v.shape), dtype=bool) if min_steepness else None,
        )
        contours = ContourReport(
            ContourOutcome.AS_BEFORE, min_steepness=min_steepness or None
        )
        iterate = Iterate(
            problem, 0, freeze(v), {}, provenance=Provenance(contours=contours)
        )
        result = Result(iterate, Status.CONVERGED, [], 0.0)
        return cls(result, _light(frame, calibration.photometry.gamma), least, 1)


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
    before: Surface | Carried | None = None,
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
    before : Surface or Carried, optional
        Of the frame before the first: its surface, if its scale is to go on, or `Step.carried`, with which
        all goes on as if there had hardly been a break.
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
    check_scale(options.get("median_distance"), **lengths)
    can_start = "start" in options_of(options.get("solver", DEFAULT_SOLVER))
    known_gain = calibration.photometry.gain is not None
    carried = before if isinstance(before, Carried) else None
    surface = Surface.of(before.result) if isinstance(before, Carried) else before
    for index, (name, picture) in enumerate(frames):
        started = time.perf_counter()
        try:
            frame = as_frame(name, picture)
            light = _light(frame, calibration.photometry.gamma)
            own = (
                options
                if surface is None
                else {k: v for k, v in options.items() if k not in LENGTHS}
            )
            result = None
            warm = False
            least = np.inf
            age = 0
            if carried is not None:
                least = carried.least
                age = carried.age
            if carried is not None and can_start:
                last = carried.result
                start = last if known_gain else _as_bright(last, light / carried.light)
                result = reconstruct(frame, calibration, start=start, **own)
                warm = result.status is Status.STOPPED or (
                    result.status is Status.CONVERGED
                    and result.energy <= LINKING.worse * least
                    and age < LINKING.refresh
                )
            if result is None or not warm:
                cold = reconstruct(frame, calibration, **own)
                least = cold.energy
                age = 0
                warm = result is not None and result.energy < cold.energy
                if result is None or not warm:
                    result = cold
            if surface is None:
                result = replace(result, iterate=scale_by_length(result.iterate, **lengths))
        except (ValueError, OSError) as error:
            if surface is None and any(length is not None for length in lengths.values()):
                raise ValueError(
                    _sentence(name, error)
                ) from error  # another frame shows other places
            yield Step(
                index,
                name,
                None,
                _sentence(name, error),
                False,
                time.perf_counter() - started,
            )
            continue
        if surface is not None:
            gain = result.problem.photometry.gain or 1.0
            factor = (
                np.sqrt(surface.gain / gain)
                if known_gain
                else scale_between(surface, result)
            )
            linked = None if known_gain and np.isclose(factor, 1) else Scale("frame before")
            linked_iterate = in_unit(result.iterate, float(factor), surface.metric, linked)
            result = replace(result, iterate=linked_iterate)
        carried = Carried(result, light, least, age + 1)
        surface = Surface.of(result)
        yield Step(index, name, result, "", warm, time.perf_counter() - started, carried)
        if result.status is Status.STOPPED:
            return


def as_frame(name: str, picture: Frame | FloatArray | None) -> Frame:
    """Make a frame of a picture that has no mask; ValueError in one sentence, if there is none."""
    if picture is None:
        raise ValueError(f"{name}: cannot be read")
    if isinstance(picture, Frame):
        return picture
    return Frame(picture, np.ones(np.shape(picture)[:2], dtype=bool), name)


def _light(frame: Frame, gamma: float) -> float:
    """Brightness of a picture: the median of its lit pixels, as light."""
    image = frame.image[frame.mask]
    lit = image[image > 0]
    return float(np.median(lit)) ** gamma if lit.size else 1.0


def _as_bright(last: Result, ratio: float) -> Result:
    """Undo what `reconstruct` does to a start when gains differ.

    It takes a brighter picture of unknown gain for one of the same surface with more gain, in a unit that
    is smaller; but the unit is tied to the picture's brightness, so that the surface stays what it was.
    """
    moved = last.iterate.log_distance - 0.5 * np.log(ratio)
    return replace(last, iterate=replace(last.iterate, log_distance=moved))


def _sentence(name: str, error: Exception) -> str:
    message = str(error)
    return message if name in message else f"{name}: {message}"


def scale_between(before: Surface, result: Result) -> float:
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
    gain = result.problem.photometry.gain or 1.0
    prior = 0.5 * np.log(before.gain / gain)
    if before.distance.shape != result.mask.shape:
        return float(np.exp(prior))
    field = result.problem.field
    thin = (
        slice(None, None, max(1, int(np.sqrt(result.mask.size / LINKING.samples)))),
    ) * 2
    old = before.distance[thin]
    new = result.distance[thin]
    maps = ThinnedMaps(field, np.isfinite(before.distance), None, thin[0].step)
    n = maps.normals(np.log(before.distance))
    u = field.rays[thin]
    facing = np.einsum("...i,...i->...", n, u)
    with np.errstate(invalid="ignore"):
        good = (old > 0) & (new > 0) & (facing < -LINKING.grazing)
    if good.sum() < LINKING.independent:
        return float(np.exp(prior))
    old = old[good]
    new = new[good]
    n = n[good]
    u = u[good]
    facing = facing[good, None]
    y = np.log(old / new)
    by_motion = n * (np.median(old) / old)[:, None] / facing
    a = np.concatenate([np.ones_like(facing), by_motion, np.cross(u, n) / facing], axis=-1)
    prior_weight = np.array([2 / LINKING.gain_step, *[1 / LINKING.motion_step] * 6]) ** 2
    x = np.array([np.median(y), *[0.0] * 6])
    for _ in range(LINKING.rounds):
        residual = y - a @ x
        last = x
        spread = max(1.4826 * float(np.median(np.abs(residual))), 1e-4)
        weight = 1 / (1 + (residual / (2 * spread)) ** 2) / spread**2
        weight *= min(1.0, LINKING.independent / len(y))
        information = (a * weight[:, None]).T @ a + np.diag(prior_weight)
        x = np.linalg.solve(
            information, a.T @ (weight * y) + prior_weight * np.array([prior, *[0.0] * 6])
        )
        if np.abs(x - last).max() < LINKING.settled:
            break
    return float(np.exp(x[0]))
