"""Checks of notebook 05: a Gauss-Newton step of one's own, and what different regularisers prefer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from endolab.course.verdict import Wrong, verdict
from endolab.datasets.known_endoscopes import load_calibration
from endolab.depth.energy import energy_terms, model_image
from endolab.depth.problem import Problem
from endolab.io.descriptions import Calibration
from endolab.model.surface import XI, to_xi
from endolab.numerics.arrays import FloatArray
from endolab.numerics.derivatives import hessian
from endolab.preprocessing.frame import Frame
from endolab.reconstruction.problem_setup import make_problem
from endolab.reconstruction.reconstruct import reconstruct
from endolab.synthetic.rendering import render
from endolab.synthetic.scenes import SCENES

WIDTH = 160  # px: of the notebook's frames
SMALL = 12  # px: of a frame whose normal equations are small enough to be written out
NUDGE = 1e-6  # of log d, for difference quotients
SAME = 0.02  # of a step, or of a number: what rounding and difference quotients may change
SHARES = 0.5 ** np.arange(12)  # of a step, as it is halved
HEAVY, FINE = 1000.0, 1e-4  # λ of exercise 1, ε of exercise 2

# What to say of a step whose matrix and whose gradient lack this: λ, W, V, all of J's or of B's. The matrix
# may also be of Jᵀ (ᵀ), the unit matrix (I) or no more than its diagonal (D).
MISTAKES = {
    "The matrix has λ and the gradient has none.": ("", "λ"),
    "The gradient has λ and the matrix has none.": ("λ", ""),
    "Where is λ? It multiplies all that comes from B.": ("λ", "λ"),
    "The data's part of the matrix is JWJᵀ: its rows are residuals. The unknowns are pixels.": ("ᵀ", ""),
    "W is missing: large residuals pull as if no Huber held them.": ("W", "W"),
    "W is in the gradient and missing in the matrix.": ("W", ""),
    "W is in the matrix and missing in the gradient.": ("", "W"),
    "V is missing: then edges count as much as all else, and a crease by its square.": ("V", "V"),
    "V is in the gradient and missing in the matrix.": ("V", ""),
    "V is in the matrix and missing in the gradient.": ("", "V"),
    "The regulariser has a residual of its own, Dξ, and the gradient lacks it: so far the map is only kept "
    "from moving, nothing draws it to a smoother one.": ("", "B"),
    "The regulariser is in the gradient and missing in the matrix.": ("B", ""),
    "The regulariser is missing altogether.": ("B", "B"),
    "The gradient lacks the data's part: the step only smooths.": ("", "J"),
    "That is steepest descent: no equations were solved.": ("I", ""),
    "Only the diagonal of the matrix was used, so that no pixel knows of its neighbours.": ("D", ""),
}

Step = Callable[..., FloatArray]
Residuals = Callable[[FloatArray], tuple[FloatArray, FloatArray]]


# A step of one's own ---------------------------------------------------------------------


@dataclass(frozen=True)
class _Small:
    """A frame of few pixels: its energy of a flat map v, as residuals and their weights."""

    problem: Problem
    truth: FloatArray  # v, flat

    @classmethod
    def of(cls, scene: str, lam: float) -> _Small:
        problem, distance = _posed(scene, SMALL)
        return cls(replace(problem, lam=lam), np.log(distance).ravel())

    def data(self, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        problem = self.problem
        e = (model_image(problem, v.reshape(problem.mask.shape)) - problem.image).ravel()
        return e, 1 / np.maximum(np.abs(e) / problem.threshold, 1)

    def bend(self, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        problem = self.problem
        x = to_xi(v.reshape(problem.mask.shape), problem.xi, problem.field.cos_alpha) / problem.xi_median
        s = hessian(x, problem.mask) * problem.derivative_scale
        weight = problem.edge_weight / np.maximum(np.linalg.norm(s, axis=0), problem.epsilon)
        return s.ravel(), np.tile(weight.ravel(), 3)

    def cost(self, v: FloatArray) -> float:
        return sum(energy_terms(self.problem, v.reshape(self.problem.mask.shape)).values())


@cache
def _posed(
    scene: str, width: int, camera: str = "simple", epsilon: float = 1e-3
) -> tuple[Problem, FloatArray]:
    """A scene as the notebook poses it, with its true distance."""
    frame, known, distance = _seen(scene, width, camera)
    return make_problem(frame, known, smooth=0, epsilon=epsilon), distance


@cache
def _seen(scene: str, width: int, camera: str = "simple") -> tuple[Frame, Calibration, FloatArray]:
    """A rendered scene, what is known of its endoscope, and its true distance."""
    known = load_calibration(camera, width)
    view = render(SCENES[scene], known.camera, known.photometry)
    return Frame(view.image, view.mask), replace(known, photometry=view.photometry), view.distance


def _jacobian(residuals: Residuals, v: FloatArray) -> FloatArray:
    """Derivative of residuals by v, (residuals, pixels), by difference quotients."""
    here = residuals(v)[0]
    nudged = (residuals(v + NUDGE * unit)[0] for unit in np.eye(v.size))
    return np.stack([(there - here) / NUDGE for there in nudged], axis=1)


def _steps(small: _Small, v: FloatArray) -> tuple[FloatArray, dict[str, FloatArray]]:
    """The step δ of the normal equations, and those of `MISTAKES`."""
    (e, w), (s, u) = small.data(v), small.bend(v)
    j, b = _jacobian(small.data, v), _jacobian(small.bend, v)
    found: list[FloatArray] = []
    for in_matrix, in_gradient in [("", ""), *MISTAKES.values()]:
        terms = []
        for lacks in (in_matrix, in_gradient):
            weight, smooth = 1 if "W" in lacks else w, 1 if "V" in lacks else u
            lam = 0.0 if "B" in lacks else 1.0 if "λ" in lacks else small.problem.lam
            terms.append((np.ones_like(w) * weight * ("J" not in lacks), np.ones_like(u) * smooth * lam))
        (weight, smooth), (pull, smooth_pull) = terms
        rows = j.T if "ᵀ" in in_matrix else j
        matrix = rows.T @ (weight[:, None] * rows) + b.T @ (smooth[:, None] * b)
        gradient = j.T @ (pull * e) + b.T @ (smooth_pull * s)
        matrix = np.eye(v.size) if "I" in in_matrix else matrix
        matrix = np.diag(np.diag(matrix)) if "D" in in_matrix else matrix
        found.append(np.asarray(np.linalg.solve(matrix, -gradient), dtype=np.float64))
    return found[0], dict(zip(MISTAKES, found[1:], strict=True))


def _after(step: Step, small: _Small, v: FloatArray) -> FloatArray:
    """What a step makes of v."""
    given = v.copy()
    try:
        new = step(given, small.data, small.bend, small.cost, small.problem.lam)
    except ValueError as error:
        raise Wrong(
            f"NumPy gives up (*{error}*). J has a row for each residual and a column for each pixel; so has "
            "B, of three times as many rows. The matrix has a row and a column for each pixel."
        ) from error
    if not np.array_equal(given, v):
        raise Wrong(
            "The map that was given has been changed in place: work on a copy, and return the new map."
        )
    if new is None:
        raise Wrong("The function returns nothing: return the new map.")
    if np.shape(new) != v.shape or not np.isfinite(new).all():
        told = "not finite" if np.shape(new) == v.shape else f"of shape {np.shape(new)}"
        raise Wrong(f"The new map is {told}: it should be a flat vector like v, of shape {v.shape}.")
    return np.asarray(new, dtype=np.float64)


def _apart(move: FloatArray, delta: FloatArray) -> float:
    """How far a move is from the best share of a step, as a part of that."""
    lengths = SHARES * np.linalg.norm(delta)
    return float(min(np.linalg.norm(move - SHARES[:, None] * delta, axis=1) / lengths))


@verdict
def gauss_newton_step(step: Step) -> str:
    """Check a Gauss-Newton step, ``step(v, data, bend, cost, lam) -> v``, on a frame of 12x9 px.

    Its move is compared with that of normal equations written out, whole or halved; and the energy has to
    fall where the whole step would overshoot.
    """
    small = _Small.of("tube", lam=0.1)
    v = small.truth + 0.1 * np.random.default_rng(0).normal(size=small.truth.size)
    new = _after(step, small, v)
    delta, mistakes = _steps(small, v)
    if _apart(new, delta) < SAME:
        raise Wrong("That is δ itself: the new map is v plus (a share of) δ.")
    move = new - v
    if np.linalg.norm(move) < 1e-3 * np.linalg.norm(delta):
        raise Wrong("The map stays where it is: no share of δ lowers the energy. Has δ the right sign?")
    if _apart(move, -delta) < SAME:
        raise Wrong("It goes the right way backwards: δ solves (matrix) δ = **minus** the gradient.")
    off = _apart(move, delta)
    if off > SAME:
        sentence = min(mistakes, key=lambda one: _apart(move, mistakes[one]))
        if _apart(move, mistakes[sentence]) < SAME:
            raise Wrong(sentence)
        angle = np.degrees(np.arccos(move @ delta / np.linalg.norm(move) / np.linalg.norm(delta)))
        length = np.linalg.norm(move) / np.linalg.norm(delta)
        raise Wrong(
            f"The move is not that of (JᵀWJ + λ BᵀVB) δ = −(JᵀW e + λ BᵀV Dξ): {angle:.0f}° from it, "
            f"{length:.2g} times as long. If your formula is this one: are the Jacobian's differences small "
            "enough (1e-6), and is nothing added to the matrix?"
        )
    far = small.problem.log_facing.ravel() + np.log(2)  # twice d₀, from where the whole step overshoots
    before, after = small.cost(far), small.cost(_after(step, small, far))
    if after >= before:
        raise Wrong(
            f"The step is right, but from twice d₀ the energy goes from {before:.2g} to {after:.2g}: the "
            "parabola holds only nearby. Halve δ until the energy falls."
        )
    fall = small.cost(new) / small.cost(v)
    return (
        f"That is the step of the normal equations, to {off:.0e} of its length. It takes the energy to "
        f"{fall:.0%} of what it was; and from twice d₀, where the whole step would raise it, to "
        f"{after / before:.0%}."
    )


# What regularisers prefer ----------------------------------------------------------------


def _percent(scene: str, **options: object) -> FloatArray:
    """Errors of a reconstructed scene's distance, %."""
    frame, known, distance = _seen(scene, WIDTH)
    found = reconstruct(frame, known, channel="green", smooth=0, **options)  # type: ignore[arg-type]
    return 100 * np.abs(found.distance / distance - 1)


def _is(found: float, expected: float) -> bool:
    return bool(abs(found - expected) <= SAME * abs(expected) + 1e-3)


def _judge_error(name: str, found: float, right: FloatArray, **others: FloatArray) -> None:
    """Raise what is wrong with a mean error in per cent; `others` are errors of runs with other options."""
    mean = float(np.mean(right))
    if _is(found, mean):
        return
    if _is(100 * found, mean):
        raise Wrong(f"{name}: that is a share, not per cent: times 100.")
    if _is(found, float(np.max(right))):
        raise Wrong(f"{name}: that is the largest error of all pixels; the mean is asked for.")
    if _is(found, float(np.median(right))):
        raise Wrong(f"{name}: that is the median; the mean is asked for.")
    for told, errors in others.items():
        if _is(found, float(np.mean(errors))):
            raise Wrong(f"{name}: that is the error with {told.replace('_', ' ')}.")
    raise Wrong(f"{name}: {found:.3g} % is not what this run leaves.")


def _bend(camera: str, xi: str) -> float:
    """Mean size of the Hessian of a plane's ξ, in units of ξ's median; of pixels well inside the picture."""
    problem, distance = _posed("plane", WIDTH, camera)
    inside = problem.mask & (problem.field.cos_alpha > np.cos(np.radians(40)))
    x = to_xi(np.log(distance), xi, problem.field.cos_alpha)
    sizes = np.linalg.norm(hessian(x / np.median(x[inside]), inside), axis=0)
    return float(np.mean(sizes[inside]))


@verdict
def exercise_1(errors: Mapping[str, float], unmoved: str, fisheye: bool) -> str:
    """Check which ξ of a plane a heavy λ does not move, and whether that holds in a fisheye.

    Parameters
    ----------
    errors : mapping of each ξ to the mean error of the distance at λ = 1000, %
    unmoved : the ξ that does not mind
    fisheye : whether it would mind with the paper's fisheye
    """
    if set(errors) != set(XI):
        raise Wrong(f"The errors should be those of {', '.join(XI)}; found {', '.join(errors) or 'none'}.")
    for xi in XI:
        right = _percent("plane", xi=xi, regulariser="second", lam=HEAVY)
        if not _is(errors[xi], float(np.mean(right))):
            light = _percent("plane", xi=xi, regulariser="second")
            first = _percent("plane", xi=xi, regulariser="first", lam=HEAVY)
            _judge_error(xi, errors[xi], right, **{"λ_=_1": light, "first_order": first})
    if unmoved != min(errors, key=lambda xi: errors[xi]):
        raise Wrong(f"Your own errors name another ξ than {unmoved!r}: which is the smallest?")
    bends = {camera: _bend(camera, unmoved) for camera in ("simple", "paper")}
    minds = bends["paper"] > 100 * bends["simple"]
    if bool(fisheye) is not minds:
        raise Wrong(
            "In a pinhole 1/z of a plane is linear in the pixel. Is a pixel of a fisheye, too, at x = X/Z?"
        )
    return (
        f"Second differences of the plane's {unmoved} are {bends['simple']:.0e} of its size in the pinhole, "
        f"which is rounding, and {bends['paper']:.0e} in the fisheye: there it minds."
    )


@verdict
def exercise_2(
    error: float, costs: Mapping[float, float], smoothest: float, family: Mapping[float, FloatArray]
) -> str:
    """Check what ε = 1e-4 does to the tube and to the family of its surfaces.

    Parameters
    ----------
    error : mean error of the distance, %
    costs : mapping of each ω to what the regulariser charges for that surface
    smoothest : the ω that it charges least for
    family : mapping of each ω to its map of v = log d, as in the notebook
    """
    fine = _percent("tube", regulariser="second", epsilon=FINE)
    usual = _percent("tube", regulariser="second")
    _judge_error("The error", error, fine, **{"ε_=_0.001": usual})
    if set(costs) != set(family):
        raise Wrong("The costs should have one number for each ω of the family.")

    def charged(epsilon: float, term: str) -> FloatArray:
        problem = _posed("tube", WIDTH, "simple", epsilon)[0]
        terms = [energy_terms(problem, v) for v in family.values()]
        return np.array([sum(one.values()) if term == "sum" else one[term] for one in terms])

    found = np.array([costs[omega] for omega in family])
    right = charged(FINE, "regulariser")
    if not np.allclose(found, right, rtol=SAME):
        for told, (epsilon, term) in {
            "those of ε = 1e-3: give make_problem the other epsilon": (1e-3, "regulariser"),
            "the data term: it cannot choose": (FINE, "data"),
            "the whole energy: the data term is in it, too": (FINE, "sum"),
        }.items():
            if np.allclose(found, charged(epsilon, term), rtol=1e-6):
                raise Wrong(f"These are {told}.")
        raise Wrong("These costs are not the term 'regulariser' of energy_terms for each surface.")
    least = list(family)[int(right.argmin())]
    if smoothest != least:
        raise Wrong(f"Your own costs have their least elsewhere than at {smoothest:+.2f}.")
    ratio = float(np.mean(fine) / np.mean(usual))
    return (
        f"The truth is still the smoothest of the family (ω = {least:.0f}), and yet the error is {ratio:.1f} "
        "times as large: no solver is bound to the family. One parameter can show that a regulariser is "
        "wrong, not that it is right."
    )
