"""Targets: the printed code, bare paper that is bare, and features in OpenCV's own order."""

import cv2
import numpy as np
import pytest
from scipy.spatial.distance import pdist

from endolab.calibration.targets import (
    TARGETS,
    AprilGrid,
    Charuco,
    Chessboard,
    CircleGrid,
    DotGrid,
    darkness,
)
from tests.tools.sheet_views import reflectance

BIG = TARGETS["vicalib_big"]
GOOD = {
    DotGrid: {"columns": 6, "rows": 5, "spacing": 5.0, "small": 1.0, "large": 1.5},
    CircleGrid: {"columns": 4, "rows": 11, "spacing": 5.0, "radius": 2.0},
    Chessboard: {"columns": 8, "rows": 6, "spacing": 5.0},
    Charuco: {"columns": 8, "rows": 6, "spacing": 5.0, "marker": 3.5},
    AprilGrid: {"columns": 4, "rows": 3, "spacing": 6.5, "marker": 5.0},
}
WHITE_ON_BLACK = [
    DotGrid(9, 8, 5.0, small=1.0, large=1.5, inverted=True),
    CircleGrid(4, 7, 2.0, radius=0.8, symmetric=True, inverted=True),
    Charuco(6, 4, 5.0, marker=3.7, legacy=True, inverted=True),
]


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
        *WHITE_ON_BLACK,
        Charuco(9, 6, 5.0, fold=4, marker=3.7),
        AprilGrid(4, 3, 6.5, marker=5.0),
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
        *WHITE_ON_BLACK,
        DotGrid(9, 8, 1.0, fold=4, small=0.2, large=0.3, greys=0.4),
        AprilGrid(4, 3, 6.5, marker=5.0),
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


def test_the_tags_of_an_aprilgrid_are_opencvs_and_numbered_from_the_lower_left():
    target = AprilGrid(4, 3, 6.5, marker=5.0, squares=False, first_id=7, border=1)
    image, to_mm = flat(target)
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    corners, ids, _ = cv2.aruco.ArucoDetector(markers).detectMarkers(image)
    assert sorted(ids.ravel()) == list(range(7, 19))
    for tag, found in zip(ids.ravel() - 7, corners, strict=True):
        known = target.points[target.tag_corners[tag], :2]
        np.testing.assert_allclose(to_mm(found[0]), known, atol=0.1)
        row, column = divmod(tag, 4)
        np.testing.assert_allclose(known[0], [6.5 * column, 6.5 * (2 - row)])


@pytest.mark.parametrize(
    "name",
    ["chessboard", "circles"],
)
def test_corners_and_circles_are_in_opencvs_order(name):
    target = TARGETS[name]
    image, to_mm = flat(target)
    if name == "chessboard":
        corners = target.columns - 1, target.rows - 1
        _, places = cv2.findChessboardCornersSB(image, corners)
    else:
        grid = target.columns, target.rows
        _, places = cv2.findCirclesGrid(image, grid, flags=cv2.CALIB_CB_ASYMMETRIC_GRID)
    places = to_mm(places.reshape(-1, 2))
    # Both look the same upside down: OpenCV may begin at the other end.
    if np.hypot(*places[0]) > target.spacing:
        places = places[::-1]
    np.testing.assert_allclose(places, target.points[:, :2], atol=0.05)


@pytest.mark.parametrize(
    ("make", "key", "value"),
    [
        *((make, "columns", value) for make in GOOD for value in (1, 101, 5.5, "5")),
        *((make, "spacing", value) for make in GOOD for value in (0.0, np.nan, 1e300)),
        (DotGrid, "small", 0.0),
        (DotGrid, "small", 2.0),
        (DotGrid, "seed", -1),
        (DotGrid, "seed", 2**32),
        (DotGrid, "greys", 1.0),
        (DotGrid, "fold", 1),
        (DotGrid, "fold", 2.5),
        (CircleGrid, "radius", 3.6),
        (CircleGrid, "fold", 2),
        (CircleGrid, "symmetric", "yes"),
        (AprilGrid, "inverted", True),
        (AprilGrid, "fold", 2),
        (AprilGrid, "border", 3),
        (AprilGrid, "first_id", 576),
        (Charuco, "first_id", 227),
        (Chessboard, "fold", 2),
        (Charuco, "marker", 5.0),
        (Charuco, "dictionary", "DICT_9X9_1"),
    ],
)
def test_wrong_values_are_named(make, key, value):
    with pytest.raises(ValueError, match=f"{key}|fold"):
        make(**(GOOD[make] | {key: value}))
