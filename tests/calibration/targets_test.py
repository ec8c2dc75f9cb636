"""Targets: the printed code, bare paper that is bare, and OpenCV's own boards."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from endolab.calibration.simulation.video import BLACK, rasterise
from endolab.calibration.targets import TARGETS, Charuco, DotGrid
from tests.tools.sheet_views import reflectance


def test_the_code_is_vicalibs_the_top_bit_of_a_mersenne_twister():
    code = TARGETS["vicalib_big"].code
    assert "".join(map(str, code[0])) == "0100110011101010100"
    generator = np.random.MT19937()
    generator._legacy_seeding(71)
    np.testing.assert_array_equal(code.ravel(), generator.random_raw(190) >> 31)


@pytest.mark.parametrize(
    "target",
    [*TARGETS.values(), DotGrid(9, 8, 1.0, fold=4, small=0.2, large=0.3, greys=0.4)],
)
def test_white_places_are_bare_and_apart(target):
    places = target.white_places()
    angle = np.linspace(0, 2 * np.pi, 49)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    around = places[:, None, :2] + 0.999 * places[:, None, 2:] * ring
    assert np.all(reflectance(target, around) == 1)
    assert np.all(target.panel_of(around) == target.panel_of(places)[:, None])
    assert places[:, 2].min() >= 0.04 * target.spacing
    assert pdist(places[:, :2]).min() >= target.spacing / 2 * (1 - 1e-9)
    assert len(places) > 0.3 * len(target.points)


@pytest.mark.parametrize("shape", [(7, 6), (6, 4), (7, 5)])
@pytest.mark.parametrize("legacy", [False, True])
def test_charuco_boards_are_opencvs(shape, legacy):
    """Its own picture of each, at 10 pixels a millimetre."""
    target = Charuco(*shape, 9.0, margin=4.0, marker=7.0, legacy=legacy)
    raster, step = rasterise(target)
    size = raster.shape[::-1]
    expected = target.board.generateImage(size, None, round(4.0 / step))
    black = raster < (1 + BLACK) / 2
    assert np.mean(black != (expected < 128)) < 1e-3
