"""Descriptions of targets come back from their files, and what is wrong with one is said."""

import json

import pytest

from endolab.calibration.targets import TARGETS, DotGrid
from endolab.io.descriptions import read_target, write_target
from tests.tools.sheet_views import OTHER_TARGETS as OTHERS

DOTS = {
    "endolab_target": 1,
    "kind": "dots",
    "columns": 5,
    "rows": 4,
    "spacing": 6,
    "small": 1,
    "large": 2,
}
# What makes one of it.
CHARUCO = {
    "kind": "charuco",
    "small": ...,
    "large": ...,
    "marker": 4,
}


def written(tmp_path, **changes):
    """A description with some of its keys changed, or left out for an ellipsis."""
    content = {
        key: value for key, value in (DOTS | changes).items() if value is not ...
    }
    path = tmp_path / "sheet.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


@pytest.mark.parametrize("target", [*TARGETS.values(), *OTHERS])
def test_a_written_target_comes_back(target, tmp_path):
    write_target(target, tmp_path / "sheet.json")
    assert read_target(tmp_path / "sheet.json") == target


def test_the_least_description_takes_the_defaults_null_means_absent_and_known_names_need_no_file(
    tmp_path,
):
    least = DotGrid(5, 4, 6.0, small=1.0, large=2.0)
    assert (
        read_target(written(tmp_path))
        == read_target(written(tmp_path, fold=None, greys=None))
        == least
    )
    assert read_target("vicalib_big") is TARGETS["vicalib_big"]


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"small": ...}, "small"),
        ({"endolab_target": True}, "endolab_target"),
        ({"kind": ["dots"]}, "kind"),
        ({"colour": "red"}, "colour"),
        ({"columns": 5.5}, "columns"),
        ({"columns": 1}, "columns"),
        ({"rows": True}, "rows"),
        ({"spacing": -1}, "spacing"),
        ({"large": 9}, "radii"),
        ({"seed": 2**40}, "seed"),
        ({"kind": "circles", "small": ..., "large": ...}, "radius"),
        (CHARUCO | {"dictionary": 3}, "dictionary"),
        (CHARUCO | {"marker": 8}, "marker"),
    ],
)
def test_what_is_wrong_with_a_description_is_said_with_file_and_key(
    changes, named, tmp_path
):
    with pytest.raises(ValueError, match=rf"^[^\n]*sheet\.json: [^\n]*{named}[^\n]*$"):
        read_target(written(tmp_path, **changes))


def test_an_unknown_name_lists_those_that_are_known_and_a_missing_file_is_named(
    tmp_path,
):
    with pytest.raises(ValueError, match=r"'vicalib'.*vicalib_big, vicalib_small"):
        read_target("vicalib")
    with pytest.raises(FileNotFoundError, match=r"none\.json"):
        read_target(tmp_path / "none.json")
