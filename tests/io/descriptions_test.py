"""Descriptions of targets come back from their files, and what is wrong with one is said."""

import json
import re

import pytest

from endolab.calibration.targets import TARGETS, DotGrid
from endolab.io.descriptions import read_target, write_target
from tests.tools.sheet_views import OTHER_TARGETS as OTHERS

DOTS = {"endolab_target": 1, "kind": "dots", "columns": 5, "rows": 4, "spacing": 6, "small": 1, "large": 2}
CHARUCO = {"kind": "charuco", "small": None, "large": None, "marker": 4}  # what makes one of it


@pytest.mark.parametrize("target", [*TARGETS.values(), *OTHERS])
def test_a_written_target_comes_back(target, tmp_path):
    path = tmp_path / "sheet.json"
    write_target(target, path)
    assert read_target(path) == read_target(str(path)) == target


def test_the_least_description_takes_the_defaults_null_means_absent_and_known_names_need_no_file(tmp_path):
    least = DotGrid(5, 4, 6.0, small=1.0, large=2.0)
    path = written(tmp_path)
    assert read_target(path) == least
    path.write_text(json.dumps(DOTS | {"fold": None, "greys": None}), encoding="utf-8")
    assert read_target(path) == least
    assert read_target("vicalib_big") is TARGETS["vicalib_big"]


def written(tmp_path, **changes):
    """A description with some of its keys changed, or left out for None."""
    content = {key: value for key, value in (DOTS | changes).items() if value is not None}
    path = tmp_path / "sheet.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"spacing": None}, "spacing: missing"),
        ({"small": None}, "small: missing"),
        ({"endolab_target": None}, "endolab_target: missing"),
        ({"endolab_target": 2}, "endolab_target: expected version 1, found 2"),
        ({"endolab_target": True}, "endolab_target: expected version 1"),
        ({"kind": None}, "kind: missing"),
        ({"kind": "hexagons"}, "kind: expected one of dots, circles, chessboard, charuco"),
        ({"kind": ["dots"]}, "kind: expected one of"),
        ({"colour": "red"}, "colour: unknown key"),
        ({"radius": 1.0}, "radius: unknown key"),
        ({"columns": 5.5}, "columns: expected a whole number, found 5.5"),
        ({"columns": "5"}, "columns: expected a finite number"),
        ({"columns": 1}, "columns must be a whole number from 2 to 100, got 1"),
        ({"rows": True}, "rows: expected a finite number"),
        ({"spacing": -1}, "spacing: expected a positive number"),
        ({"margin": 0}, "margin: expected a positive number"),
        ({"large": 9}, "the radii must be"),
        ({"seed": 2**40}, "seed must be a whole number"),
        ({"seed": -1}, "seed: expected at least 0"),
        ({"fold": "middle"}, "fold: expected a finite number"),
        ({"kind": "circles"}, "radius: missing"),
        (CHARUCO | {"dictionary": 3}, "dictionary: expected"),
        (CHARUCO | {"marker": 8}, "marker must be positive and below"),
    ],
)
def test_what_is_wrong_with_a_description_is_said_with_file_and_key(changes, complaint, tmp_path):
    path = written(tmp_path, **changes)
    with pytest.raises(ValueError, match=re.escape(complaint)) as caught:
        read_target(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"{", "not valid JSON"),
        (b"[1]", "expected an object"),
        (b"\xff\xfe", "not UTF-8"),
        (b"", "not valid"),
    ],
)
def test_a_file_that_is_no_description_is_refused(content, complaint, tmp_path):
    path = tmp_path / "sheet.json"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=complaint):
        read_target(path)


def test_an_unknown_name_lists_those_that_are_known_and_a_missing_file_is_named(tmp_path):
    with pytest.raises(ValueError, match="unknown target 'vicalib'; choose vicalib_big, vicalib_small"):
        read_target("vicalib")
    with pytest.raises(FileNotFoundError, match="no such target file"):
        read_target(tmp_path / "none.json")
