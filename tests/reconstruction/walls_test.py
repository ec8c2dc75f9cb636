"""Light that has bounced: the exchange between patches, and how much it adds to a picture."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from endolab import datasets
from endolab.reconstruction import constants
from endolab.reconstruction.walls import Walls, exchange_between
from endolab.synthetic.scenes import Colon


def ball():
    """Patches of the inside of a ball of 20 mm around the origin, all of one area."""
    count = 600
    z = 1 - (2 * np.arange(count) + 1) / count
    around = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    out = np.column_stack(
        [np.sqrt(1 - z**2) * np.cos(around), np.sqrt(1 - z**2) * np.sin(around), z]
    )
    return 20 * out, -out, np.full(count, 4 * np.pi * 20**2 / count)


def open_cells(count):
    return np.zeros((count, 2)), np.full((1, 1), np.inf)


@pytest.fixture(scope="module")
def colon():
    """A haustral colon through a 90° pinhole, 160 x 120 px."""
    field = datasets.load_calibration("simple", 160).camera.field
    return np.log(Colon().distance(field.rays)), field


def walls_of(v, field, k=2.5):
    return Walls.of(v, np.isfinite(v), field, k)


@pytest.fixture(scope="module")
def walls(colon):
    return walls_of(*colon)


def test_bounced_light_does_not_follow_the_lamps_from_pixel_to_pixel(colon, walls):
    v, field = colon
    ratio = np.where(np.arange(v.shape[1]) % 2, 1.5, 0.5) * np.ones(v.shape)
    aside = Walls.of(v, np.isfinite(v), field, walls.k, lamp_ratio=ratio)
    assert_allclose(
        ratio * aside.indirect_ratio(0.4), walls.indirect_ratio(0.4), rtol=0.1
    )


def test_in_a_closed_ball_bounced_light_is_the_same_everywhere():
    """An integrating sphere: S = mean E · ρ/(1 - ρ), wherever the light fell first."""
    x, n, area = ball()
    exchange = exchange_between(x, n, area, *open_cells(len(x)))
    # In a ball F_ij is A_j over the whole area, whatever i and j.
    assert_allclose(
        exchange.sum(axis=1), 1.0, atol=0.012
    )  # 1 % is lost between neighbours
    lit = np.where(x[:, 2] > 10.0, 1.0, 0.0)
    one = np.ones((1, len(x)))
    walls = Walls(x, n, area, lit, exchange, one > 0, one, one, 0.0)
    for albedo in (0.3, 0.6):
        expected = lit.mean() * albedo / (1 - albedo)
        assert np.mean(walls.bounced_light(albedo)) == pytest.approx(expected, rel=0.04)
        assert np.ptp(walls.bounced_light(albedo)) < 0.05 * expected


def test_light_is_exchanged_both_ways_and_none_is_made(walls):
    assert walls.exchange.sum(axis=1).max() <= 1 + 1e-12
    raw = exchange_between(
        walls.points, walls.normals, walls.area, *open_cells(len(walls.points))
    )
    given = walls.area[:, None] * raw
    assert_allclose(given, given.T, rtol=1e-9)


def test_the_share_of_bounced_light_knows_no_unit_and_grows_with_the_albedo(
    colon, walls
):
    v, field = colon
    larger = walls_of(v + np.log(7.0), field)
    green, red = (walls.indirect_ratio(albedo) for albedo in (0.38, 0.75))
    assert_allclose(larger.indirect_ratio(0.38), green, rtol=1e-9)
    assert np.all((green > 0) & (green < red), where=np.isfinite(v))
    assert np.isfinite(red).all()


def test_light_by_bounces_sums_to_that_of_the_balance(walls):
    """S = ρ F (E + S) + ρ h S, h being walls that no patch sees: solved at once, beside its series."""
    hidden = constants.HIDDEN * np.maximum(1 - walls.exchange.sum(axis=1), 0.0)
    assert hidden.max() > 0.05
    for albedo in (0.1, 0.38, 0.75):
        left = np.eye(len(hidden)) - albedo * (walls.exchange + np.diag(hidden))
        expected = np.linalg.solve(left, albedo * walls.exchange @ walls.lit)
        assert_allclose(walls.bounced_light(albedo), expected, rtol=0.01)


def test_another_lamps_spread_is_as_if_made_with_it(colon, walls):
    v, field = colon
    mask = np.isfinite(v)
    even = walls_of(v, field, 0.0)
    turned = walls.under(0.0)
    assert_allclose(turned.direct, even.direct, rtol=1e-9)
    assert_allclose(turned.lit, even.lit, rtol=0.05)  # by the patches' centres
    by_even, by_turned, by_spot = (
        lit.indirect_ratio(0.38)[mask] for lit in (even, turned, walls)
    )
    assert_allclose(by_turned, by_even, rtol=0.02)
    # A lamp that shines evenly lights the walls beside the camera, too.
    assert np.median(by_even / by_spot) > 1.3


def test_a_nearer_wall_blocks():
    """Two patches that face each other, and a third cell between them, far or near."""
    x = np.array([[-5.0, 0, 10], [5.0, 0, 10]])
    n = np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    cells = np.array([[0, 0], [0, 2]])
    for between, is_seen in ((12.0, True), (8.0, False)):
        nearest = np.array([[11.2, between, 11.2]])
        assert (exchange_between(x, n, np.ones(2), cells, nearest) > 0).any() == is_seen
