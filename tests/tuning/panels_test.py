"""The tuner's panels and boards: what is shown, where it lies, what is said of it."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.depth.energy import energy_terms
from endolab.depth.problem import NONE
from endolab.plots.scales import DECIDERS
from endolab.tuning.boards import fitting, of_one, of_two
from endolab.tuning.engine import Tuner
from endolab.tuning.panels import BELOW_NOISE, FIRST, PANELS, SILENT, TORN, Cut, View, limits_of, map_alone
from endolab.tuning.pictures import LEFT_OUT, Look, coloured
from endolab.tuning.sentences import contrast, other_start, summary
from endolab.tuning.source import Settings

LOOK = Look()
INNER = np.s_[LOOK.top : LOOK.top + LOOK.height, LOOK.edge : LOOK.edge + LOOK.width]
BAR = np.s_[LOOK.top :, LOOK.edge + LOOK.width :]


@pytest.fixture(scope="module")
def outcome():
    engine = Tuner(datasets.load_calibration("simple", 160))
    yield engine.cold(Settings(scene="tube", width=160, noise=1.0))
    engine.close()


@pytest.fixture(scope="module")
def trusted(outcome):
    """The same, and how far it can be trusted."""
    return replace(outcome, trust=el.trust_of(outcome.result, draws=4))


def drawn(outcome, name, **view):
    return PANELS[name].draw(outcome, View(**view))


def changed(outcome, **problem):
    """The outcome with another problem."""
    iterate = outcome.result.iterate
    iterate = replace(iterate, problem=replace(iterate.problem, **problem))
    return replace(outcome, result=replace(outcome.result, iterate=iterate))


def test_trust_and_who_decided_are_in_their_colours(trusted):
    sigma, decided = drawn(trusted, "σ"), drawn(trusted, "who decided")
    mask = trusted.result.mask
    percent = np.where(mask, 100 * trusted.trust.sigma / trusted.result.distance, np.nan)
    most = next(limit for limit in (2, 5, 10, 20, 50, 100) if limit >= np.nanpercentile(percent, 98))
    large = cv2.resize(coloured(percent, (0, most), "magma"), (320, 240), interpolation=cv2.INTER_LINEAR)
    assert np.array_equal(sigma[INNER], large)
    for k, colour in enumerate(DECIDERS.values(), 1):
        share = np.mean((decided[INNER] == colour).all(axis=-1))
        assert share == pytest.approx(np.mean(trusted.trust.decided_by == k), abs=0.15)


def test_what_is_not_known_yet_or_never_is_grey_and_a_lends_its_colours(trusted, outcome):
    for name in ("σ", "who decided"):
        waiting, never = drawn(outcome, name), drawn(replace(outcome, untold="no energy"), name)
        assert (waiting[100, 100] == LEFT_OUT).all()
        assert (waiting != never).any()
    other = replace(trusted, trust=replace(trusted.trust, sigma=5 * trusted.trust.sigma))
    alone, beside = drawn(other, "σ"), drawn(other, "σ", limits=limits_of(trusted))
    assert np.array_equal(beside[BAR], drawn(trusted, "σ")[BAR])
    assert (alone[BAR] != beside[BAR]).any()


def test_a_without_a_truth_lends_the_axes_of_its_section(outcome):
    blind = replace(outcome, subject=replace(outcome.subject, truth=None))
    iterate = blind.result.iterate
    twice = replace(iterate, log_distance=iterate.log_distance + 0.7)
    other = replace(blind, result=replace(blind.result, iterate=twice))
    shown = (blind, None), (other, None), (other, limits_of(blind))
    numbers = [drawn(one, "section", limits=limits)[-38:-12].astype(int) for one, limits in shown]
    assert (numbers[0] != numbers[1]).any()
    assert (numbers[0] == numbers[2]).all()


def test_the_residual_is_what_the_data_term_is_made_of_and_noise_is_no_news(outcome):
    problem, residual = outcome.result.problem, outcome.residual / 255
    known = np.isfinite(residual)
    data = energy_terms(problem, outcome.result.iterate.log_distance)["data"]
    assert np.abs(residual[known]).max() < problem.threshold  # so that the penalty is a square
    assert 0.5 * (residual[known] ** 2).sum() / problem.mask.sum() == pytest.approx(data, rel=1e-9)
    assert outcome.noise_floor == pytest.approx(
        0.5 * outcome.noise**2 * known.sum() / problem.mask.sum(), rel=0.02
    )
    quiet = np.mean(np.abs(residual[known]) <= 2 * outcome.noise)
    shown = (drawn(outcome, "model - frame")[INNER] == BELOW_NOISE).all(axis=-1).mean()
    assert shown == pytest.approx(quiet * known.mean(), abs=0.12)
    blur = float(outcome.result.problem.settings["smooth"])
    assert 255 * outcome.noise == pytest.approx(1 / (2 * np.sqrt(np.pi) * blur), rel=0.3)  # of one grey level


def test_a_silent_pixel_a_cut_and_what_is_left_out_have_their_colours(outcome):
    mask = outcome.result.mask
    evidence, cuts = np.zeros(mask.shape, np.int8), np.zeros((2, *mask.shape), bool)
    evidence[20:60, 20:60] = NONE
    cuts[0, 40:80, 70:72] = True
    other = changed(outcome, evidence=evidence, cuts=cuts)
    assert (drawn(other, "mask and highlights")[INNER] == SILENT).all(axis=-1).mean() == pytest.approx(
        1600 / mask.size, rel=0.1
    )
    assert (drawn(other, "contours")[INNER] == TORN).all(axis=-1).sum() > 100
    assert not (drawn(outcome, "contours")[INNER][:190] == TORN).all(axis=-1).any()
    assert PANELS["mask and highlights"].read(other, 30, 30) == "no evidence"
    assert PANELS["contours"].read(other, 50, 70) == "torn here"


def test_another_start_is_compared_only_if_there_was_one(outcome):
    assert other_start(outcome) == ""
    iterate = outcome.result.iterate
    moved = np.array(iterate.log_distance)
    moved[:60] += np.log(1.1)
    followed = replace(outcome.result, iterate=replace(iterate, log_distance=moved))
    other = replace(outcome, followed=followed)
    assert "up to 10 % elsewhere (50 % of it by over 1 %)" in other_start(other)
    assert PANELS["another start"].read(other, 10, 80) == "+10.0 %"
    assert (drawn(other, "another start") != drawn(outcome, "another start")).any()


def test_what_differs_is_said_and_one_iteration_is_not_many(outcome):
    one, other = Settings(scene=None, k=None, solver="primal_dual"), Settings(scene=None, k=3.0)
    assert contrast(one, other) == "λ = 1, k = as calibrated, solver = primal-dual"
    assert contrast(other, one) == "λ = 1, k = 3, solver = Gauss-Newton"
    assert contrast(replace(one, contours=False), one) == "λ = 1, contours = False"
    assert summary(outcome).count(f"{outcome.result.iterations} iterations, converged") == 1
    once = replace(outcome, result=replace(outcome.result, history=[{"k": 1}]))
    assert "1 iteration," in summary(once)


@pytest.mark.parametrize("columns", [3, 2])
@pytest.mark.parametrize("scale", [0.6, 1.0, 1.35])
def test_spots_and_boxes_are_where_panels_and_maps_are(outcome, columns, scale):
    look = Look(scale)
    board = of_one(outcome, FIRST, View(look=look), columns)
    height, width = board.picture.shape[:2]
    assert (width, height) == (columns * look.size[0], 6 // columns * look.size[1])
    for place, box, spot in zip(board.places, board.boxes, board.spots, strict=True):
        left, top, right, bottom = (round(a * b) for a, b in zip(box, (width, height) * 2, strict=True))
        assert np.array_equal(board.picture[top:bottom, left:right], place.picture)
        assert (spot is None) == (PANELS[place.name].read is None)
        if place.name == "normals":
            at = [round(a * b) for a, b in zip(spot, (width, height) * 2, strict=True)]
            inside = board.picture[at[1] : at[3], at[0] : at[2]]
            assert inside.shape[:2] == look.fitted((120, 160))[::-1]
            assert (board.picture[at[1] - 1, at[0] : at[2]] == 255).all(axis=-1).mean() > 0.9
            assert (inside == 255).all(axis=-1).mean() < 0.1


@pytest.mark.parametrize("room", [(900, 500), (1600, 870), (400, 2000), (100, 100)])
@pytest.mark.parametrize("count", [1, 2, 4, 6, 9])
def test_panels_fill_the_room_and_stay_in_it(room, count):
    columns, look = fitting(count, room)
    rows = -(-count // columns)
    wide, high = columns * look.size[0], rows * look.size[1]
    if look.scale > 0.6:
        assert wide <= room[0]
        assert high <= room[1]
    if 0.6 < look.scale < 2.0:
        assert wide > 0.85 * room[0] - 40 or high > 0.85 * room[1] - 40


def test_a_run_that_ran_out_of_iterations_says_so_on_the_board(outcome):
    short = replace(outcome, result=replace(outcome.result, status=el.Status.MAX_ITERATIONS))
    assert (drawn(short, "energy")[:26] != drawn(outcome, "energy")[:26]).any()
    assert summary(short).count("max iterations") == 1


def test_a_map_alone_has_no_section_and_no_bar(outcome):
    alone, panel = map_alone(outcome, "distance"), drawn(outcome, "distance")[INNER]
    assert alone.shape == (240, 320, 3)
    differs = (alone != panel).any(axis=-1)
    assert differs.any(axis=0).sum() < 8  # of the columns: the section's line


def test_two_of_other_sizes_stand_side_by_side_without_a_difference(outcome):
    engine = Tuner(datasets.load_calibration("simple", 160))
    small = engine.cold(Settings(scene="tube", width=80))
    engine.close()
    names = [place.name for place in of_two(small, outcome, FIRST, View()).places]
    assert names == ["distance", "distance", "model - frame", "model - frame"]


def test_a_cut_stays_in_the_picture():
    assert [Cut(share).index((3, 4)) for share in (0, 0.5, 1)] == [0, 2, 3]
    assert [Cut(share, True).index((3, 4)) for share in (0, 0.5, 1)] == [0, 1, 2]
