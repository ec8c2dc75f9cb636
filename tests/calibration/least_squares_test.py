import numpy as np
import pytest
from scipy.optimize import least_squares

from endolab.calibration.constants import OUTLIER
from endolab.calibration.least_squares import (
    Model,
    covariances,
    fit,
    robust_sigma,
)
from endolab.numerics.iteration import Status

GROUPS = 12
EACH = 25


class Decays(Model):
    """Groups of y = height · exp(-decay · t) + slope · t + offset, each measured twice."""

    def __init__(self, rng):
        unknown = np.full(2, np.inf)
        group = np.repeat(np.arange(GROUPS), EACH)
        super().__init__(group, np.zeros(2), unknown)
        self.t = rng.uniform(0, 3, len(self.group))
        own = np.column_stack([rng.uniform(1, 2, GROUPS), rng.normal(size=GROUPS)])
        self.y = np.zeros((len(self.t), 2))
        self.y = -self.linearise(np.array([0.8, 0.3]), own)[0]
        self.y += rng.normal(0, 0.01, self.y.shape)

    def usable(self, common, own):
        return np.ones(len(self.t), bool)

    def linearise(self, common, own):
        decay, slope = common
        height, offset = own[self.group].T
        fall = np.exp(-decay * self.t)
        curve = height * fall + slope * self.t + offset
        by_common = np.stack([self.t * height * fall, -self.t], axis=-1)
        by_own = np.stack([-fall, -np.ones_like(fall)], axis=-1)
        twice = [
            np.repeat(values[:, None], 2, axis=1) for values in (by_common, by_own)
        ]
        return self.y - curve[:, None], *twice


START = np.array([0.3, 0.0]), np.ones((GROUPS, 2))


def flat(common, own):
    return np.concatenate([common, own.ravel()])


def unflat(vector):
    return vector[:2], vector[2:].reshape(GROUPS, 2)


def test_a_fit_and_its_covariance_agree_with_scipy(rng):
    model = Decays(rng)
    found = fit(model, *START)
    assert found.status is Status.CONVERGED
    used, sigma = found.used, found.sigma
    oracle = least_squares(
        lambda x: model.linearise(*unflat(x))[0][used].ravel(),
        flat(*START),
        jac="3-point",
        xtol=1e-15,
        ftol=1e-15,
    )
    covariance, of_own = covariances(model, found)
    error = np.sqrt(np.diag(covariance))
    assert np.abs(found.common - oracle.x[:2]).max() < 1e-3 * error.min()
    assert flat(found.common, found.own) == pytest.approx(oracle.x, abs=1e-5)
    cost = np.sum(found.residual[used] ** 2) / 2
    assert cost == pytest.approx(oracle.cost, rel=1e-6)
    whole = np.linalg.inv(oracle.jac.T @ oracle.jac) * sigma**2
    assert covariance == pytest.approx(whole[:2, :2], rel=1e-6)
    for g in range(GROUPS):
        block = slice(2 + 2 * g, 4 + 2 * g)
        assert of_own[g] == pytest.approx(whole[block, block], rel=1e-6)


def test_an_unknown_that_nothing_tells_is_infinitely_uncertain(rng):
    class Twins(Decays):
        """The offset of each group and a common one cannot be told apart."""

        def linearise(self, common, own):
            residual, by_common, by_own = super().linearise(common, own)
            by_common[:, :, 1] = -1.0
            return residual + common[1] * (self.t - 1)[:, None], by_common, by_own

    model = Twins(rng)
    covariance, of_own = covariances(model, fit(model, *START))
    assert np.isfinite(covariance[0, 0])
    assert np.isinf(covariance[1, 1])
    assert np.all(np.isinf(of_own[:, 1, 1]))
    assert np.all(np.isfinite(of_own[:, 0, 0]))


@pytest.mark.parametrize("m", [1, 2])
@pytest.mark.parametrize("share", [0.0, 0.05, 0.2])
def test_sigma_is_that_of_the_noise(rng, m, share):
    residual = rng.normal(0, 0.3, (20000, m))
    residual[rng.random(20000) < share] += rng.choice([-6.0, 6.0])
    found = robust_sigma(residual, np.ones(20000, bool), 0)
    assert found == pytest.approx(0.3, rel=0.01)


def test_a_measurement_on_the_border_does_not_keep_the_rounds_going():
    # Residuals at just the cut: the choice must settle, whatever it is.
    for seed in range(10):
        rng = np.random.default_rng(seed)
        model = Decays(rng)
        border = OUTLIER + 0.02 * rng.normal(size=model.y[::40].shape)
        model.y[::40] += border * 0.01 / np.sqrt(2)
        assert fit(model, *START).status is Status.CONVERGED
