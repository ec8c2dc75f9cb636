"""σ of the distance against what it should be: noise solved again, known errors, units, causes apart."""

from dataclasses import fields, replace

import numpy as np
import pytest

import endolab as el
from endolab.numerics.compiled import inner, pad_maps
from endolab.numerics.iteration import Status, Stopped
from endolab.reconstruction.prior_sigma import PriorSigma
from endolab.reconstruction.uncertainty import (
    BORDER,
    DATA,
    LARGEST_SIGMA,
    LEAST_DRAWS,
    LENGTH,
    OUTSIDE,
    PRIOR,
    Linearised,
    correlated_field,
    enlarge,
    on_fewer_pixels,
    pixels_of_scale,
    uncertainty_of,
)
from endolab.solvers.gauss_newton import gauss_newton
from endolab.solvers.multigrid import multiply
from endolab.solvers.problem import NONE
from endolab.solvers.provenance import LightOutcome
from endolab.solvers.result import Iterate, run
from tests.tools.problems import at_truth, problem_of

CERTAIN = PriorSigma(
    **{one.name: 0.0 for one in fields(PriorSigma) if one.name != "notes"}
)


def solved(problem):
    """The default solver's result."""
    return run(gauss_newton(problem))


def reported(result, **facts):
    """Its iterate, of which the report says so."""
    problem = result.problem
    problem = replace(problem, report=replace(problem.report, **facts))
    return replace(result.iterate, problem=problem)


def relative(uncertainty, result, which="sigma"):
    """σ as a share of the distance, of the mask's pixels."""
    return (getattr(uncertainty, which) / result.distance)[result.mask]


@pytest.fixture(scope="module")
def curved():
    """A curved wall with a grey level of noise, its truth, its result and how far that is trusted."""
    problem, seen = problem_of("curved", 80, noise=1.0)
    result = solved(problem)
    return problem, seen, result, uncertainty_of(result)


def test_noise_alone_is_what_solving_again_with_other_noise_finds():
    """24 other noises, each solved to the end; the linear answer agrees to a fifth.

    It does where the regulariser charges squares, as here. Where it charges sizes, in creases, its parabolas
    are stiffer than itself, and a tube's noise comes out at half.
    """
    clean, _ = problem_of("curved", 64)
    rng = np.random.default_rng(1)
    level = 2 / 255

    def noisy():
        image = np.clip(
            clean.image + level * rng.standard_normal(clean.image.shape), 0.01, 1
        )
        return replace(clean, image=np.where(clean.mask, image, 0.0))

    how = {"tolerance": 1e-6, "max_iterations": 100}
    first = run(gauss_newton(noisy(), **how))
    how["start"] = first.iterate.log_distance
    maps = [
        run(gauss_newton(noisy(), **how)).iterate.log_distance[clean.mask]
        for _ in range(24)
    ]
    found = np.sqrt(np.mean(np.var(maps, axis=0, ddof=1)))
    uncertainty = uncertainty_of(first, prior_sigma=CERTAIN)
    noise = np.hypot(
        uncertainty.causes["noise"][clean.mask], uncertainty.scales["noise"]
    )
    assert np.sqrt(np.mean(noise**2)) == pytest.approx(found, rel=0.2)


def test_texture_does_what_it_is_said_to_do_and_is_seen_in_what_is_left():
    """A wall whose albedo varies by 10 %: the answer to the very field, and how strong it is found to be."""
    clean, seen = problem_of("curved", 80)
    field = correlated_field(np.random.default_rng(0), clean.mask.shape, LENGTH / 4)
    image = np.clip(
        clean.image * np.exp(0.1 * field / clean.photometry.gamma), 0, 0.999
    )
    result = solved(replace(clean, image=np.where(clean.mask, image, 0.0)))
    mask = result.mask
    surface = Linearised(result.problem, result.iterate.log_distance)
    off = np.log(result.distance / seen.distance)[mask]
    answer = surface.to_light(0.1 * field)[mask]
    assert np.corrcoef(off, answer)[0, 1] > 0.9
    assert np.std(answer) == pytest.approx(np.std(off), rel=0.2)
    uncertainty = uncertainty_of(result, prior_sigma=CERTAIN)
    even = uncertainty_of(solved(clean), prior_sigma=CERTAIN)
    strong = np.median(uncertainty.causes["texture"][mask])
    assert 0.3 < strong / np.std(off) < 1.5
    assert strong > 10 * np.median(even.causes["texture"][mask])


def test_the_unit_does_not_matter(curved):
    problem, _, result, _ = curved
    gain = 9 * problem.photometry.gain
    far = replace(problem, photometry=replace(problem.photometry, gain=gain))
    prior_sigma = replace(PriorSigma(), lamp=0.0)
    one = uncertainty_of(result, prior_sigma=prior_sigma)
    other = uncertainty_of(
        Iterate.of(far, result.iterate.log_distance + np.log(3)),
        prior_sigma=prior_sigma,
    )
    assert other.sigma[result.mask] == pytest.approx(
        3 * one.sigma[result.mask], rel=1e-3
    )
    assert other.sigma_scale == pytest.approx(one.sigma_scale, rel=1e-3)


def test_gain_and_albedo_move_all_pixels_alike(curved):
    _, _, result, _ = curved
    uncertainty = uncertainty_of(
        result, prior_sigma=replace(CERTAIN, gain=0.3, albedo=0.4)
    )
    assert uncertainty.scales["gain"] == pytest.approx(0.15)
    assert np.nanmax(uncertainty.causes["albedo"]) == 0
    assert relative(uncertainty, result).min() >= 0.25  # 0.15 and 0.2 in squares
    assert relative(uncertainty, result, "sigma_shape").max() < 0.1


def test_a_known_length_takes_the_scale_away(curved):
    _, _, result, _ = curved
    prior_sigma = replace(CERTAIN, gain=0.3, k=0.2)
    for scale, length in (
        ("median distance", 40.0),
        ("known distance", (40.0, 30, 20)),
    ):
        known = reported(result, scale=scale, length=length)
        uncertainty = uncertainty_of(known, prior_sigma=prior_sigma)
        assert uncertainty.scales["gain"] < 1e-12
    here = uncertainty.sigma[20, 30] / result.distance[20, 30]
    assert here < 1e-12


def test_the_causes_add_up(curved):
    _, _, result, uncertainty = curved
    total = sum(one[result.mask] ** 2 for one in uncertainty.causes.values())
    assert relative(uncertainty, result, "sigma_shape") ** 2 == pytest.approx(
        total, rel=1e-9
    )
    assert uncertainty.sigma_scale**2 == pytest.approx(
        sum(one**2 for one in uncertainty.scales.values())
    )
    assert np.isnan(uncertainty.sigma[~result.mask]).all()


def test_a_tube_is_trusted_less_towards_where_it_enters_the_picture():
    """Its border is free: σ rises towards it as the true error does, and is 1.6 to 2.6 times as large."""
    problem, seen = problem_of("tube", 120)
    result = solved(problem)
    uncertainty = uncertainty_of(result)
    sigma = uncertainty.sigma_shape / result.distance
    off = np.abs(np.log(result.distance / seen.distance))
    above = [np.s_[row : row + 4, 40:80] for row in (0, 8, 16)]
    assert (
        sigma[above[0]].mean()
        > 1.05 * sigma[above[1]].mean()
        > 1.6 * sigma[above[2]].mean()
    )
    for rows in above:
        assert 0.5 < sigma[rows].mean() / off[rows].mean() < 3
    assert np.all(uncertainty.dominant_source[above[0]] == BORDER)
    assert np.mean(uncertainty.dominant_source[20:30, 40:80] == DATA) > 0.9


def test_what_a_picture_does_not_say_is_the_priors():
    """A band that says nothing, wider than bumps: the prior decides its middle, which is less sure."""
    problem, _ = problem_of("curved", 120)
    evidence = np.zeros(problem.mask.shape, np.int8)
    evidence[:, 45:75] = NONE
    result = solved(replace(problem, evidence=evidence))
    uncertainty = uncertainty_of(result, prior_sigma=PriorSigma(left_in=0.0))
    here = np.s_[30:60, 56:64]
    beside = np.s_[30:60, 20:35]
    assert np.mean(uncertainty.dominant_source[here] == PRIOR) > 0.7
    assert np.mean(uncertainty.dominant_source[beside] == DATA) > 0.9
    sigma = uncertainty.sigma_shape / result.distance
    assert np.median(sigma[here]) > 1.5 * np.median(sigma[beside])
    assert uncertainty.shares.sum(axis=0)[result.mask] == pytest.approx(1)
    assert np.all(uncertainty.dominant_source[~result.mask] == OUTSIDE)


def test_light_that_bounced_is_a_cause_unless_the_colours_were_asked(curved):
    """In a single colour nobody knows how much there is."""
    _, _, result, uncertainty = curved
    asked = reported(result, light=LightOutcome.NONE_BOUNCED)
    few = uncertainty_of(asked, draws=LEAST_DRAWS)
    assert "bounced light" in uncertainty.causes
    assert "bounced light" not in few.causes


@pytest.mark.parametrize("apart", ["hole", "cuts"])
def test_an_island_of_which_nothing_is_said_is_not_known_at_all(apart):
    problem, _ = problem_of("curved", 80)
    lost = np.indices(problem.mask.shape)[1] >= 42
    mask = problem.mask.copy()
    mask[:, 38:42] = apart != "hole"
    cuts = np.zeros((2, *mask.shape), bool)
    cuts[0, :, 41] = apart == "cuts"
    evidence = np.where(lost, NONE, 0).astype(np.int8)
    result = solved(replace(problem, mask=mask, evidence=evidence, cuts=cuts))
    share = uncertainty_of(result).sigma / result.distance
    lost = lost & mask
    assert share[lost] == pytest.approx(LARGEST_SIGMA)
    assert np.median(share[mask & ~lost]) < 0.2


@pytest.mark.parametrize(
    ("photometry", "k", "gamma"),
    [
        ({}, PriorSigma.k, PriorSigma.gamma),
        ({"standard_errors": {"k": 0.011, "gamma": 0.0}}, 0.011, PriorSigma.gamma),
        ({"nominal": True}, 1.0, 0.4),
        ({"nominal": "no", "standard_errors": 3}, PriorSigma.k, PriorSigma.gamma),
    ],
)
def test_doubts_are_the_standard_errors_of_the_calibration(photometry, k, gamma):
    known = el.load_calibration("paper", width=80)
    prior_sigma = PriorSigma.of(replace(known, evidence={"photometry": photometry}))
    assert (prior_sigma.k, prior_sigma.gamma) == (k, gamma)
    assert f"± {k:.2g}" in " ".join(prior_sigma.notes)


def test_it_is_the_same_every_time_and_stops_when_asked(curved):
    """σ of the named causes alone would be too small; an interrupt is no observer's wish."""
    _, _, result, uncertainty = curved
    again = uncertainty_of(result, threads=1)
    assert np.array_equal(again.sigma, uncertainty.sigma, equal_nan=True)
    assert uncertainty.status is Status.CONVERGED

    def stopped_at(draw, wish=None):
        def observer(progress):
            if progress.done == draw and wish is not None:
                raise wish
            return progress.done == draw

        return uncertainty_of(result, observers=[observer])

    early = stopped_at(6)
    assert (early.draws, early.status) == (6, Status.STOPPED)
    assert np.nanmedian(early.sigma / uncertainty.sigma) == pytest.approx(1, abs=0.3)
    assert stopped_at(LEAST_DRAWS, KeyboardInterrupt).draws == LEAST_DRAWS
    for wish, raised in ((None, Stopped), (KeyboardInterrupt, KeyboardInterrupt)):
        with pytest.raises(raised):
            stopped_at(LEAST_DRAWS - 1, wish)


# Fewer pixels


@pytest.mark.parametrize("column", [399, 400, 401])
def test_sigma_of_a_large_frame_is_that_of_fewer_pixels(column):
    """Evidence goes along, and a cut in any place between two pixels that are kept."""
    problem, seen = problem_of("tube", 602)
    shape = problem.mask.shape
    evidence = np.zeros(shape, np.int8)
    evidence[200:300, 300:500] = NONE
    cuts = np.zeros((2, *shape), bool)
    cuts[0, :, column] = True
    problem = replace(problem, evidence=evidence, cuts=cuts)
    large = Iterate.of(problem, np.log(seen.distance))
    small = on_fewer_pixels(large, 120)
    assert (small.problem.evidence[41:59, 61:99] == NONE).all()
    (cut,) = np.flatnonzero(small.problem.cuts[0].all(axis=0))
    assert abs(cut - (column - 2) / 5) < 1
    enlarged = enlarge(small.distance[None], small.mask, large.mask)
    np.testing.assert_allclose(enlarged[0], large.distance, rtol=0.05)


def test_a_length_of_a_large_frame_is_of_a_pixel_that_is_kept():
    """The one that was given is in the mask, and of fewer pixels that it lies in none is."""
    problem, truth = at_truth("plane", 602)
    mask = problem.mask.copy()
    mask[200:206, 300:306] = False
    mask[201, 301] = True
    known = {"scale": "known distance", "length": (30.0, 301.0, 201.0)}
    report = replace(problem.report, picture_size=mask.shape[::-1], **known)
    problem = replace(problem, mask=mask, report=report)
    small = on_fewer_pixels(Iterate.of(problem, truth), 120)
    (row,), (column,) = np.nonzero(pixels_of_scale(small))
    assert small.mask[row, column]
    assert np.hypot(row - 201 / 602 * 120, column - 301 / 602 * 120) < 2


# The linear answer


@pytest.mark.parametrize("regulariser", ["first", "second"])
def test_its_slopes_are_those_of_the_steps(rng, regulariser):
    """JᵀWJ of a worn tube at a rough map, without a prior, and xᵀ(Jᵀy) = (Jx)ᵀy."""
    problem, truth = at_truth("tube", 16, regulariser=regulariser)
    mask = problem.mask & (rng.random(problem.mask.shape) > 0.05)
    cuts = rng.random((2, *mask.shape)) > 0.97
    problem = replace(problem, mask=mask, cuts=cuts, lam=0.0)
    surface = Linearised(problem, truth + 0.02 * rng.normal(size=mask.shape))
    x, y = mask * rng.normal(size=(2, *mask.shape))
    assert np.vdot(x, surface.adjoint(y)) == pytest.approx(np.vdot(surface.apply(x), y))
    expected = np.zeros(surface.coefficients.active.shape)
    multiply(surface.coefficients.matrix(0.0), pad_maps(x), expected)
    found = surface.adjoint(surface.weight * surface.apply(x))
    np.testing.assert_allclose(found, inner(expected), atol=1e-12 * np.abs(found).max())
