"""Fast marching against a readable twin, against exact scenes, and in its invariances."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.depth.energy import Problem
from endolab.depth.fast_marching import fast_marching
from endolab.evaluation import compare

AROUND = [(0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1)]  # (row, column)
FISHEYE = el.KannalaBrandt(48, 36, 24.0, 25.0, 23.0, 18.5, (-0.139, -0.00124, 0.000913, -0.0000407))
PAPER_SHEET = el.TabulatedBRDF(
    tuple(np.linspace(0, 1.5, 15)), tuple(0.2 + 0.1 * np.exp(-16 * np.linspace(0, 1.5, 15) ** 2))
)


def posed(scene, camera, *, brdf=None, mask=None, **options):
    """A rendered scene as a problem, with its truth."""
    seen = el.render(scene, camera, el.Photometry(brdf=brdf or el.Lambertian(0.5)), **options)
    mask = seen.mask & (True if mask is None else mask) & (seen.image > 0.02)
    return Problem(seen.image, mask, camera, seen.photometry), seen


def largest_root(a, b, c):
    """Of a y² + 2 b y + c; nan if there is none."""
    inside = b * b - a * c
    return (np.sqrt(inside) - b) / a if inside >= 0 else np.nan


def local_solution(y, y0, inverse_metric, row, column, highest_order):
    """d² at a pixel from its eight neighbours: the least that an edge or an upwind triangle gives.

    Depends on lower neighbours alone, so its fixed point is one (if no two neighbours tie).
    """
    limit = best = y0[row, column]
    guu, guv, gvv = inverse_metric[row, column]
    inner = lambda p, q: guu * p[0] * q[0] + guv * (p[0] * q[1] + p[1] * q[0]) + gvv * p[1] * q[1]  # noqa: E731

    def at(step, times=1):
        place = row + times * step[0], column + times * step[1]
        return y[place] if min(place) >= 0 and place[0] < y.shape[0] and place[1] < y.shape[1] else np.inf

    def difference(step, order):
        """(s, t, neighbour): p·step = s y + t."""
        near, far = at(step), at(step, 2)
        return (-1.5, 2 * near - 0.5 * far, near) if order == 2 and far <= near else (-1.0, near, near)

    for step, turned in zip(AROUND, [*AROUND[1:], AROUND[0]], strict=True):
        if at(step) >= limit:
            continue
        a, b = np.array(step[::-1]), np.array(turned[::-1])
        length = (gvv * a[0] ** 2 - 2 * guv * a[0] * a[1] + guu * a[1] ** 2) / (guu * gvv - guv**2)
        for order in range(highest_order, 0, -1):
            s, t, near = difference(step, order)
            value = largest_root(s * s / length + 4, s * t / length, t * t / length - 4 * limit**2)
            if near <= value <= limit:
                best = min(best, value)
                break
        if at(turned) >= limit:
            continue
        turn = a[0] * b[1] - a[1] * b[0]
        for order in range(highest_order, 0, -1):
            (sa, ta, ya), (sb, tb, yb) = difference(step, order), difference(turned, order)
            alpha = (b[1] * sa - a[1] * sb) / turn, (a[0] * sb - b[0] * sa) / turn
            beta = (b[1] * ta - a[1] * tb) / turn, (a[0] * tb - b[0] * ta) / turn
            value = largest_root(
                inner(alpha, alpha) + 4, inner(alpha, beta), inner(beta, beta) - 4 * limit**2
            )
            if not max(ya, yb) <= value <= limit:
                continue
            p = [alpha[0] * value + beta[0], alpha[1] * value + beta[1]]
            down = -(guu * p[0] + guv * p[1]), -(guv * p[0] + gvv * p[1])
            weights = np.array([down[0] * b[1] - down[1] * b[0], a[0] * down[1] - a[1] * down[0]]) / turn
            if weights.min() >= -1e-9 * np.abs(weights).sum():
                best = min(best, value)
                break
    return best


def fast_sweeping(problem):
    """d² by sweeping the picture in four orders until nothing changes.

    First order first, which falls to its fixed point from any upper bound; second order from there.
    """
    y0 = np.where(problem.mask, np.exp(2 * problem.log_facing), np.inf)
    y, pixels = y0.copy(), [tuple(place) for place in np.argwhere(problem.mask)]
    orders = [sorted(pixels, key=lambda p, r=r, c=c: (r * p[0], c * p[1])) for r in (1, -1) for c in (1, -1)]
    for order in (1, 2):
        for _ in range(12):
            before = y.copy()
            for pixel in (place for sweep in orders for place in sweep):
                y[pixel] = local_solution(y, y0, problem.field.inverse_metric, *pixel, order)
            if np.allclose(y[problem.mask], before[problem.mask], rtol=1e-13, atol=0):
                break
        else:
            pytest.fail("the sweeps do not converge")
    return np.where(problem.mask, y, np.nan)


@pytest.mark.parametrize("scene", ["plane", "curved", "tube", "colon"])
@pytest.mark.parametrize("camera", [el.Pinhole(24, 18, 12.0, 12.0, 11.3, 8.6), FISHEYE.resize(24, 18)])
def test_sweeping_gives_the_same_answer(scene, camera):
    rows, columns = np.indices((18, 24))
    holed = ~((rows > 10) & (rows < 14) & (columns > 5) & (columns < 10))
    problem, _ = posed(el.SCENES[scene], camera, mask=holed)
    marched = el.run(fast_marching(problem)).distance
    swept = np.sqrt(fast_sweeping(problem))
    assert np.nanmax(np.abs(marched / swept - 1)) < 1e-9


@pytest.mark.parametrize("scene", ["plane", "curved"])
def test_smooth_scenes_are_exact_to_second_order(scene):
    errors = []
    for width in (80, 160, 320):
        calibration = datasets.calibration("simple", width)
        problem, seen = posed(el.SCENES[scene], calibration.camera)
        result = el.run(fast_marching(problem))
        found = compare(
            result.distance,
            seen.distance,
            problem.field.cos_alpha,
            normals=result.normals,
            true_normals=seen.normals,
        )
        errors.append(found.mean_percent)
    assert found.mean_percent < 0.002
    assert found.mean_degrees < 0.01
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(orders > 1.7), f"orders of convergence {orders}"


def test_the_tube_needs_its_border():
    """The border of the tube is inflow: wrong without its values (as the paper is), right with them."""
    camera = datasets.calibration("simple", 320).camera
    problem, seen = posed(el.SCENES["tube"], camera)
    inflow = np.full(seen.distance.shape, np.nan)
    for edge in (np.s_[:2], np.s_[-2:], np.s_[:, :2], np.s_[:, -2:]):
        inflow[edge] = np.log(seen.distance[edge])
    without = el.run(fast_marching(problem)).distance
    given = el.run(fast_marching(problem, inflow=inflow)).distance
    assert 4 < 100 * np.nanmean(np.abs(without / seen.distance - 1)) < 9
    assert 100 * np.nanmean(np.abs(given / seen.distance - 1)) < 0.3
    np.testing.assert_allclose(np.log(given)[:2], inflow[:2], rtol=1e-12)


@pytest.mark.parametrize("brdf", [None, PAPER_SHEET], ids=["lambertian", "tabulated"])
def test_the_frame_is_explained(brdf):
    """The model of the marched surface is the frame, whatever the BRDF: below a tenth of a grey level."""
    problem, seen = posed(el.SCENES["curved"], datasets.calibration("simple", 160).camera, brdf=brdf)
    result = el.run(fast_marching(problem))
    assert 255 * np.sqrt(2 * result.iterate.terms["data"]) < 0.1
    assert 100 * np.nanmean(np.abs(result.distance / seen.distance - 1)) < 0.05


def test_facing_is_an_upper_bound_and_the_seeds_reach_it():
    problem, _ = posed(el.SCENES["colon"], datasets.calibration("paper", 120).camera, noise=2.0, bits=8)
    v = el.run(fast_marching(problem)).iterate.log_distance
    assert np.all(v[problem.mask] <= problem.log_facing[problem.mask] + 1e-12)
    lowest = np.nanargmin(problem.log_facing)
    assert v.flat[lowest] == pytest.approx(problem.log_facing.flat[lowest], abs=1e-12)


def test_islands_do_not_see_each_other():
    problem, _ = posed(el.SCENES["colon"], datasets.calibration("simple", 120).camera)
    columns = np.indices(problem.mask.shape)[1]
    left, right = problem.mask & (columns < 50), problem.mask & (columns > 51)
    both = el.run(fast_marching(replace(problem, mask=left | right))).distance
    for side in (left, right):
        alone = el.run(fast_marching(replace(problem, mask=side))).distance
        np.testing.assert_array_equal(both[side], alone[side])
    assert np.all(np.isnan(both[~(left | right)]))


def test_what_lies_outside_the_mask_is_not_read():
    problem, _ = posed(el.SCENES["curved"], datasets.calibration("simple", 80).camera)
    mask = problem.mask & (np.indices(problem.mask.shape).sum(axis=0) % 7 > 0)
    clean = el.run(fast_marching(replace(problem, mask=mask))).distance
    spoilt = np.where(mask, problem.image, np.nan)
    np.testing.assert_array_equal(
        el.run(fast_marching(replace(problem, mask=mask, image=spoilt))).distance, clean
    )


def test_mirrored_and_turned_frames_give_mirrored_and_turned_surfaces():
    camera = el.Pinhole(61, 61, 40.0, 40.0, 30.0, 30.0)
    problem, _ = posed(el.SCENES["colon"], camera)
    d = el.run(fast_marching(problem)).distance
    for turn in (np.fliplr, np.flipud, np.transpose, lambda a: np.rot90(a)):
        turned = replace(problem, image=turn(problem.image).copy(), mask=turn(problem.mask).copy())
        np.testing.assert_allclose(el.run(fast_marching(turned)).distance, turn(d), rtol=1e-9)


def test_distances_scale_with_the_root_of_the_gain():
    problem, _ = posed(el.SCENES["tube"], datasets.calibration("simple", 80).camera)
    brighter = replace(problem, photometry=replace(problem.photometry, gain=4 * problem.photometry.gain))
    ratio = el.run(fast_marching(brighter)).distance / el.run(fast_marching(problem)).distance
    np.testing.assert_allclose(ratio[problem.mask], 2.0, rtol=1e-10)


def test_the_front_advances_and_ends_where_one_pass_ends():
    problem, _ = posed(el.SCENES["colon"], datasets.calibration("paper", 120).camera)
    steps = list(fast_marching(problem, snapshots=7))
    arrived = [step.maps["arrived"] for step in steps]
    assert not arrived[0].any()
    assert np.array_equal(arrived[-1], problem.mask)
    assert all(np.all(late | ~early) for early, late in pairwise(arrived))
    assert all(np.all(np.isfinite(step.log_distance[problem.mask])) for step in steps)
    np.testing.assert_array_equal(steps[-1].log_distance, el.run(fast_marching(problem)).iterate.log_distance)
    assert len(steps) == 8
    assert el.run(fast_marching(problem, snapshots=7)).status is el.Status.CONVERGED


def test_inflow_of_another_size_is_refused():
    problem, _ = posed(el.SCENES["plane"], datasets.calibration("simple", 80).camera)
    with pytest.raises(ValueError, match=r"inflow has shape \(3, 4\)"):
        next(fast_marching(problem, inflow=np.zeros((3, 4))))


def test_a_brdf_that_hides_the_slant_is_refused():
    rising = el.TabulatedBRDF((0.0, 0.5, 1.0), (0.1, 0.3, 0.9))
    problem, _ = posed(el.SCENES["plane"], datasets.calibration("simple", 80).camera, brdf=rising)
    with pytest.raises(ValueError, match="two slants"):
        next(fast_marching(problem))
