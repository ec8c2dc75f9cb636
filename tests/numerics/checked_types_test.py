"""Types that check themselves: what they take, and one sentence about anything else."""

import pickle
from dataclasses import field, replace
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from pydantic import Field

from endolab.numerics.checked_types import (
    OneOf,
    Whole,
    checked,
    from_content,
    to_content,
)

Share = Annotated[float, Field(ge=0, le=1)]


@checked
class Matt:
    model: Literal["matt"] = field(default="matt", kw_only=True)
    albedo: Share | tuple[Share, Share, Share] = 1.0


@checked
class Table:
    model: Literal["table"] = field(default="table", kw_only=True)
    values: tuple[Share, ...] = Field(alias="value")


@checked
class Light:
    k: Share = 0.5
    gain: float | None = None
    wall: Annotated[Any, OneOf(Matt, Table)] = field(default_factory=Matt)
    count: Whole = 3


LIGHT = Light(0.25, 2, Table([0.5, 1]), count=np.int64(4))


def test_it_is_a_dataclass_that_takes_numpys_numbers_and_lists():
    assert Light(k=0.25, gain=2.0, wall=Table((0.5, 1.0)), count=4.0) == LIGHT
    assert Light(np.float32(0.25), np.array(2), Table(np.array([0.5, 1])), 4) == LIGHT
    assert replace(LIGHT, k=1).k == 1.0
    assert pickle.loads(pickle.dumps(LIGHT)) == LIGHT
    assert hash(replace(LIGHT)) == hash(LIGHT)
    assert from_content(Light, to_content(LIGHT), "light.json") == LIGHT


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"k": 2}, "k must be at most 1, got 2"),
        ({"k": True}, "k must be a valid number, got True"),
        ({"k": "0.5"}, "k must be a valid number"),
        ({"k": float("nan")}, "k must be a finite number"),
        ({"count": 3.5}, "count must be a valid integer"),
        ({"gian": 1}, "gian is unknown; did you mean gain?"),
        (
            {"wall": {"model": "matt", "albdo": 1}},
            "wall.albdo is unknown; did you mean",
        ),
        ({"wall": {"model": "matt", "albedo": [1, 1]}}, "wall.albedo[2] is missing"),
        ({"wall": {"model": "table", "value": [1, 7]}}, "wall.value[1] must be"),
        ({"wall": {"model": "table"}}, "wall.value is missing"),
        ({"wall": {"model": "mat"}}, "wall: unknown model 'mat'"),
        ({"wall": {}}, "wall: "),
        ([], "must be an object"),
    ],
)
def test_what_is_wrong_in_a_file_is_said_with_file_and_key(content, words):
    with pytest.raises(ValueError, match=r"^light\.json: ") as caught:
        from_content(Light, content, "light.json")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((7,), "k must be at most 1, got 7"),
        ((0, 1, Light()), "wall"),
        ((0,) * 9, "wall"),
    ],
)
def test_what_is_wrong_with_an_argument_is_said_with_its_name(arguments, words):
    with pytest.raises(ValueError, match=words):
        Light(*arguments)
