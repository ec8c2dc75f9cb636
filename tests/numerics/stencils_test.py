"""Derivatives on a masked grid: exact where a formula promises it, deaf to what lies outside the mask."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from endolab.numerics.stencils import (
    CENTRAL,
    FIRST,
    SECOND,
    Differences,
    central_gradient,
    differences,
    forward_gradient,
    gradient,
    links,
    shift,
)
from tests.tools.cuts import between


def second_differences(f, mask, cuts=None):
    return Differences(links(mask, cuts), SECOND).apply(np.where(mask, f, 0.0))


OPERATORS = [
    gradient,
    central_gradient,
    forward_gradient,
    differences,
    second_differences,
]
every_operator = pytest.mark.parametrize("operator", OPERATORS)


@pytest.fixture
def worn(rng):
    """A map, a ragged mask with isolated pixels and runs of two, and cuts."""
    shape = (14, 17)
    mask = rng.random(shape) < 0.6
    return rng.normal(size=shape), mask, rng.random((2, *shape)) < 0.1


@pytest.mark.parametrize("kind", [FIRST, SECOND, CENTRAL])
def test_the_adjoint_is_one(rng, worn, kind):
    """⟨K x, y⟩ = ⟨x, Kᵀ y⟩."""
    x, mask, cuts = worn
    k = Differences(links(mask, cuts), kind)
    y = rng.normal(size=(3, *mask.shape))
    assert np.vdot(x, k.adjoint(y)) == pytest.approx(np.vdot(k.apply(x), y), rel=1e-12)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("step", [-9, -2, -1, 0, 1, 2, 9])
def test_a_shift_is_a_roll_with_the_far_side_filled(rng, step, axis):
    a = rng.normal(size=(4, 5))
    padded = np.pad(a, 9, constant_values=7.0)
    expected = np.roll(padded, -step, axis)[9:-9, 9:-9]
    assert_array_equal(shift(a, step, axis, 7.0), expected)


@pytest.mark.parametrize("turn", [lambda a: a, np.transpose])
def test_the_gradient_takes_the_best_formula_that_the_mask_allows(worn, turn):
    """Quadratics where three pixels in a row are there, straight lines where two are, else 0."""
    mask = turn(worn[1])
    v, u = np.indices(mask.shape)
    far_before, before, after, far_after = (
        mask & shift(mask, step, 1, False) for step in (-2, -1, 1, 2)
    )
    three = before & after | before & far_before | after & far_after
    two = before | after
    line = gradient(2.0 * u - 3 * v, mask)[0]
    parabola = gradient(0.5 * u**2 + u * v, mask)[0]
    assert_allclose(line[two], 2.0, atol=1e-12)
    assert_allclose(parabola[three], (u + v)[three], atol=1e-12)
    assert not line[mask & ~two].any()
    assert min(three.sum(), (two & ~three).sum(), (mask & ~two).sum()) > 2


@every_operator
@pytest.mark.parametrize("rubbish", [np.nan, -np.inf, 1e300])
def test_values_outside_the_mask_never_matter(worn, operator, rubbish):
    f, mask, _ = worn
    expected = operator(np.where(mask, f, 0.0), mask)
    actual = operator(np.where(mask, f, rubbish), mask)
    assert_array_equal(actual, expected)
    assert np.isfinite(np.asarray(actual)[:, mask]).all()


def test_second_differences_of_a_quadratic():
    v, u = np.indices((9, 12))
    f = u - 2 * v + 0.5 * u**2 + 0.7 * u * v - v**2
    f_uu, mixed, f_vv = second_differences(f, np.ones(f.shape, bool))
    inner, ends = slice(1, -1), [0, -1]
    assert_allclose(f_uu[:, inner], 1, atol=1e-11)
    assert_allclose(f_vv[inner], -2, atol=1e-11)
    assert_allclose(mixed[:-1, :-1], 0.7 * np.sqrt(2), atol=1e-11)
    assert not f_uu[:, ends].any()
    assert not f_vv[ends].any()
    assert not mixed[-1].any()


@every_operator
def test_cuts_tear_a_map_into_maps_of_their_own(rng, worn, operator):
    """Cut along a patchwork's seams, each patch has the derivatives that it has as a mask of its own."""
    f, mask, _ = worn
    labels = rng.integers(0, 3, mask.shape)
    labels[4:11, 5:12] = 0
    everywhere = np.ones_like(mask)
    assert np.all(np.asarray(operator(7.0 * labels, everywhere, between(labels))) == 0)
    cut = np.asarray(operator(f, mask, between(labels)))
    assert np.any(cut[:, mask] != np.asarray(operator(f, mask))[:, mask])
    for label in range(3):
        patch = mask & (labels == label)
        assert_array_equal(cut[:, patch], np.asarray(operator(f, patch))[:, patch])
