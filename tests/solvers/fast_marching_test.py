"""Fast marching against a readable twin, against exact scenes, and in its invariances."""

from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pytest

import endolab as el
from endolab.metrics.depth_errors import depth_cuts
from endolab.solvers.solvers import fast_marching
from tests.tools.adjoints import between
from tests.tools.problems import SHEET, border, errors_of, percent_off, problem_of

# (row, column).
AROUND = [
    (0, 1),
    (1, 1),
    (1, 0),
    (1, -1),
    (0, -1),
    (-1, -1),
    (-1, 0),
    (-1, 1),
]
FISHEYE = el.KannalaBrandt(
    48, 36, 24.0, 25.0, 23.0, 18.5, (-0.139, -0.00124, 0.000913, -0.0000407)
)


def march_distances(problem, **options):
    """Distances."""
    return el.run(fast_marching(problem, **options)).distance


def largest_root(a, b, c):
    """Of a y² + 2 b y + c; nan if there is none."""
    inside = b * b - a * c
    return (np.sqrt(inside) - b) / a if inside >= 0 else np.nan


def open_steps(mask, cuts):
    """Steps (row, column) that the march may take from each pixel of the mask."""
    cuts = np.zeros((2, *mask.shape), dtype=bool) if cuts is None else cuts
    inside = set(map(tuple, np.argwhere(mask).tolist()))

    def is_cut(a, b):
        """Whether the side between two pixels is cut."""
        return bool(cuts[int(a[0] != b[0])][min(a, b)])

    def is_open(a, step):
        b = a[0] + step[0], a[1] + step[1]
        if b not in inside:
            return False
        if 0 in step:
            return not is_cut(a, b)
        corners = (a[0], b[1]), (b[0], a[1])
        around = [
            c in inside and not is_cut(a, c) and not is_cut(c, b) for c in corners
        ]
        return any(around) or not any(is_cut(x, c) for x in (a, b) for c in corners)

    return {a: [step for step in AROUND if is_open(a, step)] for a in sorted(inside)}


def local_solution(y, limit, inverse_metric, steps, pixel, highest_order):
    """d² at a pixel from its eight neighbours: the least that an edge or an upwind triangle gives.

    Depends on lower neighbours alone, so its fixed point is one (if no two neighbours tie).
    """
    best = limit
    guu, guv, gvv = inverse_metric

    def inner(p, q):
        return guu * p[0] * q[0] + guv * (p[0] * q[1] + p[1] * q[0]) + gvv * p[1] * q[1]

    def next_to(place, step):
        return place[0] + step[0], place[1] + step[1]

    def difference(step, order):
        """(s, t, neighbour): p·step = s y + t."""
        place = next_to(pixel, step)
        near = y[place]
        far = y[next_to(place, step)] if step in steps[place] else np.inf
        return (
            (-1.5, 2 * near - 0.5 * far, near)
            if order == 2 and far <= near
            else (-1.0, near, near)
        )

    for step, turned in zip(AROUND, [*AROUND[1:], AROUND[0]], strict=True):
        if step not in steps[pixel] or y[next_to(pixel, step)] >= limit:
            continue
        a = step[::-1]
        b = turned[::-1]
        length = (gvv * a[0] ** 2 - 2 * guv * a[0] * a[1] + guu * a[1] ** 2) / (
            guu * gvv - guv**2
        )
        for order in range(highest_order, 0, -1):
            s, t, near = difference(step, order)
            value = largest_root(
                s * s / length + 4, s * t / length, t * t / length - 4 * limit**2
            )
            if near <= value <= limit:
                best = min(best, value)
                break
        third = turned[0] - step[0], turned[1] - step[1]
        if turned not in steps[pixel] or third not in steps[next_to(pixel, step)]:
            continue
        if y[next_to(pixel, turned)] >= limit:
            continue
        turn = a[0] * b[1] - a[1] * b[0]
        for order in range(highest_order, 0, -1):
            (sa, ta, ya), (sb, tb, yb) = (
                difference(step, order),
                difference(turned, order),
            )
            alpha = (b[1] * sa - a[1] * sb) / turn, (a[0] * sb - b[0] * sa) / turn
            beta = (b[1] * ta - a[1] * tb) / turn, (a[0] * tb - b[0] * ta) / turn
            squared = (
                inner(alpha, alpha) + 4,
                inner(alpha, beta),
                inner(beta, beta) - 4 * limit**2,
            )
            value = largest_root(*squared)
            if not max(ya, yb) <= value <= limit:
                continue
            p = [alpha[0] * value + beta[0], alpha[1] * value + beta[1]]
            down = -(guu * p[0] + guv * p[1]), -(guv * p[0] + gvv * p[1])
            weights = (
                (down[0] * b[1] - down[1] * b[0]) / turn,
                (a[0] * down[1] - a[1] * down[0]) / turn,
            )
            if min(weights) >= -1e-9 * (abs(weights[0]) + abs(weights[1])):
                best = min(best, value)
                break
    return best


def fast_sweeping(problem):
    """d² by sweeping the picture in four orders until nothing changes.

    First order first, which falls to its fixed point from any upper bound; second order from there.
    """
    steps = open_steps(problem.mask, problem.cuts)
    d2 = np.exp(2 * problem.log_d0)
    y0 = {pixel: float(d2[pixel]) for pixel in steps}
    metric = {pixel: problem.field.inverse_metric[pixel].tolist() for pixel in steps}
    y = dict(y0)
    orders = [
        sorted(steps, key=lambda p, r=r, c=c: (r * p[0], c * p[1]))
        for r in (1, -1)
        for c in (1, -1)
    ]
    for order in (1, 2):
        for _ in range(20):
            before = list(y.values())
            for pixel in (place for sweep in orders for place in sweep):
                y[pixel] = local_solution(
                    y, y0[pixel], metric[pixel], steps, pixel, order
                )
            if np.allclose(list(y.values()), before, rtol=1e-13, atol=0):
                break
        else:
            pytest.fail("the sweeps do not converge")
    swept = np.full(problem.mask.shape, np.nan)
    swept[problem.mask] = list(
        y.values()
    )  # sorted by row and column, as the mask reads
    return swept


@pytest.mark.parametrize(
    ("scene", "tear"),
    [
        *product(el.SCENES, ["none"]),
        ("colon", "contours"),
        ("colon", "random"),
        ("tube", "random"),
    ],
)
@pytest.mark.parametrize(
    "camera", [el.Pinhole(17, 13, 8.5, 8.5, 8.2, 6.3), FISHEYE.resize(17, 13)]
)
def test_sweeping_gives_the_same_answer(rng, scene, camera, tear):
    rows, columns = np.indices((13, 17))
    holed = ~((rows > 7) & (rows < 10) & (columns > 4) & (columns < 8))
    if tear == "random":
        holed &= rng.random(holed.shape) > 0.05
    problem, seen = problem_of(scene, camera=camera, mask=holed)
    contours = depth_cuts(seen.distance)
    cuts = {
        "none": None,
        "contours": contours,
        "random": rng.random((2, 13, 17)) < 0.15,
    }[tear]
    assert contours.sum() > 20 or scene != "colon"
    problem = replace(problem, cuts=cuts)
    found = march_distances(problem)
    swept = np.sqrt(fast_sweeping(problem))
    np.testing.assert_array_equal(np.isfinite(found), problem.mask)
    assert np.nanmax(np.abs(found / swept - 1)) < 1e-9


@pytest.mark.parametrize("scene", ["plane", "curved"])
def test_smooth_scenes_are_exact_to_second_order(scene):
    posed = (problem_of(scene, width) for width in (80, 160, 320))
    found = [errors_of(el.run(fast_marching(problem)), seen) for problem, seen in posed]
    errors = np.array([each.mean_percent for each in found])
    assert errors[-1] < 0.002
    assert found[-1].mean_degrees < 0.01
    orders = np.log2(errors[:-1] / errors[1:])
    assert np.all(orders > 1.7), f"orders of convergence {orders}"


def test_the_tube_needs_its_border():
    """The border of the tube is inflow: wrong without its values (as the paper is), right with them."""
    problem, seen = problem_of("tube", 320)
    inflow = border(seen, 2)
    without = march_distances(problem)
    given = march_distances(problem, inflow=inflow)
    assert 4 < percent_off(without, seen) < 9
    assert percent_off(given, seen) < 0.3
    np.testing.assert_allclose(np.log(given)[:2], inflow[:2], rtol=1e-12)


@pytest.mark.parametrize("brdf", [None, SHEET], ids=["lambertian", "tabulated"])
def test_the_frame_is_explained(brdf):
    """The model of the marched surface is the frame, whatever the BRDF: below a tenth of a grey level."""
    problem, seen = problem_of("curved", 160, brdf=brdf)
    result = el.run(fast_marching(problem))
    assert 255 * np.sqrt(2 * result.iterate.terms["data"]) < 0.1
    assert percent_off(result, seen) < 0.05


def test_what_lies_outside_the_mask_is_not_read():
    problem, _ = problem_of("curved", 80)
    mask = problem.mask & (np.indices(problem.mask.shape).sum(axis=0) % 7 > 0)
    clean = march_distances(replace(problem, mask=mask))
    spoilt = np.where(mask, problem.image, np.nan)
    np.testing.assert_array_equal(
        march_distances(replace(problem, mask=mask, image=spoilt)), clean
    )


def test_mirrored_and_turned_frames_give_mirrored_and_turned_surfaces():
    camera = el.Pinhole(61, 61, 40.0, 40.0, 30.0, 30.0)
    problem, seen = problem_of("colon", camera=camera)
    for find_cuts in (lambda distance: None, depth_cuts):
        d = march_distances(replace(problem, cuts=find_cuts(seen.distance)))
        for turn in (np.fliplr, np.flipud, np.transpose, np.rot90):
            image, mask, truth = (
                turn(a).copy() for a in (problem.image, problem.mask, seen.distance)
            )
            turned = replace(problem, image=image, mask=mask, cuts=find_cuts(truth))
            np.testing.assert_allclose(march_distances(turned), turn(d), rtol=1e-9)


def test_the_front_advances_and_ends_where_one_pass_ends():
    problem, _ = problem_of("colon", 120, camera="paper")
    steps = list(fast_marching(problem, snapshots=7))
    arrived = [step.maps["arrived"] for step in steps]
    assert not arrived[0].any()
    assert np.array_equal(arrived[-1], problem.mask)
    assert all(np.all(late | ~early) for early, late in pairwise(arrived))
    assert all(np.all(np.isfinite(step.log_distance[problem.mask])) for step in steps)
    np.testing.assert_array_equal(
        steps[-1].log_distance, el.run(fast_marching(problem)).iterate.log_distance
    )
    assert [step.k for step in steps] == list(range(8))
    assert el.run(fast_marching(problem, snapshots=7)).status is el.Status.CONVERGED


def test_contours_that_meet_at_corners_and_holes_do_not_leak(rng):
    """A random patchwork: each patch, whatever its neighbours show, is the same."""
    problem, _ = problem_of("curved", 80)
    labels = rng.integers(0, 3, (30, 40)).repeat(2, axis=0).repeat(2, axis=1)
    labels[::7, ::3] += 1
    mask = problem.mask & (rng.random(labels.shape) > 0.1)
    cut_problem = replace(problem, mask=mask, cuts=between(labels))
    expected = march_distances(cut_problem)
    for label in range(4):
        patch = mask & (labels == label)
        image = np.where(patch, cut_problem.image, rng.uniform(0.1, 1, labels.shape))
        np.testing.assert_array_equal(
            march_distances(replace(cut_problem, image=image))[patch], expected[patch]
        )
