"""The light of an endoscope that was never calibrated, asked of the frames it took: k, by the energy.

Any k explains any frame: what it says too much of the light's fall to the side, a surface that comes
nearer at the side makes good. But that surface bends as walls do not, and the energy says so. So a frame
is solved for every k of `EXPONENTS`, each from the surface before with its sides moved by what the change
of k is worth, ½ Δk log cos α, bounced light found again each time (`separation`): a step or two each.

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
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from endolab.frames.frame import Frame
from endolab.model.brdf import Lambertian
from endolab.model.cameras import Camera
from endolab.model.endoscope import Calibration
from endolab.model.photometry import CHANNELS, Photometry
from endolab.numerics.arrays import FloatArray, freeze
from endolab.numerics.checks import excerpt, number, real_array
from endolab.numerics.iteration import Status, check_observers, close_observers, drive
from endolab.reconstruction.channels import Channel, make_channels
from endolab.reconstruction.light.colours import NoColour, known_albedo
from endolab.reconstruction.light.separation import separate, separate_from
from endolab.reconstruction.settings import Settings
from endolab.solvers.gauss_newton import gauss_newton
from endolab.solvers.provenance import Provenance
from endolab.solvers.result import Iterate, Observer, name_stage, with_provenance

LIGHT = "light"  # stage
EXPONENTS = np.linspace(0.0, 5.0, 11)  # k that are tried; endoscopes have 0.5 to 3.5


@dataclass(frozen=True)
class ExponentSearch:
    """How k is found. T and the widths make the true k of 31 path-traced frames likeliest.

    Pairs are for frames in colour, and without.
    """

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
    aside: tuple[float, float] = (0.08, 0.15)
    alike: tuple[float, float] = (0.3, 0.5)
    wrong: float = 0.05  # of frames, which tell nothing of k: fog, a wall with a pattern
    # Power of two shapes' correlation to which they are one place; 0.98 of neighbours,
    # 0.5 of others.
    same: float = 8.0
    step: float = 0.05  # of the k whose likelihood is told
    found: float = 0.5  # standard error up to which k is found; knowing nothing: 1.7
    roughly: float = 1.0  # likewise, found roughly
    edge: float = 0.5  # from the greatest k, within which the likeliest is at a bound


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
    likelihood: FloatArray  # (N, 2), k and how likely it is, per unit of k
    places: float  # as many independent frames the frames are worth
    names: tuple[str, ...]  # of the F frames
    refused: dict[str, str]  # names of others, and why, in a sentence
    status: Status  # STOPPED if not all frames were asked

    @property
    def evidence(self) -> dict[str, Any]:
        """All of it in plain numbers, for `endoscope.json`."""
        plain = ("k", "standard_error", "outcome", "verdict", "places", "refused")
        record: dict[str, Any] = {name: getattr(self, name) for name in plain}
        record |= {"interval": list(self.interval), "exponents": self.exponents.tolist()}
        costs = np.round(self.costs, 4).tolist()
        return {
            "unknown_light": record | {"costs": dict(zip(self.names, costs, strict=True))}
        }


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
        Of one endoscope, in colour, so that bounced light can be told from direct; grey ones tell less.
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
    coloured: bool  # whether indirect light was removed


def _scan(frame: Frame, calibration: Calibration) -> Generator[Iterate, None, _Scan]:
    """Solve a frame under every k; the iterates are yielded."""
    coloured = frame.image.ndim == 3
    if coloured:
        try:
            surfaces = yield from _surfaces_of_colours(frame, calibration)
        except NoColour:
            coloured = False
    if not coloured:
        surfaces = yield from _surfaces_of_grey(frame, calibration)
    costs = np.array([_cost(surface) for surface in surfaces])
    mask = surfaces[EXPONENT_SEARCH.first].mask
    v = surfaces[EXPONENT_SEARCH.first].log_distance
    fall = np.log(surfaces[EXPONENT_SEARCH.first].problem.field.cos_alpha[mask])
    if not (np.all(np.isfinite(costs)) and np.ptp(fall) > 0):
        raise ValueError(f"{frame.name}: its surface has no contrast")
    line = np.polyfit(fall, v[mask], 1)
    shape = np.full(mask.shape, np.nan)
    shape[mask] = v[mask] - np.polyval(line, fall)
    return _Scan(frame.name, costs - costs.min(), float(fall.std()), shape, coloured)


Chain = Generator[Iterate, None, Iterate]


def _surfaces_of_colours(
    frame: Frame, calibration: Calibration
) -> Generator[Iterate, None, list[Iterate]]:
    """The surface under every k, indirect light removed each time."""
    settings = Settings(
        width=min(EXPONENT_SEARCH.width, frame.width),
        smooth=EXPONENT_SEARCH.smooth,
        highlights="ignore",
    )
    colours = make_channels(frame, calibration, settings, CHANNELS)
    albedo = known_albedo(calibration)

    def solve(k: float, before: Iterate | None) -> Chain:
        lit = [_under(colour, k) for colour in colours]
        if before is None:
            separation = yield from separate(lit, albedo, False)
        else:
            separation = yield from separate_from(lit, albedo, _move_sides(before, k))
        return separation.surface

    return (yield from _solve_for_all_k(solve))


def _surfaces_of_grey(
    frame: Frame, calibration: Calibration
) -> Generator[Iterate, None, list[Iterate]]:
    """The surface under every k, all light being taken for direct."""
    settings = Settings(
        width=min(EXPONENT_SEARCH.width, frame.width), smooth=EXPONENT_SEARCH.smooth
    )
    (channel,) = make_channels(frame, calibration, settings, [None])
    provenance = Provenance(preparation=channel.report)

    def solve(k: float, before: Iterate | None) -> Chain:
        start = None if before is None else _move_sides(before, k)
        number = int(np.argmin(np.abs(EXPONENTS - k))) + 1
        solver = gauss_newton(_under(channel, k).problem, start=start)
        return (yield from name_stage(with_provenance(solver, provenance), LIGHT, number))

    return (yield from _solve_for_all_k(solve))


def _solve_for_all_k(
    solve: Callable[[float, Iterate | None], Chain],
) -> Generator[Iterate, None, list[Iterate]]:
    """Solve for every k, from FIRST outwards, each from its neighbour's surface."""
    first = yield from solve(float(EXPONENTS[EXPONENT_SEARCH.first]), None)
    up = [first]
    down = [first]
    for k in EXPONENTS[EXPONENT_SEARCH.first + 1 :]:
        up.append((yield from solve(float(k), up[-1])))
    for k in EXPONENTS[: EXPONENT_SEARCH.first][::-1]:
        down.append((yield from solve(float(k), down[-1])))
    return [*down[:0:-1], *up]


def _under(channel: Channel, k: float) -> Channel:
    problem = channel.problem
    return replace(
        channel, problem=replace(problem, photometry=replace(problem.photometry, k=k))
    )


def _move_sides(surface: Iterate, k: float) -> FloatArray:
    """Log-distance of a surface of the same slants that makes the same picture under another k."""
    problem = surface.problem
    cosine = np.where(problem.mask, problem.field.cos_alpha, 1.0)
    return surface.log_distance + 0.5 * (k - problem.photometry.k) * np.log(cosine)


def _cost(surface: Iterate) -> float:
    """What a surface costs for its contrast, c."""
    nearness = 1 / surface.distance[surface.mask]
    with np.errstate(divide="ignore"):
        return float(
            np.log(surface.energy)
            - EXPONENT_SEARCH.contrast * np.log(nearness.std() / nearness.mean())
        )


# All of them ----------------------------------------------------------------------------


def _weights(shapes: Sequence[FloatArray]) -> FloatArray:
    """What each of several frames counts: two that show one place count half each."""
    correlation = np.eye(len(shapes))
    for i, shape in enumerate(shapes):
        for j, other in enumerate(shapes[:i]):
            both = (
                np.isfinite(shape) & np.isfinite(other)
                if shape.shape == other.shape
                else np.zeros(1, bool)
            )
            if both.sum() > 1 and min(shape[both].std(), other[both].std()) > 0:
                correlation[i, j] = correlation[j, i] = (
                    max(np.corrcoef(shape[both], other[both])[0, 1], 0.0)
                    ** EXPONENT_SEARCH.same
                )
    return np.asarray(1 / correlation.sum(axis=1))


def _likelihood(scans: Sequence[_Scan], weights: FloatArray, coloured: bool) -> FloatArray:
    """How likely every k is, (N, 2): k, and per unit of k."""
    k = np.linspace(
        EXPONENTS[0],
        EXPONENTS[-1],
        round((EXPONENTS[-1] - EXPONENTS[0]) / EXPONENT_SEARCH.step) + 1,
    )

    def blur(density: FloatArray, width: float) -> FloatArray:
        smooth = np.asarray(
            gaussian_filter1d(density, width / EXPONENT_SEARCH.step, mode="constant")
        )
        return smooth / (smooth.sum() * EXPONENT_SEARCH.step)

    total = np.zeros(len(k))
    for scan, weight in zip(scans, weights, strict=True):
        cost = PchipInterpolator(EXPONENTS, scan.costs)(k)
        says = blur(
            np.exp(-(cost - cost.min()) / EXPONENT_SEARCH.temperature),
            EXPONENT_SEARCH.aside[not coloured] / scan.spread,
        )
        total += weight * np.log(
            (1 - EXPONENT_SEARCH.wrong) * says + EXPONENT_SEARCH.wrong / (k[-1] - k[0])
        )
    return np.stack(
        [k, blur(np.exp(total - total.max()), EXPONENT_SEARCH.alike[not coloured])], axis=1
    )


def _estimate(
    scans: Sequence[_Scan], refused: dict[str, str], usual: Photometry, status: Status
) -> LightEstimate:
    """What the frames tell together."""
    coloured = all(scan.coloured for scan in scans)
    weights = _weights([scan.shape for scan in scans])
    likelihood = _likelihood(scans, weights, coloured)
    k = likelihood[:, 0]
    share = np.cumsum(likelihood[:, 1]) * EXPONENT_SEARCH.step
    low, below, middle, above, high = np.interp(
        [0.025, 0.16, 0.5, 0.84, 0.975], share, k
    ).tolist()
    error = (above - below) / 2
    at_bound = k[np.argmax(likelihood[:, 1])] > k[-1] - EXPONENT_SEARCH.edge
    frames = f"{len(scans)} frame{'' if len(scans) == 1 else 's'}"
    if at_bound or error > EXPONENT_SEARCH.roughly:
        outcome = "not found"
        why = (
            f"it would be {k[-1]:g} or more"
            if at_bound
            else f"{low:.1f} to {high:.1f} are likely"
        )
        verdict = f"k is not found: by {frames}, {why}; {usual.k:g} is taken."
    else:
        outcome = "found" if error <= EXPONENT_SEARCH.found else "roughly"
        taken = middle
        roughly = ""
        instead = ""
        if outcome == "roughly":
            taken = float(
                np.average(
                    [middle, usual.k], weights=[error**-2, EXPONENT_SEARCH.usual_error**-2]
                )
            )
            roughly = "roughly "
            instead = f"; with {usual.k:g} in mind, {taken:.1f} is taken"
        verdict = f"The light falls off with k = {roughly}{middle:.1f} ± {error:.1f}, by {frames}{instead}."
        usual = replace(usual, k=round(taken, 2))
    if weights.sum() < 0.75 * len(scans):
        verdict += f" They show much the same, and count as {weights.sum():.1f}."
    if not coloured:
        verdict += (
            " Not all show three colours, so that light that bounced counts as direct."
        )
    return LightEstimate(
        k=middle,
        standard_error=error,
        interval=(low, high),
        outcome=outcome,
        verdict=f"{verdict} They do not tell γ, taken to be {usual.gamma:g}.",
        photometry=usual,
        exponents=freeze(EXPONENTS.copy()),
        costs=freeze(np.array([scan.costs for scan in scans])),
        likelihood=freeze(likelihood),
        places=float(weights.sum()),
        names=tuple(scan.name for scan in scans),
        refused=refused,
        status=status,
    )
