"""How wrong a result may be, pixel by pixel: σ of the distance, and what determined it.

Every uncertain cause is a change of the picture, to which the surface answers linearly. With J the model's
derivatives by v = log d at the estimate, W the data's weights and R the regulariser's parabolas,

    H = Jᵀ W J + R,        δv = H⁻¹ Jᵀ W δI,

δI being I/γ times a change of the logarithm of the light. What enters over the picture's rim or behind a
contour is moved itself, by δv_r of the pixels r there, and the other ones follow,

    δv_f = -H_ff⁻¹ H_fr δv_r.

A cause that has a name and a number (`PriorSigma`) takes one solve. One that has none is a random field, of
whose answers the mean square is taken: noise, what enters, and *texture*, which is all that the model leaves
unexplained. That shows in the residual, of which a fit takes most: fields that are fitted like the picture
tell how much it leaves, and the residual around a pixel over that is how strong texture is there. λ and
contours are choices: there the frame is solved again. Variances add up,

    σ² = Σ δv²,        σ_shape² = Σ (δv - mean of δv over the pixels)²,

the sums being over causes, each a mean over draws. Where a length is known, what it fixes is taken from δv.

What determined a pixel: what enters, as far as it follows if all that does is moved alike; of the rest the
data, as far as a small bump of the true surface comes through from the picture; else the prior.

What numbers there are was chosen with path-traced and real frames and their truth in view.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.ndimage import binary_erosion, label

from endolab.frames.highlights import extend
from endolab.metrics.contrast import noise_left
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checks import check_int, excerpt
from endolab.numerics.compiled import inner, pad_maps
from endolab.numerics.iteration import Status, Stopped, close_observers, drive
from endolab.numerics.noise import mean_weight
from endolab.numerics.resampling import resample
from endolab.numerics.stencils import links, px_per_reference
from endolab.numerics.threads import limit_threads
from endolab.reconstruction.lines import find_contours
from endolab.reconstruction.prior_sigma import PriorSigma
from endolab.reconstruction.scale import own_pixel
from endolab.reconstruction.walls import Walls
from endolab.solvers.gauss_newton import gauss_newton
from endolab.solvers.linearised import Linearised, on_fewer_pixels
from endolab.solvers.multigrid import Multigrid, multiply
from endolab.solvers.normal_equations import Coefficients
from endolab.solvers.problem import Problem
from endolab.solvers.provenance import LightOutcome
from endolab.solvers.result import Iterate, Result

OUTSIDE, DATA, BORDER, PRIOR = range(4)  # values of `dominant_source`
LEAST_DRAWS = 4  # below which nothing is told
TRIES = 6  # fields that tell what a fit leaves, and what it does not find
LARGEST_SIGMA = 1.0  # of log d: what is worse is not known at all
LENGTH = 12.0  # of a wall's texture: σ of a Gaussian, 1/320 of the longer side


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """How far a result can be trusted; maps are (H, W), nan outside the mask."""

    sigma: FloatArray  # standard deviation of `distance`, in its unit, of all that is uncertain
    sigma_shape: FloatArray  # the same without what all pixels share
    sigma_scale: float  # what they share, as a fraction of the distance
    shares: FloatArray  # (3, H, W): of data, border or contour, and prior; they sum to 1
    # uint8: the largest of the three, 1, 2 or 3; 0 outside the mask.
    dominant_source: np.ndarray
    # What each cause adds to `sigma_shape`, as a fraction of the distance.
    causes: dict[str, FloatArray]
    scales: dict[str, float]  # what each adds to `sigma_scale`
    draws: int  # of each random field
    status: Status  # STOPPED if fewer than were asked for
    notes: tuple[str, ...]  # sentences: what was taken


@dataclass(frozen=True)
class Progress:
    """How far the computation is, after every solve."""

    done: int  # draws; 0 while causes that have a name are solved for
    of: int


def uncertainty_of(
    result: Result | Iterate,
    calibration: Calibration | None = None,
    *,
    prior_sigma: PriorSigma | None = None,
    draws: int = 24,
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
        Of each random field. Their σ is off by a fraction of 1/√(2 draws), at random, the same in every run.
    observers : iterable of callables
        Each is shown the `Progress`; one that returns True stops, as an interrupt does, with what there is.
    threads : int, optional
        The most cores to use, as of `reconstruct`.

    Returns
    -------
    Uncertainty
        Standard deviations of each pixel's distance, by cause too, and what determined it.

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
    draws = check_int("draws", draws, LEAST_DRAWS)
    solver = result.report.asked.get("solver")
    if solver in ("facing", "fast_marching"):
        raise ValueError(
            f"solver {solver!r} minimises no energy, whose shape tells how far a result can be trusted: "
            "use 'gauss_newton'"
        )
    whole = result.iterate if isinstance(result, Result) else result
    prior_sigma = PriorSigma.of(calibration) if prior_sigma is None else prior_sigma
    answers: dict[str, list[FloatArray]] = defaultdict(list)
    with limit_threads(threads), close_observers(observers) as watching:
        iterate = on_fewer_pixels(whole)
        surface = Linearised(iterate.problem, iterate.log_distance)
        rng = np.random.default_rng(0)
        shares, unseen = shares_of(surface, rng)
        answers["bumps"] = [prior_sigma.bumps * rest for rest in unseen]
        steps = solve_for_causes(
            surface, iterate, *noise_left(whole), prior_sigma, draws, rng, answers
        )
        status = drive(
            steps, watching, lambda *step: None, lambda step: step.done >= LEAST_DRAWS
        )
    done = len(answers["texture"])
    if done < LEAST_DRAWS:
        raise Stopped(
            "how far the result can be trusted: stopped before there was anything to tell"
        )
    mask = iterate.mask
    fixed = pixels_of_scale(iterate)
    of_shape = []  # mean squares
    of_all = np.zeros(mask.shape)
    scales = {}
    for cause, maps in answers.items():
        changes = np.stack(maps)
        common = changes[:, mask].mean(axis=1)[:, None, None]
        known = changes[:, fixed].sum(axis=1)[:, None, None] / max(fixed.sum(), 1)
        of_all += np.mean((changes - known) ** 2, axis=0)
        of_shape.append(np.mean((changes - common) ** 2, axis=0))
        scales[cause] = float(np.sqrt(np.mean((common - known) ** 2)))
    squares = [of_all, np.sum(of_shape, axis=0), *of_shape]
    sigmas = np.minimum(np.sqrt(squares), LARGEST_SIGMA)
    # Of islands of the mask of which the picture says nothing, nothing is known.
    joined = np.kron(mask, [[1, 0], [0, 0]])
    joined[::2, 1::2], joined[1::2, ::2] = links(mask, iterate.problem.cuts)
    island = label(joined)[0][::2, ::2]
    sigmas[:, ~np.isin(island, island[surface.weight > 0])] = LARGEST_SIGMA
    sigma, sigma_shape, *causes = enlarge(sigmas, mask, whole.mask)
    parts = enlarge(shares, mask, whole.mask)
    source = np.where(whole.mask, DATA + np.argmax(parts, axis=0), OUTSIDE)
    return Uncertainty(
        sigma=whole.distance * sigma,
        sigma_shape=whole.distance * sigma_shape,
        sigma_scale=float(np.linalg.norm([*scales.values()])),
        shares=parts,
        dominant_source=source.astype(np.uint8),
        causes=dict(zip(scales, causes, strict=True)),
        scales=scales,
        draws=done,
        status=status,
        notes=prior_sigma.notes,
    )


# The linear answer -------------------------------------------------------------------------


def follow_inflow(surface: Linearised) -> Callable[[FloatArray], FloatArray]:
    """Return how v answers to a change of it where the light's equation enters, as a function."""
    coefficients = surface.coefficients
    enters = surface.grid.inflow_pixels(pad_maps(surface.v))
    matrix = coefficients.matrix(1e-3)
    free = coefficients.active * pad_maps((~enters).astype(np.int8))
    fixed_inflow = Multigrid(Coefficients(coefficients.parts, surface.grid.structure(free)))

    def follow(change: FloatArray) -> FloatArray:
        given = pad_maps(np.where(enters, change, 0.0))
        pulled = np.zeros_like(given)
        multiply(matrix, given, pulled)
        x = fixed_inflow.solve(-pulled * free, *surface.accuracy)[0]
        return np.asarray(inner(given + x))

    return follow


def shares_of(
    surface: Linearised, rng: np.random.Generator
) -> tuple[FloatArray, list[FloatArray]]:
    """Shares of data, border or contour, and prior, (3, H, W), and of some bumps what does not come through.

    Around a pixel the data's share of the bumps is Σ bump · answer / Σ bump².
    """
    mask = surface.problem.mask
    length = LENGTH * px_per_reference(mask.shape)
    bumps = [mask * correlated_field(rng, mask.shape, length) for _ in range(TRIES)]
    answers = [surface.to_picture(surface.apply(bump)) for bump in bumps]
    recovered, true = (
        _blur(np.sum(np.multiply(bumps, each), axis=0), length) for each in (answers, bumps)
    )
    border = np.clip(follow_inflow(surface)(np.ones(mask.shape)), 0.0, 1.0)
    data = (1 - border) * np.clip(recovered / np.maximum(true, 1e-12), 0.0, 1.0)
    shares = np.where(mask, np.stack([data, border, 1 - border - data]), 0.0)
    return shares, [*np.subtract(bumps, answers)]


def correlated_field(
    rng: np.random.Generator, shape: tuple[int, ...], length: float
) -> FloatArray:
    """A random field of unit variance: white noise, blurred by a Gaussian of this many px if by any."""
    margin = int(3 * length) + 1
    white = rng.standard_normal(np.add(shape, 2 * margin))
    return _blur(white, length)[margin:-margin, margin:-margin] / mean_weight(length)


def _blur(a: FloatArray, sigma: float) -> FloatArray:
    """In single precision, to three σ: a draw need not be finer."""
    size = (2 * int(np.ceil(3 * sigma)) + 1,) * 2
    blurred = cv2.GaussianBlur(
        a.astype(np.float32), size, sigma, borderType=cv2.BORDER_CONSTANT
    )
    return np.asarray(blurred, dtype=np.float64)


# The causes --------------------------------------------------------------------------------


def solve_for_causes(
    surface: Linearised,
    iterate: Iterate,
    noise: float,
    blur: float,
    prior_sigma: PriorSigma,
    draws: int,
    rng: np.random.Generator,
    answers: dict[str, list[FloatArray]],
) -> Generator[Progress, None, Status]:
    """Add to `answers` what each cause, or a draw of it, does to log d; a step each."""
    problem = iterate.problem
    mask = problem.mask
    for cause, light in light_changes(iterate, prior_sigma).items():
        answers[cause].append(surface.to_light(light))
        yield Progress(0, draws)
    lam = problem.lam * float(np.exp(prior_sigma.lam))
    # Every second line from some steepness on, of log d₀ per unit of length, is a contour.
    cuts = find_contours(problem.log_d0, mask) > 0.03
    cut = replace(problem, cuts=cuts if problem.cuts is None else cuts | problem.cuts)
    still = re_solve(problem, surface.v)
    for cause, weight, other in (
        ("lambda", 1.0, replace(problem, lam=lam)),
        ("contours", prior_sigma.contours, cut),
    ):
        moved = re_solve(other, surface.v) - still
        answers[cause].append(weight * np.clip(moved, -LARGEST_SIGMA, LARGEST_SIGMA))
        yield Progress(0, draws)
    follow = follow_inflow(Linearised(cut, surface.v))
    inside = binary_erosion(mask)  # what enters there, enters behind a contour
    doubt = np.where(inside, prior_sigma.behind, prior_sigma.border)
    strength = texture_strength(surface, rng, noise, prior_sigma.texture)
    unit = px_per_reference(mask.shape)
    for draw in range(draws):
        light = strength * correlated_field(rng, mask.shape, LENGTH * unit)
        answers["texture"].append(surface.to_light(light))
        if draw < 8:  # of fields that are smooth, or matter little
            # Values of one wall go together.
            entering = doubt * correlated_field(rng, mask.shape, 40.0 * unit)
            answers["border"].append(follow(entering))
            white = correlated_field(rng, mask.shape, blur)
            answers["noise"].append(surface.to_picture(noise * white))
        yield Progress(draw + 1, draws)
    return Status.CONVERGED


def light_changes(iterate: Iterate, prior_sigma: PriorSigma) -> dict[str, FloatArray]:
    """What one standard deviation of each named cause changes in the logarithm of the light."""
    problem = iterate.problem
    rays = problem.field.rays
    grazing = 0.05  # cos α or θ below which nothing more is told
    even = np.ones(problem.mask.shape)
    removed = iterate.report.albedo is not None
    bounced = prior_sigma.bounced if removed else prior_sigma.left_in
    changes = {
        "gain": prior_sigma.gain * even,
        "albedo": prior_sigma.albedo * even,
        "k": prior_sigma.k * np.log(np.maximum(problem.field.cos_alpha, grazing)),
        "gamma": prior_sigma.gamma * np.log(np.maximum(problem.image, 0.5 / 255)),
        "bounced light": bounced * bounced_light(iterate),
    }
    if problem.metric:
        normals = iterate.normals
        cosine = np.maximum(-(normals * rays).sum(axis=-1), grazing)
        for axis, name in enumerate("xy"):
            # Of cos θ/d² by the lamp's place: it is nearer, and the wall turned to it.
            slope = 3 * rays[..., axis] + normals[..., axis] / cosine
            change = prior_sigma.lamp * slope / iterate.distance
            changes[f"lamp {name}"] = np.clip(change, -1.0, 1.0)
    return {name: change for name, change in changes.items() if change.any()}


def bounced_light(iterate: Iterate) -> FloatArray:
    """log(1 + ι) of the light that the wall's green bounces, as this surface makes it."""
    problem = iterate.problem
    mask = problem.mask
    if iterate.report.light is LightOutcome.NONE_BOUNCED:
        return np.zeros(mask.shape)
    if iterate.report.albedo is not None:
        rho = iterate.report.albedo[1]
    else:
        facing = np.ones(1)
        rho = float(np.pi * problem.photometry.brdf.value(facing, facing)[0])
    k = problem.photometry.k
    walls = Walls.of(
        iterate.log_distance, mask, problem.field, k, problem.cuts, problem.lamp_ratio
    )
    return np.where(mask, np.log1p(walls.indirect_ratio(min(rho, 0.95))), 0.0)


def re_solve(problem: Problem, log_distance: FloatArray) -> FloatArray:
    """Log d (H, W) after a few steps of the solver from a map.

    In four steps a surface goes most of its way. Where a region is weakly connected, another λ or another
    contour moves it farther than its linear model says, and elsewhere.
    """
    *_, last = gauss_newton(problem, start=log_distance, max_iterations=4)
    return np.where(problem.mask, last.log_distance, 0.0)


def texture_strength(
    surface: Linearised, rng: np.random.Generator, noise: float, least: float
) -> FloatArray:
    """Standard deviation of the light's logarithm by texture and all else that the model does not explain.

    The residual around a pixel, but for noise, over what a fit leaves there of fields of unit variance; no
    less than half as much is taken to be left as in the median. Three quarters of it are texture: it holds
    folds and contours as well, whose errors end where they do. (Chosen, with the two of `PriorSigma` that
    are of borders, on rendered, path-traced and random open frames, to bring all three near 68 and 95 %.)
    """
    mask = surface.problem.mask
    unit = px_per_reference(mask.shape)
    left = np.zeros(mask.shape)
    for _ in range(TRIES):
        light = correlated_field(rng, mask.shape, LENGTH * unit)
        fitted = surface.in_light(surface.apply(surface.to_light(light)))
        left += (light - fitted) ** 2 / TRIES
    residual = surface.in_light(surface.model - surface.problem.image)
    unexplained, usual = (
        _blur((surface.weight > 0) * square, 10.0 * unit)
        for square in (residual**2 - surface.in_light(noise) ** 2, left)
    )
    least_left = 0.25 * np.median(usual[mask]) + 1e-9
    square = np.maximum(unexplained, 0.0) / np.maximum(usual, least_left)
    return np.hypot(0.76 * np.sqrt(square), least)


def pixels_of_scale(iterate: Iterate) -> BoolArray:
    """Pixels of the mask, (H, W), whose mean distance is known: none if the gain is, all if only shape is.

    One that was given, and that the mask of fewer pixels lacks, is stood for by its neighbour.
    """
    report = iterate.report
    mask = iterate.mask
    if not report.scale:
        return np.zeros_like(mask) if iterate.problem.metric else mask
    if report.scale not in ("known distance", "known diameter"):
        return mask
    fixed = np.zeros_like(mask)
    inside = np.argwhere(mask)
    for pixel in np.reshape(report.length[1:], (-1, 2)):
        apart = np.linalg.norm(inside - own_pixel(iterate, pixel)[1], axis=1)
        fixed[tuple(inside[apart.argmin()])] = True
    return fixed


# Fewer pixels ------------------------------------------------------------------------------


def enlarge(maps: FloatArray, known: BoolArray, mask: BoolArray) -> FloatArray:
    """Maps (..., h, w), known in a mask, on all pixels of another, (..., H, W); nan outside it."""
    filled = extend(np.moveaxis(maps, 0, -1), known)
    return np.where(mask, np.moveaxis(resample(filled, mask.shape), -1, 0), np.nan)
