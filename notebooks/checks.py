"""Check the answers to the exercises: right, not yet, or what is wrong, and more of it each time.

The first wrong answer is told its sign or order of magnitude, the second how far off it is, the third a hint.

Each notebook imports its own: ``from checks import quickstart as check``. An exercise is a generator that
takes an answer, and what of the notebook it rests on, and yields a `Part` for each thing that must be right.
"""

from dataclasses import dataclass, replace
from functools import cache, wraps
from math import isfinite
from types import SimpleNamespace
from typing import Any, NamedTuple

import endolab as el
import numpy as np
from endolab.model.surface import XI, to_xi
from endolab.numerics.stencils import hessian
from endolab.reconstruction.problem_of_frame import make_problem
from endolab.solvers.energy import energy_terms, model_image
from endolab.synthetic.scenes import Plane
from scipy.ndimage import minimum_filter
from scipy.optimize import brentq

NOT_YET = "Nothing here yet. Replace the dots, or the line that raises, and run the cell again."


@dataclass(frozen=True)
class Verdict:
    """What a check says; true only if the answer is right."""

    right: bool | None  # None if there is no answer yet
    words: str  # Markdown

    def __bool__(self):
        return self.right is True

    def __repr__(self):
        mark = {True: "✓", False: "✗", None: "…"}[self.right]
        return f"{mark} {self.words}"

    _repr_markdown_ = __repr__


class Part(NamedTuple):
    """One thing of an answer: a word, yes or no, a map of these, a number or an array of numbers."""

    name: str
    found: Any
    right: Any
    within: Any = 0.0  # how far off numbers may be, in the unit: one number, or one for each
    unit: str = ""

    def wrong(self, roughly=False):
        """Say how far off it is, or `roughly` which way; nothing if it is right."""
        if self.found is None:
            return f"{self.name} is None."
        if isinstance(self.right, bool):
            return "" if self.found == self.right else f"{self.name}: {self.found}, not {self.right}."
        if isinstance(self.right, str):
            return "" if self.found == self.right else f"{self.name} is not {self.found!r}."
        right = np.asarray(self.right)
        found = np.asarray(self.found, dtype=None if right.dtype == bool else float)
        if found.shape != right.shape:
            return f"{self.name} should have shape {right.shape}, and has {found.shape}."
        if right.dtype == bool:
            count = int(np.sum(found != right))
            return f"{self.name} is wrong at {count} of {right.size} pixels." if count else ""
        if np.all(np.abs(found - right) <= self.within):
            return ""
        off = float(np.max(np.abs(found - right)))
        if not isfinite(off):
            return f"{self.name} is not a finite number everywhere."
        if roughly:
            return f"{self.name} {way_off(found, right)}."
        how_far = f"{off:.2g} {self.unit}".strip()
        if right.ndim == 0:
            return f"{self.name} = {float(found):.4g} is off by {how_far}."
        return f"{self.name} is off by up to {how_far}."


def way_off(found, right):
    """Say which way numbers are off, where they are most."""
    worst = np.argmax(np.abs(found - right))
    found, right = float(found.flat[worst]), float(right.flat[worst])
    if found * right < 0:
        return "has the wrong sign"
    size = "large" if abs(found) > abs(right) else "small"
    times = max(abs(found), abs(right)) / max(min(abs(found), abs(right)), 1e-300)
    return f"is much too {size}" if times > 3 else f"is of the right size, but too {size}"


def exercise(hint):
    """Make a check of a generator of parts."""

    def decorated(parts):
        count = 0  # of wrong answers, one after the other

        @wraps(parts)
        def check(*answer):
            nonlocal count
            if any(part is ... for part in answer):
                return Verdict(None, NOT_YET)
            try:
                found = (part.wrong(roughly=count == 0) for part in parts(*answer))
                wrong = next(filter(None, found), "")
            except NotImplementedError:
                return Verdict(None, NOT_YET)
            except Exception as error:  # whatever a student's own function raises
                wrong = f"This answer ends in {type(error).__name__}: {error}."
            count = count + 1 if wrong else 0
            if not wrong:
                return Verdict(True, "Right.")
            return Verdict(False, f"{wrong} Hint: {hint}" if count > 2 else wrong)

        return check

    return decorated


def percent(distance, truth):
    """Errors of distances, %."""
    return 100 * np.abs(distance / truth - 1)


# 00 ---------------------------------------------------------------------------------------
@exercise("A gain of `None` tells no scale. How many mm is the median of `free`, divided by how many units?")
def lost_scale(free, factor, result):
    yield Part("`free.metric`", free.metric, False)
    yield Part(
        "factor", factor, each := np.nanmedian(result.distance / free.distance), 0.01 * each, "mm a unit"
    )


@exercise("Best is what errs least in the median. Light that a wall swallows does not bounce.")
def three_colours(by_channel, best, in_tissue, seen):
    off = {}
    for name in ("red", "green", "blue"):
        yield Part(f"channel of {name}", by_channel[name].report.channel, name)
        off[name] = np.nanmedian(percent(by_channel[name].distance, seen.distance))
    yield Part("best", best, min(off, key=off.get))
    albedo = dict(zip(off, seen.photometry.brdf.albedo, strict=True))
    yield Part("in_tissue", in_tissue, min(albedo, key=albedo.get))


quickstart = SimpleNamespace(exercise_1=lost_scale, exercise_2=three_colours)


# 01 ---------------------------------------------------------------------------------------
HEIGHTS = np.array([30.0, 40.0, 60.0, 80.0, 120.0])  # mm, of the planes of section 6


@exercise("rms over the distance, both on logarithmic axes; the weight is that of the lamp at x = 4 mm.")
def two_lamps(slope):
    rays = el.load_calibration("simple", 80).camera.field.rays
    for weight in (1.0, 2.0, 4.0):
        pair = tuple(el.SpotLight((x, 0, 0), exponent=1.5, weight=w) for x, w in ((-4.0, 1), (4.0, weight)))
        real, rms = el.Photometry(k=1.0, gain=1.0, lights=pair), []
        for height in HEIGHTS:
            points = Plane(height, 0.0).distance(rays)[..., None] * rays
            light, virtual = (
                one.intensity(points, [0, 0, -1.0]) ** one.gamma for one in (real, real.simplify())
            )
            rms.append(np.sqrt(np.mean((virtual / light - 1) ** 2)))
        right = np.polyfit(np.log(HEIGHTS), np.log(rms), 1)[0]
        yield Part(f"slope for weight {weight:g}", slope(weight), right, 0.03)


@exercise("Facing the camera, θ = α and d goes like 1/cos α. Set log I of both equal, up to a constant.")
def twin_brdf(twin):
    cosine = np.cos(np.deg2rad(np.arange(0.0, 71.0, 5.0)))
    brdf = 0.2 * (1 + 0.3 * np.exp(-np.arccos(cosine) / 0.2))
    for k, gamma in ((2.5, 2.2), (3.1, 2.2), (2.5, 1.8), (3.1, 1.8)):
        right = gamma / 2.2 * (5.5 * np.log(cosine) + np.log(brdf)) - (k + 3) * np.log(cosine)
        found = np.log(np.asarray(twin(brdf, cosine, 2.5, 2.2, k, gamma), dtype=float))
        name = f"log of the BRDF, less its mean, for k {k}, γ {gamma},"
        yield Part(name, found - found.mean(), right - right.mean(), 1e-9)


endoscope_model = SimpleNamespace(exercise_1=two_lamps, exercise_2=twin_brdf)


# 02 ---------------------------------------------------------------------------------------
@exercise("Four times the views leave half of the error.")
def enough_views(count, fit):
    right = len(fit.views) * (fit.standard_errors["fx"] / 0.02) ** 2
    yield Part("count", count, right, 0.12 * right, "views")


@exercise("A picture knows no mm. Distances grow as the sheet is taken for larger, and light has g/d².")
def shrunk_sheet(focal, distance, gain, *_):
    yield Part("focal", focal, 1.0, 0.002)
    yield Part("distance", distance, 1 / 0.97, 0.002)
    yield Part("gain", gain, 1 / 0.97**2, 0.005)


geometric_calibration = SimpleNamespace(exercise_1=enough_views, exercise_2=shrunk_sheet)


# 03 ---------------------------------------------------------------------------------------
@exercise("255 ((cosᵏα / d² · f_r(θ) · cos θ · g)^(1/γ) - I), each with the gain of its own frame.")
def residual(answer, samples):
    few = samples[:: max(len(samples) // 600, 1)]
    nodes, f_r = np.deg2rad([0.0, 10, 25, 45, 90]), np.array([0.41, 0.36, 0.30, 0.27, 0.24])
    gains = 3000.0 * (1 + np.arange(few.frame.max() + 1) % 7)
    light = el.Photometry(2.3, 1.9, 1.0, el.TabulatedBRDF(tuple(nodes), tuple(f_r)))
    level = light.intensity(few.points, few.normals) * gains[few.frame] ** (1 / 1.9)
    found = answer(2.3, 1.9, gains, nodes, f_r, few)
    yield Part("residual", found, 255 * (level - few.level), 1e-3, "grey levels")


ASIDE = 5.0  # mm to the left, of the lamp by which the photograph was taken


def photograph(camera, light):
    """A matt wall that faces the camera, 30 mm away, by a lamp beside the lens."""
    points = camera.field.rays * (30 / camera.field.rays[..., 2:])
    lit = replace(light.with_lamps([(-ASIDE, 0.0)]), gain=500.0, brdf=el.Lambertian())
    return lit.intensity(points, [0, 0, -1.0])


@exercise("Divide by the picture of a lamp at the lens: γ log of it is 4 x X / d², and a constant.")
def lamp_aside(side, aside):
    yield Part("side", side, "left")
    yield Part("aside", aside, ASIDE, 0.2 * ASIDE, "mm")


@exercise("I^γ falls as 1/d²: with the wrong γ, to which power does the ratio of two distances come?")
def wrong_gamma(factor):
    yield Part("factor", factor, 4 ** (2.0 / 2.2), 0.02)


photometric_calibration = SimpleNamespace(
    residual=residual, photograph=photograph, exercise_1=lamp_aside, exercise_2=wrong_gamma
)


# 04 ---------------------------------------------------------------------------------------
# A lens with h(ϑ) = 2 tan(ϑ/2), which keeps circles circles: its pixels are as wide in every direction.
STEREOGRAPHIC = (1 / 12, 1 / 120, 17 / 20160, 31 / 725760)


def pixel_angle(lens):
    """Angle that each pixel of a lens of `STEREOGRAPHIC` is wide, and high, (H, W), rad."""
    return lens.field.inverse_metric[..., 0] ** -0.5


def first_order(d0, delta):
    """Distances that a march of first order finds: all pixels are asked until nothing changes."""

    def root(lower):
        n, total = len(lower) + 4 * delta**2, sum(lower)
        inside = total**2 - n * (sum(one**2 for one in lower) - 4 * delta**2 * d0**4)
        return (total + np.sqrt(inside)) / n

    y = d0**2
    with np.errstate(invalid="ignore"):
        while True:
            around = np.pad(y, 1, constant_values=np.inf)
            across = np.minimum(around[1:-1, :-2], around[1:-1, 2:])
            along = np.minimum(around[:-2, 1:-1], around[2:, 1:-1])
            low, high = np.minimum(across, along), np.maximum(across, along)
            both, one = root((low, high)), root((low,))
            found = np.where(both >= high, both, np.where(one >= low, one, np.inf))
            if np.all(found >= y * (1 - 1e-14)):
                return np.sqrt(y)
            y = np.minimum(y, found)


@exercise("Local minima keep d₀. The lowest pixel that is not final comes next; its neighbours are updated.")
def march(answer):
    row, column = np.indices((12, 16))
    d0 = 50 + 6 * np.sin(0.8 * column) + 5 * np.cos(0.9 * row + 0.3 * column) + 0.1 * row
    delta = 0.04 + 0.001 * column + 0.002 * row
    yield Part("the distance", answer(d0.copy(), delta.copy()), first_order(d0, delta), 1e-4, "mm")


@exercise("(1/√sin β - 1) (tan 20°/tan β)² = 0.01, with β in degrees from the axis to the border.")
def half_angle(beta):
    def excess(angle):
        return (np.sin(angle) ** -0.5 - 1) * (np.tan(np.deg2rad(20)) / np.tan(angle)) ** 2 - 0.01

    right = np.rad2deg(brentq(excess, np.deg2rad(20.1), np.deg2rad(89.9)))
    yield Part("beta", beta, right, 1.0, "°")


@exercise("`inflow` takes log d at the border and on the far side of each jump in log d, and nan elsewhere.")
def error_behind_folds(error_at, seen):
    log_d = np.log(seen.distance)
    border = np.ones(log_d.shape, dtype=bool)
    border[1:-1, 1:-1] = False
    frame, known = el.Frame(seen.image, seen.mask), el.Calibration(seen.camera, seen.photometry)
    for jump in (0.08, 0.02):
        inflow = np.where(border | (log_d - minimum_filter(log_d, 3) > jump), log_d, np.nan)
        run = el.reconstruct(frame, known, solver="fast_marching", smooth=0, inflow=inflow)
        right = np.mean(percent(run.distance, seen.distance))
        yield Part(f"error for jumps of {jump}", error_at(jump), right, 0.02 * right, "%")


brightness_to_depth = SimpleNamespace(
    march=march,
    exercise_1=half_angle,
    exercise_2=error_behind_folds,
    first_order=first_order,
    pixel_angle=pixel_angle,
    STEREOGRAPHIC=STEREOGRAPHIC,
)


# 05 ---------------------------------------------------------------------------------------
@cache
def posed(scene, width, epsilon=1e-3):
    """A rendered scene as a problem, with its frame, calibration and true distance."""
    known = el.load_calibration("simple", width)
    view = el.render(el.SCENES[scene], known.camera, known.photometry)
    frame, known = el.Frame(view.image, view.mask), replace(known, photometry=view.photometry)
    return make_problem(frame, known, smooth=0, epsilon=epsilon), frame, known, view.distance


def mean_error(scene, **how):
    """Mean error of a scene's distance by Gauss-Newton in green, %."""
    _, frame, known, truth = posed(scene, 160)
    return np.mean(percent(el.reconstruct(frame, known, channel="green", smooth=0, **how).distance, truth))


def slope_of(residuals, v):
    """Derivative of residuals by a flat map, by difference quotients."""
    here = residuals(v)[0]
    return np.stack([(residuals(v + 1e-6 * unit)[0] - here) / 1e-6 for unit in np.eye(v.size)], axis=1)


@exercise("(JᵀWJ + λ BᵀVB) δ = -(JᵀWe + λ BᵀV Dξ); return v + δ, with δ halved until the energy falls.")
def gauss_newton_step(step):
    problem, _, _, truth = posed("tube", 12)
    problem = replace(problem, lam=0.1)
    shape = problem.mask.shape

    def data(v):
        e = (model_image(problem, v.reshape(shape)) - problem.image).ravel()
        return e, 1 / np.maximum(np.abs(e) / problem.threshold, 1)

    def bend(v):
        x = to_xi(v.reshape(shape), problem.xi, problem.field.cos_alpha) / problem.xi_median
        s = hessian(x, problem.mask) * problem.derivative_scale
        weight = problem.edge_weight / np.maximum(np.linalg.norm(s, axis=0), problem.epsilon)
        return s.ravel(), np.tile(weight.ravel(), len(s))

    def cost(v):
        return sum(energy_terms(problem, v.reshape(shape)).values())

    v = np.log(truth).ravel() + 0.1 * np.random.default_rng(0).normal(size=truth.size)
    (e, w), (s, u), j, b = data(v), bend(v), slope_of(data, v), slope_of(bend, v)
    matrix = j.T @ (w[:, None] * j) + 0.1 * b.T @ (u[:, None] * b)
    delta = np.linalg.solve(matrix, -j.T @ (w * e) - 0.1 * b.T @ (u * s))
    new = np.asarray(step(v.copy(), data, bend, cost, 0.1), dtype=float)
    share = min(0.5 ** np.arange(12), key=lambda one: np.linalg.norm(new - v - one * delta))
    step_of = share * delta
    yield Part("your step, new map − old,", new - v, step_of, 0.02 * np.abs(step_of).max(), "in log d")
    far = problem.log_d0.ravel() + np.log(2)  # from where the whole step overshoots
    falls = cost(step(far.copy(), data, bend, cost, 0.1)) < cost(far)
    yield Part("the energy falls from 2 d₀, where the whole step goes too far", bool(falls), True)


@exercise("1/z of a plane is linear in the pixel of a pinhole, so that its second differences are nothing.")
def heavy_lam(errors, unmoved, fisheye):
    for xi in XI:
        right = mean_error("plane", xi=xi, regulariser="second", lam=1000.0)
        yield Part(f"error of {xi}", errors[xi], right, 0.02 * right + 1e-3, "%")
    yield Part("unmoved", unmoved, "1/z")
    yield Part("fisheye", bool(fisheye), True)


@exercise("`make_problem(…, epsilon=1e-4)`, and the term 'regulariser' of `energy_terms` for each surface.")
def small_epsilon(error, costs, smoothest, family):
    right = mean_error("tube", regulariser="second", epsilon=1e-4)
    yield Part("error", error, right, 0.02 * right, "%")
    problem = posed("tube", 160, 1e-4)[0]
    charged = {omega: energy_terms(problem, v)["regulariser"] for omega, v in family.items()}
    for omega, value in charged.items():
        yield Part(f"cost of ω = {omega:.2f}", costs[omega], value, 0.02 * value)
    yield Part("smoothest", smoothest, min(charged, key=charged.get))


@exercise("`forward_gradient` of d over its median, halved; Huber of ε over ε; times w; its mean, times λ.")
def first_order_energy(data_term, regulariser):
    _, frame, known, _ = posed("tube", 160)
    problem = make_problem(frame, known, smooth=0, xi="d", regulariser="first", lam=0.03)
    terms = energy_terms(problem, problem.log_d0)
    yield Part("data term", data_term, terms["data"], 1e-3 * terms["data"])
    yield Part("regulariser", regulariser, terms["regulariser"], 1e-3 * terms["regulariser"])


convergence = SimpleNamespace(gauss_newton_step=gauss_newton_step, exercise_2=first_order_energy)
regulariser = SimpleNamespace(exercise_1=heavy_lam, exercise_2=small_epsilon)


# 06 ---------------------------------------------------------------------------------------
@exercise("Distances grow by the root of the gain. Where the median is right, what is left is bent.")
def gain_for_gamma(gain, left, why):
    yield Part("gain", gain, 1.13, 0.03)
    yield Part("left", left, 1.2, 0.3, "%")
    yield Part("why", why, "shape")


@exercise("Halve λ until the plane is right to 0.1 %. By what do 1/d of a plane's neighbours differ?")
def lam_of_a_plane(lam, charged):
    yield Part("λ", lam, 0.0083, 0.0028)
    yield Part("charged", charged, "slope")


tuner = SimpleNamespace(exercise_1=gain_for_gamma, exercise_2=lam_of_a_plane)


# 07 ---------------------------------------------------------------------------------------
@exercise(
    "`walls.exchange @ (a * walls.lit)` has bounced once, `walls.bounced_light(a)` is all that has bounced."
)
def bounced_once(once, walls):
    for a in (0.1, 0.3, 0.5, 0.75):
        right = (walls.exchange @ (a * walls.lit)).sum() / walls.bounced_light(a).sum()
        yield Part(f"share for albedo {a}", once(walls, a), right, 1e-3)


@exercise("Of all that is mirrored, how much was found? Of all that was found, how much is mirrored?")
def found_highlights(shares, sample, found):
    mirrored = sample.mirrored > 0.2 * (sample.direct + sample.indirect)[..., 1]
    both = (mirrored & found).sum()
    of_mirrored, of_found = shares
    yield Part("the share that was found", of_mirrored, both / mirrored.sum(), 1e-3)
    yield Part("the share that is right", of_found, both / found.sum(), 1e-3)


light = SimpleNamespace(exercise_1=bounced_once, exercise_2=found_highlights)


# 08 ---------------------------------------------------------------------------------------
@exercise('`channel="green"`, `width=160`, `median_distance=40`; the mean of sizes of a share, without nan.')
def treated_highlights(apart, frame, calibration):
    how = {"channel": "green", "width": 160, "median_distance": 40.0}
    ways = ("keep", "ignore", "inpaint")
    surfaces = [el.reconstruct(frame, calibration, highlights=way, **how).distance for way in ways]
    right = np.array([np.nanmean(percent(one, surfaces[2])) / 100 for one in surfaces[:2]])
    yield Part("apart", apart, right, 0.01 * right + 1e-9)


@exercise("d goes like I^(-γ/2): a ratio of distances is raised to the power by which γ has grown.")
def larger_gamma(ratios, with_gamma, usual):
    measured = []
    for gamma in (usual, 1.1 * usual):
        near, far = np.nanpercentile(with_gamma(gamma).distance, [5, 95])
        measured.append(far / near)
    right = measured[0], measured[0] ** 1.1, measured[1]
    yield Part("ratios", ratios, right, 0.002 * max(right))


real_frame = SimpleNamespace(exercise_1=treated_highlights, exercise_2=larger_gamma)


# 09 ---------------------------------------------------------------------------------------
@exercise("A pixel arrives with a step if it was more than 1 % away from its end before, and no more after.")
def last_step(last, moved, run):
    before, after = (run.depth(run.pictured[k]) for k in (-2, -1))
    right = np.abs(before / run.depth() - 1) > 0.01
    yield Part("last", last, right)
    step = np.median(np.abs(after - before)[right])
    yield Part("moved", moved, step, 1e-3 * step, "mm")


@exercise("The error is the mean of |d/d* - 1|. A curve tells if it does not fall all the way through.")
def nearest_to_truth(nearest, tellers, run, truth):
    error = {k: np.nanmean(percent(run.depth(k), truth)) for k in run.pictured}
    least = min(error.values())
    yield Part(f"the error at {nearest}", error[nearest], least, 0.01 * least, "%")
    rows = run.table()[nearest // 2 : 2 * nearest + 1]
    turns = [name for name in ("energy", "data", "change") if np.any(np.diff(rows[name]) >= 0)]
    yield Part("tellers", ", ".join(sorted(tellers)), ", ".join(sorted(turns)))


recordings = SimpleNamespace(exercise_1=last_step, exercise_2=nearest_to_truth)


# 10 ---------------------------------------------------------------------------------------
@exercise("All pixels are measured by the touched one: they inherit σ of its shape, over its distance.")
def one_touch(scales, uncertainty, result):
    share = np.where(result.mask, uncertainty.sigma_shape / result.distance, np.nan)
    right = np.array([np.nanmin(share), np.nanmax(share)])
    yield Part("scales", scales, right, 0.02 * right.min())


@exercise("The wall is smooth and has no texture: all that is left should be noise. Means of sizes, in %.")
def noisy_tube(prediction, off, frame, calibration, truth):
    right = []
    for lam in (1.0, 30.0):
        run = el.reconstruct(frame, calibration, channel="green", lam=lam)
        right.append(np.nanmean(percent(run.distance, truth)))
    yield Part("off", off, right, 0.02 * min(right), "%")
    yield Part("prediction", prediction, "more" if right[1] < right[0] else "less")


uncertainty = SimpleNamespace(exercise_1=one_touch, exercise_2=noisy_tube)
