"""Descriptions of targets come back from their files."""

import json

import pytest

from endolab.calibration.targets import TARGETS, Charuco, Chessboard
from endolab.io.descriptions import read_target
from endolab.numerics.checked_types import to_content
from tests.tools.sheet_views import OTHER_TARGETS as OTHERS


@pytest.mark.parametrize("target", [*TARGETS.values(), *OTHERS])
def test_a_written_target_comes_back(target, tmp_path):
    (tmp_path / "sheet.json").write_text(json.dumps(to_content(target)))
    assert read_target(tmp_path / "sheet.json") == target


@pytest.mark.parametrize(
    ("words", "target"),
    [
        ("chessboard:14x9:3mm", Chessboard(14, 9, 3.0)),
        ("chessboard:7x10:2.5", Chessboard(7, 10, 2.5)),
        (
            "charuco:11x8:15mm:11mm:4X4_50",
            Charuco(11, 8, 15.0, marker=11.0, dictionary="DICT_4X4_50"),
        ),
        (
            "charuco:6x4:5mm:3.7mm:DICT_5X5_250:legacy",
            Charuco(6, 4, 5.0, marker=3.7, legacy=True),
        ),
    ],
)
def test_a_board_is_named_as_it_is_bought(words, target):
    assert read_target(words) == target
