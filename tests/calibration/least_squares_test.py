from dataclasses import dataclass

import numpy as np
import pytest
from scipy.optimize import least_squares

from endolab.calibration.least_squares import ROBUST, Arrow, Linearised, fit, robust_sigma
from endolab.numerics.iteration import Status

GROUPS = 12
EACH = 25


@dataclass(frozen=True)
class Unknowns:
    common: np.ndarray  # (2,): decay, slope
    own: np.ndarray  # (groups, 2): height, offset


class Decays:
    """Groups of y = height · exp(-decay · t) + slope · t + offset, each measured twice."""

    def __init__(self, rng, noise=0.01, prior=None):
        self.group = np.repeat(np.arange(GROUPS), EACH)
        self.t = rng.uniform(0, 3, len(self.group))
        own = np.column_stack([rng.uniform(1, 2, GROUPS), rng.normal(size=GROUPS)])
        self.truth = Unknowns(np.array([0.8, 0.3]), own)
        self.prior = prior  # (index, value, sd) of a common unknown
        self.y = np.zeros((len(self.t), 2))
        self.y = -self.residual(self.truth)[0] + rng.normal(0, noise, self.y.shape)
        self.hidden = np.zeros(len(self.t), bool)

    def usable(self, u):
        return ~self.hidden

    def residual(self, u):
        height, offset = u.own[self.group].T
        curve = height * np.exp(-u.common[0] * self.t) + u.common[1] * self.t + offset
        return self.y - curve[:, None], self._prior(u)

    def _prior(self, u):
        if self.prior is None:
            return np.zeros(0)
        index, value, sd = self.prior
        return np.array([(u.common[index] - value) / sd])

    def linearise(self, u):
        height = u.own[self.group, 0]
        fall = np.exp(-u.common[0] * self.t)
        by_common = np.stack([self.t * height * fall, -self.t], axis=-1)
        by_own = np.stack([-fall, -np.ones_like(fall)], axis=-1)
        twice = [np.repeat(values[:, None], 2, axis=1) for values in (by_common, by_own)]
        residual, prior = self.residual(u)
        by_prior = np.zeros((len(prior), 2))
        if self.prior is not None:
            by_prior[0, self.prior[0]] = 1 / self.prior[2]
        return Linearised(residual, *twice, prior, by_prior)

    def take_step(self, u, common, own):
        moved = Unknowns(u.common + common, u.own + own)
        return moved if moved.common[0] > 0 else None

    def start(self):
        return Unknowns(np.array([0.3, 0.0]), np.ones((GROUPS, 2)))


def fitted(*given, **how):
    """A model and its fit."""
    model = Decays(*given, **how)
    return model, fit(model, model.start())


def flat(u):
    return np.concatenate([u.common, u.own.ravel()])


def unflat(vector):
    return Unknowns(vector[:2], vector[2:].reshape(GROUPS, 2))


def dense(model, u):
    """Residuals and the full Jacobian, measurements that are usable only."""
    lin = model.linearise(u)
    n, m, p = lin.by_common.shape
    jacobian = np.zeros((n, m, p + 2 * GROUPS))
    jacobian[:, :, :p] = lin.by_common
    for row, group in enumerate(model.group):
        jacobian[row, :, p + 2 * group : p + 2 * group + 2] = lin.by_own[row]
    keep = model.usable(u)
    return lin.residual[keep].ravel(), jacobian[keep].reshape(-1, p + 2 * GROUPS)


def test_a_fit_agrees_with_scipy(rng):
    model, found = fitted(rng)
    assert found.status is Status.CONVERGED
    used = found.iterate.used
    oracle = least_squares(
        lambda x: model.residual(unflat(x))[0][used].ravel(),
        flat(model.start()),
        xtol=1e-15,
        ftol=1e-15,
    )
    error = np.sqrt(np.diag(found.covariance.common))
    assert np.abs(found.iterate.unknowns.common - oracle.x[:2]).max() < 1e-3 * error.min()
    assert flat(found.iterate.unknowns) == pytest.approx(oracle.x, abs=1e-5)
    assert found.iterate.cost == pytest.approx(
        oracle.cost / found.iterate.sigma**2, rel=1e-6
    )


def test_covariance_is_the_dense_inverse(rng):
    model, found = fitted(rng)
    _, jacobian = dense(model, found.iterate.unknowns)
    jacobian = jacobian.reshape(-1, 2, jacobian.shape[1])[found.iterate.used].reshape(
        -1, jacobian.shape[1]
    )
    whole = np.linalg.inv(jacobian.T @ jacobian) * found.iterate.sigma**2
    assert found.covariance.common == pytest.approx(whole[:2, :2], rel=1e-6)
    for g in range(GROUPS):
        block = slice(2 + 2 * g, 4 + 2 * g)
        assert found.covariance.own[g] == pytest.approx(whole[block, block], rel=1e-6)


@pytest.mark.parametrize("damping", [1e-10, 1e-2, 10.0])
def test_a_step_solves_the_dense_normal_equations(rng, damping):
    model = Decays(rng, prior=(1, 0.5, 0.02))
    u = model.start()
    lin = model.linearise(model.start())
    weight = rng.uniform(0.5, 2, len(model.group))
    common, own = Arrow(lin, weight, model.group).solve(damping)
    residual, jacobian = dense(model, u)
    root = np.sqrt(np.repeat(weight, 2))
    residual = np.append(residual * root, lin.prior)
    prior = np.zeros((1, jacobian.shape[1]))
    prior[:, :2] = lin.prior_by_common
    jacobian = np.vstack([jacobian * root[:, None], prior])
    normal = jacobian.T @ jacobian
    expected = -np.linalg.solve(
        normal + damping * np.diag(np.diag(normal)), jacobian.T @ residual
    )
    assert np.append(common, own.ravel()) == pytest.approx(expected, rel=1e-6, abs=1e-9)
    length = Arrow(lin, weight, model.group).length(common, own)
    assert length == pytest.approx(np.sqrt(expected @ normal @ expected))


def test_an_unknown_that_nothing_tells_is_infinitely_uncertain(rng):
    class Twins(Decays):
        """The offset of each group and a common one cannot be told apart."""

        def linearise(self, u):
            lin = super().linearise(u)
            common = lin.by_common.copy()
            common[:, :, 1] = -1.0
            return Linearised(
                lin.residual, common, lin.by_own, lin.prior, lin.prior_by_common
            )

        def residual(self, u):
            height, offset = u.own[self.group].T
            curve = height * np.exp(-u.common[0] * self.t) + u.common[1] + offset
            return self.y - curve[:, None], self._prior(u)

    found = fit(Twins(rng), Decays(rng).start())
    assert np.isfinite(found.covariance.common[0, 0])
    assert np.isinf(found.covariance.common[1, 1])
    assert np.all(np.isinf(found.covariance.own[:, 1, 1]))
    assert np.all(np.isfinite(found.covariance.own[:, 0, 0]))


def test_a_fit_that_runs_out_of_iterations_or_is_interrupted_keeps_its_last_iterate(rng):
    def interrupt(iterate):
        if iterate.k == 1:
            raise KeyboardInterrupt

    model = Decays(rng)
    found = fit(model, model.start(), max_iterations=2)
    assert (found.status, found.iterate.k) == (Status.MAX_ITERATIONS, 2)
    assert [row["k"] for row in found.history] == [0, 1, 2]
    found = fit(model, model.start(), observers=[interrupt])
    assert (found.status, found.iterate.k) == (Status.STOPPED, 1)


@pytest.mark.parametrize("m", [1, 2])
@pytest.mark.parametrize("share", [0.0, 0.05, 0.2])
def test_sigma_is_that_of_the_noise(rng, m, share):
    residual = rng.normal(0, 0.3, (20000, m))
    wrong = rng.random(20000) < share
    residual[wrong] += rng.choice([-1, 1], wrong.sum())[:, None] * 6.0
    assert robust_sigma(residual, np.ones(20000, bool), 0) == pytest.approx(0.3, rel=0.01)


def test_a_measurement_on_the_border_does_not_keep_the_rounds_going():
    # Residuals at just the cut: the choice must settle, whatever it is.
    for seed in range(10):
        rng = np.random.default_rng(seed)
        model = Decays(rng)
        model.y[::40] += (
            (ROBUST.outlier + 0.02 * rng.normal(size=model.y[::40].shape))
            * 0.01
            / np.sqrt(2)
        )
        assert fit(model, model.start()).status is Status.CONVERGED
