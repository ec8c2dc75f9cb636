"""Targets: the printed code, bare paper that is bare, and features in OpenCV's own order."""

import cv2
import numpy as np
import pytest
from scipy.spatial.distance import pdist

from endolab.calibration.targets import TARGETS, Charuco, DotGrid, darkness
from tests.tools.sheet_views import reflectance

BIG = TARGETS["vicalib_big"]


def flat(target, dots=10):
    """The sheet scanned at so many dots a millimetre, 8 bits, and how to get to mm from pixels."""
    left, top, width, height = target.sheet
    shape = round(height * dots), round(width * dots)
    white = 1 - darkness(target.ink, (left, top), shape, 1 / dots)
    image = np.round(255 * white).astype(np.uint8)
    return image, lambda pixel: (pixel + 0.5) / dots + [left, top]


def test_the_code_is_vicalibs_the_top_bit_of_a_mersenne_twister():
    assert "".join(map(str, BIG.code[0])) == "0100110011101010100"
    generator = np.random.MT19937()
    generator._legacy_seeding(71)
    np.testing.assert_array_equal(BIG.code.ravel(), generator.random_raw(190) >> 31)


@pytest.mark.parametrize(
    "target",
    [
        *TARGETS.values(),
        Charuco(9, 6, 5.0, fold=4, marker=3.7),
        Charuco(6, 4, 5.0, marker=3.7, legacy=True),
    ],
)
def test_the_raster_is_the_reflectance_averaged(target):
    corner = np.array([-2.13, -1.57])
    step = 0.31
    sub = 8
    shape = 40, 50
    fine = (np.indices((shape[0] * sub, shape[1] * sub))[::-1] + 0.5) * step / sub
    value = reflectance(target, np.moveaxis(fine, 0, -1) + corner, black=0.1)
    truth = 1 - value.reshape(shape[0], sub, shape[1], sub).mean(axis=(1, 3))
    found = darkness(
        target.ink,
        corner,
        shape,
        step,
        0.1,
    )
    assert np.abs(found - truth).max() < 0.13  # 8 × 8 points, and the rim within a cell
    assert np.sqrt(np.mean((found - truth) ** 2)) < 0.025
    assert found.mean() == pytest.approx(truth.mean(), abs=3e-3)


@pytest.mark.parametrize(
    "target",
    [
        *TARGETS.values(),
        DotGrid(9, 8, 1.0, fold=4, small=0.2, large=0.3, greys=0.4),
    ],
)
def test_white_places_are_bare_and_apart(target):
    places = target.white_places()
    angle = np.linspace(0, 2 * np.pi, 49)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    for share in (0.5, 0.999):
        around = places[:, None, :2] + share * places[:, None, 2:] * ring
        assert np.all(reflectance(target, around) == 1)
        assert np.all(target.panel_of(around) == target.panel_of(places)[:, None])
    assert places[:, 2].min() >= 0.04 * target.spacing
    assert pdist(places[:, :2]).min() >= target.spacing / 2 * (1 - 1e-9)
    assert len(places) > 0.3 * len(target.points)


def test_charuco_ids_are_opencvs():
    for target in (
        TARGETS["charuco"],
        Charuco(7, 5, 8.0, marker=6.0, dictionary="DICT_4X4_50"),
        Charuco(7, 6, 8.0, marker=6.0, first_id=31),
    ):
        image, to_mm = flat(target)
        corners, ids, _, _ = cv2.aruco.CharucoDetector(target.board).detectBoard(image)
        assert sorted(ids.ravel()) == list(range(len(target.points)))
        known = target.points[ids.ravel(), :2]
        np.testing.assert_allclose(to_mm(corners.reshape(-1, 2)), known, atol=0.05)


@pytest.mark.parametrize("shape", [(7, 6), (6, 4), (7, 5)])
def test_the_old_charuco_pattern_is_opencvs(shape):
    """OpenCV's own picture of it, at the same scale."""
    target = Charuco(*shape, 9.0, margin=4.0, marker=7.0, legacy=True)
    image, _ = flat(target)
    size = image.shape[::-1]
    np.testing.assert_array_equal(target.board.generateImage(size, None, 40), image)


def test_corners_are_in_opencvs_order():
    target = TARGETS["chessboard"]
    image, to_mm = flat(target)
    corners = target.columns - 1, target.rows - 1
    _, places = cv2.findChessboardCornersSB(image, corners)
    places = to_mm(places.reshape(-1, 2))
    # It looks the same upside down: OpenCV may begin at the other end.
    if np.hypot(*places[0]) > target.spacing:
        places = places[::-1]
    np.testing.assert_allclose(places, target.points[:, :2], atol=0.05)
