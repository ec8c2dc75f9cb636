"""The light of an endoscope that was never calibrated, asked of the frames it took: k, by the energy.

Any k explains any frame: what it says too much of the light's fall to the side, a surface that comes
nearer at the side makes good. But that surface bends as walls do not, and the energy says so. So a frame
is solved for every k of `EXPONENTS`, each from the surface before with its sides moved by what the change
of k is worth, ½ Δk log cos α, bounced light found again each time (`light_and_contours`): a step or two each.

The regulariser likes little contrast, and the less k, the less of it has the surface. Charged is therefore

    c(k) = log E(k) - ½ log (spread of 1/d over its mean),

which is least at the truth on average over frames whose light never bounced; without the second term it is
a third too low. One frame seldom tells k, for its wall may well bend like another k, the more so the less
of the light's fall the camera sees. How well it does was measured on path-traced frames of many cavities
and lamps: as a likelihood, exp(-c/T), blurred by `aside` over the spread of log cos α. Frames that show
other places err independently, and their likelihoods multiply; what is common to all, a smooth straight
tube everywhere, say, blurs the product once more. The middle of what is left, its width, and a verdict
are the answer. It is one for cavities: a single flat wall before a pinhole looks like a k that is 2 larger.

γ is not told: of any two, the energy prefers the smaller, which leaves less contrast.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from endolab.frames.frame import Frame
from endolab.model.brdf import Lambertian
from endolab.model.cameras import Camera
from endolab.model.endoscope import Calibration
from endolab.model.photometry import Photometry
from endolab.numerics.arrays import FloatArray, freeze
from endolab.numerics.checks import excerpt, number, real_array
from endolab.numerics.iteration import Status, check_observers, close_observers, drive
from endolab.reconstruction.colours import NoColour, known_albedo
from endolab.reconstruction.light_and_contours import separate, separate_from
from endolab.reconstruction.problem_of_frame import check_frame, problem_of_frame
from endolab.reconstruction.settings import Settings
from endolab.solvers.problem import Problem
from endolab.solvers.result import Iterate, Observer

EXPONENTS = np.linspace(
    0.0, 5.0, 11
)  # k for which light is computed; endoscopes have 0.5 to 3.5


@dataclass(frozen=True)
class ExponentSearch:
    """How k is found. T and the widths make the true k of 31 path-traced frames likeliest."""

    first: int = 4  # of the exponents that are tried, with which to begin: 2
    width: int = 200  # px; it is the surface's large shape that tells
    # px, of that width; more blur, against noise, makes dark lumens brighter and k
    # smaller.
    smooth: float = 1.0
    usual: float = 2.5  # k of the paper's endoscope, taken if nothing is found
    # Standard deviation of the usual k, which what is found roughly is averaged with.
    usual_error: float = 1.0
    contrast: float = 0.5  # power of it by which the energy is divided
    # T, of c.
    temperature: float = 0.03
    # What shapes pretend: standard deviation of the part of a frame's log light that looks like
    # log cos α, as a share of the spread of that; and of k, for all frames of an endoscope together.
    aside: float = 0.08
    alike: float = 0.3
    wrong: float = 0.05  # of frames, which tell nothing of k: fog, a wall with a pattern
    # Power of two shapes' correlation to which they are one place; 0.98 of neighbours,
    # 0.5 of others.
    same: float = 8.0
    step: float = 0.05  # of the k whose likelihood is told
    found: float = 0.5  # standard error up to which k is found; knowing nothing: 1.7
    roughly: float = 1.0  # likewise, found roughly


EXPONENT_SEARCH = ExponentSearch()


@dataclass(frozen=True)
class LightEstimate:
    """What frames tell of the light's fall-off.

    `photometry` is ready to reconstruct with: it has the k that was found, or else the one that was to be
    taken otherwise, and the mean of both, by their errors, if k was found roughly; its gain is unknown.
    """

    k: float  # joint exponent of lamp and lens: half of the likelihood is below
    standard_error: float  # half the width of its middle 68 %
    interval: tuple[float, float]  # its middle 95 %
    outcome: str  # "found", "roughly" or "not found"
    verdict: str  # the same in a sentence
    photometry: Photometry
    exponents: FloatArray  # (K,), those that were tried
    costs: FloatArray  # (F, K), c of every frame, its least being 0
    places: float  # as many independent frames the frames are worth
    names: tuple[str, ...]  # of the F frames
    refused: dict[str, str]  # names of others, and why, in a sentence
    status: Status  # STOPPED if not all frames were asked

    @property
    def evidence(self) -> dict[str, Any]:
        """All of it in plain numbers, for `endoscope.json`."""
        plain = (
            "k",
            "standard_error",
            "interval",
            "outcome",
            "verdict",
            "places",
            "refused",
        )
        record = {name: getattr(self, name) for name in plain}
        record["exponents"] = self.exponents.tolist()
        costs = np.round(self.costs, 4).tolist()
        record["costs"] = dict(zip(self.names, costs, strict=True))
        return {"unknown_light": record}


def estimate_light(
    frames: Iterable[Frame],
    camera: Camera,
    *,
    gamma: float = 2.2,
    albedo: ArrayLike | None = None,
    otherwise: float = EXPONENT_SEARCH.usual,
    observers: Iterable[Observer] = (),
    progress: Callable[[int, str], object] | None = None,
) -> LightEstimate:
    """Find the exponent k of an endoscope's light from frames that it took, the camera being known.

    It takes two or three seconds a frame. A frame of a fisheye that sees 60° to the side and more tells k
    within a half, three within a third; five of a camera that sees 45° tell it roughly. Neighbours in a
    video count as one.

    Parameters
    ----------
    frames : iterable of Frame
        Of one endoscope, in colour, so that bounced light can be told from direct.
    camera : Camera
        For pictures of that size.
    gamma : float
        The response γ, which frames do not tell. The k that is found is one for this γ: where that is 0.3
        too large, k is 0.2 to 0.3 too large, too.
    albedo : float or three floats, optional
        Of the wall, in green alone or red, green and blue, if it is known.
    otherwise : float
        k of the photometry if it is not found.
    observers : iterable of callables
        Each is shown every iterate of every solve; one that returns True stops the search, and what the
        frames before told is the answer.
    progress : callable, optional
        ``progress(done, name)`` is called after each frame.

    Returns
    -------
    LightEstimate

    Raises
    ------
    ValueError
        In one sentence, if an argument cannot be used, or none of the frames.
    """
    if not isinstance(camera, Camera):
        raise ValueError(f"camera must be a Camera, got {excerpt(camera)}")
    if not isinstance(frames, Iterable):
        raise ValueError(f"frames must be several of Frame, got {excerpt(frames)}")
    wall = Lambertian()
    if albedo is not None:
        known = tuple(np.ravel(real_array("albedo", albedo)).tolist())
        wall = Lambertian(known if len(known) > 1 else known[0])  # type: ignore[arg-type]
    usual = Photometry(
        number("otherwise", otherwise, 0.0), number("gamma", gamma), None, wall
    )
    endoscope = Calibration(camera, usual)
    watching = check_observers(observers)
    scans: list[_Scan] = []
    refused: dict[str, str] = {}

    def scan_all() -> Generator[Iterate, None, Status]:
        for done, frame in enumerate(frames, 1):
            if not isinstance(frame, Frame):
                raise ValueError(f"frames must be several of Frame, got {excerpt(frame)}")
            try:
                scans.append((yield from _scan(frame, endoscope)))
            except NoColour as error:
                refused[frame.name] = f"{frame.name}: its colours tell nothing ({error})"
            except ValueError as error:
                refused[frame.name] = str(error)
            if progress is not None:
                progress(done, frame.name)
        return Status.CONVERGED

    with close_observers(watching):
        status = drive(scan_all(), watching, lambda *_: None)
    if not scans:
        why = "it was stopped" if status is Status.STOPPED else "there is none"
        raise ValueError(
            f"no frame tells of the light: {next(iter(refused.values()), why)}"
        )
    return _estimate(scans, refused, usual, status)


# One frame ------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Scan:
    """What one frame costs under each of EXPONENTS."""

    name: str
    costs: FloatArray  # (K,), c, its least being 0
    spread: float  # standard deviation of log cos α
    shape: FloatArray  # (H, W), log d but for its mean and what goes with log cos α; nan where unknown


def _scan(frame: Frame, calibration: Calibration) -> Generator[Iterate, None, _Scan]:
    """Solve a frame under every k; the iterates are yielded."""
    if frame.image.ndim == 2:
        raise NoColour("the picture is grey")
    surfaces = yield from _solve_for_all_k(frame, calibration)
    costs = np.array([_cost(surface) for surface in surfaces])
    middle = surfaces[EXPONENT_SEARCH.first]
    mask = middle.mask
    v = middle.log_distance[mask]
    fall = np.log(middle.problem.field.cos_alpha[mask])
    if not (np.all(np.isfinite(costs)) and np.ptp(fall) > 0):
        raise ValueError(f"{frame.name}: its surface has no contrast")
    shape = np.full(mask.shape, np.nan)
    shape[mask] = v - np.polyval(np.polyfit(fall, v, 1), fall)
    return _Scan(frame.name, costs - costs.min(), float(fall.std()), shape)


def _solve_for_all_k(
    frame: Frame, calibration: Calibration
) -> Generator[Iterate, None, list[Iterate]]:
    """Return the surface under every k, from a middle one outwards, indirect light removed each time."""
    settings = Settings(
        width=min(EXPONENT_SEARCH.width, frame.width),
        smooth=EXPONENT_SEARCH.smooth,
        highlights="ignore",
    )
    check_frame(frame, calibration, settings)
    problem = problem_of_frame(frame, calibration, settings)
    albedo = known_albedo(calibration)
    first = EXPONENT_SEARCH.first
    found = yield from separate(_under(problem, EXPONENTS[first]), albedo, False)
    surfaces = {first: found.trial.surface}
    for index in (*range(first + 1, len(EXPONENTS)), *reversed(range(first))):
        neighbour = surfaces[index - 1 if index > first else index + 1]
        k = EXPONENTS[index]
        moved = _move_sides(neighbour, k)
        trial = yield from separate_from(_under(problem, k), albedo, moved)
        surfaces[index] = trial.surface
    return [surface for _, surface in sorted(surfaces.items())]


def _under(problem: Problem, k: float) -> Problem:
    """Return the same picture under a light of another k."""
    lit = [
        replace(colour, photometry=replace(colour.photometry, k=float(k)))
        for colour in problem.colours
    ]
    return replace(lit[1], colours=tuple(lit))


def _move_sides(surface: Iterate, k: float) -> FloatArray:
    """Log-distance of a surface of the same slants that makes the same picture under another k."""
    problem = surface.problem
    cosine = np.where(problem.mask, problem.field.cos_alpha, 1.0)
    return surface.log_distance + 0.5 * (k - problem.photometry.k) * np.log(cosine)


def _cost(surface: Iterate) -> float:
    """What a surface costs for its contrast, c."""
    nearness = 1 / surface.distance[surface.mask]
    contrast = nearness.std() / nearness.mean()
    with np.errstate(divide="ignore"):
        cost = np.log(surface.energy) - EXPONENT_SEARCH.contrast * np.log(contrast)
    return float(cost)


# All of them ----------------------------------------------------------------------------


def _weights(shapes: Sequence[FloatArray]) -> FloatArray:
    """What each of several frames counts: two that show one place count half each."""
    correlation = np.eye(len(shapes))
    for i, j in combinations(range(len(shapes)), 2):
        both = np.isfinite(shapes[i]) & np.isfinite(shapes[j])
        alike = max(0.0, np.corrcoef(shapes[i][both], shapes[j][both])[0, 1])
        correlation[i, j] = correlation[j, i] = alike**EXPONENT_SEARCH.same
    return np.asarray(1 / correlation.sum(axis=1))


def _likelihood(k: FloatArray, scans: Sequence[_Scan], weights: FloatArray) -> FloatArray:
    """How likely every k is, per unit of k, (N,)."""
    step = EXPONENT_SEARCH.step

    def blur(density: FloatArray, width: float) -> FloatArray:
        smooth = np.asarray(gaussian_filter1d(density, width / step, mode="constant"))
        return smooth / (smooth.sum() * step)

    total = np.zeros(len(k))
    wrong = EXPONENT_SEARCH.wrong
    for scan, weight in zip(scans, weights, strict=True):
        cost = PchipInterpolator(EXPONENTS, scan.costs)(k)
        alone = np.exp(-(cost - cost.min()) / EXPONENT_SEARCH.temperature)
        alone = blur(alone, EXPONENT_SEARCH.aside / scan.spread)
        total += weight * np.log((1 - wrong) * alone + wrong / (k[-1] - k[0]))
    return blur(np.exp(total - total.max()), EXPONENT_SEARCH.alike)


def _estimate(
    scans: Sequence[_Scan], refused: dict[str, str], usual: Photometry, status: Status
) -> LightEstimate:
    """What the frames tell together."""
    weights = _weights([scan.shape for scan in scans])
    steps = round(EXPONENTS[-1] / EXPONENT_SEARCH.step)
    k = np.linspace(0.0, EXPONENTS[-1], steps + 1)
    likelihood = _likelihood(k, scans, weights)
    share = np.cumsum(likelihood) * EXPONENT_SEARCH.step
    low, below, middle, above, high = np.interp(
        [0.025, 0.16, 0.5, 0.84, 0.975], share, k
    ).tolist()
    error = (above - below) / 2
    frames = f"{len(scans)} frame{'' if len(scans) == 1 else 's'}"
    found = f"{middle:.1f} ± {error:.1f}, by {frames}"
    taken = middle
    if k[np.argmax(likelihood)] > EXPONENTS[-2]:  # at its bound, as good as
        outcome = "not found"
        why = f"it would be {k[-1]:g} or more"
    elif error > EXPONENT_SEARCH.roughly:
        outcome = "not found"
        why = f"{low:.1f} to {high:.1f} are likely"
    elif error > EXPONENT_SEARCH.found:
        outcome = "roughly"
        precision = [error**-2, EXPONENT_SEARCH.usual_error**-2]
        taken = float(np.average([middle, usual.k], weights=precision))
        verdict = (
            f"The light falls off with k = roughly {found}; with {usual.k:g} in mind, "
            f"{taken:.1f} is taken."
        )
    else:
        outcome = "found"
        verdict = f"The light falls off with k = {found}."
    if outcome == "not found":
        verdict = f"k is not found: by {frames}, {why}; {usual.k:g} is taken."
    else:
        usual = replace(usual, k=round(taken, 2))
    if weights.sum() < 0.75 * len(scans):
        verdict += f" They show much the same, and count as {weights.sum():.1f}."
    return LightEstimate(
        k=middle,
        standard_error=error,
        interval=(low, high),
        outcome=outcome,
        verdict=f"{verdict} They do not tell γ, taken to be {usual.gamma:g}.",
        photometry=usual,
        exponents=freeze(EXPONENTS.copy()),
        costs=freeze(np.array([scan.costs for scan in scans])),
        places=float(weights.sum()),
        names=tuple(scan.name for scan in scans),
        refused=refused,
        status=status,
    )
