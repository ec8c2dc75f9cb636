"""How wrong a result may be, pixel by pixel: σ of the distance, and who decided it.

Every uncertain cause is a change of the picture's light that the surface answers to linearly (`linearised`):
one solve for a cause with a name, some dozen for random fields, whose mean square is taken. λ and contours,
which are choices, are made otherwise, and the frame solved again (`re_solve`). Variances add up. What all
pixels share is a scale, and told apart from the shape.

Which causes there are, the length of the texture and what `PriorSigma` takes by default were chosen with
path-traced and real frames and their truth in view.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.ndimage

from endolab.frames.frame import ROUNDING
from endolab.model.endoscope import Calibration
from endolab.model.ranges import RANGES
from endolab.numerics.arrays import BoolArray, FloatArray, IntArray, freeze
from endolab.numerics.checks import check_int, excerpt
from endolab.numerics.derivatives import links, px_per_reference, shift
from endolab.numerics.iteration import (
    Status,
    Stopped,
    check_observers,
    close_observers,
    drive,
)
from endolab.numerics.noise import noise_level
from endolab.numerics.threads import limit_threads
from endolab.reconstruction.scale import own_pixel
from endolab.reconstruction.uncertainty.causes import (
    CAUSES,
    correlated_field,
    light_changes,
    possible_cuts,
    texture_strength,
)
from endolab.reconstruction.uncertainty.fewer_pixels import enlarge, thin
from endolab.reconstruction.uncertainty.linearised import Linearised
from endolab.reconstruction.uncertainty.prior_sigma import PriorSigma
from endolab.reconstruction.uncertainty.shares import DATA, OUTSIDE, follow_rim, shares_of
from endolab.solvers.gauss_newton import gauss_newton
from endolab.solvers.problem import NONE, Problem
from endolab.solvers.result import Iterate, Result


@dataclass(frozen=True)
class Sampling:
    """How many random fields are drawn, and what is taken of them."""

    draws: int = 24  # of each random field
    least_draws: int = 4  # below which nothing is told
    few_draws: int = 8  # of those that are smooth, or matter little
    # Of random fields that tell what a fit leaves, and what it does not find.
    tries: int = 6
    # Of what enters along a rim, per 320 px of the longer side: values of one wall go
    # together.
    along: float = 40.0
    largest_sigma: float = 1.0  # σ of log d at most: what is worse is not known at all
    sharp: float = 0.5  # px, blur that is none


SAMPLING = Sampling()


WITHOUT = ("facing", "fast_marching")  # solvers that do not minimise the energy


@dataclass(frozen=True)
class Uncertainty:
    """How far a result can be trusted; maps are (H, W), nan outside the mask."""

    sigma: FloatArray  # standard deviation of `distance`, in its unit, of all that is uncertain
    sigma_shape: FloatArray  # the same without what all pixels share
    sigma_scale: float  # what they share, as a share of the distance
    shares: FloatArray  # (3, H, W): of data, border or contour, and prior; they sum to 1
    # uint8: the largest of the three, 1, 2 or 3; 0 outside the mask.
    dominant_source: np.ndarray
    # What each cause adds to `sigma_shape`, as a share of the distance.
    causes: dict[str, FloatArray]
    scales: dict[str, float]  # what each adds to `sigma_scale`
    draws: int  # of each random field
    status: Status  # STOPPED if fewer than were asked for
    notes: tuple[str, ...]  # sentences: what was taken


@dataclass(frozen=True)
class Progress:
    """How far the computation is, after every solve."""

    done: int  # draws; 0 while what needs none is found
    of: int


def check_solver(solver: object) -> None:
    """Raise a ValueError if nothing can be told of what this solver finds."""
    if solver in WITHOUT:
        raise ValueError(
            f"solver {solver!r} minimises no energy, whose shape tells how far a result can be trusted: "
            "use 'gauss_newton'"
        )


def uncertainty_of(
    result: Result | Iterate,
    calibration: Calibration | None = None,
    *,
    prior_sigma: PriorSigma | None = None,
    draws: int = SAMPLING.draws,
    observers: Iterable[Callable[[Progress], bool | None]] = (),
    threads: int | None = None,
) -> Uncertainty:
    """Find how far each pixel of a result can be trusted.

    Parameters
    ----------
    result : Result or Iterate
        Of a solver that minimises the energy.
    calibration : Calibration, optional
        Its evidence tells how well k and γ are known.
    prior_sigma : PriorSigma, optional
        What is uncertain and how much, in place of that.
    draws : int
        Of each random field. Their σ is off by a share of 1/√(2 draws), at random, the same in every run.
    observers : iterable of callables
        Each is shown the `Progress`; one that returns True stops, as an interrupt does, with what there is.
    threads : int, optional
        The most cores to use, as of `reconstruct`.

    Returns
    -------
    Uncertainty
        Standard deviations of each pixel's distance, by cause too, and what decided it.

    Raises
    ------
    ValueError
        In one sentence, if the result is of a solver that has no energy, or an option cannot be used.
    Stopped
        If an observer stops it before the fourth draw: σ without the random fields, the most of it, would be
        too small, and nothing is told. An interrupt before that is passed on.

    Examples
    --------
    >>> import endolab as el
    >>> sample = el.load_traced("matt")  # a frame that comes with endolab
    >>> result = el.reconstruct(sample.frame, sample.calibration, width=96, channel="green")
    >>> uncertainty = el.uncertainty_of(result, sample.calibration)
    >>> uncertainty.sigma.shape, sorted(uncertainty.causes)[:3]
    ((72, 96), ['albedo', 'border', 'bounced light'])
    """
    if not isinstance(result, Result | Iterate):
        raise ValueError(f"result must be a Result, got {excerpt(result)}")
    if not isinstance(prior_sigma, PriorSigma | None):
        raise ValueError(f"prior_sigma must be a PriorSigma, got {excerpt(prior_sigma)}")
    draws = check_int("draws", draws, SAMPLING.least_draws)
    check_solver(result.provenance.asked.get("solver"))
    iterate = result.iterate if isinstance(result, Result) else result
    prior_sigma = PriorSigma.of(calibration) if prior_sigma is None else prior_sigma
    watching = check_observers(observers)
    with limit_threads(threads), close_observers(watching):
        estimate = _Estimate(thin(iterate), prior_sigma, draws)
        status = drive(
            estimate.steps(),
            watching,
            lambda step, seconds: None,
            lambda step: step.done >= SAMPLING.least_draws,
        )
    if estimate.done < SAMPLING.least_draws:
        raise Stopped(
            "how far the result can be trusted: stopped before there was anything to tell"
        )
    return estimate.uncertainty(status, iterate)


Answer = tuple[str, FloatArray]  # a cause, and what it or a draw of it does to log d


@dataclass
class _Estimate:
    """What is known so far."""

    iterate: Iterate
    prior_sigma: PriorSigma
    asked: int  # draws
    done: int = 0
    answers: dict[str, list[FloatArray]] = field(default_factory=dict)
    shares: FloatArray = field(init=False)

    def steps(self) -> Generator[Progress, None, Status]:
        """Solve for every cause, a step each."""
        for step in self._answer_each():
            if step is not None:
                self.answers.setdefault(step[0], []).append(step[1])
            yield Progress(self.done, self.asked)
        return Status.CONVERGED

    def _answer_each(self) -> Generator[Answer | None, None, None]:
        """What each cause does, or a draw of it; None while what that takes is made ready."""
        prior_sigma = self.prior_sigma
        problem = self.iterate.problem
        mask = problem.mask
        v = np.where(mask, self.iterate.log_distance, 0.0)
        surface = Linearised.at(problem, v)
        rng = np.random.default_rng(0)
        unit = px_per_reference(mask.shape)
        length = CAUSES.length * unit
        yield None
        bumps = []
        answers = []
        for _ in range(SAMPLING.tries):
            bump = mask * correlated_field(rng, mask.shape, length)
            answer = surface.to_picture(surface.apply(bump))
            bumps.append(bump)
            answers.append(answer)
            yield "bumps", prior_sigma.bumps * (bump - answer)
        self.shares = shares_of(surface, v, bumps, answers, length)
        yield None
        for cause, light in light_changes(self.iterate, prior_sigma):
            yield cause, surface.to_light(light)
        for cause in ("gain", "albedo"):  # they move all pixels alike
            yield cause, 0.5 * getattr(prior_sigma, cause) * mask
        cuts = possible_cuts(problem)
        others = problem if cuts is None else replace(problem, cuts=cuts)
        yield from self._choices(v, others)
        entering = follow_rim(surface if cuts is None else Linearised.at(others, v), v)
        doubt = np.where(_at_contours(others), prior_sigma.behind, prior_sigma.border)
        yield None
        left = []
        for _ in range(SAMPLING.tries):
            light = correlated_field(rng, mask.shape, length)
            change = surface.apply(surface.to_light(light))
            left.append(light - surface.in_light(change))
            yield None
        noise, blur = noise_left(self.iterate)
        strength = texture_strength(surface, left, noise, prior_sigma.texture)
        for draw in range(self.asked):
            light = correlated_field(rng, mask.shape, length)
            yield "texture", surface.to_light(strength * light)
            if draw < SAMPLING.few_draws:
                along = correlated_field(rng, mask.shape, SAMPLING.along * unit)
                yield "border", entering(doubt * along)
                white = correlated_field(rng, mask.shape, blur)
                yield "noise", surface.to_picture(noise * white)
            self.done = draw + 1
            yield None

    def _choices(
        self, v: FloatArray, others: Problem
    ) -> Generator[Answer | None, None, None]:
        """What another λ does, and cuts at all `others`."""
        problem = self.iterate.problem
        prior_sigma = self.prior_sigma
        choices: dict[str, tuple[float, Problem]] = {}
        if prior_sigma.lam:
            lam = min(problem.lam * float(np.exp(prior_sigma.lam)), RANGES["lam"][1])
            choices["lambda"] = 1.0, replace(problem, lam=lam)
        if others is not problem:
            choices["contours"] = prior_sigma.contours, others
        most = SAMPLING.largest_sigma  # what goes farther is lost anyway
        still = (yield from re_solve(problem, v)) if choices else v
        for cause, (share, other) in choices.items():
            moved = (yield from re_solve(other, v)) - still
            yield cause, share * np.clip(moved, -most, most)

    def uncertainty(self, status: Status, whole: Iterate) -> Uncertainty:
        """Sum up, on the pixels of the whole frame."""
        mask = self.iterate.mask
        lost = _without_evidence(self.iterate.problem)
        parts = enlarge(self.shares, mask, whole.mask)
        largest = SAMPLING.largest_sigma
        together = np.zeros(mask.shape)
        shape = np.zeros(mask.shape)
        causes: dict[str, FloatArray] = {}
        scales: dict[str, float] = {}

        def sigma(square: FloatArray) -> FloatArray:
            known = np.where(lost, largest, np.minimum(np.sqrt(square), largest))
            return freeze(enlarge(known, mask, whole.mask))

        for cause, maps in self.answers.items():
            of_all, of_shape, of_scale = self._squares(np.stack(maps))
            together += of_all
            shape += of_shape
            causes[cause] = sigma(of_shape)
            scales[cause] = float(np.sqrt(of_scale))
        decided = np.where(whole.mask, DATA + np.argmax(parts, axis=0), OUTSIDE)
        return Uncertainty(
            sigma=freeze(whole.distance * sigma(together)),
            sigma_shape=freeze(whole.distance * sigma(shape)),
            sigma_scale=float(np.linalg.norm([*scales.values()])),
            shares=freeze(parts),
            dominant_source=freeze(decided.astype(np.uint8)),
            causes=causes,
            scales=scales,
            draws=self.done,
            status=status,
            notes=self.prior_sigma.notes,
        )

    def _squares(self, maps: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        """Mean squares of some answers, (n, H, W): in all, of the shape, and of what all pixels share."""
        common = maps[:, self.iterate.mask].mean(axis=1)
        held = _pixels_of_scale(self.iterate)
        if held is None:
            kept = 0 * common
        elif len(held):
            kept = maps[:, *held.T].mean(axis=1)
        else:
            kept = common
        together, shape = (
            np.mean((maps - level[:, None, None]) ** 2, axis=0) for level in (kept, common)
        )
        return together, shape, float(np.mean((common - kept) ** 2))


def re_solve(
    problem: Problem, log_distance: FloatArray
) -> Generator[None, None, FloatArray]:
    """Log d (H, W) after a few steps from a map, a step of the solver each, so that who waits can stop.

    In four steps a surface goes most of its way. Where a region is weakly connected, another λ or another
    contour moves it farther than its linear model says, and elsewhere.
    """
    last = log_distance
    for iterate in gauss_newton(problem, start=log_distance, max_iterations=4):
        last = iterate.log_distance
        yield None
    return np.where(problem.mask, last, 0.0)


def _pixels_of_scale(iterate: Iterate) -> IntArray | None:
    """Pixels whose distance fixes the unit, (n, 2); n = 0 if all do together, None if the gain does.

    Each is a row and a column.
    """
    scale = iterate.provenance.scale
    if scale is None:
        return None if iterate.problem.metric else np.empty((0, 2), int)
    known = scale.by in ("known distance", "known diameter")
    pixels = np.reshape(scale.length[1:] if known else (), (-1, 2))
    most = np.array(iterate.mask.shape) - 1
    places = [np.round(own_pixel(iterate, pixel)[::-1]) for pixel in pixels]
    return np.clip(np.reshape(places, (-1, 2)), 0, most).astype(int)


def noise_left(result: Result | Iterate) -> tuple[float, float]:
    """Standard deviation of the picture's noise, and the blur, px, that it was given since."""
    shown = result.problem.shown
    prepared = result.provenance.preparation
    blur = 0.0 if prepared is None else prepared.smooth
    green = shown if shown.ndim == 2 else shown[..., 1]
    level = max(noise_level(green, result.mask), ROUNDING)
    # The mean of a Gaussian's weights, squared; they fall short of it for less than half a pixel.
    if blur < SAMPLING.sharp:
        return level, 0.0
    return level / (2 * np.sqrt(np.pi) * blur), blur


def _at_contours(problem: Problem) -> BoolArray:
    """Pixels on either side of a contour, (H, W)."""
    if problem.cuts is None:
        return np.zeros(problem.mask.shape, dtype=bool)
    right, below = problem.cuts
    return right | below | shift(right, -1, 1, False) | shift(below, -1, 0, False)


def _without_evidence(problem: Problem) -> BoolArray:
    """Pixels of islands of which the picture says nothing at all."""
    mask = problem.mask
    if problem.evidence is None:
        return np.zeros_like(mask)
    across, down = links(mask, problem.cuts)
    # Pixels, and what is between them.
    steps = np.zeros((2 * mask.shape[0], 2 * mask.shape[1]), dtype=bool)
    steps[::2, ::2] = mask
    steps[::2, 1::2] = across
    steps[1::2, ::2] = down
    island = scipy.ndimage.label(steps)[0][::2, ::2]
    return mask & ~np.isin(island, island[mask & (problem.evidence != NONE)])
