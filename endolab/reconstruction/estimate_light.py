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
and lamps: as a likelihood, exp(-c/T), blurred by .08 over the spread of log cos α. Frames that show
other places err independently, and their likelihoods multiply; what is common to all, a smooth straight
tube everywhere, say, blurs the product once more. The middle of what is left, its width, and a verdict
are the answer. It is one for cavities: a single flat wall before a pinhole looks like a k that is 2 larger.

γ is not told: of any two, the energy prefers the smaller, which leaves less contrast.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
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
from endolab.numerics.checks import check_kinds, excerpt
from endolab.numerics.iteration import finish
from endolab.reconstruction.colours import NoColour, prior_of
from endolab.reconstruction.light_and_contours import separate, separate_from
from endolab.reconstruction.problem_of_frame import check_frame, problem_of_frame
from endolab.reconstruction.report import light_verdict
from endolab.reconstruction.settings import Settings
from endolab.solvers.problem import Problem

EXPONENTS = np.linspace(0.0, 5.0, 11)  # k that are tried; endoscopes have 0.5 to 3.5


@dataclass(frozen=True, eq=False)
class LightEstimate:
    """What frames tell of the light's fall-off.

    `photometry` is ready to reconstruct with: it has the k that was found, or else that of the paper's
    endoscope, and the mean of both, by their errors, if k was found roughly; its gain is unknown.
    """

    k: float  # joint exponent of lamp and lens: half of the likelihood is below
    standard_error: float  # half the width of its middle 68 %
    interval: tuple[float, float]  # its middle 95 %
    outcome: str  # "found", "roughly" or "not found"
    photometry: Photometry
    exponents: FloatArray  # (K,), those that were tried
    costs: FloatArray  # (F, K), c of every frame, its least being 0
    places: float  # as many independent frames the frames are worth
    names: tuple[str, ...]  # of the F frames
    refused: dict[str, str]  # names of others, and why, in a sentence

    @property
    def verdict(self) -> str:
        """The outcome in a sentence."""
        return light_verdict(self)

    @property
    def evidence(self) -> dict[str, Any]:
        """All of it in plain numbers, for `endoscope.json`."""
        record = asdict(self) | {"verdict": self.verdict}
        for other in ("photometry", "names"):
            del record[other]
        record["exponents"] = self.exponents.tolist()
        costs = np.round(self.costs, 4).tolist()
        record["costs"] = dict(zip(self.names, costs, strict=True))
        return {"unknown_light": record}


@check_kinds(frames=Iterable, camera=Camera)
def estimate_light(
    frames: Iterable[Frame],
    camera: Camera,
    *,
    gamma: float = 2.2,
    albedo: ArrayLike | None = None,
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
    wall = Lambertian() if albedo is None else Lambertian(albedo)  # type: ignore[arg-type]
    usual = Photometry(2.5, gamma, None, wall)
    endoscope = Calibration(camera, usual)
    scans: list[_Scan] = []
    refused: dict[str, str] = {}
    for done, frame in enumerate(frames, 1):
        if not isinstance(frame, Frame):
            raise ValueError(f"frames must be several of Frame, got {excerpt(frame)}")
        try:
            scans.append(_scan(frame, endoscope))
        except NoColour as error:
            refused[frame.name] = f"{frame.name}: its colours tell nothing ({error})"
        except ValueError as error:
            refused[frame.name] = str(error)
        if progress is not None:
            progress(done, frame.name)
    if not scans:
        why = next(iter(refused.values()), "there is none")
        raise ValueError(f"no frame tells of the light: {why}")
    return _estimate(scans, refused, usual)


# One frame ------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Scan:
    """What one frame costs under each of EXPONENTS."""

    name: str
    costs: FloatArray  # (K,), c, its least being 0
    spread: float  # standard deviation of log cos α
    shape: FloatArray  # (H, W), log d but for its mean and what goes with log cos α; nan where unknown


def _scan(frame: Frame, calibration: Calibration) -> _Scan:
    """Solve a frame under every k, from a middle one outwards."""
    if frame.image.ndim == 2:
        raise NoColour("the picture is grey")
    # It is the surface's large shape that tells; more blur makes dark lumens brighter and k smaller.
    settings = Settings(width=min(200, frame.width), smooth=1.0, highlights="ignore")
    check_frame(frame, calibration, settings)
    colours = problem_of_frame(frame, calibration, settings).colours
    prior = prior_of(calibration)
    fall = np.log(np.where(colours[1].mask, colours[1].field.cos_alpha, 1.0))

    def under(k: float) -> Problem:
        lit = [replace(c, photometry=replace(c.photometry, k=float(k))) for c in colours]
        return replace(lit[1], colours=tuple(lit))

    first = 4  # of EXPONENTS: 2
    found = finish(separate(under(EXPONENTS[first]), prior, False))
    surfaces = {first: found.trial.surface}
    for index in (*range(first + 1, len(EXPONENTS)), *reversed(range(first))):
        neighbour = index - 1 if index > first else index + 1
        # The surface of the same slants that makes the same picture under another k.
        moved = 0.5 * (EXPONENTS[index] - EXPONENTS[neighbour]) * fall
        start = surfaces[neighbour].log_distance + moved
        trial = finish(separate_from(under(EXPONENTS[index]), prior, start))
        surfaces[index] = trial.surface

    costs = np.zeros(len(EXPONENTS))
    for index, surface in surfaces.items():
        nearness = 1 / surface.distance[surface.mask]
        with np.errstate(divide="ignore"):
            contrast = np.log(nearness.std() / nearness.mean())
        costs[index] = np.log(surface.energy) - 0.5 * contrast
    mask = surfaces[first].mask
    v = surfaces[first].log_distance[mask]
    fall = fall[mask]
    if not (np.all(np.isfinite(costs)) and np.ptp(fall) > 0):
        raise ValueError(f"{frame.name}: its surface has no contrast")
    shape = np.full(mask.shape, np.nan)
    shape[mask] = v - np.polyval(np.polyfit(fall, v, 1), fall)
    return _Scan(frame.name, costs - costs.min(), float(fall.std()), shape)


# All of them ----------------------------------------------------------------------------


def _estimate(
    scans: Sequence[_Scan], refused: dict[str, str], usual: Photometry
) -> LightEstimate:
    """What the frames tell together."""
    # Of several frames that show one place each counts less: of two, half.
    alike = np.eye(len(scans))
    for i, j in combinations(range(len(scans)), 2):
        one, other = scans[i].shape, scans[j].shape
        both = np.isfinite(one + other)
        correlation = np.corrcoef(one[both], other[both])[0, 1]
        # It is 0.98 of neighbours, 0.5 of others.
        alike[i, j] = alike[j, i] = max(0.0, correlation) ** 8
    weights = 1 / alike.sum(axis=1)

    step = 0.05  # of the k whose likelihood is told

    def blur(density: FloatArray, width: float) -> FloatArray:
        smooth = np.asarray(gaussian_filter1d(density, width / step, mode="constant"))
        return smooth / (smooth.sum() * step)

    # How likely every k is, per unit of k. T and the widths make the true k of 31 path-traced frames
    # likeliest. The widths are what shapes pretend: of the part of a frame's log light that looks like log
    # cos α, as a fraction of the spread of that; and of k, for all frames of an endoscope together.
    k = np.linspace(0.0, EXPONENTS[-1], round(EXPONENTS[-1] / step) + 1)
    wrong = 0.05  # of frames, which tell nothing of k: fog, a wall with a pattern
    total = np.zeros(len(k))
    for scan, weight in zip(scans, weights, strict=True):
        cost = PchipInterpolator(EXPONENTS, scan.costs)(k)
        alone = blur(np.exp(-(cost - cost.min()) / 0.03), 0.08 / scan.spread)
        total += weight * np.log((1 - wrong) * alone + wrong / k[-1])
    likelihood = blur(np.exp(total - total.max()), 0.3)
    below = np.cumsum(likelihood) * step
    levels = [0.025, 0.16, 0.5, 0.84, 0.975]
    low, less, middle, more, high = np.interp(levels, below, k).tolist()
    error = (more - less) / 2

    taken, outcome = middle, "found"
    # Knowing nothing, the error is 1.7. Or at its bound, as good as.
    if error > 1.0 or k[np.argmax(likelihood)] > EXPONENTS[-2]:
        taken, outcome = usual.k, "not found"
    elif error > 0.5:
        precision = [error**-2, 1.0]  # the usual k is off by 1
        taken, outcome = float(np.average([middle, usual.k], weights=precision)), "roughly"
    return LightEstimate(
        k=middle,
        standard_error=error,
        interval=(low, high),
        outcome=outcome,
        photometry=replace(usual, k=round(taken, 2)),
        exponents=freeze(EXPONENTS.copy()),
        costs=freeze(np.array([scan.costs for scan in scans])),
        places=float(weights.sum()),
        names=tuple(scan.name for scan in scans),
        refused=refused,
    )
