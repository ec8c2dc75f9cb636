"""How wrong a result may be, pixel by pixel: σ of the distance, and who decided it.

Every uncertain cause is a change of the picture's light, or of the prior, that the surface answers to
linearly (`linearised`): one solve for a cause with a name, some dozen for random fields, whose mean square
is taken. λ and contours, which are choices, are made otherwise, and the frame solved anew (`anew`). Variances
add up. What all pixels share is a scale, and told apart from the shape.

The sum is multiplied by `FACTOR`, which was fitted to path-traced and real frames with their truth; which
causes there are, the length of the texture and what `Doubts` takes by default were chosen with these in view.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph

from endolab.depth.problem import NONE, Problem
from endolab.depth.result import Iterate, Result
from endolab.model.endoscope import Endoscope
from endolab.numerics.arrays import BoolArray, FloatArray, frozen
from endolab.numerics.checks import told, whole
from endolab.numerics.derivatives import REFERENCE_WIDTH, links
from endolab.numerics.iteration import Status, checked_observers, closing, drive
from endolab.numerics.threads import limited_threads
from endolab.preprocessing.frame import QUIET, noise_level
from endolab.uncertainty.anew import Anew
from endolab.uncertainty.causes import Texture, correlated, named, perhaps_torn
from endolab.uncertainty.doubts import Doubts
from endolab.uncertainty.fewer_pixels import enlarged, thinned
from endolab.uncertainty.linearised import Linearised
from endolab.uncertainty.shares import Bumps, Rim, decided_by, of_border, rim, shares

FACTOR = 1.0  # nothing, once λ and contours are solved anew; 1.05 while they were linear
DRAWS, LEAST = 24, 4  # of each random field: by default, below which nothing is told
ALONG = 40.0  # of what enters along a rim, per 320 px of the width: values of one wall go together
FEW = 8  # of those that are smooth, or matter little
TRIES = 6  # of random fields that tell what a fit leaves, and what it does not find
LARGEST = 1.0  # σ of log d at most: what is worse is not known at all
SHARP = 0.5  # px, blur that is none
WITHOUT = ("facing", "fast_marching")  # solvers that do not minimise the energy


@dataclass(frozen=True)
class Trust:
    """How far a result can be trusted; maps are (H, W), nan outside the mask."""

    sigma: FloatArray  # standard deviation of `distance`, in its unit, of all that is uncertain
    sigma_shape: FloatArray  # the same without what all pixels share
    sigma_scale: float  # what they share, as a share of the distance
    shares: FloatArray  # (3, H, W): of data, border or contour, and prior; they sum to 1
    decided_by: np.ndarray  # uint8: the largest of the three, 1, 2 or 3; 0 outside the mask
    causes: dict[str, FloatArray]  # what each cause adds to `sigma_shape`, as a share of the distance
    scales: dict[str, float]  # what each adds to `sigma_scale`
    factor: float  # by which all that is told here was multiplied
    draws: int  # of each random field
    status: Status  # STOPPED if fewer than were asked for
    notes: tuple[str, ...]  # sentences: what was taken


@dataclass(frozen=True)
class Progress:
    """How far the computation is, after every solve."""

    done: int  # draws; 0 while what needs none is found
    of: int


class _Sums:
    """Mean squares of what causes do to log d, apart by what all pixels share."""

    def __init__(self, problem: Problem) -> None:
        self._mask, self._held = problem.mask, _held(problem)
        self.shape: dict[str, FloatArray] = {}
        self.scale: dict[str, float] = {}
        self.whole: dict[str, FloatArray] = {}
        self._count: dict[str, int] = {}

    def add(self, cause: str, answer: FloatArray) -> None:
        """Add what a cause does, or a draw of it, to the mean of its draws."""
        common, count = float(answer[self._mask].mean()), self._count.get(cause, 0)
        kept = 0.0 if self._held is None else float(np.mean([answer[one] for one in self._held] or common))
        share = 1 / (count + 1)
        before = self.shape.get(cause, 0.0), self.scale.get(cause, 0.0), self.whole.get(cause, 0.0)
        self.shape[cause] = before[0] + share * ((answer - common) ** 2 - before[0])
        self.scale[cause] = before[1] + share * ((common - kept) ** 2 - before[1])
        self.whole[cause] = before[2] + share * ((answer - kept) ** 2 - before[2])
        self._count[cause] = count + 1


def _held(problem: Problem) -> list[tuple[int, int]] | None:
    """Pixels (row, column) whose distance fixes the unit; [] if all do together, None if the gain does."""
    scale = problem.origin.scale
    if scale is None:
        return None if problem.metric else []
    pixels: list[tuple[float, float]] = []
    if scale.by == "known distance":
        pixels = [scale.length[1:]]
    elif scale.by == "known diameter":
        pixels = list(scale.length[1:])
    height, width = problem.mask.shape
    wide, high = problem.origin.picture_size or (width, height)
    found = []
    for column, row in pixels:
        i, j = round((row + 0.5) * height / high - 0.5), round((column + 0.5) * width / wide - 0.5)
        found.append((min(max(i, 0), height - 1), min(max(j, 0), width - 1)))
    return found


def check_solver(solver: object) -> None:
    """Raise a ValueError if nothing can be told of what this solver finds."""
    if solver in WITHOUT:
        raise ValueError(
            f"solver {solver!r} minimises no energy, whose shape tells how far a result can be trusted: "
            "use 'gauss_newton'"
        )


def trust_of(
    result: Result | Iterate,
    calibration: Endoscope | None = None,
    *,
    doubts: Doubts | None = None,
    draws: int = DRAWS,
    observers: Iterable[Callable[[Progress], bool | None]] = (),
    threads: int | None = None,
) -> Trust:
    """Find how far each pixel of a result can be trusted.

    Parameters
    ----------
    result : Result or Iterate
        Of a solver that minimises the energy.
    calibration : Endoscope, optional
        Its evidence tells how well k and γ are known.
    doubts : Doubts, optional
        What is uncertain and how much, in place of that.
    draws : int
        Of each random field. Their σ is off by a share of 1/√(2 draws), at random, the same in every run.
    observers : iterable of callables
        Each is shown the `Progress`; one that returns True stops, as an interrupt does, with what there is.
    threads : int, optional
        The most cores to use, as of `reconstruct`.

    Raises
    ------
    ValueError
        In one sentence, if the result is of a solver that has no energy, or an option cannot be used.
    KeyboardInterrupt
        If it is stopped before the fourth draw: σ without the random fields, the most of it, would be too
        small, and nothing is told.
    """
    if not isinstance(result, Result | Iterate):
        raise ValueError(f"result must be a Result, got {told(result)}")
    if not isinstance(doubts, Doubts | None):
        raise ValueError(f"doubts must be Doubts, got {told(doubts)}")
    draws = whole("draws", draws, LEAST)
    check_solver(result.problem.settings.get("solver"))
    iterate = result.iterate if isinstance(result, Result) else result
    doubts = Doubts.of(calibration) if doubts is None else doubts
    watching = checked_observers(observers)
    with limited_threads(threads), closing(watching):
        estimate = _Estimate(thinned(iterate), doubts, draws)
        status = drive(estimate.steps(), watching, lambda step, seconds: None)
    if estimate.done < LEAST:
        raise KeyboardInterrupt(
            "how far the result can be trusted: stopped before there was anything to tell"
        )
    return estimate.trust(status, iterate)


class _Estimate:
    """What is known so far."""

    def __init__(self, iterate: Iterate, doubts: Doubts, draws: int) -> None:
        self._iterate, self._doubts, self._asked = iterate, doubts, draws
        self._sums, self.done = _Sums(iterate.problem), 0
        self._parts: FloatArray = np.zeros((3, *iterate.mask.shape))

    def steps(self) -> Generator[Progress, None, Status]:
        """Solve for every cause, a step each."""
        for found in self._answers():
            if found is not None:
                self._sums.add(*found)
            yield Progress(self.done, self._asked)
        return Status.CONVERGED

    def _answers(self) -> Generator[tuple[str, FloatArray] | None, None, None]:
        """What each cause does, or a draw of it; None while what that takes is made ready."""
        problem, doubts, mask = self._iterate.problem, self._doubts, self._iterate.mask
        v = np.where(mask, self._iterate.log_distance, 0.0)
        surface, rng = Linearised.at(problem, v), np.random.default_rng(0)
        yield None
        bumps = Bumps(surface, rng)
        for _ in range(TRIES):
            yield "bumps", doubts.bumps * bumps.try_one()
        self._parts = shares(mask, of_border(surface, v), bumps.share())
        yield None
        for cause, light in named(problem, v, doubts):
            yield cause, surface.to_light(light)
        for cause in ("gain", "albedo"):  # they move all pixels alike
            yield cause, 0.5 * getattr(doubts, cause) * mask
        anew, loose = Anew(problem, v), surface
        if doubts.lam:
            yield "lambda", (yield from anew.with_lam(np.exp(doubts.lam)))
        cuts = perhaps_torn(problem)
        if cuts is not None and cuts is not problem.cuts:
            loose = Linearised.at(replace(problem, cuts=cuts), v)
            yield None
            yield "contours", doubts.contours * (yield from anew.with_cuts(cuts))
        entering = Rim(loose, rim(loose.problem, v))
        texture = Texture(surface, rng, doubts.texture)
        for _ in range(TRIES):
            texture.try_one()
            yield None
        noise, blur = noise_left(problem)
        strength = texture.strength(noise)
        temperature = 2 * self._iterate.energy
        for draw in range(self._asked):
            yield "texture", surface.to_light(strength * texture.field())
            if draw < FEW:
                along = correlated(rng, mask.shape, ALONG * mask.shape[1] / REFERENCE_WIDTH)
                yield "border", entering.moved(doubts.border * along)
                white = correlated(rng, mask.shape, blur)
                yield "noise", surface.to_picture(noise * white)
                yield "prior", np.sqrt(temperature) * surface.solved(surface.prior_draw(rng))
            self.done = draw + 1
            yield None

    def trust(self, status: Status, whole: Iterate) -> Trust:
        """Sum up, on the pixels of the whole frame."""
        mask, sums = self._iterate.mask, self._sums
        lost = _undetermined(self._iterate.problem)
        parts = enlarged(self._parts, mask, whole.mask)

        def sigma(squares: Iterable[FloatArray]) -> FloatArray:
            found = np.minimum(FACTOR * np.sqrt(sum(squares, np.zeros(mask.shape))), LARGEST)
            return enlarged(np.where(lost, LARGEST, found), mask, whole.mask)

        return Trust(
            sigma=frozen(whole.distance * sigma(sums.whole.values())),
            sigma_shape=frozen(whole.distance * sigma(sums.shape.values())),
            sigma_scale=FACTOR * float(np.sqrt(sum(sums.scale.values()))),
            shares=frozen(parts),
            decided_by=frozen(decided_by(parts, whole.mask)),
            causes={cause: frozen(sigma([square])) for cause, square in sums.shape.items()},
            scales={cause: FACTOR * float(np.sqrt(square)) for cause, square in sums.scale.items()},
            factor=FACTOR,
            draws=self.done,
            status=status,
            notes=self._doubts.notes,
        )


def noise_left(problem: Problem) -> tuple[float, float]:
    """Standard deviation of the picture's noise, and the blur, px, that it was given since."""
    shown = problem.shown
    level = max(noise_level(shown if shown.ndim == 2 else shown[..., 1], problem.mask), QUIET)
    blur = problem.settings.get("smooth", 0.0)
    blur = float(blur) if isinstance(blur, int | float) else 0.0
    # The mean of a Gaussian's weights, squared; they fall short of it for less than half a pixel.
    return (level / (2 * np.sqrt(np.pi) * blur), blur) if blur >= SHARP else (level, 0.0)


def _undetermined(problem: Problem) -> BoolArray:
    """Pixels of islands of which the picture says nothing at all."""
    mask = problem.mask
    silent = np.zeros_like(mask) if problem.evidence is None else problem.evidence == NONE
    if not silent.any():
        return silent
    number = np.arange(mask.size).reshape(mask.shape)
    pairs = [
        np.stack([number[step], number[step] + ahead])
        for step, ahead in zip(links(mask, problem.cuts), (1, mask.shape[1]), strict=True)
    ]
    i, j = np.concatenate(pairs, axis=1)
    graph = scipy.sparse.coo_array((np.ones(i.size, np.int8), (i, j)), shape=(mask.size, mask.size))
    island = scipy.sparse.csgraph.connected_components(graph, directed=False)[1].reshape(mask.shape)
    return mask & ~np.isin(island, np.unique(island[mask & ~silent]))
