"""What a pixel is evidence of: its share in the energy, on every grid, and what is found where it is none."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import endolab as el
from endolab.depth.energy import energy_terms, model_image
from endolab.depth.fast_marching import fast_marching
from endolab.depth.gauss_newton import gauss_newton
from endolab.depth.grid import Grid
from endolab.depth.multigrid import Multigrid
from endolab.depth.primal_dual import _Path, primal_dual
from endolab.depth.problem import AT_LEAST, EXACT, NONE
from endolab.numerics.compiled import inner
from endolab.numerics.penalties import huber
from tests.depth.gauss_newton_model import (
    GaussNewtonModel,
    check_the_compiled,
    inside,
    relative,
    slope_of_energy,
)
from tests.tools.problems import check_it_falls, energies, every_regulariser, percent_off, problem_of

SOLVERS = {"gauss_newton": gauss_newton, "primal_dual": primal_dual, "fast_marching": fast_marching}
KINDS = {"at least": (AT_LEAST,), "none": (NONE,), "all three": (EXACT, AT_LEAST, NONE)}
every_kind = pytest.mark.parametrize("kind", KINDS)


posed = partial(problem_of, bits=8)


def saturated(problem):
    return problem.mask & (problem.image >= 254.5 / 255)


def marked(problem, where, what):
    return replace(problem, evidence=np.where(where & problem.mask, what, EXACT).astype(np.int8))


def worn(rng, kind, **options):
    """A frame with holes, cuts and evidence of all sorts, and a rough map about the truth."""
    problem, seen = posed("curved", 24, **options)
    mask = problem.mask & (rng.random(problem.mask.shape) > 0.05)
    cuts = rng.random((2, *mask.shape)) > 0.95
    evidence = rng.choice(KINDS[kind], mask.shape).astype(np.int8)
    v = np.log(seen.distance) + 0.05 * rng.normal(size=mask.shape)
    return replace(problem, mask=mask, cuts=cuts, evidence=evidence), v


def test_the_data_term_is_the_sum_written_out(rng):
    problem, v = worn(rng, "all three")
    model, total = model_image(problem, v), 0.0
    for pixel in map(tuple, np.argwhere(problem.mask)):
        r = model[pixel] - problem.image[pixel]
        if problem.evidence[pixel] == AT_LEAST:
            r = min(r, 0.0)
        total += 0.0 if problem.evidence[pixel] == NONE else float(huber(r, problem.threshold))
    assert energy_terms(problem, v)["data"] == pytest.approx(total / problem.mask.sum(), rel=1e-12)


@every_kind
@every_regulariser
def test_the_slope_of_the_quadratic_is_the_energys(rng, kind, regulariser):
    problem, v = worn(rng, kind, regulariser=regulariser, epsilon=0.1)
    model = GaussNewtonModel.at(problem, v)
    assert relative(model.gradient, slope_of_energy(problem, v)).max() < 1e-6
    brighter = model_image(problem, v) > problem.image
    silent = (problem.evidence == NONE) | ((problem.evidence == AT_LEAST) & brighter)
    np.testing.assert_array_equal(model.data_weight == 0, silent | ~problem.mask)


def test_a_bound_counts_on_one_side_alone(rng):
    problem, v = worn(rng, "at least")
    model = model_image(problem, v)
    for image, counts in ((0.9 * model, False), (1.1 * model, True)):
        data = energy_terms(replace(problem, image=image), v)["data"]
        exact = energy_terms(replace(problem, image=image, evidence=None), v)["data"]
        assert data == (exact if counts else 0.0)


def test_a_highlights_value_and_edge_play_no_part(rng):
    problem, v = worn(rng, "all three")
    other = replace(problem, image=np.where(problem.evidence == NONE, rng.random(v.shape), problem.image))
    other.__dict__["xi_median"] = problem.xi_median  # the median of the start, which knows them all
    assert energy_terms(other, v) == energy_terms(problem, v)
    np.testing.assert_array_equal(other.edge_weight, problem.edge_weight)
    assert np.all(problem.edge_weight[problem.evidence == NONE] == 1)


@every_kind
@every_regulariser
def test_compiled_energy_and_equations_are_the_readable_ones(rng, kind, regulariser):
    problem, v = worn(rng, kind, regulariser=regulariser)
    check_the_compiled(problem, v, rng)


def test_a_block_says_what_its_pixels_say():
    problem, _ = posed("plane", 8)
    evidence, image = np.zeros(problem.mask.shape, dtype=np.int8), np.full(problem.mask.shape, 0.5)
    evidence[:2, :2], image[:2, :2] = [[NONE, NONE], [NONE, EXACT]], [[0.9, 0.9], [0.9, 0.3]]
    evidence[:2, 2:4], image[:2, 2:4] = NONE, [[0.1, 0.3], [0.5, 0.7]]
    evidence[:2, 4:6], image[:2, 4:6] = [[AT_LEAST, AT_LEAST], [EXACT, NONE]], [[1.0, 1.0], [0.7, 0.1]]
    evidence[:2, 6:8] = [[AT_LEAST, AT_LEAST], [EXACT, EXACT]]
    coarse = Grid.of(replace(problem, image=image, evidence=evidence)).coarser()
    np.testing.assert_array_equal(inner(coarse.evidence)[0], [EXACT, NONE, AT_LEAST, EXACT])
    np.testing.assert_allclose(inner(coarse.image)[0, :3], [0.3, 0.4, 0.9])
    # At half of a coarse grid's pixels it has the same form.
    np.testing.assert_array_equal(inner(coarse.coarser().evidence)[0], [EXACT, EXACT])


def test_coarse_equations_average_the_slope_of_xi_over_all_pixels_and_data_over_those_that_speak(rng):
    problem, v = worn(rng, "none", xi="d")
    at = inside(problem, v)
    coarse = Grid.of(problem).linearised(at, 1.0)[0].coarser()
    plain = Grid.of(replace(problem, evidence=None)).linearised(at, 1.0)[0].coarser()
    np.testing.assert_array_equal(coarse.slope, plain.slope)
    assert not coarse.weight.any()
    mixed = marked(problem, np.indices(v.shape).sum(axis=0) % 2 == 0, NONE)
    speaking = Grid.of(mixed).linearised(at, 1.0)[0].coarser()
    both = (speaking.weight > 0) & (plain.weight > 0)
    assert np.all(np.abs(speaking.by_v / np.where(both, plain.by_v, 1.0) - 1)[both] < 0.3)  # not halved
    assert np.isfinite(Multigrid(speaking).levels[0].inverse).all()


@pytest.mark.parametrize("solver", SOLVERS)
def test_evidence_that_is_exact_is_no_news(solver):
    problem, _ = posed("tube", 80)
    options = {"max_iterations": 100} if solver == "primal_dual" else {}
    each = (problem, marked(problem, False, NONE))
    without, exact = (el.run(SOLVERS[solver](one, **options)) for one in each)
    np.testing.assert_array_equal(exact.distance, without.distance)
    np.testing.assert_array_equal(energies(exact), energies(without))


def test_the_path_feels_only_what_counts(rng):
    """One step without a regulariser: pixels that nothing speaks for stay, others go as without evidence."""
    problem, v = worn(rng, "all three", lam=0.0)
    paths = [_Path.at(each, v, 0, 0.7) for each in (problem, replace(problem, evidence=None))]
    for path in paths:
        path.advance(1, 1.0, 1.0)
    found, plain = (path.log_distance for path in paths)
    counts = GaussNewtonModel.at(problem, v).data_weight > 0
    np.testing.assert_array_equal(found[counts], plain[counts])
    np.testing.assert_allclose(found[problem.mask & ~counts], v[problem.mask & ~counts], rtol=0, atol=1e-12)
    assert np.all(plain[problem.mask & ~counts] != v[problem.mask & ~counts])


@pytest.mark.parametrize("what", [AT_LEAST, NONE])
def test_both_solvers_stay_at_the_minimum_that_either_finds(what):
    """Normals of two neighbours, as the energy's: from Gauss-Newton's result the path does not depart."""
    problem, seen = posed("curved", 80, gain=1.5, lam=0.1)
    problem = marked(problem, saturated(problem), what)
    first = el.run(gauss_newton(problem, tolerance=1e-5))
    path = el.run(primal_dual(problem, first.iterate.log_distance, patch=0, max_iterations=300, tolerance=0))
    assert path.energy < 1.05 * first.energy
    np.testing.assert_allclose(path.distance, first.distance, rtol=2e-3)
    assert percent_off(path, seen, saturated(problem)) < 1


@pytest.mark.parametrize(("gain", "exact", "bounded"), [(1.5, 3.0, 0.6), (2.0, 8.5, 2.5)])
def test_a_bowl_whose_nearest_part_is_saturated(gain, exact, bounded):
    """Measured inside the saturated part, in %: 3.5 and 0.40 at 1.5 times the gain, 9.3 and 1.8 at twice."""
    problem, seen = posed("curved", 160, gain=gain)
    bright = saturated(problem)
    assert bright.mean() > 0.1
    before, after = (el.run(gauss_newton(each)) for each in (problem, marked(problem, bright, AT_LEAST)))
    assert percent_off(before, seen, bright) > exact
    assert percent_off(after, seen, bright) < bounded
    assert percent_off(after, seen, ~bright) < percent_off(before, seen, ~bright) / 2
    assert after.status is el.Status.CONVERGED
    check_it_falls(after)


@pytest.mark.parametrize("radius", [6, 12])
def test_a_painted_blob_on_a_plane_is_seen_through(radius):
    """A white disc, not inpainted. Measured inside it, in %: 17 and 18 as data, 0.02 and 0.04 ignored."""
    problem, seen = posed("plane", 160)
    rows, columns = np.indices(problem.mask.shape)
    blob = np.hypot(rows - 60, columns - 70) < radius
    problem = replace(problem, image=np.where(blob, 1.0, problem.image))
    taken, ignored = (el.run(gauss_newton(each)) for each in (problem, marked(problem, blob, NONE)))
    assert percent_off(taken, seen, blob) > 15
    assert percent_off(ignored, seen, blob) < 0.1
    assert percent_off(ignored, seen, ~blob) < 0.05


@pytest.mark.parametrize("what", [AT_LEAST, NONE])
@pytest.mark.parametrize("lam", [0.0, 1.0])
def test_a_frame_that_says_nothing_still_ends(what, lam):
    problem, _ = posed("colon", 96, gain=3.0, lam=lam)
    result = el.run(gauss_newton(marked(problem, True, what)))
    check_it_falls(result)
    assert result.status is not el.Status.NON_FINITE


@pytest.mark.parametrize(
    ("evidence", "message"),
    [
        (np.zeros((6, 8)), r"an int8 array of shape \(6, 8\), found float64 of shape \(6, 8\)"),
        (np.zeros((8, 6), np.int8), r"an int8 array .*, found int8 of shape \(8, 6\)"),
        (np.full((6, 8), 3, np.int8), r"0 \(exact\), 1 \(at least\) or 2 \(none\), found 3"),
    ],
)
def test_evidence_that_cannot_be_used_is_refused(evidence, message):
    problem, _ = posed("plane", 8)
    with pytest.raises(ValueError, match=f"evidence must be {message}"):
        replace(problem, evidence=evidence)
