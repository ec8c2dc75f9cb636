"""What notebook 05 says of answers."""

import numpy as np
import pytest

import endolab as el
from endolab.course import convergence as check
from endolab.depth.energy import energy_terms
from endolab.reconstruction.problem_setup import make_problem
from tests.depth.gauss_newton_model import GaussNewtonModel

PLAIN = {"channel": "green", "smooth": 0}


def jacobian(residuals, v, h=1e-6):
    here = residuals(v)[0]
    return np.stack([(residuals(v + h * unit)[0] - here) / h for unit in np.eye(v.size)], axis=1)


def halved(v, delta, cost):
    for share in 0.5 ** np.arange(10):
        if cost(v + share * delta) < cost(v):
            return v + share * delta
    return v


def right_matrix(j, b, w, u, lam):
    return j.T @ (w[:, None] * j) + lam * b.T @ (u[:, None] * b)


def right_gradient(j, b, e, s, w, u, lam):
    return j.T @ (w * e) + lam * b.T @ (u * s)


def written(matrix=right_matrix, gradient=right_gradient, ending=halved, h=1e-6):
    """A student's step."""

    def step(v, data, bend, cost, lam):
        (e, w), (s, u) = data(v), bend(v)
        j, b = jacobian(data, v, h), jacobian(bend, v, h)
        delta = np.linalg.solve(matrix(j, b, w, u, lam), -gradient(j, b, e, s, w, u, lam))
        return ending(v, delta, cost)

    return step


def no_lam(j, b, *rest):
    return right_gradient(j, b, *rest[:-1], 1.0)


def no_lam_in_matrix(j, b, w, u, _):
    return right_matrix(j, b, w, u, 1.0)


def no_data_weight(j, b, w, u, lam):
    return right_matrix(j, b, np.ones_like(w), u, lam)


def no_data_weight_in_gradient(j, b, e, s, w, u, lam):
    return right_gradient(j, b, e, s, np.ones_like(w), u, lam)


def no_smooth_weight(j, b, w, u, lam):
    return right_matrix(j, b, w, np.ones_like(u), lam)


def no_smooth_weight_in_gradient(j, b, e, s, w, u, lam):
    return right_gradient(j, b, e, s, w, np.ones_like(u), lam)


def in_place(v, delta, cost):
    v += delta
    return v


MISTAKES = [
    (written(gradient=no_lam), "gradient has none"),
    (written(matrix=no_lam_in_matrix), "matrix has none"),
    (written(no_lam_in_matrix, no_lam), "Where is λ"),
    (written(lambda j, b, *rest: right_matrix(j.T, b, *rest)), "JWJᵀ"),
    (written(lambda j, b, *rest: right_matrix(j, b.T, *rest)), "NumPy gives up"),
    (written(no_data_weight, no_data_weight_in_gradient), "W is missing"),
    (written(matrix=no_data_weight), "W is in the gradient"),
    (written(gradient=no_data_weight_in_gradient), "W is in the matrix"),
    (written(no_smooth_weight, no_smooth_weight_in_gradient), "V is missing"),
    (written(matrix=no_smooth_weight), "V is in the gradient"),
    (written(gradient=no_smooth_weight_in_gradient), "V is in the matrix"),
    (written(gradient=lambda j, b, e, s, w, u, lam: j.T @ (w * e)), "residual of its own"),
    (written(matrix=lambda j, b, w, u, lam: j.T @ (w[:, None] * j)), "missing in the matrix"),
    (
        written(lambda j, b, w, u, lam: j.T @ (w[:, None] * j), lambda j, b, e, s, w, u, lam: j.T @ (w * e)),
        "missing altogether",
    ),
    (written(gradient=lambda j, b, e, s, w, u, lam: lam * b.T @ (u * s)), "only smooths"),
    (written(matrix=lambda j, *_: np.eye(j.shape[1])), "steepest descent"),
    (written(matrix=lambda *all_of_it: np.diag(np.diag(right_matrix(*all_of_it)))), "diagonal"),
    (written(ending=lambda v, delta, cost: delta), "δ itself"),
    (written(ending=lambda v, delta, cost: v - delta), "backwards"),
    (written(ending=lambda v, delta, cost: halved(v, -delta, cost)), "stays where it is"),
    (written(ending=lambda v, delta, cost: v + delta), "Halve δ"),
    (written(ending=in_place), "in place"),
    (written(ending=lambda v, delta, cost: None), "returns nothing"),
    (written(ending=lambda v, delta, cost: (v + delta)[:, None]), "flat vector"),
    (written(ending=lambda v, delta, cost: v + np.nan), "not finite"),
    (written(h=0.3), "is not that of"),
]


def test_the_right_step_passes():
    told = check.gauss_newton_step(written())
    assert told
    assert "normal equations" in told.said


@pytest.mark.parametrize(("step", "said"), MISTAKES, ids=[said for _, said in MISTAKES])
def test_a_wrong_step_is_told_apart(step, said):
    told = check.gauss_newton_step(step)
    assert told.right is False
    assert said in told.said


def unwritten(v, data, bend, cost, lam):
    raise NotImplementedError


def failing(v, data, bend, cost, lam):
    return 1 / 0


def test_a_step_that_is_not_written_is_neither_and_its_own_errors_are_shown():
    assert check.gauss_newton_step(unwritten).right is None
    with pytest.raises(ZeroDivisionError):
        check.gauss_newton_step(failing)


def seen(scene):
    known = el.load_calibration("simple", 160)
    view = el.render(el.SCENES[scene], known.camera, known.photometry)
    return view, el.Frame(view.image, view.mask), el.Calibration(view.camera, view.photometry)


def errors(scene, **options):
    view, frame, known = seen(scene)
    found = el.reconstruct(frame, known, **{"regulariser": "second", **PLAIN, **options})
    return 100 * np.abs(found.distance / view.distance - 1)


@pytest.fixture(scope="module")
def heavy():
    """Errors of the plane at λ = 1000."""
    return {xi: errors("plane", xi=xi, lam=1000.0) for xi in ("1/z", "d", "1/d")}


def means(maps, change=np.mean):
    return {xi: float(change(one)) for xi, one in maps.items()}


def test_the_first_exercise(heavy):
    right = means(heavy)
    told = check.exercise_1(right, "1/z", True)
    assert told
    assert "fisheye" in told.said
    light = {xi: float(np.mean(errors("plane", xi=xi))) for xi in heavy}
    first = {xi: float(np.mean(errors("plane", xi=xi, regulariser="first", lam=1000.0))) for xi in heavy}
    for answer, said in [
        ((means(heavy, lambda one: np.mean(one) / 100) | {"1/z": right["1/z"]}, "1/z", True), "times 100"),
        ((means(heavy, np.max), "1/z", True), "largest"),
        ((right | {"d": float(np.median(heavy["d"]))}, "1/z", True), "median"),
        ((light | {"1/z": right["1/z"]}, "1/z", True), "λ = 1"),
        ((first, "1/z", True), "first order"),
        ((right | {"d": 3.0}, "1/z", True), "not what this run leaves"),
        (({"1/z": 0.0}, "1/z", True), "should be those of"),
        ((right, "d", True), "smallest"),
        ((right, "1/z", False), "linear in the pixel"),
    ]:
        told = check.exercise_1(*answer)
        assert told.right is False
        assert said in told.said
    assert check.exercise_1(..., ..., ...).right is None


@pytest.fixture(scope="module")
def family():
    """Three surfaces of the tube, the truth in their midst."""
    view, _, _ = seen("tube")
    rows = np.linspace(-1, 1, view.distance.shape[0])[:, None]
    return {omega: np.log(view.distance) + 0.3 * omega * rows**4 for omega in (-0.5, 0.0, 0.5)}


def charged(family, epsilon, term="regulariser"):
    _, frame, known = seen("tube")
    problem = make_problem(frame, known, smooth=0, epsilon=epsilon)
    terms = {omega: energy_terms(problem, v) for omega, v in family.items()}
    return {omega: sum(one.values()) if term == "sum" else one[term] for omega, one in terms.items()}


def test_the_second_exercise(family):
    fine, usual = errors("tube", epsilon=1e-4), errors("tube")
    error, costs = float(np.mean(fine)), charged(family, 1e-4)
    least = min(costs, key=costs.get)
    told = check.exercise_2(error, costs, least, family)
    assert told
    assert "as large" in told.said
    for answer, said in [
        ((float(np.mean(usual)), costs, least), "with ε = 0.001"),
        ((error / 100, costs, least), "times 100"),
        ((error, charged(family, 1e-3), least), "ε = 1e-3"),
        ((error, charged(family, 1e-4, "data"), least), "data term"),
        ((error, charged(family, 1e-4, "sum"), least), "whole energy"),
        ((error, dict.fromkeys(family, 1.0), least), "not the term"),
        ((error, {0.0: costs[0.0]}, least), "each ω"),
        ((error, costs, 0.5), "elsewhere"),
    ]:
        told = check.exercise_2(*answer, family)
        assert told.right is False
        assert said in told.said
    assert check.exercise_2(..., ..., ..., family).right is None


def test_the_step_that_it_compares_with_solves_the_librarys_own_equations(rng):
    small = check._Small.of("tube", lam=0.1)
    v = small.truth + 0.1 * rng.normal(size=small.truth.size)
    delta, _ = check._steps(small, v)
    model = GaussNewtonModel.at(small.problem, v.reshape(small.problem.mask.shape))
    found = model.multiply(delta.reshape(model.residual.shape))
    assert np.abs(found + model.gradient).max() < 1e-3 * np.abs(model.gradient).max()
