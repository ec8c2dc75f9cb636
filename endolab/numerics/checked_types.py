"""Types that check themselves: frozen dataclasses whose annotations are also their ranges (pydantic).

    @checked
    class Light:
        gamma: Annotated[float, Field(ge=0.1, le=10)] = 2.2

    Light(2.2), Light(gamma=2.2), replace(light, gamma=2)      # as with any dataclass
    Light(gamma=-1)              # ValueError: gamma must be greater than or equal to 0.1, got -1
    from_content(Light, {"gama": 2}, "light.json")
                                 # ValueError: light.json: gama is unknown; did you mean gamma?

Truth values and text are no numbers; NumPy's numbers, arrays and lists are taken for numbers and tuples.
"""

import dataclasses
import functools
import json
from typing import Annotated, Any, TypeVar, Union, dataclass_transform

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from endolab.numerics.checks import excerpt, nearest, unknown_name

Kind = TypeVar("Kind")


def as_plain(value: Any) -> Any:
    """Make Python's own numbers and tuples of NumPy's, and of lists; leave all else, and pictures, alone."""
    if isinstance(value, np.generic) or (
        isinstance(value, np.ndarray) and value.squeeze().ndim < 2
    ):
        value = np.squeeze(value).tolist()
    return tuple(map(as_plain, value)) if isinstance(value, list | tuple) else value


def _as_whole(value: Any) -> Any:
    return int(value) if isinstance(value, float) and value.is_integer() else value


# A whole number, which JSON may write as 320.0.
Whole = Annotated[int, BeforeValidator(_as_whole)]


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field, Field))
def checked(cls: type[Kind]) -> type[Kind]:
    """Make a frozen dataclass that checks its values; ValueError, in one sentence, for what is wrong."""
    rules = ConfigDict(
        extra="forbid",
        allow_inf_nan=False,
        strict=True,
        arbitrary_types_allowed=True,
        validate_by_name=True,
    )
    made: Any = dataclass(frozen=True, config=rules)(cls)
    names = [part.name for part in dataclasses.fields(made) if not part.kw_only]
    validate = made.__init__

    @functools.wraps(validate)
    def construct(self: Any, *args: Any, **kwargs: Any) -> None:
        # By name, so that pydantic tells an argument's name, not its place.
        first = dict(zip(names, as_plain(args), strict=False))
        named = {name: as_plain(value) for name, value in kwargs.items()}
        try:
            validate(self, *args[len(names) :], **first, **named)
        except ValidationError as error:
            raise ValueError(_sentence(error, made, first | named)) from None

    made.__init__ = construct
    return made


class OneOf:
    """In ``Annotated[Base, OneOf(A, B)]``: one of these types, told apart by one of their keys."""

    def __init__(self, *kinds: type, key: str = "model") -> None:
        union: Any = Union.__getitem__(kinds)
        self.kind = Annotated[union, Field(discriminator=key)]

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        return handler.generate_schema(self.kind)


def from_content(kind: Any, content: Any, name: str) -> Any:
    """Make a value of a checked type of parsed JSON; ValueError names the file (or `name`) and the key."""
    # Half of a pair of surrogates, which JSON may escape, is no text.
    text = json.dumps(content, ensure_ascii=False).encode(errors="replace")
    try:
        return TypeAdapter(kind).validate_json(text)
    except ValidationError as error:
        raise ValueError(f"{name}: {_sentence(error, kind, content)}") from None


def to_content(value: Any) -> dict[str, Any]:
    """Return a value of a checked type as JSON holds it."""
    content: dict[str, Any] = TypeAdapter(type(value)).dump_python(value, by_alias=True)
    return content


# Sentences ------------------------------------------------------------------------------
def _sentence(error: ValidationError, kind: Any, content: Any) -> str:
    """Say what is wrong: an unknown key, else what lies deepest."""
    complaints = []
    for fault in error.errors():
        path: list[Any] = []
        inside = content
        for step in fault["loc"]:
            try:
                inside = inside[step]
            except (LookupError, TypeError):
                if (step, fault["type"]) != (fault["loc"][-1], "missing"):
                    continue  # it is the name of one of several types
            path.append(step)
        text = _complaint(fault, path, kind)
        where = "".join(f"[{one}]" if isinstance(one, int) else f".{one}" for one in path)
        joint = " " if text.startswith(("must ", "is ")) else ": "
        is_key = fault["type"] == "unexpected_keyword_argument"
        complaints.append((is_key, len(path), (where + joint + text).lstrip(" .:")))
    return max(complaints, key=lambda one: one[:2])[-1]


def _complaint(fault: Any, path: list[Any], kind: Any) -> str:
    """Say what is wrong with the value at the end of a path, or the key beyond it that tells types apart."""
    facts = {"tag": fault["input"], **fault.get("ctx", {})}
    if "discriminator" in facts:
        path.append(facts["discriminator"].strip("'"))
    if fault["type"] == "unexpected_keyword_argument":
        meant = nearest(path[-1], _keys_in(kind) - {path[-1]})
        return f"is unknown; did you mean {meant}?" if meant else "is unknown"
    # 'one', 'another' or 'a third'
    choices = facts.get("expected_tags", facts.get("expected", "")).split("'")[1::2]
    if choices:
        return str(unknown_name(path[-1], facts["tag"], choices))
    if fault["type"] in ("missing", "union_tag_not_found"):
        return "is missing"
    if fault["type"] == "value_error":
        return str(facts["error"])
    # "Input should be a valid number", and the like
    what, should, rest = fault["msg"].partition(" should")
    return f"{'must' if should else what}{rest}, got {excerpt(fault['input'])}"


def _keys_in(kind: Any) -> set[str]:
    """List the keys of a checked type and of those within it."""
    schema = TypeAdapter(kind).json_schema()
    types = (schema, *schema.get("$defs", {}).values())
    return {key for one in types for key in one.get("properties", ())}
