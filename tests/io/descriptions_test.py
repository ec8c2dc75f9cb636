"""Descriptions of targets come back from their files."""

import json

import pytest

from endolab.calibration.targets import TARGETS, DotGrid
from endolab.io.descriptions import read_target
from endolab.numerics.checked_types import to_content
from tests.tools.sheet_views import OTHER_TARGETS as OTHERS

DOTS = {"kind": "dots", "columns": 5, "rows": 4, "spacing": 6, "small": 1, "large": 2}


@pytest.mark.parametrize("target", [*TARGETS.values(), *OTHERS])
def test_a_written_target_comes_back(target, tmp_path):
    (tmp_path / "sheet.json").write_text(json.dumps(to_content(target)))
    assert read_target(tmp_path / "sheet.json") == target


@pytest.mark.parametrize(
    "more", [{}, {"fold": None, "margin": None}, {"inverted": False}]
)
def test_the_least_description_takes_the_defaults_and_null_means_absent(more, tmp_path):
    """And what 0.2.0 wrote is read: that a sheet is not inverted."""
    path = tmp_path / "sheet.json"
    path.write_text(json.dumps({"endolab_target": 1} | DOTS | more))
    assert read_target(path) == DotGrid(5, 4, 6.0, small=1.0, large=2.0)
