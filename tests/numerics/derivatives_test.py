"""Derivatives on a masked grid: exact where a formula promises it, deaf to what lies outside the mask."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from endolab.numerics.stencils import (
    differences,
    forward_gradient,
    gradient,
    hessian,
    shift,
)
from tests.tools.cuts import between

ODD_SHAPES = [(1, 1), (1, 6), (6, 1), (2, 2), (1, 2), (3, 1), (5, 7), (13, 9)]


def two_pixel_gradient(f, mask=None, cuts=None):
    return np.stack(gradient(f, mask, cuts, edge_order=1))


OPERATORS = [gradient, two_pixel_gradient, forward_gradient, differences, hessian]


def polynomial(shape, c):
    """c0 + c1 u + c2 v + c3 u² + c4 uv + c5 v² with its two derivatives."""
    v, u = np.indices(shape, dtype=float)
    f = c[0] + c[1] * u + c[2] * v + c[3] * u**2 + c[4] * u * v + c[5] * v**2
    return f, (c[1] + 2 * c[3] * u + c[4] * v, c[2] + c[4] * u + 2 * c[5] * v)


@pytest.fixture
def mask(rng):
    """Ragged, with isolated pixels and runs of two."""
    return rng.random((14, 17)) < 0.6


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("step", [-9, -2, -1, 0, 1, 2, 9])
def test_shifted_is_a_roll_with_the_far_side_filled(rng, step, axis):
    a = rng.normal(size=(4, 5))
    padded = np.pad(a, 9, constant_values=7.0)
    expected = np.roll(padded, -step, axis)[9:-9, 9:-9]
    assert_array_equal(shift(a, step, axis, 7.0), expected)


def test_gradient_takes_the_best_formula_that_the_mask_allows(rng, mask):
    """Quadratics where three pixels in a row are there, straight lines where two are, else 0."""
    quadratic, exact = polynomial(mask.shape, rng.normal(size=6))
    line, slope = polynomial(mask.shape, [1.0, 2.0, -3.0, 0, 0, 0])
    seen = {"three": 0, "two": 0, "one": 0}
    padded = np.pad(mask, 2)
    for axis, step in ((1, (0, 1)), (0, (1, 0))):
        f_axis = gradient(quadratic, mask)[1 - axis]
        line_axis = gradient(line, mask)[1 - axis]
        for r, c in zip(*np.nonzero(mask), strict=True):
            here = [
                padded[r + 2 + s * step[0], c + 2 + s * step[1]]
                for s in (-2, -1, 0, 1, 2)
            ]
            run = [all(here[i : i + 3]) for i in range(3)]
            if any(run):
                seen["three"] += 1
                assert f_axis[r, c] == pytest.approx(exact[1 - axis][r, c], abs=1e-12)
            elif here[1] or here[3]:
                seen["two"] += 1
                assert line_axis[r, c] == pytest.approx(
                    slope[1 - axis][r, c], abs=1e-12
                )
            else:
                seen["one"] += 1
                assert f_axis[r, c] == 0.0
    assert min(seen.values()) > 5


@pytest.mark.parametrize("operator", OPERATORS)
@pytest.mark.parametrize("rubbish", [np.nan, np.inf, -np.inf, 1e300])
def test_values_outside_the_mask_never_matter(rng, mask, operator, rubbish):
    f = rng.normal(size=mask.shape)
    expected = operator(np.where(mask, f, 0.0), mask)
    actual = operator(np.where(mask, f, rubbish), mask)
    assert_array_equal(actual, expected)
    assert np.isfinite(np.asarray(actual)[:, mask]).all()


def test_hessian_of_a_quadratic(rng):
    c = rng.normal(size=6)
    f_uu, f_vv, *mixed = hessian(polynomial((9, 12), c)[0])
    assert_allclose(f_uu[:, 1:-1], 2 * c[3], rtol=0, atol=1e-11)
    assert_allclose(f_vv[1:-1], 2 * c[5], rtol=0, atol=1e-11)
    for f_uv in mixed:
        assert_allclose(f_uv[1:-1, 1:-1], c[4] / np.sqrt(2), rtol=0, atol=1e-11)
    assert not f_uu[:, [0, -1]].any()
    assert not f_vv[[0, -1]].any()
    assert not mixed[0][-1].any()


@pytest.mark.parametrize("operator", [differences, hessian])
def test_the_norm_is_the_same_whichever_way_a_map_is_turned(rng, mask, operator):
    f = rng.normal(size=mask.shape)
    cuts = rng.random((2, *mask.shape)) < 0.1
    norm = np.linalg.norm(operator(f, mask, cuts), axis=0)
    mirrored = np.stack([np.roll(cuts[0][:, ::-1], -1, axis=1), cuts[1][:, ::-1]])
    for turned, back in (
        (operator(f[:, ::-1], mask[:, ::-1], mirrored), np.s_[:, ::-1]),
        (
            operator(f.T, mask.T, cuts[::-1].transpose(0, 2, 1)).transpose(0, 2, 1),
            np.s_[:],
        ),
    ):
        assert_allclose(np.linalg.norm(turned, axis=0)[back], norm, rtol=0, atol=1e-14)


@pytest.mark.parametrize("operator", OPERATORS)
def test_cuts_tear_a_map_into_maps_of_their_own(rng, mask, operator):
    """Cut along a patchwork's seams, each patch has the derivatives that it has as a mask of its own."""
    f = rng.normal(size=mask.shape)
    labels = rng.integers(0, 3, mask.shape)
    labels[4:11, 5:12] = 0
    assert np.all(np.asarray(operator(7.0 * labels, cuts=between(labels))) == 0)
    cut_derivatives = np.asarray(operator(f, mask, between(labels)))
    assert np.any(cut_derivatives[:, mask] != np.asarray(operator(f, mask))[:, mask])
    for label in range(3):
        patch = mask & (labels == label)
        assert_array_equal(
            cut_derivatives[:, patch], np.asarray(operator(f, patch))[:, patch]
        )


@pytest.mark.parametrize("order", [1, 2])
def test_every_nth_pixel_is_as_in_the_whole(rng, order):
    f = rng.normal(size=(30, 41))
    mask = rng.random(f.shape) > 0.3
    cuts = rng.random((2, *f.shape)) < 0.3
    whole = gradient(f, mask, cuts, order)
    for one, thin in zip(whole, gradient(f, mask, cuts, order, step=3), strict=True):
        assert_array_equal(one[::3, ::3], thin)
