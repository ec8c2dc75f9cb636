"""λ that is chosen: by what the surface leaves of its picture, beside what it would leave of noise."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.depth.energy import model_image
from endolab.depth.gauss_newton import gauss_newton
from endolab.depth.problem import NONE
from endolab.depth.result import run
from endolab.metrics.depth_errors import resampled_truth
from endolab.preprocessing.frame import smooth_light
from endolab.reconstruction.sequence import reconstruct_sequence
from endolab.reports.result import report
from endolab.uncertainty import choice_of_lam as choice
from endolab.uncertainty.choice_of_lam import LAMS, choose_lam
from tests.tools.problems import Shot, percent_off, problem_of

FISHEYE = datasets.load_calibration("paper", 320)
HOW = {"width": 160, "channel": "green"}


def chosen(problem, start=None, **options):
    """The curve of a problem, and the surface of each λ."""
    steps, surfaces = choose_lam(problem, start, **options), {}
    while True:
        try:
            iterate = next(steps)
        except StopIteration as end:
            return end.value, surfaces
        surfaces[iterate.problem.lam] = iterate


@pytest.fixture(scope="module")
def tubes():
    """A tube in a fisheye, with a grey level of noise and with four."""
    shots = {noise: Shot("tube", FISHEYE, noise=noise, bits=8) for noise in (1, 4)}
    for shot in shots.values():
        shot.half = SimpleNamespace(distance=resampled_truth(shot.truth.distance, (120, 160)))
    return shots


@pytest.fixture(scope="module")
def ball():
    """A ball as a problem whose noise was blurred by 2 px."""

    def make(noise):
        problem, _ = problem_of("curved", noise=noise)
        gamma = problem.photometry.gamma
        return replace(problem, image=smooth_light(problem.image, problem.mask, gamma, 2.0))

    return make


@pytest.fixture(scope="module")
def auto(tubes):
    return {noise: shot.reconstruct(lam="auto", **HOW) for noise, shot in tubes.items()}


def off(shot, result):
    """Mean error of a result of half the columns, %."""
    return percent_off(result.distance, shot.half)


@pytest.mark.parametrize("noise", [1, 4])
def test_it_is_nearly_as_good_as_the_best(tubes, auto, noise):
    """λ = 1 is two to three times as far off as the best here."""
    fixed = {lam: off(tubes[noise], tubes[noise].reconstruct(lam=lam, **HOW)) for lam in LAMS}
    assert off(tubes[noise], auto[noise]) < 1.15 * min(fixed.values())
    assert off(tubes[noise], auto[noise]) < 0.7 * fixed[1.0]


def test_the_first_order_needs_a_lesser_one(tubes):
    """Its λ = 1 makes the wall face the camera."""
    results = [tubes[1].reconstruct(lam=lam, regulariser="first", **HOW) for lam in ("auto", 1.0)]
    assert off(tubes[1], results[0]) < 0.5 * off(tubes[1], results[1])


def test_more_noise_asks_for_more():
    """Sharp pictures of a ball; of blurred ones the wall decides, which is the same."""
    problems = [problem_of("curved", noise=noise, regulariser="curvature")[0] for noise in (1, 16)]
    less, more = (chosen(problem)[0].chosen for problem in problems)
    assert more > 3 * less


def test_the_curve(auto):
    """The data are explained worse, and the surface is smoother, the larger λ is."""
    curve = auto[4].problem.origin.lam_curve
    assert tuple(curve.lam) == LAMS
    assert np.all(np.diff(curve.data) > 0)
    assert np.all(np.diff(curve.regulariser) < 0)
    assert np.all(np.abs([curve.alike, curve.alike_of_noise]) <= 1)
    assert not curve.lam.flags.writeable
    assert auto[4].problem.lam == curve.chosen


def test_sizes_agree(tubes):
    """The tube in few pixels and in many, within what is between two λ that are tried."""
    lams = [
        tubes[4].reconstruct(lam="auto", width=width, channel="green").problem.lam for width in (160, 320)
    ]
    assert lams[0] == lams[1]


def test_a_unit_makes_no_difference(ball):
    """A hundred times the gain is ten times the distance."""
    problem = ball(8)
    brighter = replace(problem.photometry, gain=100 * problem.photometry.gain)
    far, _ = chosen(replace(problem, photometry=brighter), smooth=2.0)
    near, _ = chosen(problem, smooth=2.0)
    assert far.chosen == pytest.approx(near.chosen, rel=0.05)
    assert far.data == pytest.approx(near.data, rel=0.05)


def test_what_a_surface_makes_of_noise_is_what_it_makes_of_a_changed_picture():
    """Where penalties are squares, it is how the solution's picture changes when the problem's does."""
    problem, _ = problem_of("curved", 48, epsilon=1.0, threshold=1.0, lam=3.0)
    solve = {"tolerance": 1e-9, "max_iterations": 200}
    surface = run(gauss_newton(problem, **solve)).iterate
    noise = 1e-4 * choice._noise(problem.mask.shape, 1.0) * problem.mask
    changed = replace(problem, image=problem.image + noise)
    after = run(gauss_newton(changed, surface.log_distance, **solve)).iterate
    moved = model_image(problem, after.log_distance) - model_image(problem, surface.log_distance)
    told = choice._followed(surface, noise)
    assert np.linalg.norm(moved) > 0.2 * np.linalg.norm(noise)
    assert np.linalg.norm(told - moved) < 0.1 * np.linalg.norm(moved)


def test_likeness():
    """Of white noise 0, of a ramp 1, of a checkerboard -1; pixels of no mask do not count."""
    mask = np.ones((100, 120), dtype=bool)
    mask[:, 60] = False
    row, column = np.indices(mask.shape)
    checkers = np.where(mask, (-1.0) ** (row + column), np.nan)
    assert choice._alike(choice._noise(mask.shape, 0.0), mask) == pytest.approx(0, abs=0.02)
    assert choice._alike(np.ones(mask.shape), mask) == pytest.approx(1)
    assert choice._alike(checkers, mask) == pytest.approx(-1)
    assert np.isnan(choice._alike(np.zeros(mask.shape), mask))
    blurred = choice._alike(choice._noise((400, 400), 2.0), np.ones((400, 400), bool))
    assert blurred == pytest.approx(np.exp(-1 / 16), abs=0.02)


@pytest.mark.parametrize(
    ("y", "x"), [([-2, -1, 1, 2], 1.5), ([1, -1, 3, 4], 1.25), ([-3, -2, -2, -1], 3), ([1, 2, 3, 4], 0)]
)
def test_the_last_zero(y, x):
    assert choice._last_zero(np.arange(4.0), np.array(y, float), 7.0) == x
    assert choice._last_zero(np.arange(4.0), np.array([*y[:3], np.nan]), 7.0) == 7


def test_a_picture_that_says_nothing_chooses_nothing():
    problem, _ = problem_of("plane", 48)
    silent = replace(problem, evidence=np.full(problem.mask.shape, NONE, np.int8))
    curve, _ = chosen(silent, problem.log_facing)
    assert curve.chosen == 1
    assert "does not tell" in curve.told


def test_what_is_chosen_is_told_and_can_be_given_again(tubes, auto):
    again = tubes[4].reconstruct(lam=auto[4].problem.lam, **HOW)
    np.testing.assert_array_equal(again.distance, auto[4].distance)
    assert f"λ = {auto[4].problem.lam:.3g} was chosen" in " ".join(auto[4].problem.origin.notes)
    said = json.loads(json.dumps(report(auto[4])))
    assert said["settings"]["lam"] == auto[4].problem.lam
    assert said["settings"]["lam_chosen"]
    assert said["lam_curve"]["lam"] == pytest.approx(LAMS, rel=1e-4)
    assert "lam_curve" not in report(again)
    assert {stage.name for stage in auto[4].stages} == {"choice of λ", "solution"}


def test_it_can_be_stopped_on_the_way(tubes):
    stopped = tubes[4].reconstruct(lam="auto", observers=[lambda one: one.stage == "choice of λ"], **HOW)
    assert stopped.status is el.Status.STOPPED
    assert np.isfinite(stopped.distance[stopped.mask]).all()


@pytest.mark.parametrize("solver", ["facing", "fast_marching"])
def test_solvers_without_an_energy_take_no_choice(tubes, solver):
    with pytest.raises(ValueError, match=f"solver '{solver}' minimises none: use gauss_newton or primal"):
        tubes[4].reconstruct(lam="auto", solver=solver)


def test_other_words_are_none(tubes):
    with pytest.raises(ValueError, match="lam must be a number or 'auto', got 'much'"):
        tubes[4].reconstruct(lam="much")


def test_a_video_takes_one_number(tubes):
    frames = reconstruct_sequence([("one", tubes[4].frame)], tubes[4].calibration, lam="auto")
    with pytest.raises(ValueError, match="the frames of a video take one number for all"):
        next(frames)
